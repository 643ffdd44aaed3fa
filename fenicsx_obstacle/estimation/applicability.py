"""Problems for which there is an error bound."""

from __future__ import annotations

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import WithTension
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.cell_data import other_effects
from fenicsx_obstacle.estimation.flux_p1 import unknown_effects
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
    known = pair.bounded and (dim <= 2 or pair.degree == 1)
    if cell not in SIMPLICES or mesh.topology.dim != dim or not known:
        raise InputError(
            f"{model.source}: the error bound is for P1 and P2 on intervals and on triangles in the plane, and for P1 "
            f"on tetrahedra, not for {pair.name} on {cell} cells in {dim}D"
        )
    elastic = model.elastic
    if elastic.vector_valued:
        raise InputError(f"{model.source}: the error bound is for scalar u")
    if elastic.role not in ("tension", "matrix tension") and (elastic.affine or not isinstance(elastic, WithTension)):
        raise InputError(f"{model.source}: the error bound does not cover {elastic.key}")
    if dim > 1 and any(effect.role == "point forces" for effect in model.effects):
        infinite = "the error bound does not cover point loads, whose energy is infinite but on intervals"
        raise InputError(f"{model.source}: {infinite}")
    if problem.data.axial and elastic.role == "matrix tension":
        raise InputError(f"{model.source}: with axial symmetry the error bound needs an isotropic tension")
    if pair.degree == 2 and problem.data.axial:
        raise InputError(f"{model.source}: with P2 the error bound does not cover axial symmetry")
    if pair.degree == 2 and elastic.role != "tension":
        raise InputError(
            f"{model.source}: with P2 the error bound needs the effect 'tension', with an isotropic tension"
        )
    others = unknown_effects(problem.data) if dim == 1 else other_effects(problem.data)
    if pair.degree == 2 and others:
        covered = "tension, load, foundation, flux, spring and point loads" if dim == 1 else "tension and load"
        raise InputError(f"{model.source}: with P2 the error bound is for {covered}, not for {others[0].key}")
