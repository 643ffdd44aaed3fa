"""A solution sampled at quadrature points, for distances to solutions on other meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.effects.field import Rows
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.cells import corners, own_cells
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import locate
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.releases import cell_name

AT_ONCE = 300_000  # points that are looked up together


@dataclass(frozen=True, eq=False)
class Cloud:
    """Values and gradients of a solution at the quadrature points of its cells, the same on every rank.

    Attributes:
        points: Coordinates, shape (n, 3).
        weights: The volumes they stand for, times the distance from the axis where the scene has one, shape (n,).
        tension: Times them, shape (n,); or a matrix at each, shape (n, rows, rows).
        u: Solution, shape (n,).
        slopes: grad u, shape (n, 3).
    """

    points: np.ndarray
    weights: np.ndarray
    tension: np.ndarray
    u: np.ndarray
    slopes: np.ndarray

    @classmethod
    def of(cls, answer: Answer, degree: int = 1) -> Cloud:
        """The points of an answer (collective).

        The rule is exact for u^2 on its cells and, where cells of another mesh are unions of these, for the square of a
        difference; in solids, where there would be many points, for that of slopes.

        Args:
            answer: A solution.
            degree: Of the other one, where it is higher.
        """
        answer = on_simplices(answer)
        level, data = answer.level, answer.data()
        dim, count, degree = level.mesh.topology.dim, own_cells(level.mesh), max(level.pair.degree, degree)
        inside, shares = rule(dim, 2 * degree if dim < 3 else 2 * degree - 2)
        elastic = answer.scene.model.elastic
        if elastic.role == "matrix tension":
            tension = [[data.cellwise(entry) for entry in row] for row in cast(Rows, elastic.value)]
        else:
            tension = [[data.cellwise(elastic.value, positive=True)]]
        reference, found = Reference(level.mesh), []
        for block in [*blocks(count)] or [slice(0, 0)]:
            x = corners(level.mesh, block)
            points = (inside @ x).reshape(-1, 3)
            cells, where = np.arange(count)[block], inside[None]
            weights = (reference.measures(cells, where) * shares).ravel()
            weights = weights * points[:, 0] if data.model.radial else weights
            entries = [[reference.values(one, cells, where).ravel() * weights for one in row] for row in tension]
            pulling = np.moveaxis(np.array(entries), 2, 0) if len(entries) > 1 else entries[0][0]
            u, slopes = reference.values(answer.u, cells, where), reference.gradients(answer.u, cells, where)
            found.append((points, weights, pulling, u.ravel(), slopes.reshape(-1, 3)))
        mine = [np.concatenate(parts) for parts in zip(*found, strict=True)]
        return cls(*(np.concatenate(parts) for parts in zip(*level.comm.allgather(mine), strict=True)))


class Nearby:
    """Distances of functions on one mesh to a cloud; the cells that contain its points are found once.

    Points outside the mesh, where shapes are curved, count 0; on a side both cells have equal weight.
    """

    def __init__(self, cloud: Cloud, level: Level):
        """Find the cells (collective).

        Args:
            cloud: What distances are to.
            level: Where the functions live, of simplices.
        """
        self.cloud, self.comm = cloud, level.comm
        parts = []
        for start in range(0, max(len(cloud.points), 1), AT_ONCE):
            rows, *within = locate(level, cloud.points[start : start + AT_ONCE])
            parts.append((rows + start, *within))
        self._rows, self._cells, self._places = (np.concatenate(part) for part in zip(*parts, strict=True))
        found = np.bincount(self._rows, minlength=len(cloud.points))
        self.comm.Allreduce(MPI.IN_PLACE, found, MPI.SUM)
        self._share = 1.0 / found[self._rows]

    def norms(self, u: fem.Function) -> dict[str, float]:
        """`l2`, `energy`, which is ||mu^(1/2) grad(.)||, and `max`, over the points, of the difference (collective)."""
        sums, highest, reference = np.zeros(2), 0.0, Reference(u.function_space.mesh)
        for block in blocks(len(self._rows)):
            rows, share, cells, where = self._rows[block], self._share[block], self._cells[block], self._places[block]
            e = reference.values(u, cells, where[:, None])[:, 0] - self.cloud.u[rows]
            slopes = reference.gradients(u, cells, where[:, None])[:, 0] - self.cloud.slopes[rows]
            sums += share @ (self.cloud.weights[rows] * e**2), share @ _along(self.cloud.tension[rows], slopes)
            highest = max(highest, np.abs(e).max())
        l2, energy = (math.sqrt(max(total(self.comm, part), 0.0)) for part in sums)
        return {"energy": energy, "l2": l2, "max": largest(self.comm, highest)}


def on_simplices(answer: Answer) -> Answer:
    """The answer itself on simplices, of whatever degree; otherwise its interpolant on the cut cells (collective)."""
    return answer if cell_name(answer.level.mesh) in SIMPLICES else answer.plain


def _along(tension: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """(tension slope) . slope at each point."""
    if tension.ndim == 1:
        return tension * np.einsum("qi,qi->q", slopes, slopes)
    slopes = slopes[:, : tension.shape[1]]
    return np.einsum("qij,qi,qj->q", tension, slopes, slopes)
