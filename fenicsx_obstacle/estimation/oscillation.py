"""Oscillation: the part of the load that the equilibrated flux sigma does not balance.

In each cell T let g = f - Pi f and tau the smallest field with div tau = -g and no normal part on the boundary of
T: sigma + tau is in balance with the load itself. Up to the mean of g, which quadrature leaves and Friedrichs' constant
bounds, tau = grad w with a w of mean zero, so that

    ||tau||_T <= C ||g||_T   by Poincare's inequality,   (grad Q, tau)_T = (g, Q)_T   for every Q.

Where the mesh does not resolve the load the first is far off. There triangles are divided, and tau is the sum of a flux
in RT0 on the parts, which has the means of g on them, and of such fields in the parts.
"""

from __future__ import annotations

from functools import cache, reduce

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.cell_data import Load
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.simplices import Simplices, sums
from fenicsx_obstacle.mesh.cells import longest_edges
from fenicsx_obstacle.parallel import total

J11 = 3.8317059702075  # first zero of the Bessel function J_1
SMALL = 0.02  # of the load times Poincare's constant, in the norm: cells that have no more of it are not divided
UNRESOLVED = 0.25  # of ||f - mean f||^2: cells are divided if more of it is beyond linear functions
PARTS = 2**14  # of cells, in all
DEEPEST = 4


def poincare(x: np.ndarray, area: np.ndarray, *, weighted: bool = False) -> np.ndarray:
    """C with ||v|| <= C ||grad v|| for functions of mean zero in convex cells, (E7).

    It is at most diameter/pi (Payne and Weinberger 1960, Bebendorf 2003). In triangles it is at most diameter/j_11
    (Laugesen and Siudeja 2010), 3/(4 pi) in the equilateral triangle of side 1 and 1/pi in
    the right isosceles one with legs of length 1; an affine map multiplies it by its norm at most. Of integrals with a
    linear weight r >= 0 it is at most diameter/pi too, by the inequality for the convex sets {(x, t): 0 < t < s r(x)},
    s -> 0, and functions of x alone.

    Args:
        x: Corners, shape (cells, d + 1, d).
        area: |T|.
        weighted: Whether integrals have such a weight.
    """
    if x.shape[2] != 2 or weighted:
        return longest_edges(x) / np.pi
    sides = [sums((x[:, (k + 2) % 3] - x[:, (k + 1) % 3]) ** 2) for k in range(3)]
    whole = sides[0] + sides[1] + sides[2]

    def norm(squares: np.ndarray, determinant: np.ndarray) -> np.ndarray:
        """The larger singular value from the sum of the squares of both and their product."""
        return np.sqrt((squares + np.sqrt(np.maximum(squares**2 - 4 * determinant**2, 0.0))) / 2)

    found = [np.sqrt(reduce(np.maximum, sides)) / J11]
    found.append(3 / (4 * np.pi) * norm(2 / 3 * whole, 4 / np.sqrt(3) * area))
    found += [norm(whole - side, 2 * area) / np.pi for side in sides]
    return reduce(np.minimum, found)


