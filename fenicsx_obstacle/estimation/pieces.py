"""A datum on simplices: polynomials on parts of them, with bounds of the remainder.

The datum is q + r, q polynomials and |r| bounded on each part. Means, distances and excesses of any datum, in cells or
on facets, are made here. Where no bound of r is known, r counts 0: what makes of the datum a bound, has a word about
these places. Integrals may have a linear weight, as in axial symmetry, which is given at the corners of the simplices;
then means are divided by that of the weight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.estimation.parts import Arrays
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.simplex_geometry import inward, least_heights, sizes
from fenicsx_obstacle.estimation.simplices import integrals, reciprocals

LOWEST = -1e300  # where no lower bound is known


@dataclass(frozen=True, eq=False)
class Group(Arrays):
    """Parts of simplices on which a datum is near polynomials of one degree.

    Attributes:
        rows: The simplex that each is a part of.
        corners: Barycentric coordinates of its corners there, shape (parts, corners, corners); None: the simplex
            itself.
        share: Of its measure, shape (parts,).
        degree: Of the polynomials.
        coefficients: Their Bernstein coefficients, shape (parts, ...).
        rest: Bound of the datum's distance to them.
        lower: Lower bound of the datum.
        upper: Upper bound.
        steep: Bound of the gradient of the difference, if the datum is continuous.
        smooth: Whether the polynomial is near it; otherwise bounds are all that is known.
    """

    rows: np.ndarray
    corners: np.ndarray | None
    share: np.ndarray
    degree: int
    coefficients: np.ndarray = field(repr=False)
    rest: np.ndarray = field(repr=False)
    lower: np.ndarray = field(repr=False)
    upper: np.ndarray = field(repr=False)
    steep: np.ndarray = field(repr=False)
    smooth: bool

    def points(self, reference: np.ndarray) -> np.ndarray:
        """Barycentric coordinates in the simplices of points of the parts, shape (parts or 1, points, corners)."""
        return reference[None] if self.corners is None else reference @ self.corners

    def values(self, reference: np.ndarray) -> np.ndarray:
        """Of the polynomials at points of the parts, shape (parts, points)."""
        return polynomials.evaluate(self.coefficients, reference, self.degree)

    @property
    def known_rest(self) -> np.ndarray:
        """`rest`, 0 where it is infinite."""
        return np.where(np.isfinite(self.rest), self.rest, 0.0)

    def weights(self, reference: np.ndarray, weights: np.ndarray, radius: np.ndarray | None) -> np.ndarray:
        """Weights of a quadrature on the parts, shape (points,); with the weight of integrals as a factor, if any, of
        shape (parts, points).

        Args:
            reference: Points of the parts, shape (points, corners).
            weights: Of the quadrature.
            radius: The weight of integrals at the corners of the simplices; None: they have none.
        """
        if radius is None:
            return weights
        return weights * polynomials.combined(self.points(reference), radius[self.rows])

    def mean_weight(self, radius: np.ndarray | None) -> np.ndarray | float:
        """The mean weight of integrals on the parts, 1 if they have none."""
        if radius is None:
            return 1.0
        corners = radius.shape[1]
        return polynomials.combined(self.points(np.full((1, corners), 1 / corners)), radius[self.rows])[:, 0]

    def no_less(self, sign: float) -> Group:
        """The same parts, with an upper bound of sign times the datum where bounds are all that is known: the middle of
        bounds that are far apart, such as -1e20 and 0, plus half their distance is no accurate bound.

        Args:
            sign: 1 or -1.
        """
        side = self.upper if sign > 0 else self.lower
        if self.smooth or self.degree > 0:
            return self
        finite = np.isfinite(side)
        middle = np.where(finite, side, self.coefficients[:, 0])[:, None]
        return replace(self, coefficients=middle, rest=np.where(finite, 0.0, self.rest))

    def above(self, state: np.ndarray, sign: float, least: int = 1) -> tuple[int, np.ndarray, np.ndarray]:
        """Degree and Bernstein coefficients of sign times the polynomials less a function of each simplex; their
        round-off.

        Args:
            state: For each part the values of a linear function at the corners of its simplex, shape (parts, corners);
                or of a function of P2 at the nodes of its triangle, shape (parts, 6).
            sign: 1 or -1.
            least: The least degree of the result.
        """
        linear = state.shape[1] != 6
        degree, corners = max(self.degree, least, 1 if linear else 2), state.shape[1] if linear else 3
        reference = polynomials.inner_points(corners, degree)
        points = self.points(reference)
        if not linear:
            points = quadratics(points.reshape(-1, 3)).T.reshape(*points.shape[:2], 6)
        found = sign * self.values(reference) - polynomials.combined(points, state)
        size = np.maximum(polynomials.row_size(self.coefficients), polynomials.row_size(state))
        margin = polynomials.round_off(size[:, None], corners, degree)
        return degree, polynomials.coefficients(found, corners, degree), margin

    def steepness(self, coefficients: np.ndarray, corners: np.ndarray, more: np.ndarray) -> np.ndarray:
        """Bound of the mean of |grad(datum - other functions)|^2 on the parts of triangles or tetrahedra.

        Args:
            coefficients: Of Bernstein, of the polynomials less other polynomials.
            corners: Of these, shape (simplices, d + 1, d).
            more: Bound of the gradient of what is no polynomial.
        """
        x = corners[self.rows] if self.corners is None else self.corners @ corners[self.rows]
        dim = x.shape[2]
        of_corners = inward(x) / (dim * sizes(x))[:, None]
        degree = polynomials.degree_of(coefficients.shape[1], dim + 1)
        points, weights = rule(dim, 2 * (degree - 1))
        along = polynomials.slopes(coefficients, dim + 1, degree)
        there = np.stack([polynomials.evaluate(along[:, k], points, degree - 1) for k in range(dim + 1)], axis=1)
        gradient = np.einsum("nkp,xnk->npx", there, of_corners)
        mean = np.einsum("npx,npx,p->n", gradient, gradient, weights)
        known = np.isfinite(self.steep)  # of samples it is not
        unknown = np.where(known, self.steep, (self.upper - self.lower) / least_heights(x))
        return (np.sqrt(mean) + more + np.where(np.isfinite(unknown), unknown, 0.0)) ** 2

    def lower_to(self, least: np.ndarray, values: np.ndarray) -> None:
        """Let each simplex have no more than the least of the values on its parts."""
        if self.corners is None:  # each simplex has one part
            least[self.rows] = np.minimum(least[self.rows], values)
        else:
            np.minimum.at(least, self.rows, values)

    def raise_to(self, most: np.ndarray, values: np.ndarray) -> None:
        """Let each simplex have no less than the largest of the values on its parts."""
        if self.corners is None:
            most[self.rows] = np.maximum(most[self.rows], values)
        else:
            np.maximum.at(most, self.rows, values)

    def add_to(self, sums: np.ndarray, values: np.ndarray) -> None:
        """Add the values on its parts to each simplex, shape (simplices, ...)."""
        if self.corners is None:
            sums[self.rows] += values
        elif values.ndim == 1:
            sums += np.bincount(self.rows, values, len(sums))
        else:
            for k in range(values.shape[1]):
                sums[:, k] += np.bincount(self.rows, values[:, k], len(sums))

    def portions(self) -> Iterator[Group]:
        """The parts in portions that fit into memory."""
        for block in blocks(len(self.rows)):
            yield self[block]


@dataclass(frozen=True, eq=False)
class Pieces:
    """A datum on simplices.

    Attributes:
        groups: The parts of all simplices; empty where what it is between is enough, which costs little.
        lower: Lower bound over each simplex; infinite where none is known.
        upper: Upper bound.
        sampled: Whether all this comes from samples.
        rough: Whether a simplex has parts that further division makes smoother; empty without groups.
    """

    groups: list[Group]
    lower: np.ndarray
    upper: np.ndarray
    sampled: bool
    rough: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=bool))

    @property
    def finite(self) -> np.ndarray:
        return np.isfinite(self.lower) & np.isfinite(self.upper)

    def portions(self) -> Iterator[Group]:
        """All parts in portions that fit into memory."""
        for group in self.groups:
            yield from group.portions()

    def mean(self, factor: np.ndarray, radius: np.ndarray | None = None) -> np.ndarray:
        """The mean of q times a linear function over each simplex.

        Args:
            factor: The linear functions at the corners, shape (simplices, corners).
            radius: The weight of integrals there, if there is one.
        """
        found = np.zeros(len(factor))
        for part in self.portions():
            points, weights = rule(factor.shape[1] - 1, part.degree + 1 + (radius is not None))
            values = part.values(points) * polynomials.combined(part.points(points), factor[part.rows])
            part.add_to(found, part.share * integrals(values, part.weights(points, weights, radius)))
        return found if radius is None else found * reciprocals(radius.mean(axis=1))

    def distance(
        self, linear: np.ndarray, radius: np.ndarray | None = None, factor: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """How far a datum, times a factor, is from linear functions: ||.||_T/|T|^(1/2) in each simplex T.

        Args:
            linear: The linear functions at the corners, shape (simplices, corners).
            radius: The weight of integrals there, if there is one.
            factor: Linear functions that are factors of the datum; None: it has none.

        Returns:
            The norm of the difference for q, and a bound of that of r times the factor.
        """
        squares, rests = np.zeros(len(linear)), np.zeros(len(linear))
        for part in self.portions():
            degree = max(part.degree + (factor is not None), 1)
            points, weights = rule(linear.shape[1] - 1, 2 * degree + (radius is not None))
            inside, values, rest = part.points(points), part.values(points), part.known_rest
            if factor is not None:
                values = values * polynomials.combined(inside, factor[part.rows])
                rest = rest * polynomials.row_size(factor[part.rows])
            apart = values - polynomials.combined(inside, linear[part.rows])
            part.add_to(squares, part.share * integrals(apart**2, part.weights(points, weights, radius)))
            part.add_to(rests, part.share * part.mean_weight(radius) * rest**2)
        return np.sqrt(squares), np.sqrt(rests)

    def highest_above(self, linear: np.ndarray, sign: float, round_off: float = 0.0) -> np.ndarray:
        """Upper bounds of sign times a datum above a linear function in each simplex, 0 where that may be round-off.

        Args:
            linear: The linear functions at the corners, shape (simplices, corners).
            sign: 1 or -1.
            round_off: Of these functions.
        """
        found = np.full(len(linear), -np.inf)
        for group in (one.no_less(sign) for one in self.groups):
            degree, coefficients, margin = group.above(linear[group.rows], sign)
            margin = margin + round_off
            top = polynomials.largest(coefficients, linear.shape[1], degree) + group.known_rest
            group.raise_to(found, np.where(np.abs(top) <= margin, 0.0, top + margin))
        return found

    def mean_above(self, linear: np.ndarray, sign: float, radius: np.ndarray | None) -> np.ndarray:
        """A lower bound of the mean of sign times a datum above a linear function in each simplex.

        Args:
            linear: The linear functions at the corners, shape (simplices, corners).
            sign: 1 or -1.
            radius: The weight of integrals there, if there is one.
        """
        bottom = self.lower if sign > 0 else -self.upper
        unknown = np.where(np.isfinite(bottom), bottom, LOWEST) - polynomials.row_max(linear)
        found = np.zeros(len(linear))
        for group in self.groups:
            degree, coefficients, _ = group.above(linear[group.rows], sign)
            points, weights = rule(linear.shape[1] - 1, degree + (radius is not None))
            values = polynomials.evaluate(coefficients, points, degree)
            above = integrals(values, group.weights(points, weights, radius))
            weight, known = group.mean_weight(radius), np.isfinite(group.rest)
            least = np.where(known, above - group.known_rest * weight, unknown[group.rows] * weight)
            group.add_to(found, group.share * least)
        return found if radius is None else found * reciprocals(radius.mean(axis=1))


def joined(parts: list[tuple[np.ndarray, Pieces]], count: int) -> Pieces:
    """Of data that hold on some simplices each: these, and the pieces there."""
    lower, upper, rough = np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    groups = []
    for rows, pieces in parts:
        lower[rows], upper[rows], rough[rows] = pieces.lower, pieces.upper, pieces.rough
        for group in pieces.groups:
            group.rows[:] = rows[group.rows]
            groups.append(group)
    return Pieces(groups, lower, upper, any(pieces.sampled for _, pieces in parts), rough)
