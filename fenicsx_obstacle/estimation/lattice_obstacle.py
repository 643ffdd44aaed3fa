"""An obstacle above P2, bounded between the points of a lattice in each cell.

Vertices are no contact nodes of P2, so that u_h may be below the obstacle there for every eps.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

import numpy as np

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.cell_data import in_cells
from fenicsx_obstacle.estimation.covered_obstacle import CoveredObstacle, negligible
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.pieces import Group, Pieces
from fenicsx_obstacle.estimation.quadrature import blocks
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.estimation.triangle_lattice import (
    CLOSE,
    COARSE,
    DENSE,
    FEW,
    FROM_COARSE,
    HALVES,
    MIDDLES,
    OF_SMALL,
    POINTS,
    SMALL,
    above_chords,
    bernstein,
    by_part,
)
from fenicsx_obstacle.parallel import largest as largest_of
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.polynomials import coefficients, combined, inner_points, largest, row_size

AS_THEY_ARE = Division(0)
SMALL_ONES = Division(4, 1e-4, 1e-4)  # for small triangles: the distance of an obstacle to linear functions matters
BESIDE = 2  # subdivisions of small triangles with a Dirichlet corner and the obstacle possibly above u
MORE = 4096  # cells per block where more is done with each
FINE = 0.2  # relative to the distance from the chord: smaller remainders are accepted
NEARLY = 0.1  # of the range of u - obstacle in a cell: so far below u an obstacle seems not to touch, by samples


class _Bends:
    """What u - obstacle minus its chord is on the small triangles of cells, found cell by cell.

    Attributes:
        highest: The largest value of obstacle - u at the corners of each small triangle.
        bend: Upper bound of obstacle - u minus its chord.
        mean: Upper bound of the mean of u - obstacle minus its chord.
        size: Upper bound of the absolute value of that difference.
    """

    def __init__(self, gap: np.ndarray):
        """Nothing is known yet.

        Args:
            gap: u - obstacle on the lattices of the cells.
        """
        self.highest = -reduce(np.minimum, (gap[:, corner] for corner in SMALL.T))
        self.bend, self.mean, self.size = (np.zeros(self.highest.shape) for _ in range(3))

    def between(self, may_touch: np.ndarray, multiplier: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What follows for u minus obstacle between the points of the lattice.

        Args:
            may_touch: Whether the obstacle may be above u in a cell.
            multiplier: lambda_+ at the vertices of each cell, shape (cells, 3).

        Returns:
            Lower bounds of M and N (`LatticeObstacle`) in each cell, shape (2, cells); whether the obstacle may be
            above u, shape (cells, small triangles); and an upper bound of the sum over the small triangles of each cell
            of the mean of lambda_+ times u - obstacle minus its chord.
        """
        count = len(may_touch)
        needed, touches, contact = np.zeros((2, count)), np.zeros(self.bend.shape, dtype=bool), np.zeros(count)
        for block in blocks(count, FEW):
            highest, bend = self.highest[block], self.bend[block]
            touches[block] = may_touch[block, None] & (highest + bend > 0)
            M = np.where(touches[block], np.maximum(bend, 0.0), 0.0).max(axis=1, initial=0.0)
            N = np.where(touches[block], highest + bend, 0.0).max(axis=1, initial=0.0)
            with_M = M <= 2 * N  # M is preferred: what it adds decreases as u - obstacle grows
            needed[:, block] = np.where(with_M, M, 0.0), np.where(with_M, 0.0, N)
            # |lambda_+ - its mean| is at most its range, which is the same on all small triangles
            means = multiplier[block] @ MIDDLES.T
            contact[block] = np.einsum("cs,cs->c", means, self.mean[block])
            contact[block] += np.ptp(multiplier[block], axis=1) / DENSE * self.size[block].sum(axis=1)
        return needed, touches, contact


