"""Options that commands share; parsing of values, lists of values and settings."""

from __future__ import annotations

import math
import re
import sys
import tomllib
from collections.abc import Callable
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import click

from fenicsx_obstacle.console import start_log
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import pairs

MOST = 1000  # values of one key
_ELEMENTS = " or ".join(", ".join(pairs()).rsplit(", ", 1))
CHANGES = ("set", "cells", "refine", "element", "method", "start", "eps")  # of the scene


class Place(click.Path):
    """A file or folder; an empty name, such as that of an unset shell variable, is an error."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("an empty name", param, ctx)
        return super().convert(value, param, ctx)


def _load_plugins(_context: click.Context, _parameter: click.Parameter, files: tuple[str, ...]) -> None:
    from fenicsx_obstacle.effects.plugin import load_plugin

    for file in files:
        load_plugin(file)


def options(*names: str) -> Callable[[Any], Any]:
    """The shared options of these names, as one decorator."""
    shared = {
        "cells": click.option("--cells", type=int, metavar="N", help="Cells along x, of shapes.  [32]"),
        "refine": click.option("--refine", type=int, metavar="N", help="Number of uniform refinements.  [0]"),
        "element": click.option(
            "--element",
            metavar="NAME",
            help=f"Pair of spaces and rule: {_ELEMENTS}.  [P1 or Q1, by the cells]",
        ),
        "method": click.option("--method", metavar="NAME", help="penalty, successive or vi.  [penalty]"),
        "start": click.option("--start", metavar="NAME", help="nested (from coarse meshes) or cold.  [nested]"),
        "eps": click.option("--eps", metavar="E", help="Penalty parameter: auto, a number, or a formula in h.  [auto]"),
        "set": click.option(
            "--set", "set_", multiple=True, metavar="KEY=VALUE", help="Change a key of the scene: effects.load=-2."
        ),
        "output": click.option("--output", type=Place(), metavar="DIR", help="Folder for results.  [in out/SCENE]"),
        "json": click.option(
            "--json", "json_file", metavar="FILE", help="Write the values as lines of JSON; - is standard output."
        ),
        "yardstick": click.option("--yardstick", is_flag=True, help="Also time a linear Poisson solve, the baseline."),
        "plugin": click.option(
            "--plugin",
            multiple=True,
            metavar="FILE",
            callback=_load_plugins,
            expose_value=False,
            is_eager=True,
            help="Python file with effects of your own (docs/effects.md).",
        ),
        "seed": click.option("--seed", type=click.IntRange(0), metavar="S", help="Seed of the random scenes.  [1]"),
        "quiet": click.option("--quiet", is_flag=True, help="Errors only."),
        "log": click.option(
            "--log",
            type=click.Choice(["DEBUG", "INFO", "WARNING", "ERROR"], case_sensitive=False),
            metavar="LEVEL",
            callback=lambda _context, _parameter, level: start_log(level),
            expose_value=False,
            help="Log with rank and time: DEBUG, INFO, WARNING or ERROR.",
        ),
    }

    def decorate(command: Any) -> Any:
        for name in reversed(names):
            command = shared[name](command)
        return command

    return decorate


def values_of(text: str, key: str) -> list[Any]:
    """The values of a list A,B,C or a range A..B or A..B:N.

    Raises:
        InputError: If it is neither.
    """
    match = re.fullmatch(r"(.+?)\.\.(.+?)(?::(\d+))?", text)
    if match is None:
        return [_value(part) for part in _elements(text)]
    first, last = _value(match[1]), _value(match[2])
    if not all(isinstance(end, int | float) and 0 < end <= sys.float_info.max for end in (first, last)):
        raise InputError(f"--vary {key}={text}: the ends of a range are positive numbers; give a list A,B,C otherwise")
    whole = isinstance(first, int) and isinstance(last, int)
    if match[3] is not None:
        count = int(match[3])
        if not 1 <= count <= MOST:
            raise InputError(f"--vary {key}={text}: 1 to {MOST} values, not {match[3]}")
        ends, intervals = (math.log(first), math.log(last)), max(count - 1, 1)
        steps = [first, *(math.exp(ends[0] + (ends[1] - ends[0]) * i / intervals) for i in range(1, count - 1)), last]
        del steps[count:]
    else:
        factor = 10.0 if key in ("eps", "solve.eps") else 2.0
        ratio = factor if last >= first else 1 / factor
        steps = [float(first)]
        while (steps[-1] * ratio - last) * (ratio - 1) <= 1e-9 * last:
            steps.append(steps[-1] * ratio)
    # eps by tens: 1e-3 and not 1.0000000000000002e-3
    return [round(step) if whole else float(f"{step:.12g}") for step in steps]


def _elements(text: str) -> list[str]:
    """Split at the commas outside brackets."""
    depths = accumulate({"(": 1, "[": 1, ")": -1, "]": -1}.get(letter, 0) for letter in text)
    commas = [i for i, depth in enumerate(depths) if depth == 0 and text[i] == ","]
    return [text[start + 1 : end] for start, end in pairwise([-1, *commas, len(text)])]


def named(item: str, option: str, wanted: str) -> tuple[str, str]:
    """What stands on both sides of the first = of a text.

    Raises:
        InputError: If one of them is missing: what was wanted.
    """
    key, _, text = (part.strip() for part in item.partition("="))
    if not (key and text):
        raise InputError(f"{option} {item}: expected {wanted}")
    return key, text


def varied(item: str) -> tuple[str, list[Any]]:
    """Key and values of KEY=LIST.

    Raises:
        InputError: If it is not.
    """
    key, text = named(item, "--vary", "KEY=LIST, such as cells=16..128")
    return key, values_of(text, key)


def interval(item: str) -> tuple[str, tuple[float, float]]:
    """Key and ends of KEY=A..B.

    Raises:
        InputError: If it is not.
    """
    match = re.fullmatch(r"\s*([^=\s]+)\s*=\s*(.+?)\.\.(.+)", item)
    ends = [] if match is None else [_value(match[2]), _value(match[3])]
    if match is None or not all(isinstance(end, int | float) for end in ends):
        raise InputError(f"--vary {item}: expected KEY=A..B, the ends of the interval to search, such as gap=0..0.2")
    return match[1], (float(ends[0]), float(ends[1]))


def _value(text: str) -> Any:
    """A number or list as TOML reads it, otherwise the text itself, such as a formula."""
    for read in (int, float, _toml):
        try:
            return read(text)
        except ValueError:
            continue
    return text.strip()


def _toml(text: str) -> Any:
    """One value of TOML; between brackets a comment, or a second key, is none."""
    values = tomllib.loads(f"v = [{text}, 0]")["v"]
    if len(values) != 2:
        raise ValueError("not one value")
    return values[0]


def typed(given: dict[str, Any]) -> dict[str, Any]:
    """Options by name, with those of --set by their dotted keys.

    Raises:
        InputError: If a --set is not KEY=VALUE.
    """
    settings = [named(item, "--set", "KEY=VALUE, such as define.ecc=0.9") for item in given.pop("set_", ())]
    changes = {key: _value(text) for key, text in settings}
    if isinstance(given.get("eps"), str):
        given["eps"] = _value(given["eps"])
    return {**given, **changes}


def along_text(text: str) -> tuple[list[float], list[float]]:
    """The ends of a line as the command `plot` takes them: "x0,y0:x1,y1".

    Raises:
        InputError: If the text is of another form.
    """
    try:
        start, end = ([float(word) for word in part.split(",")] for part in text.split(":"))
    except ValueError:
        raise InputError(f"--along {text}: expected two points, such as 0,0.5:1,0.5") from None
    return start, end