class Oscillation:
    """The load minus Pi f in each cell, without the tension, (E12).

    Attributes:
        norm: Bound of ||tau||_T.
        rest: The part of it that is due to the load's distance to polynomials q on parts of the cells.
        first: int g (x - middle) with q in place of f, shape (d, cells).
        second: int g |x - middle|^2 with q in place of f, shape (cells,).
        poincare: C.
        beyond: Bound of ||g - linear||_T, `linear` being the linear part of g.
    """

    def __init__(self, simplices: Simplices, load: Load, value: Field | None, degree: int):
        """Bound it (collective).

        Args:
            simplices: The cells.
            load: What is known of the load.
            value: The load.
            degree: Of Pi f, 0 or 1.
        """
        self._simplices, area = simplices, simplices.area
        count, dim = len(area), simplices.dim
        self.poincare = np.empty(count)
        for block in blocks(count):
            self.poincare[block] = poincare(simplices.x[block], area[block], weighted=simplices.radius is not None)
        self.norm, self.rest, self.second, self.beyond = (np.zeros(count) for _ in range(4))
        self.first = np.zeros((dim, count))
        self._moments = self._mean = None
        if load.pieces is None or value is None:
            return
        if simplices.radius is not None:
            self._moments = load.moments * (area / simplices.size)[:, None]
            self.norm, self._mean = self.poincare * load.oscillation, sums(self._moments) / area
            linear = self._mean[:, None] + self.linear(slice(None))
            self.beyond = np.sqrt(area) * np.add(*load.pieces.distance(linear, simplices.radius))
            return
        self.rest = self.poincare * load.unknown
        self.norm = self.poincare * load.oscillation
        moments = load.moments if degree == 0 else load.moments.sum(axis=2)  # int f psi_l
        mean, of_linear = sums(moments) / area, np.empty(count)
        self._moments, self._mean = moments, mean
        for block in blocks(count):
            own = self.linear(block)
            of_linear[block] = area[block] * (sums(own**2) + sums(own) ** 2) / ((dim + 1) * (dim + 2))
            if degree == 0:
                for k in range(dim):
                    away = simplices.x[block, :, k] - simplices.middle[block, k : k + 1]
                    self.first[k, block] = sums(moments[block] * away)
        if degree == 0:
            self._add_second(load.pieces, mean)
        beyond = load.oscillation**2 - (of_linear if degree == 0 else 0.0)
        self.beyond = np.sqrt(np.maximum(beyond, 0.0))
        rough = np.flatnonzero(beyond > UNRESOLVED * (beyond + of_linear))
        comm = simplices.data.level.comm
        parts = total(comm, len(rough))
        if degree == 0:  # the error of P1 is of the size of the load times h
            of_load = total(comm, self.poincare**2 * (area * mean**2 + load.oscillation**2))
            if total(comm, self.norm[rough] ** 2) <= SMALL**2 * of_load:
                return
        depth = next((d for d in range(DEEPEST, 0, -1) if parts * 4**d <= PARTS), 0)
        if dim == 2 and depth > 0 and len(rough) > 0 and value.parts is None:
            values = np.repeat(mean[rough, None], dim + 1, axis=1)
            if degree > 0:
                values += self.linear(rough)
            self.norm[rough] = np.minimum(self.norm[rough], self._divided(rough, value, values, depth))

    def linear(self, cells: np.ndarray | slice) -> np.ndarray:
        """Of the linear part of g in some cells the values at the vertices, shape (cells, d + 1)."""
        dim, area = self._simplices.dim, self._simplices.area[cells]
        if self._moments is None or self._mean is None:
            return np.zeros((len(area), dim + 1))
        # the nodal values of Pi_1 f, by the inverse of the mass matrix
        factor = (dim + 1) * (dim + 2) / area
        found = self._moments[cells] * factor[:, None] - ((dim + 2) * self._mean[cells])[:, None]
        if self._simplices.radius is not None:  # of mean zero with the weight
            radius = self._simplices.radius[cells]
            found -= (sums(found * (radius + sums(radius)[:, None])) / ((dim + 2) * sums(radius)))[:, None]
        return found

    def _add_second(self, pieces: Pieces, mean: np.ndarray) -> None:
        """Integrate (q - mean) |x - middle|^2."""
        simplices = self._simplices
        for part in pieces.portions():
            points, weights = rule(simplices.dim, part.degree + 2)
            inside, x, middle = part.points(points), simplices.x[part.rows], simplices.middle[part.rows]
            distance = reduce(np.add, ((polynomials.combined(inside, x[..., k]) - middle[:, k : k + 1]) ** 2
                                       for k in range(simplices.dim)))  # fmt: skip
            integrals = ((part.values(points) - mean[part.rows, None]) * distance) @ weights
            part.add_to(self.second, part.share * simplices.area[part.rows] * integrals)

    def _divided(self, cells: np.ndarray, value: Field, linear: np.ndarray, depth: int) -> np.ndarray:
        """Bound of ||tau|| in some cells by division.

        Args:
            cells: Which.
            value: The load.
            linear: Pi f at the vertices of these.
            depth: How often their edges are halved.
        """
        simplices, area = self._simplices, self._simplices.area[cells]
        inside, count = polynomials.halvings(3, depth), 4**depth
        corners = (inside @ simplices.x[cells][:, None]).reshape(-1, 3, 2)
        size, nearest = np.repeat(area, count) / count, (inside @ linear[:, None, :, None]).reshape(-1, 3)
        pieces = pieces_of(simplices.data, value, corners, np.repeat(cells, count), Division(1))
        means, squares, rests = (np.zeros(len(corners)) for _ in range(3))
        for group in pieces.groups:
            points, weights = rule(2, 2 * max(group.degree, 1))
            there = polynomials.combined(group.points(points), nearest[group.rows])
            g = group.values(points) - there
            rest = np.where(np.isfinite(group.rest), group.rest, np.inf)
            for integral, found in ((means, g @ weights), (squares, g**2 @ weights), (rests, rest**2)):
                group.add_to(integral, group.share * found)
        poincare_there = self.poincare[cells] / 2**depth
        variance = np.maximum(squares - means**2, 0.0) * size
        within = poincare_there * np.sqrt(variance.reshape(-1, count).sum(axis=1))
        rest = self.poincare[cells] * np.sqrt((rests * size).reshape(-1, count).sum(axis=1))
        means = means.reshape(-1, count)
        means = (means - means.mean(axis=1, keepdims=True)) * (area / count)[:, None]
        a, b = (simplices.x[cells, k] - simplices.x[cells, 0] for k in (1, 2))
        metric = np.stack([np.einsum("cx,cx->c", p, q) for p, q in ((a, a), (a, b), (b, b))]) / (2 * area)
        between = np.einsum("kc,kij,ci,cj->c", metric, _energies(depth), means, means, optimize=True)
        return np.sqrt(np.maximum(between, 0.0)) + within + rest