class LatticeObstacle(CoveredObstacle):
    """One obstacle on a lattice of the cells in which u may touch it; values are times -1 for an upper obstacle.

    On the lattice u is raised by max(obstacle + M - u, N, 0), M and N in P1. Let d = obstacle - u. On the small
    triangles of a cell where d may be positive, M at its vertices is at least d minus its chord, or N at least d,
    whichever adds less. What is added is continuous, and the raised u is nowhere below the obstacle, except on small
    triangles with points where u is given: nothing is added there.
    """

    def __init__(self, simplices: Simplices, dirichlet: BoundaryData, sign: float, field: Field, known: Pieces):
        """Store the obstacle and its bounds (collective); the arguments are those of `CoveredObstacle`."""
        super().__init__(simplices, dirichlet, sign, field, known)
        self._pieces: list[tuple[np.ndarray, Pieces]] = []  # of the cells enclosed so far
        self._enclosed = np.zeros(len(self._top), dtype=bool)
        self._differs = False
        self._beside = np.empty(0, dtype=int), np.empty(0, dtype=int)  # cells and small triangles at the boundary

    def above(
        self, u: np.ndarray, added: np.ndarray, multiplier: np.ndarray,
        at_nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """What raises a state above the obstacle where it may be below or is pressed against it, (E19) (collective).

        Args:
            u: Values of P2 at the nodes of cells, shape (cells, 6).
            added: The state less u on the lattices of cells: by what the other obstacle has moved it.
            multiplier: lambda_+ at the vertices of cells.
            at_nodes: The obstacle at the nodes of cells, if samples of it are to do: faster, and no bound.

        Returns:
            Cells; state - obstacle on their lattices; the amount by which it is raised there; and the bound of
            `_Bends.between` for the contact term.
        """
        pressing = multiplier.any(axis=1)
        touches = self._may_touch(u, added) if at_nodes is None else self._seems_to_touch(u, at_nodes)
        near = np.flatnonzero(touches | pressing)
        needed, of_u, moved = np.zeros((2, len(touches))), self._gap(u, near), self.sign * added
        gap = of_u + moved[near]
        bends = self._bends(u, near, of_u, gap, pressing[near]) if at_nodes is None else self._samples(of_u, gap)
        needed[:, near], of_small, contact = bends.between(touches[near], multiplier[near])
        place, small = np.nonzero(of_small & self._at_boundary(near))
        self._beside = near[place], small
        M, N = (self._at_vertices(side) for side in needed)
        # where the obstacle jumps across an edge only one cell may touch; both need the same values on the edge
        around = self._at_vertices((touches | pressing).astype(float))
        others = np.flatnonzero((M + N + around)[self.simplices.dofs].any(axis=1) & ~(touches | pressing))
        cells, gap = np.concatenate([near, others]), np.vstack([gap, self._gap(u, others) + moved[others]])
        of_M, of_N = (values[self.simplices.dofs[cells]] @ POINTS.T for values in (M, N))
        raised = np.where(self._held(cells), 0.0, np.maximum(of_M - gap, of_N))
        self._differs = not self._field.pointwise and len(near) > 0
        return cells, gap, raised, np.append(contact, np.zeros(len(others)))

    def beyond(self, u: np.ndarray, added: np.ndarray, moved: np.ndarray | None = None) -> float:
        """By how much the obstacle may be above the final state, on any rank, but on small triangles with a Dirichlet
        corner (collective).

        There it is covered (`CoveredObstacle`), and elsewhere if it may be round-off.

        Args:
            u: Values of P2 at the nodes of cells.
            added: The final state less u on the lattices of cells.
            moved: Whether the other obstacle has moved the state in each cell after this one; None: nowhere.
        """
        comm, (cells, small), most = self.simplices.data.level.comm, self._beside, 0.0
        if moved is not None:
            near = np.flatnonzero(moved & self._may_touch(u, added))
            gap = self._gap(u, near)
            bends = self._bends(u, near, gap, gap + self.sign * added[near], np.zeros(len(near), dtype=bool))
            above, beside = bends.highest + bends.bend, self._at_boundary(near)
            most = largest_of(comm, above[~beside])
            rounded, limit = negligible(comm, u)
            covered = (beside & (above > 0)) | ((above > rounded) & (most <= limit))
            place, number = np.nonzero(covered)
            kept = ~moved[cells]
            cells, small = np.append(cells[kept], near[place]), np.append(small[kept], number)
        lift = np.take_along_axis(self.sign * added[cells], SMALL[small], axis=1)
        unbounded = self._cover(cells, POINTS[SMALL[small]], lift, BESIDE, u, largest_of(comm, np.abs(u)))
        self.sampled = self._of_samples or total(comm, int(self._differs or unbounded)) > 0
        return most

    def _held(self, cells: np.ndarray) -> np.ndarray:
        """Which lattice points of some cells are Dirichlet points."""
        on_side = self.simplices.held[cells] @ (POINTS.T == 0)
        return on_side | (self.simplices.given[self.simplices.dofs[cells]] @ (POINTS.T == 1))

    def _at_boundary(self, cells: np.ndarray) -> np.ndarray:
        """Which small triangles of some cells have a Dirichlet corner."""
        return self._held(cells)[:, SMALL].any(axis=2)

    def _at_vertices(self, heights: np.ndarray) -> np.ndarray:
        """The largest height in the cells around each local vertex (collective)."""
        return self.simplices.around.largest(np.repeat(heights[:, None], 3, axis=1))

    def _seems_to_touch(self, u: np.ndarray, at_nodes: np.ndarray) -> np.ndarray:
        """Whether the interpolant of the obstacle is above u, or nearly, in each cell."""
        above = bernstein(self.sign * (at_nodes - u))
        highest = above.max(axis=1, initial=-np.inf)
        return highest >= -NEARLY * (highest - above.min(axis=1, initial=np.inf))

    def _may_touch(self, u: np.ndarray, added: np.ndarray) -> np.ndarray:
        """Whether the obstacle may be above a state in each cell (collective where the obstacle needs the distance to
        the boundary); the arguments are those of `above`."""
        lowest = bernstein(self.sign * u).min(axis=1, initial=np.inf)
        allowance = self.dirichlet.deviation + np.maximum(-self.sign * added, 0.0).max(axis=1, initial=0.0)
        found = np.zeros(len(u), dtype=bool)
        for rows, group in self._known(np.flatnonzero(self._top + allowance >= lowest)):
            bounded = group.no_less(self.sign)
            degree, coefficient, margin = bounded.above(self.sign * u[rows], self.sign)
            touches = largest(coefficient, 3, degree) + bounded.rest + allowance[rows] > margin
            np.logical_or.at(found, rows, touches)
        return found

    def _known(self, cells: np.ndarray) -> Iterator[tuple[np.ndarray, Group]]:
        """Polynomials near the obstacle in at least these cells, and the cell of each part (collective where the
        obstacle needs the distance)."""
        new = cells[~self._enclosed[cells]]
        self._pieces.append((new, in_cells(self.simplices, self._field, AS_THEY_ARE, new)))
        self._enclosed[new] = True
        for owner, pieces in self._pieces:
            for group in pieces.groups:
                yield owner[group.rows], group

    def _bends(
        self, u: np.ndarray, cells: np.ndarray, of_u: np.ndarray, gap: np.ndarray,
        pressing: np.ndarray,
    ) -> _Bends:  # fmt: skip
        """Bound state - obstacle between the points of the lattice; the state less u is linear there.

        Args:
            u: Values of P2 at the nodes of all cells.
            cells: The cells to bound it in, where u may touch or has a multiplier.
            of_u: u - obstacle on their lattices.
            gap: State - obstacle on their lattices.
            pressing: Whether they have a multiplier.
        """
        found, at = _Bends(gap), np.arange(len(cells))
        part = np.zeros(len(at), dtype=np.int64)
        for times, half in enumerate(HALVES):
            rough = np.ones(len(at), dtype=bool)
            nodes = by_part(half.to_nodes, part, u[cells[at]])
            if times == 0:
                groups = self._whole(cells[at])
            else:
                groups = self._on_parts(by_part(half.corners, part, self.simplices.x[cells[at]]), cells[at])
            of_bend, of_mean, of_size, at_corners = (
                values.reshape(len(cells), len(half.corners), len(half.small))
                for values in (found.bend, found.mean, found.size, found.highest)
            )  # views
            for places, whole in groups:
                for block in blocks(len(places), MORE):
                    rows, group = places[block], whole[block]
                    degree, coefficient, margin = group.above(self.sign * nodes[rows], self.sign, CLOSE)
                    known = 2 * group.rest[:, None]  # twice: of the datum and of its chord
                    rest = known + 2 * (self.dirichlet.deviation[cells[at[rows]]] + margin)[:, None]
                    most, least, means = above_chords(times, degree, coefficient)
                    place = at[rows], part[rows]
                    above = most + rest
                    of_bend[place], of_mean[place] = above, rest - means
                    of_size[place] = np.maximum(most, -least) + rest
                    matters = pressing[at[rows], None] | (at_corners[place] + above > 0)
                    limit = np.maximum(FINE * (most - least), 2 * margin[:, None])
                    rough[rows] = (matters & (known > limit)).any(axis=1)
            at, part = np.repeat(at[rough], 4), (4 * part[rough, None] + np.arange(4)).ravel()
        place = at, part  # after the last halving each part is a small triangle
        found.bend[place], found.mean[place], found.size[place] = self._bends_anew(u, cells[at], part, of_u[at])
        return found

    @staticmethod
    def _samples(of_u: np.ndarray, gap: np.ndarray) -> _Bends:
        """The same for the interpolants of degree 4 of u - obstacle in cells with these values on the lattice."""
        found = _Bends(gap)
        for block in blocks(len(gap), FEW):
            most, least, means = above_chords(0, CLOSE, -of_u[block][:, COARSE] @ FROM_COARSE)
            found.bend[block], found.mean[block], found.size[block] = most, -means, np.maximum(most, -least)
        return found

    def _bends_anew(
        self, u: np.ndarray, cells: np.ndarray, small: np.ndarray, gap: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Enclose the obstacle on small triangles (collective where it needs the distance).

        Args:
            u: Values of P2 at the nodes of all cells.
            cells: The cell of each small triangle.
            small: Its index in that cell.
            gap: u - obstacle on the lattice of that cell.

        Returns:
            Upper bounds, for d = obstacle - u: of d minus its chord, of the mean of the chord minus d, and of the
            absolute value of the difference.
        """
        corners = POINTS[SMALL[small]] @ self.simplices.x[cells]
        nodes = np.einsum("jsi,sj->si", OF_SMALL[:, small], u[cells])
        linear = -np.take_along_axis(gap, SMALL[small], axis=1)
        bend, mean, size = np.full(len(cells), -np.inf), np.zeros(len(cells)), np.zeros(len(cells))
        for group in pieces_of(self.simplices.data, self._field, corners, cells, SMALL_ONES).groups:
            degree, coefficient, margin = group.above(self.sign * nodes[group.rows], self.sign)
            chord = combined(group.points(inner_points(3, degree)), linear[group.rows])
            above = coefficient - coefficients(chord, 3, degree)
            rest = group.known_rest + 2 * self.dirichlet.deviation[cells[group.rows]] + margin
            group.raise_to(bend, largest(above, 3, degree) + rest)
            group.raise_to(size, row_size(above) + rest)
            mean += np.bincount(group.rows, group.share * (rest - above.mean(axis=1)), len(mean))
        return bend, mean, size

    def _whole(self, cells: np.ndarray) -> Iterator[tuple[np.ndarray, Group]]:
        """Polynomials near the obstacle in whole cells, and the indices of these cells in `cells` (collective where the
        obstacle needs the distance)."""
        place = np.full(len(self._enclosed), -1)
        place[cells] = np.arange(len(cells))
        for rows, group in self._known(cells):
            if group.corners is None:
                chosen = np.flatnonzero((place[rows] >= 0) & np.isfinite(group.rest))
                yield place[rows[chosen]], group[chosen]

    def _on_parts(self, corners: np.ndarray, cells: np.ndarray) -> Iterator[tuple[np.ndarray, Group]]:
        """Polynomials near the obstacle on triangles in cells, and the places of these (collective where the obstacle
        needs the distance)."""
        for group in pieces_of(self.simplices.data, self._field, corners, cells, AS_THEY_ARE).groups:
            if group.corners is None:
                chosen = np.flatnonzero(np.isfinite(group.rest))
                yield group.rows[chosen], group[chosen]

    def _gap(self, u: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """How far u with the boundary values is from the obstacle on the lattice."""
        inside = u[cells] @ quadratics(POINTS) - self.simplices.values(self._field, POINTS, cells)
        return self.sign * (inside + self.dirichlet.values(cells, POINTS))
