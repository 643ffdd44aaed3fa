"""The cases of the suite: a list in TOML, with scenes of the suite, of the catalogue and of demos."""

from __future__ import annotations

import tomllib
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from fenicsx_obstacle.checkout import DEMOS
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import nearest

FOLDER = Path(__file__).parent / "scenes"
LIST = "suite.toml"


class Case(Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """One hard scene of the suite.

    Attributes:
        name: Of the case.
        family: Of cases with the same difficulty, a table of the list.
        hard: What is hard about it, in a few words.
        scene: Name of the scene, of this folder, the catalogue or demos; by default that of the case.
        set: Changes of its keys, as --set makes them.
        meshes: The two values of `by`, from coarse to fine.
        by: The key that refines: mesh.cells, or mesh.refine for files.
        refuse: Part of the message, where there is no solution and the program must say so.
        known: Of elastic bodies, names of [report] that are 0 by an independent truth, and how far they may be off.
    """

    name: str
    family: str
    hard: str
    scene: str = ""
    set: dict[str, Any] = {}
    meshes: tuple[int, int] = (32, 64)
    by: str = "mesh.cells"
    refuse: str = ""
    known: dict[str, float] = {}

    @cached_property
    def base(self) -> Scene:
        """The scene with its changes.

        Raises:
            InputError: If it, or a key, is wrong.
        """
        name = self.scene or self.name
        if name in catalogue.names():
            return catalogue.scene(name, self.set)
        files = [folder / f"{name}.toml" for folder in (FOLDER, DEMOS)]
        return Scene.read(next(filter(Path.is_file, files), files[0]), self.set)

    @property
    def compared(self) -> bool:
        """Whether ranks are compared: at rest, where what is unknown of an answer does not add up over steps."""
        return not self.refuse and self.base.time is None

    def on(self, mesh: int) -> Scene:
        """The scene on the mesh of this number: 0 coarse, 1 fine."""
        return self.base.change({self.by: self.meshes[mesh]})


@lru_cache(maxsize=1)
def cases() -> tuple[Case, ...]:
    """All of them, in the order of the list."""
    families = tomllib.loads((FOLDER / LIST).read_text(encoding="utf-8"))
    rows = [{"name": name, "family": family, **row} for family, rows in families.items() for name, row in rows.items()]
    return msgspec.convert(rows, tuple[Case, ...])


def case(name: str) -> Case:
    """The case of this name.

    Raises:
        InputError: If there is none, naming the nearest.
    """
    known = {one.name: one for one in cases()}
    if name not in known:
        raise InputError(
            f"hard {name}: no such scene" + nearest(name, sorted({*known, *(one.family for one in cases())}))
        )
    return known[name]


def named(name: str) -> tuple[Case, ...]:
    """The case of this name, or all of the family of this name.

    Raises:
        InputError: If there is neither, naming the nearest.
    """
    return tuple(one for one in cases() if one.family == name) or (case(name),)
