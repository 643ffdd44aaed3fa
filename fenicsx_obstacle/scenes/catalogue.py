"""Scenes by name, of the catalogue of scenes with exact solutions, or by file, with changes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.tables import Tables
from fenicsx_obstacle.text import nearest

_FOLDER = Path(__file__).parent.parent / "catalogue"
SCENE = "a Scene, a file with one, or a name of the catalogue"
_SHORT = {"cells": "mesh.cells", "refine": "mesh.refine", "eps": "solve.eps", "method": "solve.method",
          "start": "solve.start", "element": "solve.element"}  # fmt: skip


def names() -> list[str]:
    """Names of all scenes, the one-dimensional ones last."""
    found = sorted(path.stem for path in _FOLDER.glob("*.toml"))
    return sorted(found, key=lambda name: name.startswith("string"))


def scene(name: str, changes: Mapping[str, Any] | None = None) -> Scene:
    """The scene of this name, with other values as in `Scene.change`.

    Raises:
        InputError: If there is none, naming the nearest.
    """
    return Scene.read(_file(name), changes)


def text(name: str) -> str:
    """Its TOML, as the file has it.

    Raises:
        InputError: As `scene`.
    """
    return _file(name).read_text(encoding="utf-8")


def read(place: str, changes: Mapping[str, Any] | None = None) -> Scene:
    """The scene of a file, or of a bare name where there is no such file, with other values as in `Scene.change`.

    Raises:
        InputError: As `Scene.read` and `scene`.
    """
    path = Path(place)
    is_name = place == path.stem and not path.is_file()
    return scene(place, changes) if is_name else Scene.read(path, changes)


def changed(scene: Scene | str | Path, options: Mapping[str, Any] | None = None) -> Scene:
    """A scene, or the one in a file, or of a name in the catalogue, with options that are not None.

    Cells, refine, eps, method, start and element have short names. Options may give what a file lacks.

    Raises:
        InputError: If there is no such file or name, a key is unknown, or a value does not fit it.
    """
    changes = _by_keys(options or {}, scene.source if isinstance(scene, Scene) else str(scene))
    if isinstance(scene, Scene) and not changes:
        return scene
    found = scene.change(changes) if isinstance(scene, Scene) else read(str(scene), changes)
    if "mesh.cells" in changes and (found.mesh is not None or found.tables.mesh.file is not None):
        raise InputError(
            f"{found.source}: 'cells' is for shapes; refine a mesh from a file or from Python with 'refine'"
        )
    return found


def _file(name: str) -> Path:
    if name not in names():
        raise InputError(f"{name}: no such scene" + nearest(name, names()))
    return _FOLDER / f"{name}.toml"


def _by_keys(options: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Options that are not None by their keys in TOML."""
    known = {*_SHORT, *Tables.__struct_fields__}
    for key in options:
        if "." not in key and key not in known:
            raise InputError(f"{source}: unknown key '{key}'" + nearest(key, known))
    return {_SHORT.get(key, key): value for key, value in options.items() if value is not None}
