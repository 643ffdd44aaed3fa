"""A scene: what is to be solved, from a TOML file or from Python, before any mesh exists."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from fenicsx_obstacle.effects.effect import Effect, registered
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes import formulas, tables
from fenicsx_obstacle.scenes.formulas import Formula, nearest

COORDINATES = ("x", "y", "z", "r", "theta")
CONSTANTS = {"pi": math.pi}
RESERVED = {
    *COORDINATES,
    *CONSTANTS,
    "t",
    "distance",
    "eps",
    "h",
    "u",
    "p",
    "contact",
    "slope",
    "flux",
    *formulas.FUNCTIONS,
}


@dataclass(frozen=True, init=False)
class Scene:
    """An obstacle problem, checked as far as it can be without a mesh.

    `Scene(mesh=..., tension=1, lower="0.3 - x^2")` or `Scene.read("ball.toml")`.

    Attributes:
        name: Short name, for files.
        tables: The scene as it stands in TOML.
        effects: One object per effect that the scene names.
        mesh: A DOLFINx mesh of the caller's own, or None.
        folder: Where relative file names start.
    """

    name: str
    source: str
    tables: tables.Tables
    effects: tuple[Effect, ...]
    define: Mapping[str, Formula] = field(repr=False)
    mesh: Any = None
    folder: Path = Path()

    def __init__(
        self,
        *,
        mesh: Any,
        lower: float | str | None = None,
        upper: float | str | None = None,
        boundary: Any = ({"value": 0.0},),
        exact: float | str | None = None,
        define: Mapping[str, float | str] | None = None,
        title: str = "",
        u: str = "u",
        **effects: Any,
    ):
        """Scene from Python.

        Args:
            mesh: A DOLFINx mesh, or a table such as {"shape": "rectangle", "cells": 32}.
            lower: Lower obstacle, a number or a formula.
            upper: Upper obstacle, likewise.
            boundary: List of tables as in [[boundary]]; by default u = 0 on the whole boundary.
            exact: Exact solution, where known.
            define: Named numbers and formulas.
            title: Title.
            u: Name of the unknown on axes.
            **effects: One value per effect: tension=1, load=-2.

        Raises:
            InputError: For anything that is wrong without looking at a mesh.
        """
        raw = {
            "title": title, "u": u, "define": dict(define or {}), "effects": effects,
            "mesh": mesh if isinstance(mesh, dict) else {},
            "obstacle": {key: value for key, value in (("lower", lower), ("upper", upper)) if value is not None},
            "boundary": list(boundary),
        }  # fmt: skip
        if exact is not None:
            raw["exact"] = {"u": exact}
        self._fill(raw, "scene", Path(), None if isinstance(mesh, dict) else mesh)

    @classmethod
    def read(cls, path: str | Path) -> Scene:
        """Scene from a TOML file (every rank reads it).

        Raises:
            InputError: Naming file, table and key.
        """
        path = Path(path)
        self = cls.__new__(cls)
        self._fill(tables.read_toml(path), str(path), path.parent, None)
        return self

    def change(self, changes: Mapping[str, Any]) -> Scene:
        """The same scene with other values: `scene.change({"mesh.cells": 64, "define.ecc": 0.9})`.

        Raises:
            InputError: If a key is unknown or a value does not fit it.
        """
        raw = msgspec.to_builtins(self.tables)
        for key, value in changes.items():
            *path, last = key.split(".")
            table = raw
            for step in path:
                table = table.setdefault(step, {})
            if not isinstance(table, dict):
                raise InputError(f"{key}: not a key that can be set")
            table[last] = value
        new = Scene.__new__(Scene)
        new._fill(raw, self.source, self.folder, self.mesh)
        return new

    def _fill(self, raw: dict[str, Any], source: str, folder: Path, mesh: Any) -> None:
        typed = tables.checked(raw, source)
        set_ = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731  (the class is frozen)
        set_("name", Path(source).stem)
        set_("source", source)
        set_("folder", folder)
        set_("tables", typed)
        set_("mesh", mesh)
        set_("define", self._definitions())
        set_("effects", self._effects())
        if mesh is None and (typed.mesh.shape is None) == (typed.mesh.file is None):
            raise InputError(f"{source}: [mesh] needs either a 'shape' or a 'file'")
        for formula in self._formulas():
            formula.check_names(self.known_names)
        if typed.exact is not None:
            self.formula(typed.exact.u, "[exact] u").check_names({*self.known_names, "eps"})
        eps = self.number(typed.solve.eps, "[solve] eps", {"h": 1.0})
        if eps <= 0:
            raise InputError(f"{source}: [solve] eps = {typed.solve.eps}: must be positive and finite")
        for number, part in enumerate(typed.boundary):
            if part.value is None:
                raise InputError(f"{source}: [[boundary]] (no. {number + 1}): the key 'value' is missing")
            if part.on is not None and part.where is not None:
                raise InputError(f"{source}: [[boundary]] (no. {number + 1}): 'on' and 'where' exclude each other")

    @property
    def known_names(self) -> set[str]:
        """Names that formulas at points may use."""
        return {*self.define, *CONSTANTS, *COORDINATES}

    def formula(self, value: float | str, place: str) -> Formula:
        """Parse a value of this scene; `place` is its table and key."""
        return formulas.parse(value, f"{self.source}: {place}")

    def at_points(self, formula: Formula, x: np.ndarray, values: Mapping[str, Any] | None = None) -> np.ndarray:
        """Values of a formula.

        Args:
            formula: From `formula()`.
            x: Points, shape (3, n).
            values: Further names, such as eps.

        Returns:
            Array of n values.
        """
        names: dict[str, Any] = {**CONSTANTS, **(values or {}), **dict(zip("xyz", x, strict=True))}
        # a million points: only what the formula needs
        needed = set(formula.names)
        for key in reversed(list(self.define)):
            needed |= self.define[key].names if key in needed else set()
        if "r" in needed:
            names["r"] = np.linalg.norm(x, axis=0)
        if "theta" in needed:
            names["theta"] = np.arctan2(x[1], x[0])
        for key in (key for key in self.define if key in needed):
            names[key] = self.define[key].on_arrays(names)
        return np.broadcast_to(formula.on_arrays(names), x.shape[1:])

    def number(self, value: float | str, place: str, values: Mapping[str, float] | None = None) -> float:
        """A value that must be one finite number, such as a corner of the mesh.

        Raises:
            InputError: If it depends on the place or is not finite.
        """
        formula = self.formula(value, place)
        names: dict[str, Any] = {**CONSTANTS, **(values or {})}
        for key, defined in self.define.items():
            if defined.names <= set(names):
                names[key] = float(defined.on_arrays(names))
        formula.check_names(names)
        result = float(formula.on_arrays(names))
        if not math.isfinite(result):
            raise InputError(f"{formula.place} = {formula.text}: is {result}")
        return result

    def _definitions(self) -> dict[str, Formula]:
        definitions: dict[str, Formula] = {}
        for key, value in self.tables.define.items():
            place = f"[define] {key}"
            if not key.isidentifier():
                raise InputError(f"{self.source}: {place}: a name has letters, digits and _ only")
            if key in RESERVED:
                raise InputError(f"{self.source}: {place}: '{key}' has a meaning already; choose another name")
            formula = self.formula(value, place)
            formula.check_names({*definitions, *CONSTANTS, *COORDINATES})
            definitions[key] = formula
        return definitions

    def _effects(self) -> tuple[Effect, ...]:
        known = registered()
        for key, value in self.tables.effects.items():
            if key not in known:
                raise InputError(f"{self.source}: [effects] unknown effect '{key}'" + nearest(key, known))
            if isinstance(value, bool) or not isinstance(value, float | int | str):
                raise InputError(f"{self.source}: [effects] {key} = {value!r}: expected a number or a formula")
        if not any(known[key].elastic for key in self.tables.effects):
            raise InputError(f"{self.source}: [effects] names no stiffness: add 'tension = 1'")
        return tuple(known[key](self.formula(value, f"[effects] {key}")) for key, value in self.tables.effects.items())

    def _formulas(self) -> list[Formula]:
        obstacle, parts = self.tables.obstacle, []
        parts += [(value, f"[obstacle] {key}") for key, value in (("lower", obstacle.lower), ("upper", obstacle.upper))]
        for number, part in enumerate(self.tables.boundary):
            place = f"[[boundary]] (no. {number + 1})"
            parts += [(part.value, f"{place} value"), (part.where, f"{place} where")]
        found = [self.formula(value, place) for value, place in parts if value is not None]
        return found + [effect.value for effect in self.effects]

    def toml(self) -> str:
        """The scene as TOML text that `Scene.read` takes."""
        return msgspec.toml.encode(self.tables).decode()
