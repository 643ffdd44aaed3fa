"""Refinement: parent cells of a refined mesh, and what it inherits from them; points on CAD geometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import numpy as np
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.mesh.cells import cell_facets, corners, facet_vertices, longest_edges, own_cells
from fenicsx_obstacle.parallel import before, on_root
from fenicsx_obstacle.polynomials import CHILDREN, EDGES

Name = TypeVar("Name", str, tuple[int, int])
ToCad: TypeAlias = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
STAYS = 1e-12  # of its distance from 0: such a move is round-off


def inherited(
    named: dict[Name, np.ndarray],
    mesh: dmesh.Mesh,
    new: dmesh.Mesh,
    parents: np.ndarray,
    places: np.ndarray,
    times: int,
) -> dict[Name, np.ndarray]:
    """Named facets of a refined mesh: those that lie within a named facet of the mesh it was refined from (local).

    Args:
        named: Local facets.
        mesh: Theirs.
        new: The refined mesh.
        parents: Of each of its owned cells; after `times` halvings between both meshes, by rows of the last of these.
        places: Where in the parent the corners of the cell are.
        times: Number of these halvings, of intervals or triangles.
    """
    dim, own = mesh.topology.dim, own_cells(mesh)
    old_facets, new_facets = cell_facets(mesh)[:own], cell_facets(new)
    flags = np.zeros((len(named), old_facets.max(initial=-1) + 1), dtype=bool)
    for row, facets in zip(flags, named.values(), strict=True):
        row[facets[facets < len(row)]] = True
    # nearly all cells lie inside: follow the others only
    near = np.flatnonzero(flags.any(axis=0)[old_facets].any(axis=1))
    marked, within = flags[:, old_facets[near]], facets_within(CHILDREN[dim][0])
    for _ in range(times):
        children = (marked[:, :, within] & (within >= 0)).reshape(len(named), len(near) * len(within), dim + 1)
        outer = children.any(axis=(0, 2))
        near, marked = (len(within) * near[:, None] + np.arange(len(within))).ravel()[outer], children[:, outer]
    row_of = np.full(own * len(within) ** times, -1)
    row_of[near] = np.arange(len(near))
    cells = np.flatnonzero(row_of[parents] >= 0)
    within = facets_within(places[cells])
    there = np.take_along_axis(marked[:, row_of[parents[cells]]], np.maximum(within, 0)[None], axis=2) & (within >= 0)
    facets = new_facets[cells]
    return {name: np.unique(facets[some]).astype(np.int32) for name, some in zip(named, there, strict=True)}


def facets_within(places: np.ndarray) -> np.ndarray:
    """The facet of its parent in which each facet of a cell lies, -1 where it is inside, shape (cells, dim + 1).

    Args:
        places: Where in the parent the corners of the cell are, as in `Grid`.
    """
    dim = places.shape[1] - 1
    members = facet_vertices(dim)
    points = [{i} for i in range(dim + 1)] + [set(edge) for edge in EDGES[dim]]
    # the facets that each place is on, as bits
    bits = np.array([sum(1 << k for k, facet in enumerate(members) if point <= set(facet)) for point in points])
    common = np.stack([np.bitwise_and.reduce(bits[places[:, facet]], axis=1) for facet in members], axis=1)
    number = np.full(2 ** (dim + 1), -1)
    number[1 << np.arange(dim + 1)] = np.arange(dim + 1)
    return number[common]


def on_cad(
    V: fem.FunctionSpace, points: np.ndarray, parts: dict[tuple[int, int], np.ndarray], to_cad: ToCad
) -> np.ndarray:
    """Points of the dofs of V, those on facets or cells of curves or surfaces moved to these (collective).

    A point that would be moved by more than the size of its cells stays: the nearest one is on the other side of a
    body.

    Args:
        V: Lagrange elements.
        points: Of its local dofs, shape (dofs, 3).
        parts: Local facets or owned cells on each curve or surface, by its dimension and number, for every rank.
        to_cad: As `Level.to_cad`.
    """
    mesh, comm = V.mesh, V.mesh.comm
    for dim in sorted({dim for dim, _ in parts}):
        mesh.topology.create_connectivity(dim, mesh.topology.dim)  # of cells to themselves too: newer DOLFINx wants it
    dofs = {key: fem.locate_dofs_topological(V, key[0], some.astype(np.int32)) for key, some in parts.items()}
    mine = np.unique(np.concatenate([np.empty(0, np.int64), *dofs.values()])).astype(np.int64)
    rows = np.concatenate([np.empty(0, np.int64), *(np.searchsorted(mine, some) for some in dofs.values())])
    entities = np.repeat(np.array(list(dofs)).reshape(-1, 2), [len(some) for some in dofs.values()], axis=0)
    first = before(comm, len(mine))
    pairs = comm.gather((points[mine], rows + first, entities))
    found = on_root(comm, lambda: to_cad(*(np.concatenate(part) for part in zip(*pairs, strict=True))))
    old, new = points[mine], found[first : first + len(mine)]
    distance, size = np.linalg.norm(new - old, axis=1), np.full(len(points), np.inf)
    longest = longest_edges(corners(mesh))
    np.minimum.at(size, releases.cell_dofs(V), longest[:, None])
    far = (distance > STAYS * np.linalg.norm(old, axis=1)) & (distance < size[mine])
    moved = points.copy()
    moved[mine[far]] = new[far]
    return moved
