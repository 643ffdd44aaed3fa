"""Accuracy of a solution: error norms, contact sets, forces, error bounds, reference problems.

Contents: errors, bounds and contact of a given solution. Not here: solving and refining; only `answers` uses both
solvers and estimates.
"""
