"""Solvers of one discrete problem by PETSc SNES: the penalty and the variational inequality.

Contents: iterations, preconditioners, stopping tests. Not here: creation of meshes (solvers never refine), errors and
bounds, files.
"""
