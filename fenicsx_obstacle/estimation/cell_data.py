"""Tension, load and obstacles in the cells of a plane mesh: as the solver has them, and as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.fields import array_of
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.exactness import Known, in_cells, number
from fenicsx_obstacle.estimation.quadrature import DEGREE, rule
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.triangles import Triangles, halved_rule
from fenicsx_obstacle.parallel import largest, smallest

SHARP = 0.1  # of the largest value: what varies so much in a cell may jump there
Fields = Callable[[np.ndarray | slice, np.ndarray], tuple[np.ndarray, np.ndarray]]


def tension_of(data: Data) -> Field:
    """mu, of a problem that `refuse_no_bound` lets pass."""
    tension = data.model.elastic.isotropic_tension
    assert tension is not None
    return tension


def load_of(data: Data) -> Field | None:
    """f, if there is a load per area; of several the first."""
    return next((load for effect in data.model.effects if (load := effect.area_load) is not None), None)


def other_effects(data: Data) -> list[Effect]:
    """The effects besides that tension and load."""
    effects = data.model.effects
    load = next((effect for effect in effects if effect.area_load is not None), None)
    return [effect for effect in effects if effect is not data.model.elastic and effect is not load]


def obstacles_of(data: Data) -> list[tuple[float, Field]]:
    """The obstacles that there are: 1 and the lower one, -1 and the upper one."""
    given = ((1.0, data.model.lower), (-1.0, data.model.upper))
    return [(sign, obstacle) for sign, obstacle in given if obstacle is not None]


def of_solver(
    triangles: Triangles, data: Data, value: Field, points: np.ndarray, *, positive: bool = False
) -> np.ndarray:
    """What the solver has of a datum at barycentric points of the cells, shape (cells, points) (collective on first
    use).

    Args:
        triangles: The cells.
        data: Of the solver's elements on the same mesh.
        value: Of the datum.
        points: Barycentric coordinates, shape (points, 3).
        positive: Whether values that are not positive are an error.
    """
    made, count = data.cellwise(value, positive=positive), len(triangles.area)
    if isinstance(made, fem.Constant):
        return np.full((count, len(points)), array_of(made)[0])
    dofs = releases.cell_dofs(data.level.W)[:count]
    if dofs.shape[1] == 1:
        return np.repeat(made.x.array[dofs], len(points), axis=1)
    return made.x.array[triangles.turned_nodes(dofs)] @ quadratics(points)


@dataclass(frozen=True, eq=False)
class Samples:
    """Values of a datum at the points of a quadrature rule, the same in each of some cells.

    Attributes:
        cells: Which cells.
        points: Barycentric coordinates, shape (points, 3).
        weights: Of sum 1.
        values: Shape (cells, points).
    """

    cells: np.ndarray | slice
    points: np.ndarray
    weights: np.ndarray
    values: np.ndarray = field(repr=False)


class Load:
    """Moments of the load in the cells, and how far it is from the polynomials that the flux is in balance
    with.

    Attributes:
        moments: int f q for each test function q, shape (cells, ...).
        missing: The same less what the solver makes of it.
        oscillation: ||f - Pi f||_T, shape (cells,).
        known: What is known of it in the cells.
    """

    def __init__(
        self,
        triangles: Triangles,
        data: Data,
        tests: Callable[[np.ndarray], np.ndarray],
        basis: Callable[[np.ndarray], np.ndarray],
    ):
        """Sample it (collective).

        Args:
            triangles: The cells.
            data: Of the solver's elements on the same mesh.
            tests: Test functions q at barycentric points, shape (points, ...).
            basis: Of the polynomials that Pi projects onto, shape (points, n).
        """
        self._triangles, self._tests, self._basis = triangles, tests, basis
        count = len(triangles.area)
        points, weights = rule(2, 4)  # exact for what the solver has, times q
        self.known, self.oscillation = number(count), np.zeros(count)
        self.moments = np.zeros((count, *tests(points).shape[1:]))
        self.missing = np.zeros_like(self.moments)
        value = load_of(data)
        if value is None:
            return
        everywhere = Samples(slice(None), points, weights, of_solver(triangles, data, value, points))
        solver = self._integrals(everywhere)
        if value.uniform:
            self.moments = solver
            return
        self.known = in_cells(triangles, value)
        for samples in self._samples(value):
            self.moments[samples.cells] = self._integrals(samples)
            self.oscillation[samples.cells] = self._distance(samples)
        self.missing = self.moments - solver

    def _samples(self, value: Field) -> Iterator[Samples]:
        """Of the datum: in all cells, then once more, to replace these, where it may jump or is a polynomial."""
        triangles = self._triangles
        points, weights = rule(2)
        values = triangles.values(value, points)
        yield Samples(slice(None), points, weights, values)
        sizes = np.abs(values).max(axis=1, initial=0.0)
        wide = np.ptp(values, axis=1) > SHARP * largest(triangles.data.level.comm, sizes)
        sharp = np.flatnonzero(wide & ~self.known.exact)
        points, weights = halved_rule(2)
        yield Samples(sharp, points, weights, triangles.values(value, points, sharp))
        for degree, cells in self.known.degrees(DEGREE // 2 + 1):
            points, weights = rule(2, 2 * degree)
            yield Samples(cells, points, weights, triangles.values(value, points, cells))

    def _integrals(self, samples: Samples) -> np.ndarray:
        """int f q."""
        q = self._tests(samples.points)
        found = samples.values @ (samples.weights[:, None] * q.reshape(len(q), -1))
        return (self._triangles.area[samples.cells, None] * found).reshape(-1, *q.shape[1:])

    def _distance(self, samples: Samples) -> np.ndarray:
        """||f - Pi f||_T."""
        basis = self._basis(samples.points)
        weighted = samples.weights[:, None] * basis
        nearest = samples.values @ weighted @ np.linalg.inv(basis.T @ weighted) @ basis.T
        return np.sqrt(self._triangles.area[samples.cells] * ((samples.values - nearest) ** 2 @ samples.weights))


class Tension:
    """The tension in the cells, with samples where it varies within them.

    Attributes:
        least: A lower bound in each cell, or its least sample.
        mean: Its mean.
        most: An upper bound, or its largest sample.
        varies: Whether it varies within a cell.
        known: What is known of it in the cells.
    """

    def __init__(self, triangles: Triangles, mu: np.ndarray):
        """Sample it (collective).

        Args:
            triangles: The cells.
            mu: Its mean in each cell, as the solver has it.

        Raises:
            InputError: If it is not positive somewhere.
        """
        self._area = triangles.area
        self.least = self.mean = self.most = mu
        self.varies = np.zeros(len(mu), dtype=bool)
        self.known = Known(mu, mu, np.zeros(len(mu), dtype=int))
        # samples, and what the square of a difference of fluxes is divided by there
        self._samples: list[tuple[Samples, np.ndarray]] = []
        value = tension_of(triangles.data)
        parts = [value] if value.parts is None else list(value.parts.values())
        if all(part.uniform for part in parts):
            return
        self.known = in_cells(triangles, value)
        self.least, self.mean, self.most = mu.copy(), mu.copy(), mu.copy()
        self._sample(triangles, value)
        if smallest(triangles.data.level.comm, self.least) <= 0:
            raise InputError(f"{value}: must be positive everywhere, not at midpoints of cells only")

    def _sample(self, triangles: Triangles, value: Field) -> None:
        """Take its bounds and mean from samples, or from what is known where it is a polynomial."""
        known = self.known
        points, weights = rule(2)
        tension = triangles.values(value, points)
        spread = np.ptp(tension, axis=1)
        sharp = spread > SHARP * np.abs(tension).max(axis=1, initial=0.0)
        sampled = ~known.exact | (known.lower <= 0)
        smooth = np.flatnonzero((spread > 0) & ~sharp & sampled)
        self._take(Samples(smooth, points, weights, tension[smooth]))
        points, weights = halved_rule(2)
        cells = np.flatnonzero(sharp & sampled)
        self._take(Samples(cells, points, weights, triangles.values(value, points, cells)))
        for degree, cells in known.degrees(1):
            cells = cells[known.lower[cells] > 0]
            # with the least tension in place of 1/tension all is polynomial, of fluxes of degree 2 at most
            points, weights = rule(2, 2 * max(degree + 1, 2))
            values, least = triangles.values(value, points, cells), known.lower[cells]
            self._take(Samples(cells, points, weights, values), least[:, None])
            self.least[cells], self.most[cells] = least, known.upper[cells]

    def _take(self, samples: Samples, divisor: np.ndarray | None = None) -> None:
        """Let samples count in their cells, distances being divided by the samples themselves or by a lower bound."""
        cells, values = samples.cells, samples.values
        self.least[cells], self.most[cells] = values.min(axis=1), values.max(axis=1)
        self.mean[cells] = values @ samples.weights
        self.varies[cells] = True
        self._samples.append((samples, values if divisor is None else divisor))

    def integrate_distances(self, squares: np.ndarray, fields: Fields) -> None:
        """Set squares to ||mu^(1/2) g - mu^(-1/2) s||_T^2 in the cells where the tension varies (local).

        Args:
            squares: One for each cell.
            fields: Gives g and s at barycentric points of some cells, each of shape (cells, points, 2).
        """
        for samples, divisor in self._samples:
            g, s = fields(samples.cells, samples.points)
            difference = samples.values[..., None] * g - s
            density = np.einsum("cpx,cpx->cp", difference, difference) / divisor
            squares[samples.cells] = self._area[samples.cells] * (density @ samples.weights)
