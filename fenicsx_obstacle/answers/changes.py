"""Changes of a scene: keys by their names in TOML, frequent ones by short names."""

from __future__ import annotations

from collections.abc import Mapping
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


def changed(scene: Scene | str | Path, options: Mapping[str, Any] | None = None) -> Scene:
    """A scene, or the one in a file, or of a name in the catalogue, with options that are not None.

    Cells, refine, eps, method, start and element have short names. Options may give what a file lacks.

    Raises:
        InputError: If there is no such file or name, a key is unknown, or a value does not fit it.
    """
    changes = _by_keys(options or {}, scene.source if isinstance(scene, Scene) else str(scene))
    if not isinstance(scene, Scene):
        found = catalogue.read(str(scene), changes)
    else:
        found = scene.change(changes) if changes else scene
    if "mesh.cells" in changes and (found.mesh is not None or found.tables.mesh.file is not None):
        raise InputError(
            f"{found.source}: 'cells' is for shapes; refine a mesh from a file or from Python with 'refine'"
        )
    return found


def _by_keys(options: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Options that are not None by their keys in TOML."""
    known = {*_SHORT, *Tables.__struct_fields__}
    for key in options:
        if "." not in key and key not in known:
            raise InputError(f"{source}: unknown key '{key}'" + nearest(key, known))
    return {_SHORT.get(key, key): value for key, value in options.items() if value is not None}
