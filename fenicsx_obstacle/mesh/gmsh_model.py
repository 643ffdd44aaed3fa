"""The mesh of a Gmsh model as arrays, checked: what DOLFINx would not take is rejected here."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import basix
import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.validation import place, validate_mesh
from fenicsx_obstacle.text import counted

# Gmsh's numbers of cells with straight sides and of those of degree 2, and their kinds with their vertices in Gmsh
_KNOWN = {15: ("point", 1), 1: ("interval", 2), 2: ("triangle", 3), 3: ("quadrilateral", 4), 4: ("tetrahedron", 4),
          5: ("hexahedron", 8), 8: ("interval", 2), 9: ("triangle", 3), 10: ("quadrilateral", 4),
          11: ("tetrahedron", 4), 12: ("hexahedron", 8), 16: ("quadrilateral", 4), 17: ("hexahedron", 8)}  # fmt: skip
_CURVED = set(range(8, 18)) - {15}
# DOLFINx counts vertices by coordinates, Gmsh and VTK go around a face; the permutation is its own inverse
AROUND = {"quadrilateral": [0, 1, 3, 2], "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6]}
_KINDS = ("point", "curve", "surface", "volume")
_NO_NAME = "Open CASCADE"  # with which names begin that a CAD file has for bodies without one
SAMPLES = 9  # of a curve; of a surface in each direction
ROUNDS = 5  # in which a point comes to lie on two surfaces


def arrays_of(model: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The cells of the highest dimension, and the facets in physical groups.

    With physical groups of that dimension only their cells are part of the mesh, as in what Gmsh itself saves;
    otherwise all cells are.

    Returns:
        The attributes of `meshing.Arrays` that are words, and those that are arrays.

    Raises:
        InputError: If there are no cells, or of several kinds; if one is degenerate; if an entity is in two groups; if
            a group of facets is not on the mesh.
    """
    dims = [dim for dim in (1, 2, 3) if len(model.mesh.getElementTypes(dim))]
    if not dims:
        raise InputError("holds no cells")
    dim = max(dims)
    types = list(model.mesh.getElementTypes(dim))
    if len({_KNOWN.get(kind) for kind in types}) != 1 or types[0] not in _KNOWN:
        kinds = [model.mesh.getElementProperties(kind)[0] for kind in types]
        raise InputError(f"has {', '.join(kinds)} cells; it needs cells of one kind: lines, triangles, quadrilaterals, "
                         "tetrahedra or hexahedra, of degree 1 or 2")  # fmt: skip
    cell = _KNOWN[types[0]][0]
    groups = {d: _groups(model, d) for d in (dim, dim - 1)}
    tags, coordinates, _ = model.mesh.getNodes()
    order = np.argsort(tags)
    tags, coordinates = np.asarray(tags)[order], np.asarray(coordinates).reshape(-1, 3)[order]

    rows = {(d, tag): _rows(model, d, tag, tags) for d, tag in (*model.getEntities(dim), *model.getEntities(dim - 1))}
    remarks = [
        f"the physical group '{name}' holds no mesh"
        for d, found in groups.items()
        for name, members in found.items()
        if not any(len(rows[d, tag]) for tag in members)
    ]
    if set(types) & _CURVED:
        remarks.append("the cells of degree 2 are taken by their vertices, with straight edges")
    filled = [tag for d, tag in rows if d == dim and len(rows[d, tag])]
    grouped = {tag for members in groups[dim].values() for tag in members}
    if grouped.intersection(filled):
        materials = tuple(groups[dim])
        pieces = [(number, tag) for number, name in enumerate(materials) for tag in groups[dim][name]]
        lost = [tag for tag in filled if tag not in grouped]
        if lost:
            which = f"{counted(len(lost), _KINDS[dim])} in no physical group, such as {lost[0]}"
            count = counted(sum(len(rows[dim, tag]) for tag in lost), "cell")
            remarks.append(f"{which}: {count} not part of the mesh")
    else:
        materials, pieces = (), [(0, tag) for tag in filled]
    cells, material = _joined(pieces, rows, dim)
    _, surface = _joined([(tag, tag) for _, tag in pieces], rows, dim)
    cells = cells[:, AROUND.get(cell, slice(None))]
    validate_mesh(coordinates, cells)

    parts = tuple(groups[dim - 1])
    pieces = [(number, tag) for number, name in enumerate(parts) for tag in groups[dim - 1][name]]
    facets, facet_part = _joined(pieces, rows, dim - 1)
    lone = np.flatnonzero(~_on_mesh(cell, cells, facets))
    if len(lone):
        middle, name = place(coordinates[facets[lone[0]]].mean(axis=0)), parts[facet_part[lone[0]]]
        raise InputError(f"'{name}' is not on the mesh; a part inside must be embedded in its domain: see {middle}")

    used = np.unique(cells)  # Gmsh keeps nodes that no cell has, such as the centres of circles
    points = coordinates[used]
    extended = np.abs(points).max(axis=0) > 1e-12 * np.abs(points).max()
    gdim = max(dim, int(np.flatnonzero(extended).max(initial=0)) + 1)
    sides = [tag for d, tag in rows if d == dim - 1 > 0]
    curved = [(tag, tag) for tag in sides if not _is_flat(model.getType(dim - 1, tag))]
    bent, entity = _joined(curved, rows, dim - 1)
    on = _on_mesh(cell, cells, bent)
    plane = [tag for d, tag in rows if d == dim and _is_flat(model.getType(d, tag))]
    surface = np.where(np.isin(surface, plane), 0, surface) if dim == 2 < gdim else surface[:0]
    words = {
        "cell": cell, "materials": materials, "parts": parts, "remarks": remarks, "straight": _is_straight(model),
    }  # fmt: skip
    return words, {
        "points": points[:, :gdim], "cells": np.searchsorted(used, cells),
        "cell_material": material if materials else material[:0], "facets": np.searchsorted(used, facets),
        "facet_part": facet_part, "bent": np.searchsorted(used, bent[on]), "bent_entity": entity[on],
        "cell_entity": surface,
    }  # fmt: skip


