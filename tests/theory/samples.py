"""Scenes of demos/ on which the statements are measured."""

from __future__ import annotations

from fenicsx_obstacle.checkout import DEMOS
from fenicsx_obstacle.scenes.scene import Scene


def sample(name: str, cells: int) -> Scene:
    """A scene with so many cells a side."""
    return Scene.read(DEMOS / f"{name}.toml").change({"mesh.cells": cells})
