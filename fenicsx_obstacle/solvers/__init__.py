"""Solvers of one discrete problem by PETSc SNES: the penalty and the variational inequality."""
