"""Solutions of scenes: solver context, adaptive refinement, time stepping, saved folders.

Enters: what puts levels, solvers and estimates together for one answer. Stays out: several answers in a row; pictures,
but for the late import of `Answer.plot`.
"""
