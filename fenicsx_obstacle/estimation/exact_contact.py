"""Contact area and contact force of an exact solution, by repeated subdivision at the free boundary."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.norms import ExactSolution
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.mesh.cells import corners, own_cells, volumes
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.polynomials import halved
from fenicsx_obstacle.releases import cell_name

TOUCHES = 1e-14  # relative to the values of u
DEPTH = {1: 40, 2: 12}  # how often cells are halved; in solids, where contact is not found so, never


def exact_contact(model: Model, exact: ExactSolution | None, level: Level) -> dict[str, float]:
    """`area` where u touches, and `force`, the integral of |p| where p is known (collective).

    Empty without an exact solution, in solids, and where contact is on the boundary or weighted by a radius.

    Args:
        model: What is solved.
        exact: Its solution, or None.
        level: Any of its meshes: what differs between the samples of its cells is found.
    """
    mesh = level.mesh
    dim = mesh.topology.dim
    if exact is None or dim not in DEPTH or cell_name(mesh) not in SIMPLICES or model.thin or model.radial:
        return {}
    u, p = exact.u, exact.pressure
    sides = [side for side in (model.lower, model.upper) if side is not None]
    if any(field.needs_distance for field in (u, *sides)):
        return {}
    points, weights = rule(dim)
    where = np.vstack([points, np.eye(dim + 1)])

    def values(field: Field, x: np.ndarray) -> np.ndarray:
        return field.at(np.ascontiguousarray(x.reshape(-1, 3).T), {"eps": 0.0}).reshape(x.shape[:2])

    def sampled(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        touching, pressing = np.zeros((len(cells), len(where)), dtype=bool), np.zeros(len(cells))
        mixed = np.zeros(len(cells), dtype=bool)
        for block in blocks(len(cells)):
            x = where @ cells[block]
            u_values = values(u, x)
            for side in sides:
                touching[block] |= np.abs(u_values - values(side, x)) <= TOUCHES * scale
            mixed[block] = touching[block].any(axis=1) != touching[block].all(axis=1)
            if p is not None:
                pressure = values(p, x)
                pressing[block] = np.abs(pressure[:, : len(points)]) @ weights
                mixed[block] |= (pressure != 0).any(axis=1) != (pressure != 0).all(axis=1)
        return touching, pressing, mixed

    cells, area, force = corners(mesh)[: own_cells(mesh)], 0.0, 0.0
    scale = largest(level.comm, np.abs(values(u, cells)))
    for depth in range(DEPTH[dim] + 1):
        touching, pressing, mixed = sampled(cells)
        last = depth == DEPTH[dim]
        done = np.full(len(cells), True) if last else ~mixed
        size = volumes(cells)
        area += float((size * touching[:, : len(points)].dot(weights))[done].sum())
        force += float((size * pressing)[done].sum())
        if not last:
            cells = halved(cells[mixed])
    found = {"area": total(level.comm, area)}
    return {**found, "force": total(level.comm, force)} if p is not None else found
