"""The tables of a scene and their keys, as typed structures; unknown keys and wrong types are rejected."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from fenicsx_obstacle.algebra.options import MethodName, StartName
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.shapes import SHAPES
from fenicsx_obstacle.text import in_toml, nearest, shown

Value = float | str  # a number or a formula
Numbers = tuple[Value, ...]
MAX_BYTES = 1_000_000  # of a scene file
MAX_NAME = 100  # bytes of a profile, which names files
MAX_PARTS = 1000  # of the boundary
MESHES = (".msh", ".geo", ".xdmf", ".step", ".stp")
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*{_PART}){{100}}")  # a dotted key, however it is quoted
# msgspec's names of types, in those of TOML
WORDS = {" | null": "", "`int`": "a whole number", "`float | str | object`": "a number, a formula or {file = ...}",
         "`float | str | array | object`": "a number, a formula, a list of these or {file = ...}",
         "`float | str`": "a number or a formula", "`float`": "a number", "`str`": "a text in quotes",
         "`str | array`": "a text in quotes, or a list of these", "`array`": "a list", "`object`": "a table",
         "`bool`": "true or false", "`date`": "a date"}  # fmt: skip
MAX_DEPTH = 8  # of tables and lists within each other
Positive = Annotated[int, Meta(ge=1, le=10**9)]
if TYPE_CHECKING:
    ShapeName = str
else:
    ShapeName = Literal[tuple(SHAPES)]


class DataTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Measured data, {file = "rough.csv"}: the keys of `data.measured.surface.Table`."""

    file: str
    x: Numbers | None = None
    y: Numbers | None = None
    range: Numbers | None = None
    scale: Value | Numbers = 1.0
    rotate: Value = 0.0
    shift: Numbers | None = None
    smooth: Value = 0.0

    def __str__(self) -> str:
        return in_toml(msgspec.to_builtins(self))


Datum = Value | DataTable
Vector = tuple[Datum, ...]  # of an elastic body: its components


class MeshTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[mesh]: a shape with its corners, or a file."""

    shape: ShapeName | None = None
    file: str | None = None
    x: tuple[Value, Value] = (0.0, 1.0)
    y: tuple[Value, Value] = (0.0, 1.0)
    z: tuple[Value, Value] = (0.0, 1.0)
    radius: Value = 1.0
    cells: Positive = 32
    refine: Annotated[int, Meta(ge=0, le=20)] = 0
    cell: Literal["triangle", "quadrilateral", "tetrahedron", "hexahedron"] | None = None
    diagonal: Literal["right", "left", "crossed", "union-jack"] = "right"
    perturb: Annotated[float, Meta(ge=0, lt=0.5)] = 0.0


_OF_ANY = ("shape", "file", "cells", "refine")


class ObstacleTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[obstacle]: bounds of u."""

    lower: Datum | None = None
    upper: Datum | None = None


ACTING = (*sorted(known("boundary")), "lower", "upper")  # keys of [[boundary]] other than `value`: effects, obstacles
OF_BODIES: dict[str, Any] = {"obstacle": dict[str, Any], "pressure": Datum, "traction": Vector}  # of elastic bodies
_TYPES = {**OF_BODIES, "spring": Datum | Vector}


class _PartTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[[boundary]]: where, and the value of u there, or what acts: tension du/dn = flux - spring u + p of obstacles."""

    on: str | tuple[str, ...] | None = None
    where: str | None = None
    value: Datum | Vector | None = None


if TYPE_CHECKING:

    class BoundaryTable(_PartTable, frozen=True):
        lower: Datum | None = None
        upper: Datum | None = None
        obstacle: dict[str, Any] | None = None

else:
    BoundaryTable = msgspec.defstruct(
        "BoundaryTable", [(key, _TYPES.get(key, Datum) | None, None) for key in ACTING], bases=(_PartTable,),
        module=__name__, frozen=True, forbid_unknown_fields=True, omit_defaults=True,
    )  # fmt: skip


class TimeTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[time]: from t = 0. Without rate or inertia an equilibrium is computed at each time.

    Attributes:
        end: The last moment.
        steps: How many; where a tolerance chooses them, the first has the length end/steps.
        start: u at t = 0, with rate or inertia.
        velocity: u_t at t = 0, with inertia.
        scheme: Of rate.
        tolerance: Of rate: what a step may add to the error, in the unit of u; chooses the steps.
        frames: How many moments are kept as fields, in addition to t = 0.
        name: What t is, with its unit, on axes.
    """

    end: Value
    steps: Annotated[int, Meta(ge=1, le=10**6)]
    start: Datum | None = None
    velocity: Datum | None = None
    scheme: Literal["euler", "bdf2"] | None = None
    tolerance: Annotated[float, Meta(gt=0)] | None = None
    frames: Annotated[int, Meta(ge=0, le=1000)] = 30
    name: str = "t"


class RatesTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[exact] rates: orders in h of the errors with these names, by SNES VI and by the penalty with eps = h^2.

    As h tends to 0, on uniform meshes; None where none is claimed.
    """

    l2: float | None = None
    h1: float | None = None
    pressure_l2: float | None = None
    pressure_dual: float | None = None


class ExactTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[exact]: the solution, where it is known, and what is known about it.

    Attributes:
        u: The solution.
        pressure: The contact pressure, where it is a function; an integrable one may still not be in L2.
        free: Where the free boundary is, in words.
        regularity: Of u and the pressure, in words.
        rates: Orders of convergence to expect.
    """

    u: Value
    pressure: Value | None = None
    free: str = ""
    regularity: str = ""
    rates: RatesTable = RatesTable()


class ProfileTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, rename={"from_": "from"}):
    """[profile.NAME]: a line, or a curve of the mesh by its name, along which all quantities are written and drawn.

    Attributes:
        from_: First point; in TOML 'from'.
        to: Last point.
        on: A named curve instead.
        n: Number of points, at equal distances.
        compare: Formulas by the quantity over which they are drawn: {p = "p0*sqrt(1 - (x/a)^2)"}.
    """

    from_: Value | Numbers | None = None
    to: Value | Numbers | None = None
    on: str | None = None
    n: Annotated[int, Meta(ge=2, le=100_000)] = 200
    compare: dict[str, Value] = {}


class SolveTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[solve]: how to solve; options of the command line take precedence."""

    element: str | None = None
    method: MethodName = "penalty"
    start: StartName = "nested"
    eps: Value = "auto"


class Tables(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A whole scene."""

    title: str = ""
    u: str = "u"
    define: dict[str, Value] = {}
    mesh: MeshTable = MeshTable()
    effects: dict[str, Any] = {}
    obstacle: ObstacleTable = ObstacleTable()
    boundary: tuple[BoundaryTable, ...] = ()
    time: TimeTable | None = None
    exact: ExactTable | None = None
    report: dict[str, Value] = {}
    profile: dict[str, ProfileTable] = {}
    solve: SolveTable = SolveTable()


