"""Scenes, from TOML or Python: tables, formulas and catalogues, from which models and meshes are made.

Enters: what can be checked before a mesh exists, with the place in the file; meshes from [mesh], figures of
[report]. Reading a scene imports neither DOLFINx nor PETSc, so that a mistake in it is told at once.
"""
