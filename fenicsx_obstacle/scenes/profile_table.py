"""Formulas of comparison under [profile.NAME], checked without a mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import nearest

if TYPE_CHECKING:
    from fenicsx_obstacle.scenes.scene import Scene

DRAWN, DRAWN_OF_BODIES = ("u", "p"), ("u_x", "u_y", "u_z", "gap", "p", "von_mises")  # what a plot of a line can show


def compare_place(name: str) -> str:
    """The name of the formulas of a profile in messages."""
    return f"[profile.{name}] compare"


def check_profiles(scene: Scene) -> None:
    """Reject formulas of comparison of unknown quantities or with unknown names.

    Raises:
        InputError: Naming the profile.
    """
    for name, table in scene.tables.profile.items():
        check_formulas(scene, table.compare, compare_place(name))


def check_formulas(scene: Scene, given: Mapping[str, float | str], place: str) -> None:
    """The same of some formulas.

    Args:
        scene: Whose definitions they may use.
        given: Formulas by the quantity over which they are drawn.
        place: Where they stand, for messages.

    Raises:
        InputError: Naming the formula.
    """
    known = DRAWN_OF_BODIES if scene.model.vector_valued else DRAWN
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{scene.source}: {place} {key}: no quantity of this name{nearest(key, known)}")
        scene.formula(value, f"{place} {key}").check_names(scene.known_names - {"distance"})
