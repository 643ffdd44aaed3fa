"""The catalogue: scenes with exact solutions, as TOML files within the package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import nearest

_FOLDER = Path(__file__).parent.parent / "catalogue"


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


def _file(name: str) -> Path:
    if name not in names():
        raise InputError(f"{name}: no such scene" + nearest(name, names()))
    return _FOLDER / f"{name}.toml"
