"""Validation of MeshTags and facets that callers pass: they must be of the mesh, and of entities that it has."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.cells import cells_at_facets
from fenicsx_obstacle.parallel import agree, largest, total
from fenicsx_obstacle.text import counted, shown

_REMEDY = "create MeshTags of this mesh, with dolfinx.mesh.meshtags"


def check_tags(tags: Any, mesh: dmesh.Mesh, dim: int, place: str) -> None:
    """Reject what is not MeshTags of entities of a mesh (collective).

    Indices of another mesh would be taken for those of this one, or lead out of its arrays.

    Args:
        tags: What was given.
        mesh: The mesh to which they must belong.
        dim: Dimension of the tagged entities.
        place: What messages call the tags.

    Raises:
        InputError: On all ranks, if any rank has other tags.
    """
    mesh.topology.create_entities(dim)
    entities = mesh.topology.index_map(dim)
    with agree(mesh.comm):
        if not hasattr(tags, "find") or tags.dim != dim:
            got = shown(tags) if not hasattr(tags, "find") else f"MeshTags of dimension {tags.dim}"
            raise InputError(f"{place} = {got}: expected MeshTags of dimension {dim}")
        topology = releases.topology_of(tags)
        if topology is not None and topology is not releases.topology_of(mesh):
            raise InputError(f"{place}: these MeshTags belong to another mesh: {_REMEDY}")
        count = entities.size_local + entities.num_ghosts
        lost = tags.indices[(tags.indices < 0) | (tags.indices >= count)]
        if len(lost):
            there = f"which has {count} entities of dimension {dim} on this rank"
            raise InputError(f"{place}: index {lost[0]} is not on this mesh, {there}: {_REMEDY}")


def check_both_sides(mesh: dmesh.Mesh, facets: np.ndarray | None, place: str) -> None:
    """Reject facets inside the domain that integrals leave out: those of which this rank has the cell on one side only,
    and those at which more than two cells meet (collective).

    The first are between the cells of two ranks, on a mesh without ghost cells, the others where surfaces or wires
    branch.

    Args:
        mesh: The mesh.
        facets: Local facets; None for all.
        place: What messages call the integral.

    Raises:
        InputError: On all ranks, with the remedy.
    """
    dim = mesh.topology.dim
    most = largest(mesh.comm, cells_at_facets(mesh)[slice(None) if facets is None else facets])
    if most > 2:
        raise InputError(
            f"{place}: {most:.0f} cells meet at a facet there; a flux, a spring, an obstacle and the integrals "
            "of a form are for facets with one or two cells"
        )
    mesh.topology.create_connectivity(dim - 1, dim)
    one_sided = np.diff(mesh.topology.connectivity(dim - 1, dim).offsets) == 1
    one_sided[mesh.topology.index_map(dim - 1).size_local :] = False  # their owners integrate over them
    one_sided[dmesh.exterior_facet_indices(mesh.topology)] = False
    count = total(mesh.comm, one_sided if facets is None else one_sided[facets])
    if count > 0:
        raise InputError(
            f"{place}: of {counted(int(count), 'facet')} inside the domain no rank has the cells on both sides: make "
            "the mesh with ghost_mode=dolfinx.mesh.GhostMode.shared_facet, with dolfinx.io.gmshio by "
            "partitioner=dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.shared_facet)"
        )
