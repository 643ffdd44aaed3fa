"""Scenes with every kind of invalid value for every key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from tests.cli.broken.case import SCENE, Broken

LINES = {
    "title": '"one"',
    "u": '"height"',
    "[define] c": "0.1",
    "[mesh] shape": '"rectangle"',
    "[mesh] x": "[0, 1]",
    "[mesh] cells": "4",
    "[effects] tension": "1",
    "[effects] load": '"-10*c"',
    "[obstacle] lower": "-0.01",
    "[obstacle] upper": "0.5",
    "[[boundary]] on": '["left", "right"]',
    "[[boundary]] value": "0",
    "[report] q": '"integral(u)"',
}
"""A scene that is right, key by key."""
MOVING = {"[effects] inertia": "1", "[time] end": "1", "[time] steps": "2", "[time] start": "0"}
"""What makes it move."""

TYPES = {"true": "true", "a date": "1979-05-27", "a list": "[[1]]", "a table": "{a = {b = 1}}"}
NUMBERS = {
    "not a number": "nan",
    "infinity": "inf",
    "minus infinity": "-inf",
    "a formula cut off": '"2*(x + "',
    "two operators": '"2*^y"',
    "an assignment": '"a = 1"',
    "an unknown name": '"2*q7"',
    "an unknown function": '"sine(x)"',
    "too many arguments": '"sin(1, 2)"',
    "division by zero": '"1/0"',
    "root of a negative number": '"sqrt(-1 - x^2)"',
    "overflow": '"10^400"',
    "9^9^9^9": '"9^9^9^9"',
}
FITTING = {
    "[obstacle] lower": {"minus infinity"},
    "[obstacle] upper": {"infinity", "division by zero", "overflow", "9^9^9^9"},
    "[report] q": set(NUMBERS),
}
"""What is not wrong: an obstacle of 1e20 or beyond means that there is none, and a figure need not be finite."""
FORMULAS = {
    "an empty formula": '""',
    "a complex number": '"1j"',
    "an import": "\"__import__('os').system('true')\"",
    "an attribute": '"x.__class__"',
    "the way to all classes": '"().__class__.__bases__[0].__subclasses__()"',
    "a subscript": '"x[0]"',
    "a lambda": '"(lambda: 1)()"',
    "a comprehension": '"[a for a in (1, 2)]"',
    "a format string": "\"f'{x}'\"",
    "a walrus": '"(a := 1)"',
    "a text in a formula": "\"'a'\"",
    "a keyword argument": '"sin(x=1)"',
    "a star": '"min(*x)"',
    "a call of a call": '"sin(x)(x)"',
    "exec": "\"exec('1')\"",
    "1e5 minus signs": f'"{"-" * 100000}1"',
    "1e5 terms": f'"{"+".join(["x"] * 50000)}"',
    "900 brackets": f'"{"(" * 900}x{")" * 900}"',
    "600 nested functions": f'"{"sin(" * 390}x{")" * 390}"',
    "1000 digits": f'"{"9" * 1000}"',
    "a NUL": '"x\\u0000"',
    "a foreign minus": '"1 \\u2212 x"',
    "a line break": '"1 +\\n+ "',
}
WORDS = {"a number for a text": "7", "a list of numbers for a text": "[1, 2]"}
COUNTS = {"minus one": "-1", "a fraction": "1.5", "a text": '"many"', "infinite": "inf", "not a number": "nan",
          "2^70": str(2**70), "1e9": "1000000000"}  # fmt: skip
CHOICES = {"an unknown word": '"nonsense"', "an empty text": '""', "a number": "3"}
ENDS = {
    "without length": "[1, 1]", "one number": "[1]", "three numbers": "[0, 1, 2]", "no list": "1",
    "not a number": "[0, nan]", "infinite": "[-inf, 1]", "a place": '[0, "x"]', "too long": "[0, 1e200]",
    "too short": "[1, 1.000000000000001]",
}  # fmt: skip
KINDS: tuple[tuple[Sequence[str], Mapping[str, str]], ...] = (
    (("[define] c", "[effects] tension", "[effects] load", "[obstacle] lower", "[obstacle] upper", "[[boundary]] value",
      "[[boundary]] where", "[mesh] radius", "[exact] u", "[exact] pressure", "[report] q", "[solve] eps", "[time] end",
      "[time] start", "[time] velocity"), {**FORMULAS, **NUMBERS}),
    (("title", "u", "[mesh] file", "[exact] free", "[exact] regularity", "[time] name"), WORDS),
    (("[mesh] cells", "[mesh] refine", "[time] steps", "[time] frames"), COUNTS),
    (("[mesh] shape", "[mesh] cell", "[mesh] diagonal", "[solve] element", "[solve] method", "[solve] start",
      "[[boundary]] on", "[time] scheme"), CHOICES),
    (("[mesh] perturb",), {"negative": "-0.1", "one half": "0.5", "not a number": "nan"}),
    (("[time] tolerance",), {"negative": "-0.1", "zero": "0", "not a number": "nan"}),
    (("[mesh] x",), ENDS),
)  # fmt: skip
BESIDE: dict[str, dict[str, str | None]] = {
    "[mesh] file": {"[mesh] shape": None},
    "[mesh] radius": {"[mesh] shape": '"disk"', "[[boundary]] on": '"circle"'},
    "[[boundary]] where": {"[[boundary]] on": None},
    **{key: {"[exact] u": "0"} for key in ("[exact] pressure", "[exact] free", "[exact] regularity")},
}
"""What else such a key needs."""


def scene_text(lines: Mapping[str, str | None]) -> str:
    """TOML of keys such as "[mesh] cells"."""
    tables: dict[str, list[str]] = {"": []}
    for key, value in lines.items():
        table, _, name = key.rpartition(" ")
        if value is not None:
            tables.setdefault(table, []).append(f"{name} = {value}")
    return "".join("\n".join(([table] if table else []) + rows) + "\n" for table, rows in tables.items())


def broken_lines() -> Iterator[Broken]:
    """Every line in every way."""
    for keys, values in KINDS:
        for key in keys:
            for what, value in {**values, **TYPES}.items():
                if what not in FITTING.get(key, ()):
                    yield _with(key, value, what)
    for key, ending in (("[obstacle] lower", "csv"), ("[effects] load", "npy")):
        yield _with(key, f'{{file = "a\\u0000.{ending}"}}', "a NUL in a name", "a\\x00")
    for table in ("define", "mesh", "effects", "obstacle", "boundary", "exact", "report", "solve", "time", "nonsense"):
        for what, value in {"a number": "1", "a text": '"a"', "a list": "[1]"}.items():
            kept = {key: line for key, line in LINES.items() if f"[{table}]" not in key}
            yield Broken(f"{table} is {what}", [SCENE, table], files=_file(f"{table} = {value}\n" + scene_text(kept)))
    for table in ("define", "mesh", "effects", "obstacle", "[boundary]", "exact", "report", "solve", "time"):
        yield _with(f"[{table}] nonsense", "[]", "an unknown key")


def _with(key: str, value: str, what: str, *words: str) -> Broken:
    moving = MOVING if key.startswith("[time]") else {}
    lines = {**LINES, **moving, **BESIDE.get(key, {}), key: value}
    table, _, name = key.rpartition(" ")
    return Broken(f"{key}: {what}", [SCENE, table, name, *words], files=_file(scene_text(lines)))


def _file(text: str) -> dict[str, bytes]:
    return {SCENE: text.encode()}
