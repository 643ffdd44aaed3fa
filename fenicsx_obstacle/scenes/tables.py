"""The tables of a scene and their keys, as typed structures; unknown keys and wrong types are rejected."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from fenicsx_obstacle.algebra.options import MethodName, StartName
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.measured.table import in_words
from fenicsx_obstacle.scenes.formulas import SHOWN
from fenicsx_obstacle.text import nearest

Value = float | str  # a number or a formula
Numbers = tuple[Value, ...]
MAX_BYTES = 1_000_000  # of a scene file
MAX_NAME = 100  # bytes of a profile, which names files
MAX_PARTS = 1000  # of the boundary
MESHES = (".msh", ".geo", ".xdmf", ".step", ".stp")
_PART = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*{_PART}){{100}}")  # a dotted key, however it is quoted
MAX_DEPTH = 8  # of tables and lists within each other
Positive = Annotated[int, Meta(ge=1, le=10**9)]


class DataTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Measured data, {file = "rough.csv"}: the keys of `measured.table.Table`."""

    file: str
    x: Numbers | None = None
    y: Numbers | None = None
    range: Numbers | None = None
    scale: Value | Numbers = 1.0
    rotate: Value = 0.0
    shift: Numbers | None = None
    smooth: Value = 0.0

    def __str__(self) -> str:
        return in_words(msgspec.to_builtins(self))


Datum = Value | DataTable
Vector = tuple[Datum, ...]  # of an elastic body: its components


class MeshTable(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """[mesh]: a shape with its corners, or a file."""

    shape: Literal["interval", "rectangle", "disk", "l-shape", "box"] | None = None
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


OF_SHAPE = {  # its keys other than `cells` and `refine`
    "interval": ("x",), "rectangle": ("x", "y", "cell", "diagonal", "perturb"),
    "box": ("x", "y", "z", "cell", "perturb"), "l-shape": ("x", "y"), "disk": ("radius",),
}  # fmt: skip
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


def data_table(raw: dict[str, Any], place: str) -> DataTable:
    """A table of measured data among the values of [effects], typed.

    Args:
        raw: As it stands in TOML.
        place: What messages call it, with its file.

    Raises:
        InputError: Naming the key.
    """
    try:
        return msgspec.convert(raw, DataTable)
    except msgspec.ValidationError as error:
        problem = str(error).replace(" - at `$.", ": ").rstrip("`")
        if match := re.match(r"Object contains unknown field `(.*)`", problem):
            raise InputError(
                f"{place}: unknown key '{match[1]}'" + nearest(match[1], DataTable.__struct_fields__)
            ) from None
        raise InputError(f"{place}: {problem[0].lower()}{problem[1:]}") from None


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
    except msgspec.ValidationError as error:
        raise InputError(f"{source}: {_in_words(str(error), raw)}") from None
    _no_idle_key(typed.mesh, raw.get("mesh", {}), source)
    for name, table in typed.profile.items():
        if not re.fullmatch(r"[\w-]+", name) or len(name.encode()) > MAX_NAME:
            wanted = f"a name has letters, digits, _ and - only, at most {MAX_NAME} bytes"
            raise InputError(f"{source}: [profile.{_short(name)}]: {wanted}")
        if (table.on is None) == (table.from_ is None) or (table.from_ is None) != (table.to is None):
            raise InputError(f"{source}: [profile.{name}]: needs the keys 'from' and 'to', or 'on'")
    return typed


def _no_idle_key(mesh: MeshTable, given: dict[str, Any], source: str) -> None:
    """Reject keys of [mesh] that do not belong to the shape or the file."""
    known, default = (*_OF_ANY, *OF_SHAPE.get(mesh.shape or "", ())), MeshTable()
    for key in given:
        if key not in known and getattr(mesh, key) != getattr(default, key):
            of = f"shape = '{mesh.shape}'" if mesh.shape else "a mesh from a file"
            says = ", ".join(known[2:])
            raise InputError(
                f"{source}: [mesh] {key} = {_short(given[key])}: does not belong to {of}; its keys are: {says}"
            )


def _in_words(message: str, raw: dict[str, Any]) -> str:
    """msgspec's message with TOML's names for the place, the value found, and the nearest key."""
    problem, _, path = message.partition(" - at `$")
    path = path.rstrip("`").lstrip(".").replace("profile[...]", f"profile.{_wrong_profile(raw)}")
    place = _place(path)
    if match := re.match(r"Object contains unknown field `(.*)`", problem):
        known, kind = _keys_at(path), "key" if path else "table or key"
        return f"{place}unknown {kind} {_short(match[1])}" + nearest(match[1], known)
    if match := re.match(r"Object missing required field `(.*)`", problem):
        return f"{place}the key '{match[1]}' is missing"
    if path in ("define[...]", "report[...]"):
        table = path.removesuffix("[...]")
        key, found = next((key, value) for key, value in raw[table].items() if not _is_value(value))
        place = f"[{table}] {key} "
    else:
        found = _value_at(path, raw)
    if problem.startswith("Invalid enum value"):
        return f"{place}= {_short(found)} is not known" + nearest(str(found), _choices_at(path))
    words = {" | null": "", "`int`": "a whole number", "`float | str | object`": "a number, a formula or {file = ...}",
             "`float | str | array | object`": "a number, a formula, a list of these or {file = ...}",
             "`float | str`": "a number or a formula", "`float`": "a number",
             "`str`": "a text in quotes", "`str | array`": "a text in quotes, or a list of these", "`array`": "a list",
             "`object`": "a table", "`bool`": "true or false", "`date`": "a date"}  # fmt: skip
    for word, plain in words.items():
        problem = problem.replace(word, plain)
    return f"{place}= {_short(found)}: {problem[0].lower()}{problem[1:]}"


def _wrong_profile(raw: dict[str, Any]) -> str:
    """The name of the first profile that is none; msgspec does not say."""
    for name, table in raw.get("profile", {}).items() if isinstance(raw.get("profile"), dict) else ():
        try:
            msgspec.convert(table, ProfileTable)
        except msgspec.ValidationError:
            return str(name)
    return ""


def _short(found: Any) -> str:
    """A value as TOML's reader has it, or its beginning."""
    text = repr(found)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]} ..."


