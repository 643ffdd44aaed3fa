"""The discrete problem of a model on a mesh: a `System` from effects or a form, with its levels and checks.

Contents: matrices and residuals, the levels that a problem is solved on, contact nodes and rigid motions of bodies.
Not here: iterations; output quantities.
"""
