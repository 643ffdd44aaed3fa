"""Differences of two solutions, on one mesh or on two: norms of u and p, contact sets, forces, energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import cKDTree

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import corners, facet_corners, own_cells, sides, volumes
from fenicsx_obstacle.mesh.points import places, values_of
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.parallel import largest, on_root, total
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.signatures import checked

SAME = 1e-9  # of h: nodes that are nearer are at one place
HALF = 0.5 + 1e-9  # of a contact node; of P2 there are values of 1/2 with round-off
INWARD = 1e-5  # of the way to the middle of a cell
_EXPECTED = "a Solution, or the folder of a saved one"


@checked(a=_EXPECTED, b=_EXPECTED)
def compare(a: Solution | str | Path, b: Solution | str | Path) -> dict[str, Any]:
    """Differences of two solutions, of scenes or of forms, taken at the nodes of the finer mesh (collective).

    Args:
        a: An Answer or a Solution, or the folder of a saved one.
        b: The other one.

    Returns:
        `u`: l2, h1 and max norm of the difference, and `energy` ||mu^(1/2) grad(.)|| where the finer one is of a scene
        whose tension is a formula of the place; `pressure`: l2 and max; `contact`: Jaccard measure (common area /
        joint area, 1 for equal sets) and Hausdorff distance of the contact nodes, and areas; `force` and `energy` of
        both; `outside`, the number of nodes of the finer mesh that do not lie in the other.

    Raises:
        InputError: If their meshes are of different dimensions, u is vector-valued, or a folder has no result.
    """
    a, b = (one if isinstance(one, Solution) else read(Path(one)) for one in (a, b))
    if any("resultant" in one.record["contact"] for one in (a, b)):
        raise InputError("compare: vector-valued solutions are not compared; at() has their values at points")
    if a.level.mesh.geometry.dim != b.level.mesh.geometry.dim:
        raise InputError("compare: the results have meshes of different dimensions")
    fine, coarse = (a, b) if a.plain.level.dofs >= b.plain.level.dofs else (b, a)
    points, inward, mine = _everywhere(fine)

    def at_nodes(values: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        if not inward.any():
            return values(points)[mine]
        return (2 * values(points + inward) - values(points + 2 * inward))[mine]

    there = {"u": at_nodes(coarse.values)}
    a, b, fine, coarse = a.plain, b.plain, fine.plain, coarse.plain
    comm, own = fine.level.comm, fine.level.owned
    for name in ("pressure", "contact"):
        there[name] = at_nodes(partial(values_of, coarse.functions()[name], level=coarse.level))
    outside = np.isnan(there["u"])
    difference = {name: np.where(outside, 0.0, getattr(fine, name).x.array - there[name]) for name in there}
    ours, theirs = fine.contact.x.array > HALF, there["contact"] > HALF
    return {
        "u": _norms(fine, difference["u"]),
        "pressure": {key: value for key, value in _norms(fine, difference["pressure"]).items() if key in ("l2", "max")},
        "contact": {
            "jaccard": _jaccard(fine, ours, theirs),
            "hausdorff": _hausdorff(a, b),
            "area": [x.record["contact"]["area"] for x in (a, b)],
        },
        "force": {
            side: [x.record["contact"].get(side, {}).get("force") for x in (a, b)] for side in ("lower", "upper")
        },
        "energy": [x.record["energy"] for x in (a, b)],
        "outside": int(total(comm, np.count_nonzero(outside[:own]))),
    }


def read(folder: Path) -> Solution:
    """Read a folder: the answer of a scene, or the solution of a form (collective).

    Raises:
        InputError: If it holds neither.
    """
    of_scene = on_root(MPI.COMM_WORLD, (folder / "scene.toml").exists)
    return Answer.read(folder) if of_scene else Solution.read(folder)


def _everywhere(answer: Solution) -> tuple[np.ndarray, np.ndarray, slice]:
    """The local nodes of all ranks (collective).

    Returns:
        Their coordinates, shape (n, 3); short ways from there into a cell of the node, for nodes at one place, on both
        sides of a slit, and 0 for the others; and which nodes are those of this rank.
    """
    level = answer.plain.level
    comm, dofs, inward = level.comm, releases.cell_dofs(level.V), np.zeros((len(level.points.T), 3))
    inward[dofs.ravel()] = INWARD * np.repeat(corners(level.mesh).mean(axis=1), dofs.shape[1], axis=0)
    parts = comm.allgather((places(level), inward - INWARD * level.points.T))
    nodes, inward = (np.vstack(each) for each in zip(*parts, strict=True))
    near = SAME * level.h
    pairs = cKDTree(nodes[:, :3]).query_pairs(near, output_type="ndarray")
    apart = pairs[np.linalg.norm(np.diff(nodes[pairs, 3:], axis=1)[:, 0], axis=1) > near]
    inward[np.setdiff1d(np.arange(len(nodes)), apart)] = 0.0
    start = sum(len(one) for one, _ in parts[: comm.rank])
    return nodes[:, :3], inward, slice(start, start + len(level.points.T))


def _norms(answer: Solution, nodal: np.ndarray) -> dict[str, float]:
    """Norms of a P1 function given at the local nodes, exact on each cell (collective)."""
    level, comm, e = answer.level, answer.level.comm, fem.Function(answer.level.V)
    e.x.array[:] = nodal
    cells, reference = np.arange(own_cells(level.mesh)), Reference(level.mesh)
    points, weights = rule(level.mesh.topology.dim, 2)
    size = reference.measures(cells, points[None]) * weights
    if isinstance(answer, Answer) and answer.scene.model.radial:
        size *= corners(level.mesh, cells)[..., 0] @ points.T
    slopes = size.sum(axis=1) * (reference.gradients(e, cells, points[None, :1])[:, 0] ** 2).sum(axis=1)
    l2, gradient = total(comm, size * reference.values(e, cells, points[None]) ** 2), total(comm, slopes)
    norms = {"l2": math.sqrt(l2), "h1": math.sqrt(l2 + gradient), "max": largest(comm, np.abs(nodal))}
    if not isinstance(answer, Answer):
        return norms
    elastic = answer.scene.model.elastic
    tension = elastic.value if elastic.role == "tension" else None
    if tension is not None and tension.parts is None and not tension.needs_distance:
        with suppress(InputError):  # not on this mesh, or not in the file
            mu = answer.data().at(tension, np.ascontiguousarray(corners(level.mesh, cells).mean(axis=1).T), cells)
            norms["energy"] = math.sqrt(total(comm, mu * slopes))
    return norms


def _jaccard(answer: Solution, ours: np.ndarray, theirs: np.ndarray) -> float:
    """Common over joint area of two sets of local nodes, 1 where both are empty (collective).

    A node has its share of the cells around it; with obstacles on a part of the boundary, of the facets around it, if
    there are any of those whose nodes are all in the sets; on a curve inside all nodes count alike.
    """
    mesh, comm, own = answer.level.mesh, answer.level.comm, answer.level.owned
    cells, joint, on_part = slice(own_cells(mesh)), ours | theirs, answer.lower is None and answer.upper is None
    dofs, x = releases.cell_dofs(answer.level.V)[cells], corners(mesh, cells)
    if on_part:
        beside, numbers, _ = sides(mesh, answer.level.boundary_facets)
        members = np.array(facet_corners(mesh))[numbers]
        dofs, x = dofs[beside[:, None], members], x[beside[:, None], members]
    size = np.repeat(volumes(x)[:, None], dofs.shape[1], axis=1)
    if isinstance(answer, Answer) and answer.scene.model.radial:  # of int phi_i r, up to a factor
        size *= x[..., 0].sum(axis=1, keepdims=True) + x[..., 0]
    around = AroundNodes(answer.level.V, dofs)
    weights = around.sums(size)
    if on_part:
        within = around.sums(np.where(joint[dofs].all(axis=1, keepdims=True), size, 0.0))
        weights = np.where(within > 0, within, weights)
    if total(comm, np.count_nonzero(weights[joint] > 0)) == 0:
        weights = np.ones(len(joint))
    common, together = (total(comm, weights[:own][nodes[:own]]) for nodes in (ours & theirs, joint))
    return common / together if together else 1.0


def _hausdorff(a: Solution, b: Solution) -> float | None:
    """Largest distance from a contact node of one to the nearest of the other; None where one has none (collective)."""
    sets = []
    for answer in (a, b):
        own = answer.level.owned
        mine = answer.level.points.T[:own][answer.contact.x.array[:own] > HALF]
        sets.append(np.vstack(answer.level.comm.allgather(mine)))
    if not all(len(points) for points in sets):
        return None
    trees = [cKDTree(points) for points in sets]
    return float(max(trees[0].query(sets[1])[0].max(), trees[1].query(sets[0])[0].max()))
