"""A rigid obstacle in front of a part of the boundary of an elastic body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.effects.effect import OnPart, Reader, register
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.elasticity import ball_gap, plane_gap
from fenicsx_obstacle.text import counted, in_toml

KINDS = {"sphere": "centre", "cylinder": "centre", "box": "centre", "plane": "at", "table": None, "stl": None,
         "gap": None}  # what places each of them  # fmt: skip
FROM_FILES = ("table", "stl")
HERTZ = {"sphere": 2.5, "cylinder": 4.0}  # (half-width over radius of gyration)^2 of Hertz's pressure


@register
@dataclass(frozen=True)
class Obstacle(OnPart):
    """u . n <= gap: contact without friction, with the pressure p >= 0 on the body.

    n is the direction in which the gap is measured, a unit vector out of the body: `along`, of a half-space its normal,
    otherwise the normal of the body, at nodes the mean over the facets there.

    Attributes:
        value: The gap as a formula, or the measured data of a table or an STL surface; None for the other shapes.
        kind: sphere, cylinder, box, plane, table, stl or gap.
        radius: Of a sphere or cylinder.
        sizes: Of a box, its lengths along the axes.
        point: Its centre, or a point on the plane.
        direction: The axis of a cylinder in space; the normal of a half-space, towards the elastic body.
        measured: Direction of the gap, `along` in the scene, or empty.
        force: With which the obstacle presses; None if it stays where it is.
        travel: How far it has moved, a formula of t; None if it stays where it is or moves until it presses.
        moves: The direction in which it then moves, a unit vector; empty if it stays.
        words: As it stands in the scene.
        source: Where it stands, for messages.
    """

    value: Field | None  # type: ignore[assignment]
    kind: str
    radius: float
    sizes: tuple[float, ...]
    point: tuple[float, ...]
    direction: tuple[float, ...]
    measured: tuple[float, ...]
    force: float | None
    travel: Field | None
    moves: tuple[float, ...]
    words: str
    source: str

    key = "obstacle"
    equation = "- p n"
    vector_valued = True

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Obstacle:
        others = ("centre", "at", "axis", "along", "force", "travel", "moves")
        reader.table(raw, place, (), (*KINDS, *others), tuple(KINDS))
        source, kinds = f"{reader.source}: {place}", [key for key in KINDS if key in raw]
        if len(kinds) > 1:
            raise InputError(f"{source}: {' and '.join(kinds)} exclude each other; use a table [[boundary]] for each")
        kind = kinds[0]
        needed = KINDS[kind]
        if needed is not None and needed not in raw:
            raise InputError(f"{source}: {kind} needs the key '{needed}'")
        allowed = {kind, needed, "along", "force", "travel", "moves", *(["axis"] if kind == "cylinder" else [])}
        for key in raw:
            if key not in allowed:
                raise InputError(f"{source}: '{key}' does not belong to a {kind}")
        if "force" in raw and "travel" in raw:
            raise InputError(f"{source}: 'force' and 'travel' exclude each other")
        if ("force" in raw or "travel" in raw) != ("moves" in raw):
            together = "'force' or 'travel' and 'moves', the direction in which the obstacle moves, go together"
            raise InputError(f"{source}: {together}")
        travel = reader.field(raw["travel"], f"{place}.travel") if "travel" in raw else None
        if travel is not None and not travel.uniform:
            raise InputError(f"{source}.travel = {raw['travel']}: must be the same everywhere, at one time")

        def vector(key: str, *, unit: bool = False) -> tuple[float, ...]:
            if key not in raw:
                return ()
            given = raw[key]
            if not isinstance(given, list | tuple) or len(given) not in (2, 3):
                raise InputError(f"{source}.{key} = {given!r}: expected a list of two or three numbers")
            found = [reader.number(one, f"{place}.{key}[{k}]") for k, one in enumerate(given)]
            length = sum(x * x for x in found) ** 0.5
            if unit and length == 0:
                raise InputError(f"{source}.{key} = {given!r}: has no direction")
            return tuple(x / length for x in found) if unit else tuple(found)

        def positive(key: str) -> float:
            found = reader.number(raw[key], f"{place}.{key}")
            if found <= 0:
                raise InputError(f"{source}.{key} = {raw[key]}: must be positive")
            return found

        sizes = vector(kind) if kind == "box" else ()
        if any(size <= 0 for size in sizes):
            raise InputError(f"{source}.box = {raw['box']}: lengths along the axes must be positive")
        value = reader.field(raw["gap"], f"{place}.gap") if kind == "gap" else None
        if kind in FROM_FILES:
            value = reader.value(raw[kind], f"{place}.{kind}")
        return cls(
            value, more["part"], kind,
            radius=positive(kind) if kind in HERTZ else 0.0, sizes=sizes,
            point=vector(needed) if needed is not None else (),
            direction=vector("plane" if kind == "plane" else "axis", unit=True),
            measured=vector("along", unit=True),
            force=positive("force") if "force" in raw else None,
            travel=travel, moves=vector("moves", unit=True), words=in_toml(raw), source=source,
        )  # fmt: skip

    def __str__(self) -> str:
        return self.words

    def check(self, gdim: int, *, axial: bool) -> None:
        """Reject what does not fit the mesh.

        Args:
            gdim: Coordinates of its points.
            axial: Whether x is the distance from an axis.

        Raises:
            InputError: With the remedy.
        """
        for key, vector in (("centre or at", self.point), ("plane or axis", self.direction), ("box", self.sizes),
                            ("along", self.measured), ("moves", self.moves)):  # fmt: skip
            if vector and len(vector) != gdim:
                wanted = f"points have {counted(gdim, 'coordinate')}"
                raise InputError(f"{self.source}: {key} has {counted(len(vector), 'component')}, but {wanted}")
        if gdim == 2 and self.kind == "cylinder" and (axial or self.direction):
            why = "with axial_symmetry take a sphere" if axial else "in the plane it has no axis; remove the key"
            raise InputError(f"{self.source}: cylinder: {why}")
        if gdim == 2 and self.kind == "sphere" and not axial:
            raise InputError(f"{self.source}: sphere: in the plane take a cylinder, or add axial_symmetry to [effects]")
        if gdim == 3 and self.kind == "cylinder" and not self.direction:
            raise InputError(f"{self.source}: cylinder: in space it needs the key 'axis'")
        if self.kind == "stl" and gdim == 2:
            raise InputError(f"{self.source}: stl: a surface in space is for solids; in the plane take a table")
        if axial and self.kind in ("sphere", "box") and self.point[0] != 0:
            raise InputError(f"{self.source}: centre = {list(self.point)}: must be on the axis x = 0")
        if axial and self.moves and self.moves[0] != 0:
            raise InputError(f"{self.source}: moves = {list(self.moves)}: must be along the axis x = 0")

    def gap(self, x: Any, n: Any, shift: Sequence[Any]) -> Any:
        """The gap of a sphere, a cylinder or a half-space, in UFL.

        Args:
            x: Points of the body's surface.
            n: Direction of the gap.
            shift: How far the obstacle has moved, along each axis.
        """
        place = [p + s for p, s in zip(self.point, shift, strict=True)]
        if self.kind == "plane":
            return plane_gap(x, n, place, self.direction)
        return ball_gap(x, n, place, self.radius, self.direction or None)
