"""Lengths, areas and volumes of many simplices. Without DOLFINx, since the process of Gmsh is no rank."""

from __future__ import annotations

from itertools import combinations
from math import factorial

import numpy as np


def volumes(corners: np.ndarray) -> np.ndarray:
    """Lengths, areas or volumes of simplices given by their corners (n, vertices, 3); 1 for points."""
    edges = corners[:, 1:] - corners[:, :1]
    dim = edges.shape[1]
    return spanned(edges) / factorial(dim) if dim else np.ones(len(corners))


def spanned(edges: np.ndarray) -> np.ndarray:
    """What 1 to 3 vectors span, shape (n, vectors, 3): their length, or area or volume of a parallelepiped.

    Accurate for vectors that are nearly parallel, which a determinant of their inner products is not.
    """
    if edges.shape[1] == 1:
        return lengths(edges[:, 0])
    (a, b, c), (u, v, w) = edges[:, 0].T, edges[:, 1].T
    across = np.stack([b * w - c * v, c * u - a * w, a * v - b * u], axis=1)
    return lengths(across) if edges.shape[1] == 2 else np.abs(np.einsum("ni,ni->n", across, edges[:, 2]))


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Of the last axis."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def edge_lengths(corners: np.ndarray) -> np.ndarray:
    """Lengths of the edges of simplices given by their corners (n, vertices, 3), shape (n, edges)."""
    pairs = combinations(range(corners.shape[1]), 2)
    return np.stack([lengths(corners[:, i] - corners[:, j]) for i, j in pairs], axis=1)


def sizes(corners: np.ndarray) -> np.ndarray:
    """dim! times the volume over the longest edge to the power dim."""
    edges, longest = corners[:, 1:] - corners[:, :1], edge_lengths(corners).max(axis=1)
    return spanned(edges / np.maximum(longest, np.finfo(float).tiny)[:, None, None])
