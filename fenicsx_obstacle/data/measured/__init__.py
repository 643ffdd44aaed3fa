"""Measured data: tables from files and arrays, interpolated and enclosed.

A table is bilinear on the rectangles of a grid, so that bounds of it over whole cells are exact, or linear on triangles
between points that are no grid; these are known by samples alone.
"""
