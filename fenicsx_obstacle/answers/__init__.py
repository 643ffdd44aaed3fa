"""From a scene to an answer: the choice of solver, the frozen result, the saved folder.

Enters: what puts levels, solvers and estimates together for one answer. Stays out: several answers in a row; pictures,
but for the late import of `Answer.plot`.
"""
