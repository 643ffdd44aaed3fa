"""What there is a bound for."""

from __future__ import annotations

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError


def refuse_no_bound(problem: Problem) -> None:
    """What there is no bound for.

    Raises:
        InputError: Saying why.
    """
    scene, level = problem.scene, problem.level
    mesh, pair = level.mesh, level.pair
    if releases.cell_name(mesh) != "triangle" or mesh.geometry.dim != 2 or not pair.bounded:
        what = f"{pair.name} on {releases.cell_name(mesh)} cells in {mesh.geometry.dim}D"
        raise InputError(f"{scene.source}: the error bound is for P1 on triangles in the plane, and P2, not for {what}")
    for effect in sorted(scene.effects, key=lambda effect: not effect.elastic):
        if effect.no_bound:
            raise InputError(f"{scene.source}: {effect.no_bound}")
        if effect.elastic and effect.isotropic_tension is None:
            raise InputError(f"{scene.source}: the error bound does not know {effect.key}")
    if problem.data.thin:
        raise InputError(f"{scene.source}: the error bound is for obstacles in the domain, not on its boundary")
