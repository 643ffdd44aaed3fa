"""Measured data: tables from files and arrays, interpolated and enclosed.

A table is linear on triangles or bilinear on the rectangles of a grid, so that bounds of it over whole cells are exact.
"""
