"""Changes of a scene: keys by their names in TOML, frequent ones by short names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.tables import Tables
from fenicsx_obstacle.text import nearest

SCENE = "a Scene, a file with one, or a name of the catalogue"
_SHORT = {"cells": "mesh.cells", "refine": "mesh.refine", "eps": "solve.eps", "method": "solve.method",
          "start": "solve.start", "element": "solve.element"}  # fmt: skip


def scene_of(scene: Scene | str | Path) -> Scene:
    """A scene, or the one in a file, or of a name in the catalogue.

    Raises:
        InputError: If there is no such file or name.
    """
    return scene if isinstance(scene, Scene) else catalogue.read(str(scene))


def changed(scene: Scene, options: dict[str, Any]) -> Scene:
    """The scene with options that are not None; cells, refine, eps, method, start and element by their short names.

    Raises:
        InputError: If a key is unknown or a value does not fit it.
    """
    changes = _by_keys(options, scene.source)
    _check_cells(changes, scene)
    return scene.change(changes) if changes else scene


def read(place: str, options: dict[str, Any]) -> Scene:
    """The scene of a file or of a name, checked with its options: they may give what it lacks.

    Raises:
        InputError: As `changed`, and for a scene that is wrong.
    """
    changes = _by_keys(options, place)
    scene = catalogue.read(place, changes)
    _check_cells(changes, scene)
    return scene


def _by_keys(options: dict[str, Any], source: str) -> dict[str, Any]:
    """Options that are not None by their keys in TOML."""
    known = {*_SHORT, *Tables.__struct_fields__}
    for key in options:
        if "." not in key and key not in known:
            raise InputError(f"{source}: unknown key '{key}'" + nearest(key, known))
    return {_SHORT.get(key, key): value for key, value in options.items() if value is not None}


def _check_cells(changes: dict[str, Any], scene: Scene) -> None:
    if "mesh.cells" in changes and (scene.mesh is not None or scene.tables.mesh.file is not None):
        raise InputError(
            f"{scene.source}: 'cells' is for shapes; refine a mesh from a file or from Python with 'refine'"
        )
