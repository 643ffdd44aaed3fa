"""Quantities of the rows of a study with their orders according to the paper, and lines through a grid of keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.problems.summary import lookup
from fenicsx_obstacle.text import short

Row = Mapping[str, Any]
Vary = Mapping[str, Sequence[Any]]  # values of each key


@dataclass(frozen=True)
class Quantity:
    """A measured quantity that tends to zero.

    Attributes:
        key: Dotted name in a row.
        label: Head of its column.
        tex: The same for pictures.
        order: The order to expect in the varied parameter.
        stated: Whether the paper states it; otherwise it is the best that P1 can give.
    """

    key: str
    label: str
    tex: str
    order: float
    stated: bool


IN_EPS = (  # h fixed: (5.5), Theorem 3.3, and (3.7) for the penetration
    Quantity("to_vi.energy", "|u_eps-u_h|_a", r"$\|u_\epsilon-u_h\|_a$", 1.0, True),
    Quantity("to_vi.max", "max|u_eps-u_h|", r"$\max|u_\epsilon-u_h|$", 1.0, True),
    Quantity("to_vi.pressure_l2", "|p_eps-p_h|_0", r"$\|p_\epsilon-p_h\|_0$", 1.0, True),
    Quantity("penetration", "penetration", "penetration", 1.0, True),
)
IN_H = (  # (5.6)-(5.9); of the pressure in L2, (5.7) claims no more than that it is bounded
    Quantity("errors.h1", "|u-u_h|_1", r"$\|u-u_h\|_1$", 1.0, True),
    Quantity("errors.l2", "|u-u_h|_0", r"$\|u-u_h\|_0$", 2.0, False),
    Quantity("errors.max", "max|u-u_h|", r"$\max|u-u_h|$", 2.0, False),
    Quantity("errors.pressure_l2", "|p-p_h|_0", r"$\|p-p_h\|_0$", 0.0, True),
    Quantity("errors.pressure_dual", "|p-p_h|_1*", r"$\|p-p_h\|_1^*$", 1.0, True),
)


def parameter(varied: Sequence[str]) -> str:
    """The parameter of the orders: eps if it varies, h if meshes vary, otherwise ''."""
    if "eps" in varied or "solve.eps" in varied:
        return "eps"
    return "h" if {"cells", "refine", "mesh.cells", "mesh.refine"} & set(varied) else ""


def quantities(varied: Sequence[str], row: Row) -> list[Quantity]:
    """The quantities that this study measures."""
    candidates = IN_EPS if parameter(varied) == "eps" else IN_H
    return [quantity for quantity in candidates if lookup(row, quantity.key) is not None]


def order(key: str, row: Row, before: Row | None, by: str) -> float | None:
    """Observed order between two rows, log(e1/e0) / log(x1/x0), that differ in the parameter only."""
    if before is None or not by:
        return None
    x1, x0, e1, e0 = (lookup(r, k) for k in (by, key) for r in (row, before))
    if not all(isinstance(v, float) and v > 0 for v in (x1, x0, e1, e0)) or x1 == x0:
        return None
    return math.log(e1 / e0) / math.log(x1 / x0)


def along(vary: Vary) -> str:
    """The key that lines run along: one that changes eps or h, or else one whose values are numbers."""
    by = parameter(list(vary))
    changing = [key for key in vary if by and parameter([key]) == by]
    numbers = [key for key, values in vary.items() if all(isinstance(value, int | float) for value in values)]
    return [*changing, *numbers, *vary][0]


def line_of(row: Row, key: str) -> str:
    """The values of all keys of a row but this one, which identify its line."""
    others = {name: value for name, value in row["vary"].items() if name != key}
    return ", ".join(f"{last_part(name)} = {short(value)}" for name, value in others.items())


def lines_of(rows: Sequence[Row], key: str) -> dict[str, list[Row]]:
    """The rows of each line, by its name; the name is empty where one key varies."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(line_of(row, key), []).append(row)
    return found


def figures_of(row: Row) -> dict[str, str]:
    """The output quantities of a study without errors, name by dotted key: [report], or those of the contact."""
    report = {f"report.{name}": name for name in row.get("report") or {}}
    contact = {"contact.area": "contact area", "contact.lower.force": "force on lower obstacle",
               "contact.upper.force": "force on upper obstacle", "energy": "energy"}  # fmt: skip
    return report or {key: name for key, name in contact.items() if lookup(row, key) is not None}


def last_part(key: str) -> str:
    """Name of a dotted key in tables and on axes: define.ecc is ecc."""
    return key.rpartition(".")[2]
