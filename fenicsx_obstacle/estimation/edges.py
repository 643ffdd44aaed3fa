"""Jumps of boundary values, and parts of the boundary that end inside a facet.

No function of finite energy jumps along the boundary. A datum is divided along each edge where a condition in it is
undecided, until the place is known to round-off; there, and at the ends of each edge, values on both sides are
compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.pieces import Group
from fenicsx_obstacle.estimation.simplices import Simplices, last_on_sides
from fenicsx_obstacle.mesh.cells import cell_facets, corners, facet_vertices, sides
from fenicsx_obstacle.parallel import first_given, largest, smallest

FINEST = 1e-11  # of the coordinates: how near to a jump values are compared,
WIDER = 64  # and so many times farther from it
KEEPS = 0.9  # of the difference is left between the two if it is a jump; if it is steep, less
CONTINUOUS = 1e-10  # of the range of boundary values: a smaller difference is none,
ROUNDED = 1e-14  # nor is it one of their size
SLIVER = 1e-8  # of the extent of the mesh: a part may reach so far beyond the facets on which it holds,
NOTHING = 1e-12  # but by itself it may be no longer than round-off of the coordinates
SHORT = 1e-6  # of an edge: parts where conditions are undecided, after division
SAMPLES = 5  # on each, and on each edge
MAX_PIECES = 20_000


@dataclass(frozen=True)
class Edges:
    """Edges of owned cells from one vertex to another.

    Attributes:
        start: First end point of each edge, shape (edges, d).
        end: Second end point of each edge, shape (edges, d).
        cells: The local cell beside each.
    """

    start: np.ndarray
    end: np.ndarray
    cells: np.ndarray

    def at(self, edges: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Points, shape (n, d): t = 0 at the start, 1 at the end."""
        t = np.clip(t, 0.0, 1.0)[:, None]
        return (1 - t) * self.start[edges] + t * self.end[edges]

    def pieces(self, edges: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Corners of parts of edges, shape (n, 2, d)."""
        return np.stack([self.at(edges, low), self.at(edges, high)], axis=1)


class Jumps:
    """The largest jump of boundary values that has been found on this rank."""

    def __init__(self, data: Data, nodal: np.ndarray):
        """Nothing so far (collective).

        Args:
            data: Of the problem.
            nodal: Boundary values at the nodes of this rank.
        """
        self.data = data
        self._least, self._most = np.inf, -np.inf
        self.take(nodal)
        self.worst: tuple[float, tuple[float, float], np.ndarray, str] | None = None

    def take(self, values: np.ndarray) -> None:
        """Widen the range of boundary values, beside which differences are judged (collective)."""
        comm, finite = self.data.level.comm, values[np.isfinite(values)]
        self._least = min(self._least, smallest(comm, finite))
        self._most = max(self._most, largest(comm, finite))

    def look(self, field: Field, edges: Edges, ends: np.ndarray) -> None:
        """Compare values on both sides wherever conditions change, and at the ends with the nodal values (collective).

        Args:
            field: Of the boundary value.
            edges: Where it holds.
            ends: Nodal values at start and end, shape (edges, 2).
        """
        count = len(edges.start)
        every = np.arange(count)
        if field.uniform:
            value = self._values(field, edges, every, np.zeros(count))
            for k in range(2):
                self._judge(field, (value, ends[:, k]), (value, ends[:, k]), edges.at(every, np.full(count, k)))
            return
        for t in np.linspace(0, 1, SAMPLES + 2)[1:-1]:  # all nodal values may be 0
            self.take(self._values(field, edges, every, np.full(count, t)))
        near = self._finest(edges)
        for k, direction in ((0, 1.0), (1, -1.0)):
            inside = [self._values(field, edges, every, k + direction * s * near) for s in (1, WIDER)]
            places = edges.at(every, np.full(count, k))
            self._judge(field, (inside[0], ends[:, k]), (inside[1], ends[:, k]), places)
        which, low, high = self._changes(field, edges, near)
        margin = np.maximum(high - low, near[which])
        close, far = (
            (self._values(field, edges, which, low - r), self._values(field, edges, which, high + r))
            for r in (margin, WIDER * margin)
        )
        self._judge(field, close, far, edges.at(which, (low + high) / 2))

    def between_samples(self, field: Field, edges: Edges, group: Group) -> Group:
        """Bound a boundary value by samples on short parts of edges on which its conditions are undecided.

        Its terms may jump there although it does not, as `look` has found: bounds of the terms over a short part would
        make it steep without limit. Its slope stays unknown there, so that the bound of the error rests on samples.

        Args:
            field: The boundary value.
            edges: Where it holds.
            group: Parts of the edges.
        """
        short = np.flatnonzero(~np.isfinite(group.steep) & (group.share <= SHORT))
        if not len(short) or group.corners is None or group.degree > 0:
            return group
        rows, ends = group.rows[short], group.corners[short, :, 1]
        samples = np.array([self._values(field, edges, rows, ends @ (1 - t, t)) for t in np.linspace(0, 1, SAMPLES)])
        lower, upper, rest = group.lower.copy(), group.upper.copy(), group.rest.copy()
        lower[short], upper[short] = samples.min(axis=0), samples.max(axis=0)
        rest[short] = (upper - lower)[short] / 2
        middle = group.coefficients.copy()
        middle[short, 0] = (lower + upper)[short] / 2
        return replace(group, coefficients=middle, rest=rest, lower=lower, upper=upper)

    def compare(self, field: Field, values: np.ndarray, others: np.ndarray, places: np.ndarray) -> None:
        """Keep the largest difference of values that are to be the same.

        Args:
            field: That gives the first ones.
            values: Of any shape.
            others: Of the same shape.
            places: Their points, shape (..., 3).
        """
        one, other = values.ravel(), others.ravel()
        self._judge(field, (one, other), (one, other), places.reshape(len(one), places.shape[-1]))

    def in_words(self) -> str | None:
        """Place and size of the largest jump on all ranks; None where there is none (collective)."""
        found = [one for one in self.data.level.comm.allgather(self.worst) if one is not None]
        if not found:
            return None
        _, (one, other), place, field = max(found, key=lambda candidate: candidate[0])
        return (
            f"{field}: the boundary values jump at {self.data.place(place)}, from {one:.9g} to "
            f"{other:.9g}; no u with such values has a finite energy"
        )

    def reject(self) -> None:
        """Raise where there is a jump (collective).

        Raises:
            InputError: Naming the place and the two values.
        """
        words = self.in_words()
        if words is not None:
            raise InputError(
                f"{words}, so that no error bound and no tolerance is possible: use a continuous boundary value"
            )

    def _changes(self, field: Field, edges: Edges, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where conditions change: edges, and ends of a short part of each."""
        count = len(edges.start)
        which, low, high = np.arange(count), np.zeros(count), np.ones(count)
        cut = self._cut(field, edges, which, low, high)
        which, low, high = which[cut], low[cut], high[cut]
        found = []
        while 0 < len(which) <= MAX_PIECES:
            middle = (low + high) / 2
            halves = [self._cut(field, edges, which, *ends) for ends in ((low, middle), (middle, high))]
            between = ~(halves[0] | halves[1])  # a condition may change at the middle itself
            ended = between | (high - low <= near[which])
            ends = np.where(between, middle, low), np.where(between, middle, high)
            found.append((which[ended], ends[0][ended], ends[1][ended]))
            kept = [half & ~ended for half in halves]
            of_both = (which, which), (low, middle), (middle, high)
            which, low, high = (np.concatenate([first[kept[0]], second[kept[1]]]) for first, second in of_both)
        found.append((which[:0], low[:0], high[:0]))
        which, low, high = (np.concatenate(column) for column in zip(*found, strict=True))
        return which, low, high

    def _cut(self, field: Field, edges: Edges, which: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Whether a condition is undecided in part of an edge, or a value or its slope may be infinite there."""
        known = self.data.here(field).over(edges.pieces(which, low, high), self.data.names(field), edges.cells[which])
        if known is None:
            return np.zeros(len(which), dtype=bool)
        bounds = known.once()
        return ~(bounds.whole & bounds.finite & np.isfinite(bounds.derivative(1)))

    def _finest(self, edges: Edges) -> np.ndarray:
        """The distance from a jump at which values are compared, relative to each edge."""
        size = np.abs(np.hstack([edges.start, edges.end])).max(axis=1, initial=0.0)
        return np.clip(FINEST * size / np.linalg.norm(edges.end - edges.start, axis=1), FINEST, 1e-3)

    def _values(self, field: Field, edges: Edges, which: np.ndarray, t: np.ndarray) -> np.ndarray:
        x, points = np.zeros((3, len(which))), edges.at(which, t)
        x[: points.shape[1]] = points.T
        return self.data.at(field, x, edges.cells[which])

    def _judge(
        self,
        field: Field,
        close: tuple[np.ndarray, np.ndarray],
        far: tuple[np.ndarray, np.ndarray],
        places: np.ndarray,
    ) -> None:
        """Keep the largest difference that does not vanish as the distance does."""
        small, large = (np.abs(pair[0] - pair[1]) for pair in (close, far))
        varies = np.abs(close[0] - far[0]) + np.abs(close[1] - far[1])  # on either side
        none = max(CONTINUOUS * (self._most - self._least), ROUNDED * max(self._most, -self._least, 0.0))
        jumps = (small > none) & (small >= KEEPS * large) & (small >= varies)
        jumps |= ~np.isfinite(small)
        if not jumps.any():
            return
        first = int(np.argmax(np.where(jumps, np.where(np.isfinite(small), small, np.inf), -1.0)))
        if self.worst is None or small[first] > self.worst[0]:
            pair = float(close[0][first]), float(close[1][first])
            place = np.zeros(3)
            place[: places.shape[1]] = places[first]
            self.worst = (float(small[first]), pair, place, str(field))


def boundary_jump(data: Data) -> str | None:
    """Where the boundary values of a model without time jump, in words; None where they do not (collective).

    Args:
        data: On plane triangles.
    """
    level, (fixed, given) = data.level, data.fixed
    held = np.concatenate([*data.held, np.empty(0, dtype=np.int32)])
    values, near = given.x.array, np.unique(sides(level.mesh, held)[0])
    dofs, x = releases.cell_dofs(level.V)[near], corners(level.mesh, near)
    part_of = last_on_sides(cell_facets(level.mesh)[near], data.held)
    jumps = Jumps(data, values[fixed])
    for number, part in enumerate(data.model.boundary):
        if part.value is not None:
            rows, side = np.nonzero(part_of == number)
            members = np.array(facet_vertices(2))[side]
            ends = np.moveaxis(x[rows[:, None], members, :2], 1, 0)
            jumps.look(part.value, Edges(ends[0], ends[1], near[rows]), values[dofs[rows[:, None], members]])
    return jumps.in_words()


def cut_parts(simplices: Simplices) -> list[str]:
    """The parts whose `where` ends inside a facet, or holds on other facets than those taken (collective).

    On meshes that are not the domain itself a facet whose vertices are all on the part is not looked at: the boundary
    lies beside it.

    Returns:
        One sentence for each.
    """
    data, level, dim, found = simplices.data, simplices.data.level, simplices.dim, list[str]()
    if dim == 1:  # its parts are points
        return found
    extent = data.extent
    sides = "edges" if dim == 2 else "facets"
    cells, opposite = np.nonzero(simplices.on_sides(level.boundary_facets))
    members = np.array(facet_vertices(dim))[opposite]
    x = simplices.x[cells[:, None], members]
    middle = x.mean(axis=1, keepdims=True)
    size = np.linalg.norm(x - middle, axis=2).max(axis=1, initial=0.0)[:, None]
    for number, part in enumerate(data.model.boundary):
        if part.where is None:
            continue
        held = np.isin(simplices.facets[cells, opposite], data.facets[number])
        beside = np.isin(simplices.dofs[cells[:, None], members], data.dofs_on(data.facets[number]))
        short = np.minimum(np.where(beside, SLIVER, NOTHING) * extent / size, 0.5)
        inside = x + short[..., None] * (middle - x)
        known = part.where.over(inside, {}, cells)
        if known is None:
            found.append(
                f"{part.name} where = {part.where.text} may end inside one of the {sides}: only its samples are known"
            )
            continue
        truth = known.truth()
        holds, fails = (np.broadcast_to(may, len(cells)) for may in (truth.may_hold, truth.may_fail))
        wrong = np.where(held, fails, holds)
        if not level.polygonal:
            wrong &= ~held
        mine = np.append(middle[np.argmax(wrong), 0], np.zeros(3 - dim)) if wrong.any() else None
        at = first_given(level.comm, mine)
        if at is not None:
            found.append(
                f"{part.name} where = {part.where.text} is not made of whole {sides} of the mesh, near "
                f"{data.place(at)}, so that on other meshes it is another part"
            )
    return found