def _is_value(value: Any) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def _place(path: str) -> str:
    """'mesh.cells' -> '[mesh] cells ', 'boundary[0].on' -> '[[boundary]] (no. 1) on '."""
    table, _, key = path.partition(".")
    if match := re.match(r"boundary\[(\d+)\]", table):
        table = part_place(int(match[1]))
    elif key or table in Tables.__struct_fields__[2:]:
        table = f"[{table}]"
    return " ".join(part for part in (table, key) if part) + (" " if path else "")


def _table_type(path: str) -> Any:
    kinds = {"mesh": MeshTable, "obstacle": ObstacleTable, "exact": ExactTable, "solve": SolveTable,
             "time": TimeTable, "profile": ProfileTable}  # fmt: skip
    name, _, key = path.partition(".")
    if key in ("lower", "upper", "value", "start", "velocity", *ACTING):
        return DataTable
    return BoundaryTable if name.startswith("boundary") else kinds.get(name, Tables)


def _keys_at(path: str) -> tuple[str, ...]:
    return _table_type(path).__struct_encode_fields__


def _choices_at(path: str) -> list[str]:
    """Allowed words of a Literal field."""
    key = path.partition(".")[2]
    for info in msgspec.structs.fields(_table_type(path)):
        if info.name == key:
            described = msgspec.inspect.type_info(info.type)
            options = getattr(described, "types", (described,))
            return [word for option in options for word in getattr(option, "values", ())]
    return []


def _value_at(path: str, raw: Any) -> Any:
    for step in re.findall(r"[^.\[\]]+", path.replace("[...]", "")):
        try:
            raw = raw[int(step)] if step.isdigit() else raw[step]
        except (KeyError, IndexError, TypeError):
            return raw
    return raw
