"""The discrete paper: quadrature rules (3.5)-(3.6) and the penalised residual (3.4), as pure UFL.

Enters: what can be written down for any mesh. Stays out: scenes, effects, meshes, matrices, anything that is solved.
"""
