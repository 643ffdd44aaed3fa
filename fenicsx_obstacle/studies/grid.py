"""Studies over several keys, as lines along one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fenicsx_obstacle.studies.orders import lookup, parameter
from fenicsx_obstacle.text import short

Row = Mapping[str, Any]
Vary = Mapping[str, Sequence[Any]]  # values of each key


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
