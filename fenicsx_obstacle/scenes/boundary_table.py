"""Checks of [[boundary]] that need no mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.from_python import stands_for_an_object
from fenicsx_obstacle.scenes.tables import ACTING, OF_BODIES, BoundaryTable
from fenicsx_obstacle.scenes.vocabulary import TIME
from fenicsx_obstacle.text import plain

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.scene import Scene


def part_place(number: int) -> str:
    """The name of a [[boundary]] in messages; `number` counts from 0."""
    return f"[[boundary]] (no. {number + 1})"


def check_parts(scene: Scene) -> None:
    """Reject tables [[boundary]] without data or with contradictory data.

    Raises:
        InputError: Naming the part.
    """
    for number, part in enumerate(scene.tables.boundary):
        _check(scene, part, f"{scene.source}: {part_place(number)}")


def _check(scene: Scene, part: BoundaryTable, place: str) -> None:
    _check_kind(scene, part, place)
    acting = [key for key in ACTING if getattr(part, key) is not None]
    if part.value is None and not acting:
        known = [key for key in ACTING if key == "spring" or (key in OF_BODIES) == scene.model.vector_valued]
        raise InputError(f"{place}: the key 'value' is missing, or {', '.join(known)}")
    partly = isinstance(part.value, tuple) and "free" in part.value  # of an elastic body: rollers may carry a load
    if part.value is not None and acting and not partly:
        raise InputError(f"{place}: {acting[0]} has no effect where u is given by 'value'; use separate tables")
    if part.on == ():
        raise InputError(f"{place} on = []: has no part")
    if part.on is not None and part.where is not None:
        raise InputError(f"{place}: 'on' and 'where' exclude each other")
    if part.where is not None and not stands_for_an_object(part.where):
        needed = scene.needs(scene.formula(part.where, ""))
        if "distance" in needed:
            raise InputError(f"{place} where: 'distance' is 0 on the whole boundary")
        if TIME in needed:
            raise InputError(f"{place} where: parts of the boundary cannot depend on time; 't' is for values")


def _check_kind(scene: Scene, part: BoundaryTable, place: str) -> None:
    """Reject scalar data of displacements, and the other way round."""
    if not scene.model.vector_valued:
        if isinstance(part.value, tuple):
            raise InputError(f"{place} value = [{', '.join(map(plain, part.value))}]: a list is for elastic bodies")
        return
    if part.value is not None and not isinstance(part.value, tuple):
        wanted = 'u has several components: give a list, such as [0, "free"]'
        raise InputError(f"{place} value = {plain(part.value)}: {wanted}")
    for side in ("lower", "upper"):
        if getattr(part, side) is not None:
            raise InputError(f"{place} {side}: bounds a scalar u; of an elastic body take 'obstacle'")
