"""Tension, load and obstacles in the cells: the samples of the solver, and enclosures of the data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import polynomials, releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import array_of
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.effects.field import Field, Rows
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.certification import CellDatum
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.pieces import Group, Pieces, joined
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.simplices import Simplices, integrals
from fenicsx_obstacle.parallel import largest, smallest, total

TENSION = Division(4, share=1 / 256)  # a fourth of the parts of Division(6), for .3 % more on bounds with jumps
# by the degree of the elements; the mean of the rest counts with Friedrichs' constant, not with h
LOAD = {1: Division(5, 1e-2, 5e-3, 2), 2: Division(8, 1e-3, 1e-4)}
SEEN = 100.0  # times the largest load that the solver has: a bound beyond that tells nothing about the load
UNDECIDED = 0.25  # times the same: bounds of the mean in a cell so far apart do not tell it
Fields = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def tension_of(data: Data) -> Field | None:
    """mu; None where the tension is a matrix, or depends on u."""
    elastic = data.model.elastic
    return elastic.value if elastic.role == "tension" else None


def matrix_of(data: Data) -> Rows | None:
    """The rows of A where the tension is a matrix, otherwise None."""
    elastic = data.model.elastic
    return cast(Rows, elastic.value) if elastic.role == "matrix tension" else None


def proved(data: Data) -> bool:
    """Whether the bound is proved for the operator -div(mu grad u); otherwise the error is estimated with the tension
    of the solver."""
    return data.model.elastic.affine


def load_of(data: Data) -> Field | None:
    """f, if there is a load per area; of several the first."""
    return next((effect.value for effect in data.model.effects if effect.role == "load"), None)


def other_effects(data: Data) -> list[Effect]:
    """The effects besides that tension and load, and the weight of integrals."""
    effects = [effect for effect in data.model.effects if effect.role != "radial weight"]
    load = next((effect for effect in effects if effect.role == "load"), None)
    return [effect for effect in effects if effect is not data.model.elastic and effect is not load]


def obstacles_of(data: Data) -> list[tuple[float, Field]]:
    """The obstacles that there are: 1 and the lower one, -1 and the upper one."""
    given = ((1.0, data.model.lower), (-1.0, data.model.upper))
    return [(sign, obstacle) for sign, obstacle in given if obstacle is not None]


def of_solver(
    simplices: Simplices, data: Data, value: Field, points: np.ndarray, *, positive: bool = False
) -> np.ndarray:
    """What the solver has of a datum at barycentric points of the cells, shape (cells, points) (collective on first
    use).

    Args:
        simplices: The cells.
        data: Of the solver's elements on the same mesh.
        value: Of the datum.
        points: Barycentric coordinates, shape (points, vertices).
        positive: Whether values that are not positive are an error.

    Returns:
        Shape (cells, points), or (cells, 1) of one value in each cell.
    """
    made, count = data.cellwise(value, positive=positive), len(simplices.area)
    if isinstance(made, fem.Constant):
        return np.full((count, 1), array_of(made)[0])
    dofs = releases.cell_dofs(data.level.W)[:count]
    if dofs.shape[1] == 1:
        return made.x.array[dofs]
    return made.x.array[simplices.turned_nodes(dofs)] @ quadratics(points)


def matrix_of_solver(simplices: Simplices, rows: Rows) -> np.ndarray:
    """A matrix in each owned cell as the solver has it, shape (cells, d, d) (collective on first use)."""
    data, count = simplices.data, len(simplices.area)
    made = data.matrices(rows)
    if len(made) == 1:
        made = np.broadcast_to(made, (count, *made.shape[1:]))
    else:
        made = made[releases.cell_dofs(data.level.W)[:count, 0]]
    return (made + made.transpose(0, 2, 1)) / 2


def tension_of_state(problem: Problem, simplices: Simplices) -> np.ndarray | None:
    """The tension in each owned cell for the state of the problem where the bound is not `proved`; otherwise None
    (collective)."""
    elastic, level = problem.model.elastic, problem.level
    if proved(problem.data):
        return None
    u, W = fem.Function(level.V), releases.functionspace(level.mesh, "DG", 0)
    u.x.array[:] = problem.solution().x.array
    mean = elastic.tension_at(u, problem.data) * ufl.TestFunction(W) / ufl.CellVolume(level.mesh)
    found = fem.Function(W)
    fem.petsc.assemble_vector(releases.vec(found), releases.form(mean * problem.data.dx))
    return found.x.array[releases.cell_dofs(W)[: len(simplices.area), 0]] * simplices.area / simplices.size


def in_cells(simplices: Simplices, value: Field, division: Division, cells: np.ndarray | None = None) -> Pieces:
    """A datum in owned cells, by default in all (collective where it is the first to need the distance).

    Args:
        simplices: The cells.
        value: The datum.
        division: When cells are divided.
        cells: Which; rows of the pieces are places in this array.
    """
    data, x = simplices.data, simplices.x if cells is None else simplices.x[cells]
    cells = np.arange(len(simplices.area)) if cells is None else cells
    if value.parts is None:
        return pieces_of(data, value, x, cells, division)
    found = []
    for name, field in value.parts.items():
        rows = np.flatnonzero(np.isin(cells, data.level.groups[name]))
        found.append((rows, pieces_of(data, field, x[rows], cells[rows], division)))
    return joined(found, len(cells))


class Load:
    """Moments of the load in the cells, and how far it is from the polynomials that the flux is in balance
    with.

    The load is q + r, q polynomials on parts of the cells and |r| bounded there. Where integrals have a weight, the
    moments of a cell have the sum that they have with it; among its vertices they are distributed as the solver's.

    Attributes:
        moments: int q test for each test function, shape (cells, ...).
        missing: The same less what the solver makes of it.
        oscillation: Bound of ||f - Pi q||_T, shape (cells,).
        unknown: The part of it that is due to r.
        rest: Bound of the mean of r in each cell.
        lower: A lower bound of the load in each cell; infinite where none is known.
        upper: An upper bound.
        pieces: What is known of it; None of a number.
    """

    def __init__(self, simplices: Simplices, data: Data, tests: Callable[[np.ndarray], np.ndarray]):
        """Enclose it (collective).

        Args:
            simplices: The cells.
            data: Of the solver's elements on the same mesh.
            tests: Test functions at barycentric points, shape (points, ...); their sums over the last axis span the
                polynomials that Pi projects onto.
        """
        self._simplices, self._tests, self._dim = simplices, tests, simplices.dim
        count = len(simplices.area)
        points, weights = rule(self._dim, 4)  # exact for what the solver has, times a test function
        self.oscillation, self.unknown, self.rest = (np.zeros(count) for _ in range(3))
        self.lower = self.upper = np.zeros(count)
        self.moments = np.zeros((count, *tests(points).shape[1:]))
        self.missing = np.zeros_like(self.moments)
        self.pieces: Pieces | None = None
        value = load_of(data)
        if value is None:
            return
        weighted = weights[:, None] * tests(points).reshape(len(points), -1)
        seen = of_solver(simplices, data, value, points)
        weighted = weighted.sum(axis=0, keepdims=True) if seen.shape[1] == 1 else weighted
        solver = (simplices.size[:, None] * (seen @ weighted)).reshape(self.moments.shape)
        if value.uniform:
            self.moments, self.lower, self.upper = solver, seen[:, 0], seen[:, 0]
            return
        comm, degree = data.level.comm, data.level.pair.degree
        division = LOAD[degree]
        if degree == 1:
            sides = [largest(comm, simplices.x[..., k]) - smallest(comm, simplices.x[..., k]) for k in range(self._dim)]
            division = replace(division, length=min(sides) / np.pi)  # about Friedrichs' constant
        self.pieces = in_cells(simplices, value, division)
        self.lower, self.upper = self.pieces.lower, self.pieces.upper
        highest, unknown = largest(comm, np.abs(seen)), np.zeros(count)
        for group in self.pieces.groups:
            group.add_to(unknown, group.share * group.known_rest)
        far = [_far(group, SEEN * highest, unknown > UNDECIDED * highest) for group in self.pieces.groups]
        of_groups = list(zip(self.pieces.groups, far, strict=True))
        cells = np.unique(np.concatenate([np.empty(0, int), *(one.rows[parts] for one, parts in of_groups)]))
        if total(comm, len(cells)) > 0:
            mean = np.zeros(count)
            mean[cells] = simplices.values(value, points, cells).mean(axis=1)
            self.pieces = replace(self.pieces, groups=[_near_seen(one, parts, mean) for one, parts in of_groups])
        self._integrate(self.pieces)
        self.missing = np.subtract(self.moments, solver, out=solver)

    def _basis(self, points: np.ndarray) -> np.ndarray:
        """The polynomials that Pi projects onto, at barycentric points, shape (points, n)."""
        return _rows(self._tests(points).sum(axis=-1))

    @property
    def largest(self) -> np.ndarray:
        """An upper bound of |f| in each cell."""
        return np.maximum(np.abs(self.lower), np.abs(self.upper))

    def forget_polynomials(self) -> None:
        """Keep no more than bounds of the load; its polynomials take much memory."""
        if self.pieces is not None:
            self.pieces = replace(self.pieces, groups=[])

    def _integrate(self, pieces: Pieces) -> None:
        """Moments, and distances to their projections."""
        simplices, area, size = self._simplices, self._simplices.area, self._simplices.size
        flat = _rows(self.moments)  # a view
        ratio = size / area
        for part in pieces.portions():
            points, weights = rule(self._dim, part.degree + 2)  # the weight of integrals is linear
            tests = _rows(_at(self._tests, part.points(points)), 2)
            found = polynomials.combined(tests.transpose(0, 2, 1), part.values(points) * weights)
            part.add_to(flat, (part.share * size[part.rows])[:, None] * found)
            if simplices.radius is not None:
                with_weight = part.weights(points, weights, simplices.radius)
                more = integrals(part.values(points), with_weight) - ratio[part.rows] * (part.values(points) @ weights)
                part.add_to(
                    flat, (part.share * area[part.rows] * more / flat.shape[1])[:, None] * np.ones(flat.shape[1])
                )
            of_rest = part.known_rest * part.mean_weight(simplices.radius) / ratio[part.rows]
            part.add_to(self.rest, part.share * of_rest)
        points, weights = rule(self._dim, 2)
        basis = self._basis(points)
        of_basis = _rows(self.moments.sum(axis=-1))
        nearest = of_basis @ np.linalg.inv(basis.T @ (weights[:, None] * basis)) / size[:, None]
        known, rests = pieces.distance(nearest @ self._basis(np.eye(self._dim + 1)).T, simplices.radius)
        self.unknown = np.sqrt(area) * rests
        self.oscillation = np.sqrt(area) * known + self.unknown


def _far(group: Group, limit: float, undecided: np.ndarray) -> np.ndarray:
    """Parts of cells with bounds of a load that are far apart, and no polynomial near it: beyond a limit, or in cells
    in which it is undecided as a whole."""
    wide = (group.rest > limit) | (undecided[group.rows] & (group.rest > 0))
    return np.flatnonzero((group.degree == 0) & np.isfinite(group.rest) & wide)


def _near_seen(group: Group, parts: np.ndarray, mean: np.ndarray) -> Group:
    """Replace a load whose bounds are far apart by the mean of its samples.

    The middle of its bounds would do for the bound; but the solver takes this load too.

    Args:
        group: Parts of cells.
        parts: Which of them.
        mean: Of the load at points inside the cells.
    """
    if not len(parts):
        return group
    lower, upper = group.lower[parts], group.upper[parts]
    middle, chosen, rest = np.clip(mean[group.rows[parts]], lower, upper), group.coefficients.copy(), group.rest.copy()
    chosen[parts, 0], rest[parts] = middle, np.maximum(upper - middle, middle - lower)
    return replace(group, coefficients=chosen, rest=rest)


class Tension:
    """The tension in the cells; one that depends on u is that of the state.

    Attributes:
        least: A lower bound in each cell.
        most: An upper bound.
        least_mean: A lower bound of its mean, times the weight of integrals if they have one.
        most_mean: An upper bound.
        varies: Whether it varies within a cell, or is a matrix.
        poincare: C with ||v||_T <= C ||A^(1/2) grad v||_T for functions of mean zero, where it is a matrix A.
        pieces: What is known of it; None of a number, or of a number for each material.
    """

    poincare: np.ndarray | None = None

    def __init__(self, simplices: Simplices, mu: np.ndarray):
        """Enclose it (collective).

        Args:
            simplices: The cells.
            mu: Its mean in each cell, as the solver has it.

        Raises:
            InputError: If it is not positive somewhere.
        """
        self._simplices, self._area, self._dim = simplices, simplices.area, simplices.dim
        self.least = self.most = mu
        self.least_mean = self.most_mean = mu * (simplices.size / simplices.area)
        self.varies = np.zeros(len(mu), dtype=bool)
        self._parts: list[Group] = []
        self.pieces: Pieces | None = None
        value = tension_of(simplices.data)
        if value is None:
            return
        parts = [value] if value.parts is None else list(value.parts.values())
        if all(part.uniform for part in parts):
            return
        self.pieces = in_cells(simplices, value, TENSION)
        self._take(self.pieces.groups)
        if smallest(simplices.data.level.comm, self.least) <= 0:
            raise InputError(f"{value}: must be positive everywhere, not at midpoints of cells only")

    def _take(self, groups: list[Group]) -> None:
        """Bounds and means; where bounds are of no use, the middle of a part stands for it."""
        count = len(self._area)
        self.least, self.most, mean, spread = (np.zeros(count) for _ in range(4))
        self.least[:], self.most[:] = np.inf, -np.inf
        for group in groups:
            middle = group.values(np.full((1, self._dim + 1), 1 / (self._dim + 1)))[:, 0]
            useless = ~((group.lower > 0) & np.isfinite(group.upper))
            lower, upper = (np.where(useless, middle, bound) for bound in (group.lower, group.upper))
            rest = np.where(useless, 0.0, group.rest)
            group.lower_to(self.least, lower)
            group.raise_to(self.most, upper)
            group.add_to(mean, group.share * self._mean_of(group))
            group.add_to(spread, group.share * rest * group.mean_weight(self._simplices.radius))
            varies = (group.degree > 0) | (rest > 0) | (group.corners is not None)
            self.varies[group.rows[varies]] = True
            near = replace(group, lower=lower, upper=upper, rest=rest)
            self._parts += near[np.flatnonzero(varies)].portions()
        ratio = self._simplices.size / self._area
        self.least_mean = np.maximum(mean - spread, self.least * ratio)
        self.most_mean = np.minimum(mean + spread, self.most * ratio)

    def _mean_of(self, group: Group) -> np.ndarray:
        """Of the polynomials on parts of cells, times the weight of integrals."""
        if self._simplices.radius is None:
            return group.coefficients.mean(axis=1)
        points, weights = rule(self._dim, group.degree + 1)
        return integrals(group.values(points), group.weights(points, weights, self._simplices.radius))

    def known(self) -> CellDatum:
        """What is known of it, for `certification.Hypotheses`."""
        return CellDatum("tension", self.pieces, "tension may be 0, negative, infinite or undefined", least=0.0)

    def energy_above(self, gradient: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Upper bounds of ||mu^(1/2) g||_T^2 of one vector per cell, shape (d, cells) (local).

        Args:
            gradient: The vectors g.
            cells: Which.
        """
        return self._area[cells] * self.most_mean[cells] * np.einsum("xc,xc->c", gradient, gradient)

    def energy_below(self, gradient: np.ndarray, cells: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Lower bounds of the same."""
        return self._area[cells] * self.least_mean[cells] * np.einsum("xc,xc->c", gradient, gradient)

    def integrate_distances(self, squares: np.ndarray, fields: Fields, degree: int) -> None:
        """Set squares to a bound of ||mu^(1/2) g - mu^(-1/2) s||_T^2 in the cells where the tension mu varies, (E25)
        (local).

        Where mu is q + r, q polynomials, |r| <= R and mu >= m > 0, it is at most
        m^(-1/2) (||q g - s|| + R ||g||). Where only m <= mu <= M is known the square of the integrand, which is convex
        in mu, is at most the larger of a and b, its values for m and for M, and

            2 int max(a, b) = int a + int b + int |a - b| <= int a + int b + |T|^(1/2) ||a - b||.

        All integrals have the weight that there may be.

        Args:
            squares: One for each cell.
            fields: Gives g and s at barycentric points of some cells, shape (cells or 1, points, d + 1), each of shape
                (cells, points, d).
            degree: That of s at least, and one more than that of g at least.
        """
        squares[self.varies] = 0.0
        for part in self._parts:
            measure = part.share * self._area[part.rows]
            least, most = part.lower[:, None], part.upper[:, None]
            more = self._simplices.radius is not None
            exact = 2 * max(part.degree + degree - 1, degree) if part.smooth else 4 * degree
            points, weights = rule(self._dim, exact + more)
            g, s = fields(part.rows, part.points(points))
            weights = part.weights(points, weights, self._simplices.radius)
            gg, gs, ss = (np.einsum("cpx,cpx->cp", *pair) for pair in ((g, g), (g, s), (s, s)))
            if part.smooth:
                difference = part.values(points)[..., None] * g - s
                near = integrals(np.einsum("cpx,cpx->cp", difference, difference), weights)
                found = (np.sqrt(near) + part.rest * np.sqrt(integrals(gg, weights))) ** 2 / part.lower
            else:
                a, b = (mu * gg - 2 * gs + ss / mu for mu in (least, most))
                apart = np.sqrt(integrals((a - b) ** 2, weights) * part.mean_weight(self._simplices.radius))
                found = (integrals(a + b, weights) + apart) / 2
            part.add_to(squares, measure * found)

    def least_energy(self, squares: np.ndarray, fields: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        """Set squares to a lower bound of ||mu^(1/2) g||_T^2 in the cells where the tension mu varies (local).

        Args:
            squares: One for each cell.
            fields: Gives g, of degree 1 at most, as `integrate_distances` has it.
        """
        squares[self.varies] = 0.0
        for part in self._parts:
            points, weights = rule(self._dim, part.degree + 2)
            g = fields(part.rows, part.points(points))
            gg = np.einsum("cpx,cpx->cp", g, g)
            found = np.maximum((part.values(points) * gg) @ weights - part.rest * (gg @ weights),
                               part.lower * (gg @ weights))  # fmt: skip
            part.add_to(squares, part.share * self._area[part.rows] * found)


def _at(functions: Callable[[np.ndarray], np.ndarray], points: np.ndarray) -> np.ndarray:
    """Functions of barycentric points at points of shape (parts or 1, points, d + 1)."""
    found = functions(points.reshape(-1, points.shape[2]))
    return found.reshape(*points.shape[:2], *found.shape[1:])


def _rows(values: np.ndarray, kept: int = 1) -> np.ndarray:
    """A view with the axes after the first `kept` made one; -1 for it would fail on ranks without cells."""
    return values.reshape(*values.shape[:kept], math.prod(values.shape[kept:]))
