"""Solvers of one discrete problem by PETSc SNES: the penalty and the variational inequality.

Enters: iterations, preconditioners, when to stop. Stays out: the making of meshes (solvers never refine), errors and
bounds, files.
"""
