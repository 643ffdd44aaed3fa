"""The same scene in other units, and with another zero of u: results must agree after conversion.

Factors are powers of two near 10^9, so that scaling itself rounds nothing; what then differs is an absolute tolerance
somewhere. Heights shifted by about 10^6 times the size of the solution do lose digits, as many as the data lose.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec

from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.effects.domain.power_law import FLAT
from fenicsx_obstacle.effects.effect import OnPart, is_support
from fenicsx_obstacle.mesh.shapes import SHAPES
from fenicsx_obstacle.scenes.scene import Scene

BILLION = 2.0**30
MILLION = 2.0**20
_LENGTHS = re.compile(r"\b(x|y|z|r|distance)\b")
KEEP_SLOPES = {"large_slope"}  # effects that are the same in other units only where slopes are
ROUND_SLOPES = {"power_law"}  # effects whose powers of slopes are rounded anew in units with other slopes


@dataclass(frozen=True)
class Units:
    """How many new units make an old one, and the new height of the old zero.

    -div(tension grad u) = load + p becomes the same equation with tension * force, load * force * height / length^2 and
    p too; eps has the unit of u/p. Slopes are heights over lengths: tensions that depend on them are the same only
    if both grow by the same factor, but for a power law, which is homogeneous.

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

    def exact(self, model: Model) -> bool:
        """Whether steps are the same in these units.

        Powers of slopes that are no integers are rounded anew. Shifted heights have lost digits: with nonlinear effects
        that changes the steps, and with drift the first contact set, where round-off decides about nodes without force,
        and with it the path of a line search on the norm of the residual.
        """
        if self.shift != 0.0:
            return all(effect.affine and effect.symmetric for effect in model.effects)
        return self.height == self.length or not any(effect.key in ROUND_SLOPES for effect in model.effects)

    def of(self, scene: Scene) -> Scene:
        """The scene in these units, without its exact solution and report; meshes of files keep their length."""
        tables: dict[str, Any] = msgspec.to_builtins(scene.tables)
        mesh, obstacle = tables.get("mesh", {}), tables.get("obstacle", {})
        for key in {"x", "y", "z"} & set(mesh):
            mesh[key] = [self._times(value, self.length) for value in mesh[key]]
        if mesh.get("shape") and self.length != 1.0:
            for key in set(SHAPES[mesh["shape"]].keys) & {"x", "y", "z"} - set(mesh):
                mesh[key] = [0.0, self.length]
            if mesh["shape"] == "disk":
                mesh["radius"] = self._times(mesh.get("radius", 1.0), self.length)
        changes: dict[str, Any] = {f"mesh.{key}": value for key, value in mesh.items()}
        changes |= {f"define.{key}": self._old(value) for key, value in tables.get("define", {}).items()}
        dim = {"interval": 1, "box": 3}.get(mesh.get("shape", ""), 2)
        given = tables.get("effects", {})
        changes["effects"] = {key: self._datum(key, value, dim) for key, value in given.items()}
        changes |= {f"obstacle.{key}": self.height_of(value) for key, value in obstacle.items()}
        new = {"value": self.height_of, "lower": self.height_of, "upper": self.height_of, "where": self._old}
        acting = {effect.key for effect in scene.effects if isinstance(effect, OnPart)}
        new |= {key: partial(self._datum, key, dim=dim) for key in acting}
        parts = tables.get("boundary", ())
        changes["boundary"] = [{k: new[k](v) if k in new else v for k, v in part.items()} for part in parts]
        return scene.change({**changes, "exact": None, "report": {}})

    def _datum(self, key: str, raw: Any, dim: int) -> Any:
        """The entry of an effect in a scene."""
        return CONVERSIONS[key](raw, self, dim)

    def scaled(self, value: Any, factor: float) -> Any:
        """A number or a formula times a factor, at the same places; or each of those in a list or a table."""
        if isinstance(value, dict):
            return {name: self.scaled(part, factor) for name, part in value.items()}
        if isinstance(value, list):
            return [self.scaled(part, factor) for part in value]
        return self._times(self._old(value), factor)

    def _old(self, value: Any) -> Any:
        """A formula whose coordinates are the new ones."""
        return _LENGTHS.sub(rf"(\1/{self.length!r})", value) if isinstance(value, str) and self.length != 1.0 else value

    def _times(self, value: Any, factor: float) -> Any:
        return f"({value})*{factor!r}" if isinstance(value, str) else value * factor

    def height_of(self, value: Any) -> Any:
        """A number or a formula for a height."""
        scaled = self._times(self._old(value), self.height)
        if self.shift == 0.0:
            return scaled
        return f"{scaled} + {self.shift!r}" if isinstance(scaled, str) else scaled + self.shift


