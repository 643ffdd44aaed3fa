"""Limit loads of elastic effects whose force per length is bounded, and films beyond them that an obstacle catches."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.discrete.mesh_system import MeshSystem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.parallel import largest, smallest, total

HINT = "; no solution exists where the load is beyond the limit load of the film"
LOADS = ("load", "part load", "point forces", "radial weight")  # roles of effects with which a film has a limit load
FINE = 8  # cells across the domain from which a slope in one cell is no slope of the film
ROUNDOFF_MARGIN = 1e-9  # of the force: what a load equal to its limit may be beyond it by round-off


def check_limit_load(problem: MeshSystem) -> None:
    """Reject loads beyond the limit load of an elastic effect with bounded force per length (collective).

    With |tension| < s, the equation tested with v = 1, and with a discrete v that is 1 at free and 0 at fixed dofs,

        |int f| <= int of s over the part of the boundary where u is given,    |sum of f_i| < int s |grad v|,

    f_i at free dofs. These conditions are necessary, not sufficient: a part of the film may be overloaded.

    Raises:
        InputError: Since no solution exists.
    """
    film, data, level = problem.model.elastic, problem.data, problem.level
    others = [effect for effect in problem.model.effects if effect is not film and effect.role not in LOADS]
    if film.role != "film" or others:
        return
    comm, at_rest = level.comm, problem.elastic.array_r
    load, load_inside = -total(comm, at_rest), -total(comm, at_rest[~problem.fixed])
    opposed = problem.below if load < 0 else problem.above
    if load == 0 or opposed is not None or total(comm, np.count_nonzero(problem.fixed)) == 0:
        return
    s = data.cellwise(film.value, positive=True)
    conditions = [(load, _along_edges(data, s))]
    if level.pair.degree == 1 and releases.cell_name(level.mesh) in SIMPLICES:
        conditions.append((load_inside, _around_free_dofs(data, s)))
    for force, most in conditions:
        if abs(force) > most * (1 + ROUNDOFF_MARGIN):
            raise InputError(
                f"{problem.model.source}: no solution exists: the load is {abs(force):.6g} in all, and "
                f"{film.key} carries at most {most:.6g} to where u is given; take a smaller load"
            )


def _along_edges(data: Data, s: Any) -> float:
    """The integral of s over the boundary where u is given; infinite where u is given inside (collective)."""
    level, comm = data.level, data.level.comm
    facets = np.unique(np.concatenate(data.held)).astype(np.int32)
    inside = np.count_nonzero(~np.isin(facets, level.boundary_facets))
    if total(comm, inside) > 0:
        return np.inf
    dim = level.mesh.topology.dim - 1
    own = facets[facets < level.mesh.topology.index_map(dim).size_local]
    marks = dmesh.meshtags(level.mesh, dim, own, np.ones(len(own), dtype=np.int32))
    ds = ufl.Measure("ds", domain=level.mesh, subdomain_data=marks)(1)
    weight = ufl.SpatialCoordinate(level.mesh)[0] if data.model.radial else 1.0
    return total(comm, fem.assemble_scalar(releases.form(s * weight * ds)))


def _around_free_dofs(data: Data, s: Any) -> float:
    """The integral of s |grad v| for the v that is 1 at free dofs and 0 at fixed ones (collective)."""
    v = fem.Function(data.level.V)
    v.x.array[:] = 1.0
    v.x.array[data.fixed[0]] = 0.0
    slope = ufl.sqrt(ufl.inner(ufl.grad(v), ufl.grad(v)))
    return total(data.level.comm, fem.assemble_scalar(releases.form(s * slope * data.dx)))


def torn(problem: System, active: np.ndarray) -> str | None:
    """A film beyond its limit load that falls on an obstacle: u jumps within one cell at the boundary.

    Where a film is vertical at the boundary, and its radius of curvature there is R, it falls by (2 R h)^(1/2) within
    a cell of size h, and by less in the next. With R up to half of the domain that is less than the limit here.
    Concentrated loads make a film steep that is not curved, but then it falls as far in its other cells.
    """
    assert isinstance(problem, MeshSystem)
    comm, level, data = problem.comm, problem.level, problem.data
    across = 2 * largest(comm, level.points[0]) if data.axial else data.extent
    if level.h * FINE > across:
        return None
    dofs, values = data.fixed
    given, u = values.x.array[dofs], problem.solution().x.array
    low, high = smallest(comm, given), largest(comm, given)
    fixed = np.zeros(len(u), dtype=bool)
    fixed[dofs] = True
    cells = releases.cell_dofs(level.V)
    outer = fixed[cells].any(axis=1)
    for side, fall in ((-1, low - u), (1, u - high)):
        if total(comm, np.count_nonzero(active == side)) == 0:
            continue
        fallen = np.maximum(fall, 0.0)
        falls = np.ptp(fallen[cells], axis=1)
        jump, others = largest(comm, falls[outer]), largest(comm, falls[~outer])
        if jump > sqrt(across * level.h) and jump > min(2 * others, largest(comm, fallen) / 2):
            return (
                f"u falls by {jump:.4g} within one cell where it is given, farther than a film can: the load is beyond "
                "its limit, and no solution has these boundary values; take a smaller load"
            )
    return None