def _is_flat(kind: str) -> bool:
    """Whether Gmsh's type of a curve or surface is a line or a plane, or it has no geometry."""
    return kind in ("", "Line", "Plane", "Unknown") or kind.startswith("Discrete")


def ungrouped_cells(model: Any) -> list[str]:
    """A remark on a geometry whose physical groups hold no cells of the highest dimension; none for other ones.

    All cells are the mesh then. What Gmsh saves, and what dolfinx.io takes from it, are the groups.
    """
    dim = model.getDimension()
    grouped = max((d for d, _ in model.getPhysicalGroups()), default=dim)
    if grouped >= dim:
        return []
    whole, part = _KINDS[dim], _KINDS[grouped]
    return [
        f"no {whole} is in a physical group: all {whole}s are the mesh. Gmsh saves, and dolfinx.io takes from it, only "
        f"the {part}s in groups: for these save a .msh file, for the {whole}s add a Physical {whole.capitalize()}"
    ]


def join_bodies(model: Any) -> None:
    """Let bodies of a CAD file that touch share the sides on which they do, so that these have common nodes.

    Raises:
        InputError: If bodies overlap.
    """
    dim = model.getDimension()
    bodies = model.getEntities(dim)
    if len(bodies) < 2 or dim < 2:
        return
    _, pieces = model.occ.fragment(bodies[:1], bodies[1:])
    model.occ.synchronize()
    owner: dict[int, int] = {}
    for number, of_body in enumerate(pieces):
        for _, tag in of_body:
            if owner.setdefault(tag, number) != number:
                at = place(np.array(model.occ.getCenterOfMass(dim, tag)))
                what = f"{_KINDS[dim]}s {bodies[owner[tag]][1]} and {bodies[number][1]}"
                raise InputError(f"{what} overlap at {at}; cut one from the other, in Gmsh by BooleanDifference")


def name_bodies(model: Any) -> None:
    """Put each body of the highest dimension, and each of its sides, into a physical group with the name that the CAD
    file has for it, or else its number."""
    dim = model.getDimension()
    bodies = model.getEntities(dim)
    sides = model.getBoundary(bodies, False, False) if dim > 1 else []
    for d, tags in ((dim, {tag for _, tag in bodies}), (dim - 1, {tag for _, tag in sides})):
        groups: dict[str, list[int]] = {}
        for tag in sorted(tags):
            label = model.getEntityName(d, tag).rpartition("/")[2].strip()
            groups.setdefault(str(tag) if label.startswith(_NO_NAME) or not label else label, []).append(tag)
        for name, members in groups.items():
            model.setPhysicalName(d, model.addPhysicalGroup(d, members), name)