Conversion = Callable[[Any, Units, int], Any]  # of an effect's entry in a scene, on a mesh of some dimension


def _of_unit(length: int, height: int, force: int) -> Conversion:
    """The conversion of a value whose unit has these exponents of length, u and tension."""

    def convert(raw: Any, units: Units, dim: int) -> Any:
        return units.scaled(raw, units.length**length * units.height**height * units.force**force)

    return convert


def _point_load(raw: Any, units: Units, dim: int) -> Any:
    factor = units.pressure * units.length**dim
    return [
        {"at": [units.scaled(x, units.length) for x in (at if isinstance(at, list) else [at])],
         "force": units.scaled(one["force"], factor)}
        for one in raw for at in [one["at"]]
    ]  # fmt: skip


def _power_law(raw: Any, units: Units, dim: int) -> Any:
    slope = units.height / units.length
    # a power of two for exponents with one digit: nothing is rounded
    factor = units.force * 2.0 ** round(math.log2(slope) * (2 - float(raw["exponent"])), 6)
    return {
        **raw, "coefficient": units.scaled(raw.get("coefficient", 1.0), factor),
        "regularisation": units.scaled(raw.get("regularisation", FLAT), slope),
    }  # fmt: skip


def _soft_obstacle(raw: Any, units: Units, dim: int) -> Any:
    sides = {side: units.height_of(g) for side, g in raw.items() if side != "stiffness"}
    return {**sides, "stiffness": CONVERSIONS["foundation"](raw["stiffness"], units, dim)}


# by the key of the effect; scenes with other effects have no other units
CONVERSIONS: dict[str, Conversion] = {
    "axial_symmetry": lambda raw, units, dim: raw,
    "drift": _of_unit(-1, 0, 1),
    "flux": _of_unit(-1, 1, 1),
    "foundation": _of_unit(-2, 0, 1),
    "inertia": _of_unit(-2, 0, 1),
    "large_slope": _of_unit(0, 0, 1),
    "load": _of_unit(-2, 1, 1),
    "point_load": _point_load,
    "power_law": _power_law,
    "rate": _of_unit(-2, 0, 1),
    "soft_obstacle": _soft_obstacle,
    "spring": _of_unit(-1, 0, 1),
    "tension": _of_unit(0, 0, 1),
}


def all_units(scene: Scene, size: float) -> list[Units]:
    """The units in which a scene is the same.

    Args:
        scene: Meshes of files keep their lengths; none are known for effects that are not in `CONVERSIONS`.
        size: Of its solution.
    """
    shape, effects = scene.tables.mesh.shape is not None, scene.effects
    if any(effect.key not in CONVERSIONS for effect in effects):
        return []
    found = []
    for key in ("length", "height", "force"):
        for sign, factor in (("-", 1 / BILLION), ("", BILLION)):
            scaled = {key: factor}
            if any(effect.key in KEEP_SLOPES for effect in effects) and key != "force":
                scaled = {"length": factor, "height": factor}
            if shape or "length" not in scaled:
                found.append(Units(f"{' and '.join(f'{one}s' for one in scaled)} x 2^{sign}30", **scaled))
    if any(is_support(effect) and effect.order == 0 for effect in effects):  # heights count from 0 there
        return list(dict.fromkeys(found))
    power = 2.0 ** round(math.log2(size)) if size > 0 else 1.0
    return [*dict.fromkeys(found), Units("heights + 2^20 sizes", shift=MILLION * power)]
