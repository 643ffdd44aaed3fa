"""What there is a bound for."""

from __future__ import annotations

from fenicsx_obstacle import releases
from fenicsx_obstacle.accuracy.cell_data import other_effects
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError


def refuse_no_bound(problem: Problem) -> None:
    """Check that there is a bound for a problem.

    Raises:
        InputError: Saying why.
    """
    model, level = problem.model, problem.level
    mesh, pair = level.mesh, level.pair
    known = (pair.degree == 1 and not pair.voronoi) or pair.stacks
    if releases.cell_name(mesh) != "triangle" or mesh.geometry.dim != 2 or not known:
        what = f"{pair.name} on {releases.cell_name(mesh)} cells in {mesh.geometry.dim}D"
        raise InputError(f"{model.source}: the error bound is for P1 on triangles in the plane, and P2, not for {what}")
    if not any(effect.key == "tension" for effect in model.effects):
        raise InputError(f"{model.source}: the error bound needs the effect 'tension'")
    if any(effect.elastic and isinstance(effect.value, tuple) for effect in model.effects):
        raise InputError(f"{model.source}: the error bound needs a tension alike in all directions")
    if any(effect.key == "point_load" for effect in model.effects):
        raise InputError(f"{model.source}: the energy of a point load is infinite: there is no bound of its error")
    if problem.data.model.radial:
        raise InputError(f"{model.source}: the error bound is for plane problems, not for axial symmetry")
    if problem.data.thin:
        raise InputError(f"{model.source}: the error bound is for obstacles in the domain, not on its boundary")
    others = other_effects(problem.data)
    if pair.degree == 2 and others:
        raise InputError(f"{model.source}: with P2 the error bound is for tension and load, not for {others[0].key}")
