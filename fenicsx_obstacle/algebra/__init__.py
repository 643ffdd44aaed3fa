"""The discrete obstacle problem as matrices and arrays, and its solvers by PETSc SNES.

Contents: the system, the penalty and the variational inequality, stopping tests, multigrid, algebraic coarse levels,
`solve_system`. Not here: meshes, forms (nothing of DOLFINx or UFL), errors and bounds, files.
"""
