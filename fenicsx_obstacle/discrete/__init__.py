"""A scene on a mesh: levels, nodal data and the discrete problem.

Enters: meshes and their hierarchy, samples of formulas, matrices, the residual of one level. Stays out: iterations, and
figures of an answer. Levels own meshes; a problem borrows one.
"""
