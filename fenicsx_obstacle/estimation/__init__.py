"""Accuracy of a solution: error norms, contact sets, forces, error bounds, reference problems.

Enters: what measures a state that is there. Stays out: what solves or refines; only `answers` sees both solvers and
estimates.
"""