def part_place(number: int) -> str:
    """The name of a [[boundary]] in messages; `number` counts from 0."""
    return f"[[boundary]] (no. {number + 1})"


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a file, not yet checked.

    Raises:
        InputError: If the file is missing or is not TOML.
    """
    if path.suffix in MESHES and path.is_file():
        raise InputError(f"{path}: a mesh, not a scene: write a scene that has mesh = {{file = '{path.name}'}}")
    try:
        if path.exists() and not path.is_file():  # a pipe, which might wait for ever; a device, which might never end
            raise InputError(f"{path}: a {'folder' if path.is_dir() else 'pipe or device'}, not a scene file")
        if path.stat().st_size > MAX_BYTES:
            size = path.stat().st_size / 1e6
            raise InputError(
                f"{path}: {size:.3g} MB, which is too large for a scene; the limit is {MAX_BYTES / 1e6:g} MB"
            )
        text = path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
        if _LONG_KEY.search(text):  # the time that they take grows like the square of their parts
            raise RecursionError
        raw = tomllib.loads(text)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: no such scene file") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text in UTF-8: byte {error.start} is none") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    inner: list[Any] = [raw]
    for _ in range(MAX_DEPTH):
        parts = [part for value in inner for part in (value.values() if isinstance(value, dict) else value)]
        inner = [part for part in parts if isinstance(part, dict | list)]
    if inner:
        raise InputError(f"{path}: nested too deeply")
    return raw


def checked(raw: dict[str, Any], source: str) -> Tables:
    """The tables as typed structures.

    Raises:
        InputError: Naming the table and key, and the nearest known key for an unknown one.
    """
    if isinstance(parts := raw.get("boundary"), list) and len(parts) > MAX_PARTS:
        raise InputError(f"{source}: [[boundary]]: {len(parts)} tables; the limit is {MAX_PARTS}")
    if isinstance(raw.get("boundary"), dict):
        raise InputError(
            f"{source}: [boundary]: write [[boundary]], in double brackets: each part has a table of its own"
        )
    try:
        typed = msgspec.convert(raw, Tables)
    except msgspec.ValidationError:
        for place, kind, part in _parts(raw):
            as_structure(part, kind, f"{source}:{place}")
        raise
    _no_idle_key(typed.mesh, raw.get("mesh", {}), source)
    for name, table in typed.profile.items():
        if not re.fullmatch(r"[\w-]+", name) or len(name.encode()) > MAX_NAME:
            wanted = f"a name has letters, digits, _ and - only, at most {MAX_NAME} bytes"
            raise InputError(f"{source}: [profile.{shown(name)}]: {wanted}")
        if (table.on is None) == (table.from_ is None) or (table.from_ is None) != (table.to is None):
            raise InputError(f"{source}: [profile.{name}]: needs the keys 'from' and 'to', or 'on'")
    return typed


def _no_idle_key(mesh: MeshTable, given: dict[str, Any], source: str) -> None:
    """Reject keys of [mesh] that do not belong to the shape or the file."""
    known, default = (*_OF_ANY, *(SHAPES[mesh.shape].keys if mesh.shape else ())), MeshTable()
    for key in given:
        if key not in known and getattr(mesh, key) != getattr(default, key):
            of = f"shape = '{mesh.shape}'" if mesh.shape else "a mesh from a file"
            says = ", ".join(known[2:])
            raise InputError(
                f"{source}: [mesh] {key} = {shown(given[key])}: does not belong to {of}; its keys are: {says}"
            )


def _parts(raw: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """The name of each part of a scene in messages, its type, and the part."""
    kinds = {one.name: one.type for one in msgspec.structs.fields(Tables)}
    for name, value in raw.items():
        if name == "boundary" and isinstance(value, list | tuple):
            yield from ((f" {part_place(k)}", BoundaryTable, part) for k, part in enumerate(value))
        elif name == "profile" and isinstance(value, dict):
            yield from ((f" [profile.{key}]", ProfileTable, part) for key, part in value.items())
        elif name in ("define", "report") and isinstance(value, dict):
            yield from ((f" [{name}] {key}", Value, part) for key, part in value.items())
        elif name in ("title", "u") or name not in kinds:
            yield "", Tables, {name: value}
        else:
            yield f" [{name}]", kinds[name], value


def as_structure(raw: Any, kind: Any, place: str) -> Any:
    """A part of a scene as a typed structure.

    Args:
        raw: As it stands in TOML.
        kind: The type.
        place: What messages call it, with its file.

    Raises:
        InputError: With TOML's names for the place, the value found, and the nearest key.
    """
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        problem, _, path = str(error).partition(" - at `$")
    path = path.rstrip("`").lstrip(".")
    place, declared, (key, *_) = f"{place} {path}".rstrip(), kind, re.split(r"[.\[]", path)
    if key:
        declared = {one.encode_name: one.type for one in msgspec.structs.fields(next(_structs(kind)))}[key]
    if match := re.match(r"Object contains unknown field `(.*)`", problem):
        struct = next(_structs(declared))
        hint = nearest(match[1], struct.__struct_encode_fields__)
        raise InputError(f"{place} unknown {'table or key' if struct is Tables else 'key'} {shown(match[1])}{hint}")
    if match := re.match(r"Object missing required field `(.*)`", problem):
        raise InputError(f"{place} the key '{match[1]}' is missing")
    for step in re.findall(r"[^.\[\]]+", path.replace("[...]", "")):
        raw = raw[int(step)] if step.isdigit() else raw[step]
    if problem.startswith("Invalid enum value"):
        words = [word for one in (declared, *get_args(declared)) for word in get_args(one) if isinstance(word, str)]
        raise InputError(f"{place} = {shown(raw)} is not known" + nearest(str(raw), words))
    for word, plain in WORDS.items():
        problem = problem.replace(word, plain)
    raise InputError(f"{place} = {shown(raw)}: {problem[0].lower()}{problem[1:]}")


def _structs(kind: Any) -> Iterator[Any]:
    """The structures that a value of a type may be, or hold."""
    if hasattr(kind, "__struct_encode_fields__"):
        yield kind
    for part in get_args(kind):
        yield from _structs(part)


def set_values(raw: dict[str, Any], changes: Mapping[str, Any], source: str) -> None:
    """Set values in tables as they stand in TOML, which are checked afterwards; tables that are missing are made.

    Items of a list are counted from 0, as in `boundary.0.value`; the number after the last one adds a table.

    Raises:
        InputError: If a key is below a number or a text, a list has no such item, or a new name of [define] is used
            nowhere.
    """
    defined = raw.get("define")
    had = set(defined) if isinstance(defined, dict) else set[str]()
    for key, value in changes.items():
        *steps, last = key.split(".")
        table: Any = raw
        for step in steps:
            table = _inner(table, step, key, source)
        if isinstance(table, dict):
            table[last] = value
        else:
            table[_item(last, key, source, len(table))] = value
    for key in changes:
        path, _, name = key.rpartition(".")
        used = re.compile(rf"\b{re.escape(name)}\b")
        if path == "define" and name not in had and not any(map(used.search, _texts(raw))):
            raise InputError(
                f"{source}: [define] has no '{name}', and no formula uses it" + (nearest(name, had) if had else "")
            )


def _inner(table: Any, step: str, key: str, source: str) -> Any:
    """The table or list of this name or number within a table or list."""
    if isinstance(table, dict):
        inner = table.setdefault(step, [] if step == "boundary" else {})
    else:
        number = _item(step, key, source, len(table) + 1)
        if number == len(table):
            table.append({})
        inner = table[number]
    if isinstance(inner, tuple):
        inner = list(inner)
        table[step if isinstance(table, dict) else int(step)] = inner
    if not isinstance(inner, dict | list):
        raise InputError(f"{source}: {key}: not a key that can be set: {step} is no table")
    return inner


def _item(step: str, key: str, source: str, count: int) -> int:
    """The number of an item of a list, below `count`."""
    if not re.fullmatch(r"\d{1,4}", step) or int(step) >= count:
        wanted = f"; take a number from 0 to {count - 1}" if count else ", which is empty"
        raise InputError(f"{source}: {key}: '{step}' is no item of the list{wanted}")
    return int(step)


def _texts(value: Any) -> Iterator[str]:
    """All texts within tables and lists, but no keys."""
    if isinstance(value, str):
        yield value
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        yield from _texts(part)
