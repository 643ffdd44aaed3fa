"""Raviart and Thomas' space RT1 on the reference triangle, and integrals of hats and quadratics: tables alone.

Functions of RT1 are given on the reference triangle (Piola) by eight moments: of each edge i, opposite to vertex i and
run through from vertex i + 1 to i + 2, the flux F_i out of it and its moment G_i with 2 s - 1; then int sigma.
"""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.estimation.quadrature import rule

MASS = (np.ones((3, 3)) + np.eye(3)) / 12  # int psi_j psi_k over the area
_KINDS = {1: 2 / 120, 2: 4 / 120, 3: 12 / 120}
TRIPLES = np.array(
    [[[_KINDS[4 - len({i, j, k})] for k in range(3)] for j in range(3)] for i in range(3)]
)  # int psi_i psi_j psi_k over the area
MIDDLES = MASS[None] - 2 * TRIPLES  # int (1 - 2 psi_m) psi_j psi_k: of the multiplier at middle m, opposite to vertex m


def _basis() -> np.ndarray:
    """The eight functions dual to the moments, as coefficients of the monomials of `_monomials`, shape (8, 8)."""
    s, w = np.polynomial.legendre.leggauss(4)
    s, w = (s + 1) / 2, w / 2
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rows = []
    for i in range(3):
        start, end = corners[(i + 1) % 3], corners[(i + 2) % 3]
        x = start + s[:, None] * (end - start)
        out = np.array([(end - start)[1], -(end - start)[0]])  # its length is the edge's
        flux = np.einsum("x,mpx->mp", out, _monomials(x))
        rows += [flux @ w, flux @ (w * (2 * s - 1))]
    points, weights = rule(2)
    inside = np.einsum("mpx,p->xm", _monomials(points[:, 1:]), weights / 2)
    return np.linalg.inv(np.vstack([*rows, inside]))


def _monomials(x: np.ndarray) -> np.ndarray:
    """Eight vector fields that span RT1 at reference points (n, 2), shape (8, n, 2)."""
    X, Y = x.T
    one, zero = np.ones_like(X), np.zeros_like(X)
    pairs = [(one, zero), (zero, one), (X, zero), (Y, zero), (zero, X), (zero, Y), (X * X, X * Y), (X * Y, Y * Y)]
    return np.stack([np.stack(pair, axis=1) for pair in pairs])


BASIS = _basis()


def reference_fields(where: np.ndarray) -> np.ndarray:
    """The eight functions at barycentric points (n, 3), shape (8, n, 2)."""
    return np.einsum("md,mpx->dpx", BASIS, _monomials(where[:, 1:]))


def _grams() -> np.ndarray:
    """Gram matrices of their components, xx, xy + yx, yy, shape (3, 8, 8)."""
    points, weights = rule(2)
    fields = reference_fields(points)
    products = np.einsum("ipx,jpy,p->xyij", fields, fields, weights / 2)
    return np.stack([products[0, 0], products[0, 1] + products[1, 0], products[1, 1]])


GRAMS = _grams()
# fluxes of a corner a, b, c = vertices 0, 1, 2, nothing leaving opposite to a: F and G on a-b, on a-c (from a on), int
_CORNER = np.zeros((8, 6))
_CORNER[4, 0] = _CORNER[5, 1] = _CORNER[2, 2] = _CORNER[6, 4] = _CORNER[7, 5] = 1.0
_CORNER[3, 3] = -1.0
# what goes round the vertex, the moment that enters across a-b, the one that leaves across a-c
_MOVES = np.array([(-1, 0, 1, 0, -0.5, 0.5), (0, -1, 0, 0, -0.5, 0), (0, 0, 0, 1, 0, 0.5)]).T
_OF_CORNER = np.einsum("ij,kil,lm->kjm", _CORNER, GRAMS, _CORNER)
FORMS = np.einsum("iu,kij,jv->kuv", _MOVES, _OF_CORNER, _MOVES)
PULLS = np.einsum("iu,kij->kuj", _MOVES, _OF_CORNER)


def metric(to_b: np.ndarray, to_c: np.ndarray, area: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """J^T J / (det J mu) of cells with these edges from a vertex: xx, xy, yy, shape (3, cells)."""
    products = [np.einsum("cx,cx->c", p, q) for p, q in ((to_b, to_b), (to_b, to_c), (to_c, to_c))]
    return np.stack(products) / (2 * area * mu)


def quadratics(points: np.ndarray) -> np.ndarray:
    """The functions of P2 at barycentric points: vertices, then opposite middles, shape (6, points); on intervals the
    middle, shape (3, points)."""
    psi = points.T
    if len(psi) == 2:
        return np.vstack([psi * (2 * psi - 1), 4 * psi[0] * psi[1]])
    return np.vstack([psi * (2 * psi - 1), 4 * psi[[1, 2, 0]] * psi[[2, 0, 1]]])


def nodes_of(corners: np.ndarray) -> np.ndarray:
    """Vertices, then the midpoints of the opposite edges."""
    return np.vstack([corners, (corners[[1, 2, 0]] + corners[[2, 0, 1]]) / 2])


def against_nodes(products: np.ndarray) -> np.ndarray:
    """int f phi_i of the functions of P2 from int f psi_j psi_k, shape (cells, 6)."""
    vertices = 2 * np.einsum("cjj->cj", products) - products.sum(axis=2)
    return np.hstack([vertices, 4 * products[:, [1, 2, 0], [2, 0, 1]]])
