"""What nodes do not see: obstacles and boundary values between the nodes.

An obstacle is sampled inside every cell, densely in cells where u may touch it, and its highest point above the nodal
interpolant is added at the nodes around, with something to spare for what lies between the samples. Boundary values
are sampled along each edge, and the difference to their nodal interpolant is extended into the cell beside it as a
cone that vanishes at the opposite vertex.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.accuracy.fans import Fans
from fenicsx_obstacle.accuracy.quadrature import blocks, rule
from fenicsx_obstacle.accuracy.triangles import Triangles, lattice, lattice_cells
from fenicsx_obstacle.parallel import largest, total

SPARE = 1.5  # times the height that a few points of a cell have found,
SPARE_DENSE = 1.1  # and that of a dense lattice
NEAR = 4.0  # times that height: how near u may come before a cell is sampled densely
DENSE = 8  # parts of an edge
SEGMENTS = 16  # of an edge where u is given
ROUND_OFF = 1e-14  # of the heights


class Rim:
    """Boundary values along the edges where u is given (d = g - g_h, zero at the nodes).

    Attributes:
        twice: Whether a cell has two such edges.
        torn: Largest jump of the boundary values at a node, where two parts of the boundary disagree.
        cells: Cells with an edge where d is not zero, once for each edge.
        opposite: Vertex opposite to that edge.
        dip: Largest |d|, shape (all owned cells,).
        volume: Integral of the cones over each cell.
    """

    def __init__(self, triangles: Triangles, middles: np.ndarray | None = None):
        """Sample the boundary values (collective).

        Args:
            triangles: The cells.
            middles: Of P2 the nodal values at the middle of the edge opposite to each vertex, shape (cells, 3).
        """
        self.triangles, data, self._middles = triangles, triangles.data, middles
        scene, cells = data.scene, len(triangles.area)
        values = data.fixed[1].x.array
        part = np.full(max(triangles.facets.max(initial=-1) + 1, 1), -1)
        for number, facets in enumerate(data.held):
            part[facets[facets < len(part)]] = number  # of two parts the later one counts
        self._formulas = [
            scene.formula(0.0 if table.value is None else table.value, f"[[boundary]] (no. {number + 1}) value")
            for number, table in enumerate(scene.tables.boundary)
        ]
        steps = np.linspace(0.0, 1.0, SEGMENTS + 1)
        found: list[tuple[np.ndarray, ...]] = []
        comm = data.level.comm
        heights = largest(comm, np.abs(values[data.fixed[0]]))
        self.torn = 0.0
        for number, formula in enumerate(self._formulas):
            beside, opposite = np.nonzero(part[triangles.facets] == number)
            d = triangles.values(formula, _on_edge(opposite, steps), beside)
            ends = values[triangles.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            d = d - self._interpolated(beside, opposite, ends, steps[None])
            self.torn = max(self.torn, largest(comm, np.abs(d[:, [0, -1]])))
            d[:, [0, -1]] = 0.0
            curved = np.abs(d).max(axis=1, initial=0.0) > ROUND_OFF * heights
            found.append((beside[curved], opposite[curved], np.full(np.count_nonzero(curved), number), d[curved]))
        self.torn = 0.0 if self.torn <= 1e-9 * heights else self.torn
        empty = (np.empty(0, int), np.empty(0, int), np.empty(0, int), np.empty((0, SEGMENTS + 1)))
        self.cells, self.opposite, self._number, self._d = (
            np.concatenate(parts) for parts in zip(empty, *found, strict=True)
        )
        # one cone keeps to the segments between its ends, two in a corner may together leave them
        self.twice = total(comm, np.count_nonzero(np.bincount(self.cells) > 1)) > 0
        self.dip, self.volume = np.zeros(cells), np.zeros(cells)
        np.maximum.at(self.dip, self.cells, np.abs(self._d).max(axis=1, initial=0.0))
        # (H/3) int d: the cone is (1 - t/H) d
        means = (self._d[:, :-1] + self._d[:, 1:]).mean(axis=1) / 2
        np.add.at(self.volume, self.cells, 2 * triangles.area[self.cells] / 3 * means)

    def _interpolated(self, cells: np.ndarray, opposite: np.ndarray, ends: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """The nodal interpolant along the edges opposite to vertices."""
        linear = (1 - steps) * ends[:, :1] + steps * ends[:, 1:]
        if self._middles is None:
            return linear
        return linear + 4 * steps * (1 - steps) * (self._middles[cells, opposite] - ends.mean(axis=1))[:, None]

    def energy(self, mu: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad||^2 of the cones in each cell, mu being the largest tension there."""
        x, area = self.triangles.x[self.cells], self.triangles.area[self.cells]
        row = np.arange(len(area))
        a, b, c = (x[row, (self.opposite + k) % 3] for k in range(3))
        length = np.linalg.norm(c - b, axis=1)
        height = 2 * area / length
        foot = np.einsum("ix,ix->i", a - b, c - b) / length
        step = (length / SEGMENTS)[:, None]
        slope = np.diff(self._d, axis=1) / step
        # d - (s - s_0) d' is constant on each segment, where d is taken to be linear
        across = (self._d[:, :-1] - slope * (step * np.arange(SEGMENTS) - foot[:, None])) / height[:, None]
        edges = np.bincount(self.cells, minlength=len(mu))
        energy = (1 + 1 / SEGMENTS) ** 2 * mu[self.cells] * height / 2 * ((slope**2 + across**2) * step).sum(axis=1)
        return edges * np.bincount(self.cells, weights=energy, minlength=len(mu))

    def cones(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Their sum in given cells at barycentric coordinates, shape (points, 3) (collective)."""
        found = np.zeros((len(cells), len(where)))
        row = np.full(len(self.triangles.area), -1)
        row[cells] = np.arange(len(cells))
        values = self.triangles.data.fixed[1].x.array
        for number, formula in enumerate(self._formulas):
            chosen = np.flatnonzero((self._number == number) & (row[self.cells] >= 0))
            beside, opposite = self.cells[chosen], self.opposite[chosen]
            share = where[:, (opposite[:, None] + [1, 2]) % 3].transpose(1, 0, 2)
            width = share.sum(axis=2)
            step = np.divide(share[..., 1], width, out=np.zeros_like(width), where=width > 0)
            ends = values[self.triangles.dofs[beside[:, None], (opposite[:, None] + [1, 2]) % 3]]
            g = self.triangles.values(formula, _on_edge(opposite, step), beside)
            np.add.at(found, row[beside], width * (g - self._interpolated(beside, opposite, ends, step)))
        return found


def _on_edge(opposite: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Barycentric coordinates, shape (edges, points, 3), of points on the edges opposite to vertices."""
    where = np.zeros((len(opposite), steps.shape[-1], 3))
    row = np.arange(len(opposite))
    where[row, :, (opposite + 1) % 3], where[row, :, (opposite + 2) % 3] = 1 - steps, steps
    return where


class Peaks:
    """One obstacle between its nodes; heights count away from it: times -1 for an upper one.

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        nodal: sign times its nodal values at local dofs.
        cover_energy: ||grad||^2 in each cell of what is added to the state beside the boundary (see `lift`).
        cover_volume: Its integral.
        surprise: By how much dense samples found it higher than all the others let expect: it may have peaks narrower
            than either.
    """

    def __init__(self, triangles: Triangles, fans: Fans, rim: Rim, side: str):
        """Sample it at a few points of each cell (collective)."""
        data = triangles.data
        self.triangles, self.fans, self.rim = triangles, fans, rim
        self.sign = 1.0 if side == "lower" else -1.0
        self.nodal = self.sign * getattr(data, side).x.array
        self._formula = data.scene.formula(getattr(data.scene.tables.obstacle, side), f"[obstacle] {side}")
        comm, cells = data.level.comm, len(triangles.area)
        self._heights = largest(comm, np.abs(self.nodal))
        self._flat = triangles.data.uniform(self._formula)
        points, weights = rule(2)
        self.mean, self._height = np.zeros(cells), np.zeros(cells)
        if not self._flat:
            for block in blocks(cells):
                above = self._above(points, np.arange(block.start, block.stop))
                self.mean[block] = above @ weights  # of the obstacle above its nodal interpolant
                self._height[block] = SPARE * self._clean(above.max(axis=1, initial=0.0))
        self._is_dense = np.zeros(cells, dtype=bool)
        self.surprise = 0.0
        self.cover_energy, self.cover_volume = np.zeros(cells), np.zeros(cells)

    def lift(self, u: np.ndarray) -> np.ndarray:
        """Nodal heights of an obstacle that is nowhere below this one where u may touch it (collective).

        Beside nodes where u is given it may be below; there `cover_energy` and `cover_volume` are those of the function
        that makes up for it.

        Args:
            u: sign times the state at local dofs.

        Returns:
            At local dofs; where u is given, the nodal height.
        """
        if self._flat and not self.rim.twice:
            return self.nodal
        dofs = self.triangles.dofs
        slack = (u - self.nodal)[dofs].min(axis=1) - self.rim.dip
        near = slack <= np.maximum(NEAR * self._height, ROUND_OFF * self._heights)
        new = np.flatnonzero(near & ~self._is_dense)
        above = self._clean(self._above(lattice(DENSE), new).max(axis=1, initial=0.0))
        expected = self._height[new] + max(largest(self.triangles.data.level.comm, self._height), 0.0)
        self.surprise = max(self.surprise, largest(self.triangles.data.level.comm, above - expected))
        self._height[new] = SPARE_DENSE * above
        self._is_dense[new] = True
        given = np.zeros(len(u), dtype=bool)
        given[self.triangles.data.fixed[0]] = True
        lifted = self.nodal + np.where(given, 0.0, self._at_nodes(np.where(near, self._height, 0.0)))
        self._cover(np.where(given, u, np.maximum(u, lifted)), near & (given[dofs].any(axis=1) | (self.rim.dip > 0)))
        return lifted

    def _cover(self, state: np.ndarray, beside: np.ndarray) -> None:
        """What is still above the state beside nodes that cannot be raised, because u is given there (collective).

        It is taken to be linear on a lattice, so that cells fit together.
        """
        triangles, where, cells = self.triangles, lattice(DENSE), np.flatnonzero(beside)
        gap = (state - self.nodal)[triangles.dofs[cells]] @ where.T + self.sign * self.rim.cones(cells, where)
        cover = self._clean(np.maximum(self._above(where, cells) - gap, 0.0))
        parts = np.array(lattice_cells(DENSE))
        share = triangles.area[cells] / len(parts)
        self.cover_volume[:], self.cover_energy[:] = 0.0, 0.0
        self.cover_volume[cells] = cover[:, parts].mean(axis=2).sum(axis=1) * share
        # every part is the cell over again, DENSE times smaller and maybe turned round
        normal = DENSE * triangles.normal[:, cells] / (2 * triangles.area[cells])[:, None]
        gradient = np.einsum("cpi,xci->xcp", cover[:, parts], normal)
        self.cover_energy[cells] = (1 + 1 / DENSE) ** 2 * np.einsum("xcp,xcp->c", gradient, gradient) * share

    def _at_nodes(self, heights: np.ndarray) -> np.ndarray:
        """The largest value in the cells around each local dof (collective)."""
        function = fem.Function(self.triangles.data.level.V)
        if total(function.function_space.mesh.comm, np.count_nonzero(heights)) > 0:
            corners = self.fans.gather(np.repeat(heights[:, None], 3, axis=1))[0]
            function.x.array[: self.fans.owned] = self.fans.largest(corners)
            function.x.scatter_forward()
        return function.x.array

    def _above(self, where: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """How far the obstacle is above its nodal interpolant, shape (cells, points)."""
        inside = self.sign * self.triangles.values(self._formula, where, cells)
        return inside - self.nodal[self.triangles.dofs[cells]] @ where.T

    def _clean(self, heights: np.ndarray) -> np.ndarray:
        return np.where(heights <= ROUND_OFF * self._heights, 0.0, heights)