@cache
def _energies(depth: int) -> np.ndarray:
    """Of fluxes in RT0 on the parts from what they gather in each part, nothing leaving the triangle.

    They are the smallest ones in an equilateral triangle, which any other one is mapped to.

    Returns:
        Shape (3, parts, parts); times J^T J/det J (xx, 2 xy, yy) the squared norm.
    """
    inside = polynomials.halvings(3, depth)
    count = len(inside)
    x = inside[:, :, 1:]  # reference coordinates
    size = 0.5 / count
    middles = (x + x[:, [1, 2, 0]]) / 2  # the rule there is exact for degree 2
    arms = middles[:, None] - x[:, :, None]  # part, function, point, axis
    grams = np.einsum("pima,pjmb->abpij", arms, arms) / 3 * size / (4 * size**2)
    grams = np.stack([grams[0, 0], grams[0, 1] + grams[1, 0], grams[1, 1]])
    numbers: dict[tuple[int, ...], int] = {}
    rows, signs = np.full((count, 3), -1), np.zeros((count, 3))
    corners = np.rint(inside * 2**depth).astype(int)
    for part, side in np.ndindex(count, 3):
        ends = corners[part, [(side + 1) % 3, (side + 2) % 3]]
        if np.any(ends.sum(axis=0) == 0):  # on an edge of the triangle
            continue
        key = tuple(ends.sum(axis=0))  # twice the middle of the edge
        signs[part, side] = -1.0 if key in numbers else 1.0
        rows[part, side] = numbers.setdefault(key, len(numbers))
    edges = len(numbers)
    energies, gathered = np.zeros((3, edges, edges)), np.zeros((count, edges))  # what goes out of each part
    for i, j in np.ndindex(3, 3):
        both = np.flatnonzero((rows[:, i] >= 0) & (rows[:, j] >= 0))
        products = grams[:, both, i, j] * signs[both, i] * signs[both, j]
        for energy, product in zip(energies, products, strict=True):
            np.add.at(energy, (rows[both, i], rows[both, j]), product)
        if i == j:
            gathered[both, rows[both, i]] = signs[both, i]
    metric = np.array([1.0, 0.5, 1.0]) / (np.sqrt(3) / 2)  # J^T J/det J of the equilateral triangle
    system = np.zeros((edges + count - 1, edges + count - 1))
    system[:edges, :edges] = np.einsum("k,kef->ef", metric, energies)
    # nothing is left for the last part
    system[:edges, edges:], system[edges:, :edges] = gathered[:-1].T, gathered[:-1]
    right = np.vstack([np.zeros((edges, count)), (np.eye(count) - 1 / count)[:-1]])
    fluxes = np.linalg.solve(system, right)[:edges]
    return np.stack([fluxes.T @ energy @ fluxes for energy in energies])
