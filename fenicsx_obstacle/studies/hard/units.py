"""The same scene in other units, and counted from another height: nothing may change but the numbers.

Factors are powers of two near 10^9, so that scaling itself rounds nothing; what then differs is an absolute tolerance
somewhere. Heights shifted by about 10^6 times the size of the solution do lose digits, as many as the data lose.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import msgspec

from fenicsx_obstacle.scenes.scene import Scene

BILLION = 2.0**30
MILLION = 2.0**20
_LENGTHS = re.compile(r"\b(x|y|z|r|distance)\b")


@dataclass(frozen=True)
class Units:
    """How many new units make an old one, and the new height of the old zero.

    -div(tension grad u) = load + p becomes the same equation with tension * force, load * force * height / length^2 and
    p likewise; eps has the unit of u/p.

    Attributes:
        name: In words.
        length: Of coordinates.
        height: Of u and the obstacles.
        force: Of the tension.
        shift: In new units.
    """

    name: str
    length: float = 1.0
    height: float = 1.0
    force: float = 1.0
    shift: float = 0.0

    @property
    def eps(self) -> float:
        """By what eps is multiplied."""
        return self.length**2 / self.force

    @property
    def pressure(self) -> float:
        """By what pressures are."""
        return self.force * self.height / self.length**2

    def of(self, scene: Scene) -> Scene:
        """The scene in these units, without its exact solution and report; meshes of files keep their length."""
        tables: dict[str, Any] = msgspec.to_builtins(scene.tables)
        mesh, effects, obstacle = tables.get("mesh", {}), tables.get("effects", {}), tables.get("obstacle", {})
        for key in {"x", "y", "z"} & set(mesh):
            mesh[key] = [self._times(value, self.length) for value in mesh[key]]
        if mesh.get("shape") and self.length != 1.0:
            for key in {"x", "y", "z"} - set(mesh):
                mesh[key] = [0.0, self.length]
            if mesh["shape"] == "disk":
                mesh["radius"] = self._times(mesh.get("radius", 1.0), self.length)
        changes: dict[str, Any] = {f"mesh.{key}": value for key, value in mesh.items()}
        changes |= {f"define.{key}": self._old(value) for key, value in tables.get("define", {}).items()}
        factors = {"tension": self.force, "load": self.pressure}
        for key, value in effects.items():
            parts = {name: self._times(self._old(part), factors[key]) for name, part in value.items()} if isinstance(
                value, dict) else self._times(self._old(value), factors[key])  # fmt: skip
            changes[f"effects.{key}"] = parts
        changes |= {f"obstacle.{key}": self._height(value) for key, value in obstacle.items()}
        new = {"value": self._height, "where": self._old}
        parts = tables.get("boundary", ())
        changes["boundary"] = [{k: new[k](v) if k in new else v for k, v in part.items()} for part in parts]
        return scene.change({**changes, "exact": None, "report": {}})

    def _old(self, value: Any) -> Any:
        """A formula whose coordinates are the new ones."""
        return _LENGTHS.sub(rf"(\1/{self.length!r})", value) if isinstance(value, str) and self.length != 1.0 else value

    def _times(self, value: Any, factor: float) -> Any:
        return f"({value})*{factor!r}" if isinstance(value, str) else value * factor

    def _height(self, value: Any) -> Any:
        scaled = self._times(self._old(value), self.height)
        if self.shift == 0.0:
            return scaled
        return f"{scaled} + {self.shift!r}" if isinstance(scaled, str) else scaled + self.shift


def all_units(size: float, shape: bool) -> list[Units]:
    """The units to try.

    Args:
        size: Of the solution.
        shape: Whether the mesh is one of our shapes, whose lengths can be changed.
    """
    found = []
    for key in ("length", "height", "force") if shape else ("height", "force"):
        found += [
            Units(f"{key}s x 2^{sign}30", **{key: factor}) for sign, factor in (("-", 1 / BILLION), ("", BILLION))
        ]
    power = 2.0 ** round(math.log2(size)) if size > 0 else 1.0
    return [*found, Units("heights + 2^20 sizes", shift=MILLION * power)]
