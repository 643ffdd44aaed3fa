"""The data of a model, sampled on a mesh and checked.

Contents: fields from numbers, Functions, UFL expressions, callables and measured data; obstacles, boundary values and
data in cells; the model itself, with its time discretization. Not here: formulas of scenes, which are fields like any
others in this layer; matrices.
"""
