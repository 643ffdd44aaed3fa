"""Solutions of scenes: solver context, adaptive refinement, time stepping, saved folders.

Contents: levels, solvers and estimates combined for one solution. Not here: several solutions in a row, which are
`studies`; pictures, except for the late import in `Answer.plot`.
"""
