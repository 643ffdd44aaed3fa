"""Friedrichs' constant: c with ||v|| <= c ||grad v|| for functions that are 0 where u is given.

Of a box, or of a domain that is held all around, it is known. Of any other shape, held on any part of the boundary, one
is proved by paths of cells.

In a simplex T let F be the facet opposite to the vertex P. As (x - P) . n is d |T|/|F| on F and 0 on the other facets,

    int_T div((x - P) v) = d |T| mean_F v.

The difference of two such equations, of facets F and F' opposite to P and P', and with d int_T v the first one, give

    d |T| (mean_F v - mean_F' v) = int_T (P' - P) . grad v,   d |T| (mean_F v - mean_T v) = int_T (x - P) . grad v.

So both differences of means are at most c_T ||grad v||_T with c_T = (longest edge of T)/(d |T|^(1/2)). A path of cells
that leads from a facet where v = 0 to T through common facets gives (mean_T v)^2 <= s_T ||grad v||^2, s_T being the sum
of c^2 over its cells. With Poincare's inequality in T, of Payne and Weinberger's constant (longest edge)/pi,

    ||v||^2 = sum_T (||v - mean_T v||_T^2 + |T| (mean_T v)^2)
           <= (max_T (longest edge/pi)^2 + sum_T |T| s_T) ||grad v||^2.

On meshes of size h the constant is some L (L/h)^(1/2) in the plane, L being the length of paths. That is far from the
best one, but forces that it weighs are those that balance leaves over: round-off, and data inside cells.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.estimation.dirichlet_boundary import DirichletBoundary
from fenicsx_obstacle.estimation.patches import pairs
from fenicsx_obstacle.mesh.cells import cell_facets, corners, longest_edges, volumes
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import largest, total

J01 = 2.404825557695773  # first zero of the Bessel function J_0


def friedrichs(level: Level, boundary: DirichletBoundary, held_sides: np.ndarray) -> float:
    """Friedrichs' constant, in axial symmetry with the weight of integrals; infinite where none is known (collective).

    Args:
        level: A mesh of simplices.
        boundary: Where u is given.
        held_sides: As for `friedrichs_by_paths`.
    """
    if boundary.everywhere or boundary.faces.any():
        return of_box(boundary)
    by_paths = friedrichs_by_paths(level, held_sides)
    if boundary.radii is None:
        return by_paths
    inner, outer = boundary.radii
    return by_paths * sqrt(outer / inner) if inner > 0 else np.inf


def of_box(boundary: DirichletBoundary) -> float:
    """Friedrichs' constant of a box, a side after the other by its first eigenvalue, (E8); of any other domain held all
    around that of the box around it.

    With the weight of axial symmetry, which is between two numbers, along the radius the root of their ratio is a
    factor; and held outside it is that of a disk, whose first eigenvalue is (j_01/R)^2, if the domain or the box begins
    at the axis, or if functions that are 0 all around can be continued there. Infinite where `boundary` has no such
    face.
    """
    wave = (2 if boundary.everywhere else boundary.faces) * pi / (2 * boundary.sides)
    if boundary.radii is not None:
        inner, outer = boundary.radii
        wave[0] *= sqrt(max(inner, 0.0) / outer)
        if boundary.everywhere or (inner == 0 and boundary.faces[0] > 0):
            wave[0] = max(wave[0], J01 / outer)
    return 1 / float(np.linalg.norm(wave)) if np.any(wave > 0) else np.inf


def friedrichs_by_paths(level: Level, held_sides: np.ndarray) -> float:
    """c with ||v|| <= c ||grad v|| for all v that are 0 on the held facets, (E9); infinite if some cell has no path to
    one (collective).

    Args:
        level: A mesh of simplices.
        held_sides: Whether u is given on the facet opposite to each vertex of the owned cells, shape (cells, vertices).
    """
    own, vertices = len(held_sides), corners(level.mesh)
    longest, size = longest_edges(vertices), volumes(vertices)
    along = _along_paths(level, held_sides.any(axis=1), longest**2 / (level.mesh.topology.dim**2 * size))[:own]
    squared = (largest(level.comm, longest[:own]) / np.pi) ** 2 + total(level.comm, size[:own] * along)
    return sqrt(squared) if np.isfinite(squared) else np.inf


def _along_paths(level: Level, starts: np.ndarray, step: np.ndarray) -> np.ndarray:
    """For each local cell the sum of `step` over a shortest path to it, infinite if there is none (collective).

    Paths are shortest by their number of cells; of several the one of least sum counts, whatever the partition.

    Args:
        level: A mesh of simplices.
        starts: Whether a path can begin in an owned cell.
        step: Of each local cell.
    """
    facets = cell_facets(level.mesh)
    beside = pairs(facets.ravel(), facets.max(initial=-1) + 1).reshape(facets.shape) // facets.shape[1]  # or -1
    shared = fem.Function(releases.functionspace(level.mesh, "DG", 0))
    dofs, own = releases.cell_dofs(shared.function_space)[:, 0], len(starts)
    found = np.full(len(step), np.inf)
    shared.x.array[:] = np.inf
    reached = np.flatnonzero(starts)
    found[reached] = step[reached]
    while total(level.comm, len(reached)) > 0:
        shared.x.array[dofs[reached]] = found[reached]
        shared.x.scatter_forward()
        there = shared.x.array[dofs[own:]]
        ghosts = own + np.flatnonzero(there < found[own:])
        found[own:] = there
        front = np.concatenate([reached, ghosts])
        cells, before = beside[front].ravel(), np.repeat(found[front], beside.shape[1])
        new = (cells >= 0) & (cells < own)
        new[new] = np.isinf(found[cells[new]])
        reached = np.unique(cells[new])
        np.minimum.at(found, cells[new], before[new])
        found[reached] += step[reached]
    return found
