"""Values of a scene that are set by dotted keys: `mesh.cells`, `effects.load`, `boundary.0.value`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import nearest


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
            table[_item(table, last, key, source, len(table))] = value
    for key in changes:
        path, _, name = key.rpartition(".")
        if path == "define" and name not in had and not _is_used(raw, name):
            raise InputError(
                f"{source}: [define] has no '{name}', and no formula uses it" + (nearest(name, had) if had else "")
            )


def _inner(table: Any, step: str, key: str, source: str) -> Any:
    """The table or list of this name or number within a table or list."""
    if isinstance(table, dict):
        inner = table.setdefault(step, [] if step == "boundary" else {})
    else:
        number = _item(table, step, key, source, len(table) + 1)
        if number == len(table):
            table.append({})
        inner = table[number]
    if isinstance(inner, tuple):
        inner = list(inner)
        table[step if isinstance(table, dict) else int(step)] = inner
    if not isinstance(inner, dict | list):
        raise InputError(f"{source}: {key}: not a key that can be set: {step} is no table")
    return inner


def _item(items: list[Any], step: str, key: str, source: str, count: int) -> int:
    """The number of an item of a list, below `count`."""
    if not re.fullmatch(r"\d{1,4}", step) or int(step) >= count:
        wanted = f"; take a number from 0 to {count - 1}" if count else ", which is empty"
        raise InputError(f"{source}: {key}: '{step}' is no item of the list{wanted}")
    return int(step)


def _is_used(raw: dict[str, Any], name: str) -> bool:
    """Whether a formula has this name."""
    texts, values = list[str](), list(raw.values())
    while values:
        value = values.pop()
        if isinstance(value, dict):
            values += value.values()
        elif isinstance(value, list | tuple):
            values += value
        elif isinstance(value, str):
            texts.append(value)
    return any(re.search(rf"\b{re.escape(name)}\b", text) for text in texts)
