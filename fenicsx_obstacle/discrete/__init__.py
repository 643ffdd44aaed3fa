"""A model on a mesh: levels, sampled data and the discrete problem.

Contents: meshes and their hierarchy, data of any kind, matrices, the residual on one mesh. Not here: scenes, whose
formulas are data like any others in this layer; iterations; output quantities. Levels own meshes; a problem uses one.
"""
