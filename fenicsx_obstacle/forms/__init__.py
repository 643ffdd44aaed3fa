"""The discrete paper: quadrature rules (3.5)-(3.6) and the penalised residual (3.4), as pure UFL.

Contents: forms that are the same on any mesh. Not here: scenes, effects, meshes, matrices, solving.
"""
