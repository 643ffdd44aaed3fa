"""Shapes: points and cells, names of sides, projection onto a curved boundary; those that scenes can name; the coarsest
grid of a shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import factorial
from typing import Protocol, TypeAlias

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.forms.pairs import SIMPLICES

Sides = Mapping[str, Callable[[np.ndarray], np.ndarray]]
Named: TypeAlias = dict[str, np.ndarray]
COARSEST = {1: 16, 2: 500, 3: 500}  # cells at least on the coarsest level of a shape,
PER_RANK = {1: 8, 2: 100, 3: 100}  # and on each rank: cells stay on their rank when refined


@dataclass(frozen=True)
class Shape:
    """A domain with named sides.

    Attributes:
        cell: Cell type.
        lower: Lower corner of its box, one number per dimension.
        upper: Upper corner.
        cells: Cells along the first side; along the others in proportion, so that cells are about square.
        diagonal: How rectangles are cut into triangles.
        perturb: How far at most inner vertices are moved at random along each axis, in parts of h.
        sides: Marks the points, shape (3, n), of each named side.
        h: Side of the grid.
        arrays: Makes (points, cells) where DOLFINx has no builder for the shape.
        project: Moves boundary points, shape (n, gdim), onto the true boundary, where that is curved.
        coarser: Makes the recipe with cells twice as large whose uniform refinement is this grid; None without one.
    """

    cell: str
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]
    sides: Sides
    h: float
    diagonal: str = "right"
    perturb: float = 0.0
    arrays: Callable[[], tuple[np.ndarray, np.ndarray]] | None = None
    project: Callable[[np.ndarray], np.ndarray] | None = field(default=None, compare=False)
    coarser: Callable[[], Shape] | None = field(default=None, compare=False)

    def vertices(self, finer: float = 1.0) -> float:
        """About how many vertices the mesh will have, or one so many times finer."""
        share = 1.0 if self.arrays is None else 0.75  # six sectors of a disk for eight of its box; an L lacks a quarter
        return share * float(np.prod([n * finer + 1 for n in self.cells])) * (1 + (self.diagonal == "crossed"))

    @property
    def simplices(self) -> float:
        """About how many cells the mesh will have, if they are simplices."""
        return factorial(len(self.cells)) * float(np.prod(self.cells))

    def on_curve(self, x: np.ndarray) -> np.ndarray:
        """Whether points, shape (n, gdim), are on the boundary, which `project` says to be curved."""
        return np.any([side(x.T) for side in self.sides.values()], axis=0)

    def moved(self, x: np.ndarray) -> np.ndarray:
        """Inner vertices, shape (n, 3), moved at random: the same for a place whatever the order or the rank."""
        moved, dim = x.copy(), len(self.cells)
        lower, upper = np.add(self.lower, self.h / 4), np.subtract(self.upper, self.h / 4)
        inside = np.all((x[:, :dim] > lower) & (x[:, :dim] < upper), axis=1)
        place = np.rint((x[inside, :dim] - self.lower) / self.h * 2).astype(np.int64)
        for axis in range(dim):
            # a hash of the place: a generator would depend on the order of the vertices
            mixed = np.sin(place @ np.array([12.9898, 78.233, 37.719])[:dim] + 1.7 * axis) * 43758.5453
            moved[inside, axis] += self.perturb * self.h * (2 * (mixed - np.floor(mixed)) - 1)
        return moved


def box(
    cell: str, corners: list[tuple[float, float]], cells: int, diagonal: str = "right", perturb: float = 0.0
) -> Shape:
    """Interval, rectangle or box between corners, `cells` along x."""
    lower, upper = zip(*corners, strict=True)
    h = (upper[0] - lower[0]) / cells
    along = (cells, *(max(1, round((b - a) / h)) for a, b in corners[1:]))
    tolerance = 1e-9 * max(b - a for a, b in corners)
    names = [("left", "right"), ("bottom", "top"), ("back", "front")][: len(corners)]
    sides = {
        name: _near(axis, at, tolerance)
        for axis, (pair, ends) in enumerate(zip(names, corners, strict=True))
        for name, at in zip(pair, ends, strict=True)
    }
    shape = Shape(cell, lower, upper, along, sides, h, diagonal, perturb)
    # halving every edge keeps one direction of the diagonal, but not a pattern of several
    return _halving(shape) if diagonal in ("right", "left") and not perturb else shape


def _halving(shape: Shape) -> Shape:
    """The grid, with the way to half as many cells along each side, if they are even."""
    if any(n % 2 for n in shape.cells):
        return shape
    coarse = replace(shape, cells=tuple(n // 2 for n in shape.cells), h=2 * shape.h, coarser=None)
    return replace(shape, coarser=lambda: _halving(coarse))


def _near(axis: int, at: float, tolerance: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: np.abs(x[axis] - at) < tolerance


def l_shape(corners: list[tuple[float, float]], cells: int) -> Shape:
    """Rectangle without its lower right quarter; sides `outer`, and `notch` at the re-entrant corner."""
    cells += cells % 2
    (x0, x1), (y0, y1) = corners
    xm, ym, tolerance = (x0 + x1) / 2, (y0 + y1) / 2, 1e-9 * (x1 - x0 + y1 - y0)

    def arrays() -> tuple[np.ndarray, np.ndarray]:
        x, y = np.meshgrid(np.linspace(x0, x1, cells + 1), np.linspace(y0, y1, cells + 1))
        i, j = (k.ravel() for k in np.meshgrid(np.arange(cells), np.arange(cells)))
        kept = (i < cells // 2) | (j >= cells // 2)
        corner = (j * (cells + 1) + i)[kept]
        a, b, c, d = corner, corner + 1, corner + cells + 1, corner + cells + 2
        triangles = np.vstack([np.column_stack([a, b, d]), np.column_stack([a, c, d])])
        used, renumbered = np.unique(triangles, return_inverse=True)
        return np.column_stack([x.ravel(), y.ravel()])[used], renumbered.reshape(-1, 3)

    def notch(x: np.ndarray) -> np.ndarray:
        vertical = (np.abs(x[0] - xm) < tolerance) & (x[1] < ym + tolerance)
        return vertical | ((np.abs(x[1] - ym) < tolerance) & (x[0] > xm - tolerance))

    def outer(x: np.ndarray) -> np.ndarray:
        ends = [(0, x0), (0, x1), (1, y0), (1, y1)]
        return np.any([np.abs(x[axis] - at) < tolerance for axis, at in ends], axis=0)

    sides = {"outer": outer, "notch": notch}
    coarser = None if cells % 4 else lambda: l_shape(corners, cells // 2)
    grid = (cells, cells), sides, (x1 - x0) / cells
    return Shape("triangle", (x0, y0), (x1, y1), *grid, arrays=arrays, coarser=coarser)


def disk(radius: float, cells: int) -> Shape:
    """Disk about the origin, `cells` along its diameter; side `circle`.

    Rings of six triangles more each time: no triangle is obtuse, and the area of all is alike.
    """
    rings = max(1, (cells + 1) // 2)

    def arrays() -> tuple[np.ndarray, np.ndarray]:
        count = np.maximum(6 * np.arange(rings + 1), 1)
        first = np.concatenate([[0], np.cumsum(count)])
        ring = np.repeat(np.arange(rings + 1), count)
        angle = 2 * np.pi * (np.arange(first[-1]) - first[ring]) / count[ring]
        points = radius / rings * ring[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        triangles = []
        for k in range(1, rings + 1):
            j = np.arange(6 * k)  # points of ring k; sector j // k, place j % k within it
            inside = lambda m, k=k: first[k - 1] + m % count[k - 1]  # noqa: E731
            below = (j // k) * (k - 1) + j % k  # point of ring k-1 below the start of edge j
            outer = np.column_stack([first[k] + j, first[k] + (j + 1) % (6 * k), inside(below)])
            m = j[j % k != 0]
            sides = inside((m // k) * (k - 1) + m % k - 1), first[k] + m, inside((m // k) * (k - 1) + m % k)
            triangles += [outer, np.column_stack(sides)]
        return points, np.vstack(triangles)

    def project(x: np.ndarray) -> np.ndarray:
        return x * (radius / np.linalg.norm(x, axis=1))[:, None]

    sides = {"circle": lambda x: np.abs(np.hypot(x[0], x[1]) - radius) < 1e-9 * radius}
    coarser = None if rings % 2 else lambda: disk(radius, rings)
    grid = (-radius, -radius), (radius, radius), (2 * rings, 2 * rings), sides, radius / rings
    return Shape("triangle", *grid, arrays=arrays, project=project, coarser=coarser)


class Measures(Protocol):
    """What [mesh] says of a shape; each method rejects what makes no domain."""

    @property
    def cells(self) -> int:
        """Cells along the first side."""

    @property
    def diagonal(self) -> str:
        """How rectangles are cut into triangles."""

    @property
    def perturb(self) -> float:
        """How far inner vertices are moved."""

    def side(self, axis: str) -> tuple[float, float]:
        """Both ends along an axis."""

    def positive(self, key: str) -> float:
        """A positive number."""

    def cell(self, *kinds: str) -> str:
        """The kind of cells, one of these."""


@dataclass(frozen=True)
class Recipe:
    """A shape that scenes can name.

    Attributes:
        keys: Its keys of [mesh] other than `cells` and `refine`.
        make: Makes it.
    """

    keys: tuple[str, ...]
    make: Callable[[Measures], Shape]


def _interval(of: Measures) -> Shape:
    return box("interval", [of.side("x")], of.cells)


def _rectangle(of: Measures) -> Shape:
    cell = of.cell("triangle", "quadrilateral")
    return box(cell, [of.side("x"), of.side("y")], of.cells, of.diagonal, of.perturb)


def _box(of: Measures) -> Shape:
    cell = of.cell("tetrahedron", "hexahedron")
    return box(cell, [of.side(axis) for axis in "xyz"], of.cells, perturb=of.perturb)


SHAPES = {
    "interval": Recipe(("x",), _interval),
    "rectangle": Recipe(("x", "y", "cell", "diagonal", "perturb"), _rectangle),
    "disk": Recipe(("radius",), lambda of: disk(of.positive("radius"), of.cells)),
    "l-shape": Recipe(("x", "y"), lambda of: l_shape([of.side("x"), of.side("y")], of.cells)),
    "box": Recipe(("x", "y", "z", "cell", "perturb"), _box),
}


def coarsest_grid(asked: Shape, comm: MPI.Comm) -> tuple[dmesh.Mesh, Named, float, int]:
    """The coarsest grid that leads to the one asked for (collective).

    Returns:
        The mesh, the local facets of its named sides, its h, and how often to halve its edges.
    """
    dim, shape, halvings = len(asked.cells), asked, 0
    while shape.coarser is not None and shape.cell in SIMPLICES:
        coarser = shape.coarser()
        if coarser.simplices < max(COARSEST[dim], PER_RANK[dim] * comm.size):
            break
        shape, halvings = coarser, halvings + 1
    if shape.arrays is not None:
        points, cells = shape.arrays() if comm.rank == 0 else (np.empty((0, dim)), np.empty((0, dim + 1), np.int64))
        mesh = releases.create_mesh(comm, cells, points, shape.cell)
    else:
        ghosts = {"ghost_mode": releases.FACET_GHOSTS}
        ends = [np.array(shape.lower), np.array(shape.upper)]
        if dim == 1:
            mesh = dmesh.create_interval(comm, shape.cells[0], [shape.lower[0], shape.upper[0]], **ghosts)
        elif dim == 2:
            kind = releases.diagonal({"union-jack": "right_left"}.get(shape.diagonal, shape.diagonal))
            ghosts["cell_type"] = getattr(dmesh.CellType, shape.cell)
            mesh = dmesh.create_rectangle(comm, ends, list(shape.cells), diagonal=kind, **ghosts)
        else:
            ghosts["cell_type"] = getattr(dmesh.CellType, shape.cell)
            mesh = dmesh.create_box(comm, ends, list(shape.cells), **ghosts)
        mesh = releases.settle(mesh)
    sides = {name: dmesh.locate_entities_boundary(mesh, dim - 1, marker) for name, marker in shape.sides.items()}
    if shape.perturb:
        mesh.geometry.x[:] = shape.moved(mesh.geometry.x)
    return mesh, sides, shape.h, halvings
