"""free_boundary.csv, from the cells near the free boundary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.fields.cut import OnNodes
from fenicsx_obstacle.fields.scalar import Fields
from fenicsx_obstacle.parallel import gathered, largest, on_root, write_text
from fenicsx_obstacle.show.boundary import RINGS, SIDES, Patch, free_boundary, gap, pressed, with_levels


def write_free_boundary(fields: Fields, path: Path) -> None:
    """Write one line per piece of the free boundary: the coordinates of its ends, or of its corners (collective).

    Raises:
        InputError: If the file cannot be written.
    """
    on_root(fields.level.comm, _write, near_free_boundary(fields), path)


def near_free_boundary(fields: Fields) -> Patch | None:
    """The cells within `RINGS` of a free boundary with their levels, on rank 0; None elsewhere (collective)."""
    shown = fields.on_nodes() or fields.plain.on_nodes()
    assert shown is not None  # plain has the nodes of P1
    level, owned, values = shown.level, shown.level.owned, shown.fields
    sides = [side for side in SIDES if side in values]
    gaps = {side: max(0.0, largest(level.comm, gap(values, side)[:owned])) for side in sides}
    near, nodes = _near(shown, [pressed(values, side) for side in sides])
    rows = np.flatnonzero(nodes[:owned])
    parts: dict[str, np.ndarray] = {
        "numbers": shown.global_(rows),
        "cells": shown.global_(shown.cells[near]),
        "points": level.points.T[rows],
        **{name: values[name][rows] for name in ("u", "pressure", "contact", *sides)},
    }
    found = {name: gathered(level.comm, part) for name, part in parts.items()}
    whole = {name: part for name, part in found.items() if part is not None}
    if not whole:
        return None
    # owned numbers rise from rank to rank: the nodes stay in their order
    renumbered = np.searchsorted(whole.pop("numbers"), whole.pop("cells"))
    return with_levels(Patch(whole.pop("points"), renumbered, whole), gaps)


def _near(shown: OnNodes, touching: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Whether each owned simplex, and each local node of these, is near the edge of a set of nodes (collective).

    Args:
        shown: The simplices.
        touching: Sets of local nodes, ghosts included.
    """
    level, cells = shown.level, shown.cells
    corners = cells.T.astype(np.intp)  # once: indices of another type are converted in each use
    near = np.zeros(len(cells), dtype=bool)
    for nodes in touching:
        inside = [nodes[corner] for corner in corners]
        near |= np.logical_or.reduce(inside) & ~np.logical_and.reduce(inside)
    marked = fem.Function(level.V)
    for _ in range(RINGS + 1):  # cells of nodes that are told to touch lie beside the edge
        marked.x.array[:] = 0.0
        marked.x.array[cells[near]] = 1.0
        releases.add_ghosts(marked)
        marked.x.scatter_forward()
        nodes = marked.x.array > 0
        near = np.logical_or.reduce([nodes[corner] for corner in corners])
    marked.x.array[:] = 0.0
    marked.x.array[cells[near]] = 1.0
    releases.add_ghosts(marked)
    return near, marked.x.array > 0


def _write(patch: Patch, path: Path) -> None:
    lines = free_boundary(patch)
    pieces = [line.points[line.cells].reshape(len(line.cells), -1) for line in lines]
    table = np.concatenate([*pieces, np.empty((0, pieces[0].shape[1] if pieces else 6))])
    heads = [f"{axis}{corner}" for corner in range(1, table.shape[1] // 3 + 1) for axis in "xyz"]
    rows = [",".join(heads), *(",".join(f"{x:.9g}" for x in row) for row in table)]
    write_text(path, "\n".join(rows) + "\n")
