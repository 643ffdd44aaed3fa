"""Command lines with every kind of invalid option, and saved results that were truncated."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping

from tests.cli.broken.case import SCENE, Broken, Content
from tests.cli.broken.files import PLAIN

RESULT = "result"  # folder of a saved answer

_WRONG = {
    "--cells": ["0", "-1", "1.5", "many", "nan", "", "1000000000", "99999999999999999999"],
    "--refine": ["-1", "99", "1.5", "x", "20"],
    "--element": ["P3", "", "q1"],
    "--method": ["newton", ""],
    "--start": ["warm", ""],
    "--eps": ["0", "-1", "nan", "inf", "", "h^", "q7", "x", "__import__('os')", "1/0", "0*h", "1j", "[1]", "true"],
    "--tol": ["0", "-1", "nan", "inf", "x", ""],
    "--tol-absolute": ["0", "-1", "nan", "x"],
    "--set": ["", "cells", "cells=", "nope.c=1", "define.nope=1", "define.c=sine(x)", "mesh.cells=many", "mesh=1",
              "title.a=1", "mesh.cells.a=1", "=1", "define.c=__import__('os')", "mesh.x=[0, nan]",
              "effects.load={a = {b = 1}}", "boundary=1", "boundary.7.value=1", "boundary.x.value=1",
              "mesh.x.2=1", "effects.load.steel.a=1", ".=1", "effects={}"],
    "--log": ["LOUD", ""],
    "--nonsense": ["1"],
}  # fmt: skip
_VARIED = ["", "cells", "cells=", "cells=1,x", "cells=0..4", "cells=a..b", "cells=4..8:0", "cells=4..8:x", "cels=1,2",
           "=1,2", "cells=1..2..3", "cells=-4..4", "eps=0,1", "eps=1..nan", "eps=inf..1", "cells=1..9:1000000000",
           "method=penalty,newton", "define.nope=1,2", "cells=1,,2", "define.c=1e308..1e-308:2000000"]  # fmt: skip


_INCOMPLETE = b'[mesh]\nshape = "rectangle"\ncells = 4\n[effects]\nload = "2*q"\n'
_SETTINGS = {
    "define.q=3": "has no stiffness",
    "effects.tension=1; define.q=1; define.other=2": "no 'other', and no formula uses it",
    "effects.tensoin=1; define.q=1": "did you mean 'tension'",
    "boundary.3.value=1": "'3' is no item of the list; take a number from 0 to 0",
    "boundary.first.value=1": "'first' is no item of the list",
    "boundary.0=1": "is no item of the list, which is empty",
    "effects.load.a=1": "load is no table",
    "effects=3; effects.tension=1": "effects is no table",
}
Q1 = ("--element", "Q1", "--set", "report={}", "--set", "mesh.cell=quadrilateral")
_LATER = b"""[mesh]
shape = "interval"
[effects]
tension = 1
[obstacle]
upper = "0.5 - t"
[[boundary]]
value = 0
[time]
end = 1
steps = 4
"""


def broken_options() -> Iterator[Broken]:
    """Command lines."""
    files: dict[str, Content] = {SCENE: PLAIN}
    for option, values in _WRONG.items():
        for value in values:
            # of a setting the message is about the key
            named = value.partition("=")[0].rpartition(".")[2] if "=" in value[1:] else option.strip("-")
            yield Broken(f"{option} {value!r}", [named], ("solve", SCENE, option, value), files)
    for settings, message in _SETTINGS.items():
        given = [word for setting in settings.split("; ") for word in ("--set", setting)]
        yield Broken(f"--set {settings}", [message], ("solve", SCENE, *given), {SCENE: _INCOMPLETE})
    for value in _VARIED:
        # the complaint is about the option, or about the key that it sets
        yield Broken(f"--vary {value!r}", [], ("study", SCENE, "--vary", value), files)
    yield Broken("an obstacle that meets a boundary value later", [SCENE, "[[boundary]]", "at t = 0.75"],
                 ("solve", SCENE, "--output", "out"), {SCENE: _LATER})  # fmt: skip
    budget = ("--tol", "0.1", "--budget")
    for value in ("", "x", "60", "nans", "-1s", "0s", "1 TB", "1..2s", "1e999s"):
        yield Broken(f"--budget {value!r}", ["--budget"], ("solve", SCENE, *budget, value), files)
    for what, arguments, names in [
        ("no command", ["slove"], ["slove"]),
        ("an option of no command", ["--fast"], ["--fast"]),
        ("no scene", ["solve"], ["SCENE"]),
        ("two scenes", ["solve", SCENE, SCENE], [SCENE]),
        ("an empty name", ["solve", ""], []),
        ("a name with NUL's picture", ["solve", "\u2400"], ["\u2400"]),
        ("a name of 300 characters", ["solve", "a" * 300 + ".toml"], []),
        ("no value", ["solve", SCENE, "--eps"], ["--eps"]),
        ("no list", ["study", SCENE], ["--vary"]),
        ("a key twice", ["study", SCENE, "--vary", "cells=1,2", "--vary", "cells=3"], ["--vary"]),
        ("eps of a vi", ["study", SCENE, "--vary", "eps=1,2", "--method", "vi"], ["eps cannot vary"]),
        ("eps of one vi", ["study", SCENE, "--vary", "eps=1,2", "--vary", "method=penalty,vi"], ["eps cannot vary"]),
        ("eps of nothing", ["study", SCENE, "--vary", "eps=1,2", "--set", "obstacle={}"], ["without an obstacle"]),
        ("two tolerances", ["solve", SCENE, "--tol", "0.1", "--tol-absolute", "0.1"], ["--tol"]),
        ("a budget without tolerance", ["solve", SCENE, "--budget", "60s"], ["--tol"]),
        ("a bound for Q1", ["solve", SCENE, "--bound", *Q1], ["bound", "P1 and P2 on intervals"]),
        ("a tolerance for Q1", ["solve", SCENE, "--tol", "0.1", *Q1], ["Q1"]),
        ("output into a file", ["solve", SCENE, "--output", SCENE], ["--output"]),
        ("output below a file", ["solve", SCENE, "--output", f"{SCENE}/a/b"], ["--output"]),
        ("output below /proc", ["solve", SCENE, "--output", "/proc/nowhere"], ["--output"]),
        ("output without name", ["solve", SCENE, "--output", ""], ["--output"]),
        ("JSON into a folder", ["solve", SCENE, "--json", "."], ["--json"]),
        ("JSON onto the scene", ["solve", SCENE, "--json", SCENE], ["--json", "is a scene, which would be lost"]),
        ("JSON below a file", ["solve", SCENE, "--json", f"{SCENE}/a.json"], ["--json"]),
        ("LaTeX into a folder", ["study", SCENE, "--vary", "cells=2,4", "--latex", "."], ["--latex"]),
        ("LaTeX below a file", ["study", SCENE, "--vary", "cells=2,4", "--latex", f"{SCENE}/a"], ["--latex"]),
        ("study into a file", ["study", SCENE, "--vary", "cells=2,4", "--output", SCENE], ["--output"]),
        ("explain nothing", ["explain", "none.toml"], ["none.toml"]),
        ("compare one", ["compare", "a"], ["B"]),
        ("compare nothing", ["compare", "a", "b"], ["a"]),
        ("plot nothing", ["plot", "a"], ["a"]),
        ("plot a file", ["plot", SCENE], [SCENE]),
        ("no such scene", ["scenes", "bal"], ["bal", "ball"]),
        ("no such statement", ["theory", "9.9"], ["9.9"]),
        ("theory into a file", ["theory", "3.3", "--output", SCENE], ["--output"]),
        ("demo into a file", ["demo", "--output", SCENE], ["--output"]),
    ]:
        yield Broken(f"command line: {what}", names, arguments, files)
    for petsc in (["-penalty_ksp_type", "nonsense"], ["-penalty_pc_type", "nonsense"], ["nonsense"],
                  ["-penalty_snes_type", "nonsense"], ["-penalty_ksp_max_it", "many"],
                  ["-penalty_snes_linesearch_type", "nonsense"], ["-penalty_ksp_rtol", "x"]):  # fmt: skip
        yield Broken(f"-- {' '.join(petsc)}", [petsc[-1]], ("solve", SCENE), files, petsc)


def torn_results(result: Mapping[str, bytes]) -> Iterator[Broken]:
    """A saved answer with one of its files missing, empty, torn or of another kind.

    Args:
        result: Its files.
    """
    for name in ("answer.json", "fields.h5", "scene.toml", "history.csv"):
        whole = result[name]
        for what, content in {
            "is missing": None, "is empty": b"", "is torn in its middle": whole[: len(whole) // 2],
            "holds random bytes": bytes(range(256)) * 20, "is a list": b"[1, 2]", "is a folder": os.mkdir,
        }.items():  # fmt: skip
            files: dict[str, Content] = {f"{RESULT}/{other}": kept for other, kept in result.items()}
            del files[f"{RESULT}/{name}"]
            if content is not None:
                files[f"{RESULT}/{name}"] = content
            # without a scene it is a solution of ObstacleProblem, which is drawn, but not along a line
            along = ("--along", "0,0:1,0") if (name, content) == ("scene.toml", None) else ()
            yield Broken(f"{name} {what}", [RESULT], ("plot", RESULT, *along), {RESULT: os.mkdir, **files})
