"""A model on a mesh: levels, sampled data and the discrete problem.

Enters: meshes and their hierarchy, data of any kind, matrices, the residual on one mesh. Stays out: scenes, whose
formulas are data like others here; iterations, and figures of an answer. Levels own meshes; a problem borrows one.
"""
