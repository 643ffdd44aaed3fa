"""Meshes: shapes, files, refinement, checks, points and parts.

Contents: levels, which are meshes with their spaces, and the levels that they were refined from; Gmsh and CAD; the
search for points. Not here: data of a problem.
"""
