"""Reading a scene: TOML tables, formulas and the shapes of domains.

Enters: what can be known and refused before a mesh exists, with the place in the file. Stays out: DOLFINx and PETSc, so
that a mistake in a scene is told at once.
"""
