"""The catalogue: scenes with exact solutions, as TOML files within the package."""

from __future__ import annotations

from pathlib import Path

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.formulas import nearest
from fenicsx_obstacle.scenes.scene import Scene

_FOLDER = Path(__file__).parent.parent / "catalogue"


def names() -> list[str]:
    """Names of all scenes, the one-dimensional ones last."""
    found = sorted(path.stem for path in _FOLDER.glob("*.toml"))
    return sorted(found, key=lambda name: name.startswith("string"))


def scene(name: str) -> Scene:
    """The scene of this name.

    Raises:
        InputError: If there is none, naming the nearest.
    """
    return Scene.read(_file(name))


def text(name: str) -> str:
    """Its TOML, as the file has it.

    Raises:
        InputError: As `scene`.
    """
    return _file(name).read_text(encoding="utf-8")


def read(place: str) -> Scene:
    """The scene of a file, or of a bare name where there is no such file.

    Raises:
        InputError: As `Scene.read` and `scene`.
    """
    path = Path(place)
    return scene(place) if place == path.stem and not path.is_file() else Scene.read(path)


def _file(name: str) -> Path:
    if name not in names():
        raise InputError(f"{name}: no such scene" + nearest(name, names()))
    return _FOLDER / f"{name}.toml"