def on_cad(model: Any, points: np.ndarray, rows: np.ndarray, entities: np.ndarray) -> np.ndarray:
    """Points moved to the nearest ones of CAD curves; those on none to surfaces, to several in turn, until on all.

    Args:
        model: Gmsh's.
        points: Shape (points, 3).
        rows: A row of `points` for each pair of a point and an entity.
        entities: Dimension and Gmsh's number of the entity of each pair, shape (pairs, 2).
    """
    points, on_curve = points.copy(), entities[:, 0] == 1
    # what is nearest on a surface may be on its other side where a point lies beyond its rim, which is a curve
    on_surface = ~on_curve & ~np.isin(rows, rows[on_curve])
    for dim, of_dim in ((1, on_curve), *[(2, on_surface)] * ROUNDS):
        for entity in np.unique(entities[of_dim, 1]):
            own = np.unique(rows[of_dim & (entities[:, 1] == entity)])
            found, _ = model.getClosestPoint(dim, int(entity), points[own].ravel().tolist())
            points[own] = np.array(found).reshape(-1, 3)
    return points


def samples(model: Any) -> np.ndarray:
    """Points on each curve and surface of a geometry, by which two geometries with the same mesh differ."""
    found = [np.empty(0)]
    for dim, tag in (*model.getEntities(1), *model.getEntities(2)):
        ends = np.array(model.getParametrizationBounds(dim, tag)).reshape(2, -1)
        if ends.shape[1] == dim:  # none where an entity is a mesh
            grid = np.meshgrid(*(np.linspace(low, high, SAMPLES) for low, high in ends.T))
            found.append(np.asarray(model.getValue(dim, tag, np.stack(grid, axis=-1).ravel().tolist())))
    return np.concatenate(found)


def _joined(
    pieces: Iterable[tuple[int, int]], rows: dict[tuple[int, int], np.ndarray], dim: int
) -> tuple[np.ndarray, np.ndarray]:
    """The elements of entities, and the number that goes with each."""
    found = [(number, rows[dim, tag]) for number, tag in pieces]
    numbers = [np.full(len(some), number, np.int32) for number, some in found]
    vertices = next((some.shape[1] for _, some in found if len(some)), dim + 1)
    return (
        np.concatenate([np.empty((0, vertices), np.int64), *(some for _, some in found if len(some))]),
        np.concatenate([np.empty(0, np.int32), *numbers]),
    )


def _is_straight(model: Any) -> bool:
    """Whether all CAD curves are lines, and all surfaces planes; False also where there is no CAD geometry."""
    kinds = {model.getType(d, tag) for d, tag in model.getEntities() if d in (1, 2)}
    return kinds in ({"Line"}, {"Line", "Plane"})


def _groups(model: Any, dim: int) -> dict[str, list[int]]:
    """Entities of each physical group of a dimension; a group without a name has its number as name."""
    groups: dict[str, list[int]] = {}
    owner: dict[int, str] = {}
    for d, tag in model.getPhysicalGroups(dim):
        name = model.getPhysicalName(d, tag) or str(tag)
        for entity in map(int, model.getEntitiesForPhysicalGroup(d, tag)):
            if owner.setdefault(entity, name) != name:
                words = f"'{owner[entity]}' and '{name}'"
                raise InputError(f"{_KINDS[d]} {entity} is in the physical groups {words}; one is allowed")
            members = groups.setdefault(name, [])
            members += [entity] if entity not in members else []
    return groups


def _rows(model: Any, dim: int, entity: int, tags: np.ndarray) -> np.ndarray:
    """Rows of `tags` of the vertices of each element of an entity, shape (elements, vertices)."""
    kinds, elements, nodes = model.mesh.getElements(dim, entity)
    if len(kinds) > 1 or set(kinds) - set(_KNOWN):
        words = [model.mesh.getElementProperties(kind)[0] for kind in kinds]
        raise InputError(f"{_KINDS[dim]} {entity} has {', '.join(words)}; its cells have other sides")
    if not len(kinds):
        return np.empty((0, dim + 1), np.int64)
    vertices = nodes[0].reshape(len(elements[0]), -1)[:, : _KNOWN[kinds[0]][1]]
    found = np.searchsorted(tags, vertices)
    if found.max(initial=-1) >= len(tags) or (tags[found] != vertices).any():
        raise InputError(f"{_KINDS[dim]} {entity} has a vertex that is not in the file")
    return found


def _on_mesh(cell: str, cells: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Whether each of these facets is a facet of a cell."""
    marked = np.zeros(cells.max() + 2, dtype=bool)
    marked[facets[facets < len(marked)]] = True
    sides = [cells[:, side] for side in basix.topology(getattr(basix.CellType, cell))[-2]]
    candidates = [side[marked[side].all(axis=1)] for side in sides]
    known = {tuple(row) for row in np.sort(np.concatenate(candidates), axis=1).tolist()}
    return np.array([tuple(row) in known for row in np.sort(facets, axis=1).tolist()], dtype=bool)
