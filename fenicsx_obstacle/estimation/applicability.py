"""Problems for which there is an error bound."""

from __future__ import annotations

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.cell_data import other_effects
from fenicsx_obstacle.forms.pairs import SIMPLICES


def check_bound_exists(problem: Problem) -> None:
    """Check that there is a bound for a problem.

    Raises:
        InputError: Saying why.
    """
    model, level = problem.model, problem.level
    if model.time is not None:
        raise InputError(f"{model.source}: the error bound is for one equilibrium, not for [time]")
    mesh, pair = level.mesh, level.pair
    cell, dim = releases.cell_name(mesh), mesh.geometry.dim
    known = pair.bounded and (dim == 2 or pair.degree == 1)
    if cell not in SIMPLICES or mesh.topology.dim != dim or not known:
        raise InputError(
            f"{model.source}: the error bound is for P1 on intervals, on triangles in the plane and on tetrahedra, and "
            f"for P2 on triangles in the plane, not for {pair.name} on {cell} cells in {dim}D"
        )
    for effect in sorted(model.effects, key=lambda effect: not effect.elastic):
        if effect.no_bound and dim >= effect.no_bound_from:
            raise InputError(f"{model.source}: {effect.no_bound}")
        if effect.elastic and not _has_tension(effect):
            raise InputError(f"{model.source}: the error bound does not cover {effect.key}")
    if problem.data.axial and model.elastic.role == "matrix tension":
        raise InputError(f"{model.source}: with axial symmetry the error bound needs an isotropic tension")
    if pair.degree == 2 and problem.data.axial:
        raise InputError(f"{model.source}: with P2 the error bound does not cover axial symmetry")
    if pair.degree == 2 and model.elastic.role != "tension":
        raise InputError(
            f"{model.source}: with P2 the error bound needs the effect 'tension', with an isotropic tension"
        )
    others = other_effects(problem.data)
    if pair.degree == 2 and others:
        raise InputError(f"{model.source}: with P2 the error bound is for tension and load, not for {others[0].key}")


def _has_tension(effect: Effect) -> bool:
    """Whether the tension is known: a number, a matrix, or one that depends on u."""
    linear = effect.role in ("tension", "matrix tension")
    return linear or (not effect.affine and type(effect).tension_at is not Effect.tension_at)
