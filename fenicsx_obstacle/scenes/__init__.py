"""Scenes, from TOML or Python: tables, formulas and catalogues, from which models and meshes are made.

Contents: checks that need no mesh, with the place in the file; meshes from [mesh]; output quantities of [report].
Reading a scene imports neither DOLFINx nor PETSc, so that a mistake is reported at once.
"""
