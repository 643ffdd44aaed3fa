"""Tension and load of a P2 problem in its cells, as the solver has them and as their formulas are."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.accuracy.exactness import in_cells, number
from fenicsx_obstacle.accuracy.flux import SHARP
from fenicsx_obstacle.accuracy.quadrature import DEGREE, rule
from fenicsx_obstacle.accuracy.rt1 import MASS, against_nodes, quadratics
from fenicsx_obstacle.accuracy.triangles import Triangles, halved_rule
from fenicsx_obstacle.discrete.data import Data, array_of
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.parallel import largest


class Samples2:
    """What of the data the bound for P2 needs.

    Attributes:
        triangles: The owned cells, with the dofs of P1.
        nodes: Local dofs of P2 at the vertices of each cell and at the middles opposite to them, shape (cells, 6).
        mu: Mean tension of each cell, as the solver has it.
        load: int f psi_j psi_k, shape (cells, 3, 3).
        oscillation: ||f - Pi_1 f||_T.
        load_known: What is known of the load in the cells.
        missing: Force at owned nodes that the load's formula gives more than what the solver makes of it.
    """

    def __init__(self, triangles: Triangles, data: Data):
        """Sample (collective).

        Args:
            triangles: Of P1 on the same mesh.
            data: Of P2.
        """
        self.triangles, self.data, self.level = triangles, data, data.level
        dofs = releases.cell_dofs(self.level.V)[: len(triangles.area)]
        self.nodes = np.hstack([triangles.turned(dofs[:, :3]), triangles.turned(dofs[:, 3:])])
        self._sample_tension()
        self._sample_load()

    def summed(self, values: np.ndarray, *, middles: bool = False) -> np.ndarray:
        """Sums over the cells around each local node of P2, from values (cells, 6), or (cells, 3) at middles
        (collective)."""
        function, nodes = fem.Function(self.level.V), self.nodes[:, 3:] if middles else self.nodes
        function.x.array[:] = np.bincount(nodes.ravel(), values.ravel(), len(function.x.array))
        releases.add_ghosts(function)
        function.x.scatter_forward()
        return function.x.array.copy()

    def _in_cells(self, value: Field, points: np.ndarray, *, positive: bool = False) -> np.ndarray:
        """What the solver has of a formula at barycentric points, shape (cells, points)."""
        made = self.data.cellwise(value, positive=positive)
        values = array_of(made)
        if len(values) == 1 and not isinstance(made, fem.Function):
            return np.full((len(self.triangles.area), len(points)), values[0])
        dofs = releases.cell_dofs(self.level.W)[: len(self.triangles.area)]
        dofs = np.hstack([self.triangles.turned(dofs[:, :3]), self.triangles.turned(dofs[:, 3:])])
        return values[dofs] @ quadratics(points)

    def _sample_tension(self) -> None:
        """int mu psi_j psi_k and the mean of mu."""
        tension = self.data.model.elastic
        points, weights = rule(2)
        mu = self._in_cells(tension.value, points, positive=True)
        self.mu = mu @ weights
        products = np.einsum("pj,pk->pjk", points, points)
        self._mu_products = self.triangles.area[:, None, None] * np.einsum("cp,p,pjk->cjk", mu, weights, products)

    def _sample_load(self) -> None:
        triangles, area = self.triangles, self.triangles.area
        self.load, self.oscillation = np.zeros((len(area), 3, 3)), np.zeros(len(area))
        missing = np.zeros((len(area), 3, 3))
        points, weights = rule(2)
        self.load_known = number(len(area))
        for value in (effect.value for effect in self.data.model.effects if effect.key == "load"):
            solver = self._in_cells(value, points)
            of_solver = self._products(solver, points, weights, slice(None))
            if value.uniform:
                self.load += of_solver
                continue
            values = triangles.values(value, points)
            known = self.load_known = in_cells(triangles, value)
            exact, waves = self._products(values, points, weights, slice(None)), self._wave(values, points, weights)
            sizes = np.abs(values).max(axis=1, initial=0.0)
            wide = np.ptp(values, axis=1) > SHARP * largest(self.level.comm, sizes)
            sharp = np.flatnonzero(wide & ~known.exact)
            dense, shares = halved_rule(2)
            values = triangles.values(value, dense, sharp)
            exact[sharp] = self._products(values, dense, shares, sharp)
            waves[sharp] = self._wave(values, dense, shares)
            for degree, cells in known.degrees(DEGREE // 2 + 1):
                dense, shares = rule(2, 2 * degree)
                values = triangles.values(value, dense, cells)
                exact[cells] = self._products(values, dense, shares, cells)
                waves[cells] = self._wave(values, dense, shares)
            self.load += exact
            self.oscillation += np.sqrt(area * waves)
            missing += exact - of_solver
        self.missing = self.summed(against_nodes(missing))[: self.level.owned]

    def _products(
        self, values: np.ndarray, points: np.ndarray, weights: np.ndarray, cells: np.ndarray | slice
    ) -> np.ndarray:
        """int f psi_j psi_k."""
        products = np.einsum("p,pj,pk->pjk", weights, points, points)
        return self.triangles.area[cells][:, None, None] * np.einsum("cp,pjk->cjk", values, products)

    @staticmethod
    def _wave(values: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Mean square of the distance to the nearest linear function."""
        linear = values @ (weights[:, None] * points) @ np.linalg.inv(MASS)
        return (values - linear @ points.T) ** 2 @ weights
