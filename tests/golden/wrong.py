"""100 wrong inputs: exit status and the first line of the message."""

from __future__ import annotations

from pathlib import Path

from cases import ALL, COMM, ONE, Values, add
from commands import invoke, place

SCENE = '[mesh]\nshape = "rectangle"\ncells = 6\n[effects]\ntension = 1\nload = -4\n[obstacle]\nlower = -0.1\n' \
        "[[boundary]]\nvalue = 0\n"  # fmt: skip
OPTIONS = [
    "--cells 0", "--cells -1", "--cells 1.5", "--cells many", "--cells 99999999999999999999", "--refine -1",
    "--refine 99", "--refine x", "--element P3", "--element q1", "--method newton", "--start warm",
    "--eps 0", "--eps -1", "--eps nan", "--eps inf", "--eps h^", "--eps q7", "--eps 1/0", "--eps __import__('os')",
    "--eps 1e-40", "--tol 0", "--tol -1", "--tol nan", "--tol x", "--tol-absolute -1", "--tol 0.1 --tol-absolute 0.1",
    "--budget 60s", "--tol 0.1 --budget 60", "--tol 0.1 --budget x", "--of force", "--tol 0.1 --of nothing",
    "--tol 0.1 --uncertainty", "--restart FOLDER", "--set cells", "--set nope.c=1", "--set mesh.cells=many",
    "--set effects.load=sine(x)", "--set mesh.x=[0,nan]", "--set boundary.7.value=1", "--set effects={}", "--log LOUD",
    "--nonsense 1", "--bound --element Q1", "--tol 0.1 --element Q2", "--plugin FOLDER/none.py",
    "--output FOLDER/one.toml",
]  # fmt: skip
LINES = [
    "solve", "slove", "--fast", "solve FOLDER/none.toml", "solve FOLDER", "solve nothing", "solve bal", "study ball",
    "study ball --vary cells", "study ball --vary cells=1,x", "study ball --vary cels=1,2",
    "study ball --vary cells=4..8:0", "study ball --vary eps=0,1", "study ball --vary eps=1,2 --method vi",
    "study ball --vary cells=1,2 --vary cells=3",
    "find ball --vary cells=1..2", "find ball --vary define.s=0.5..0.9 --target force",
    "find ball --vary define.s=0.8..0.9 --target nothing=1", "find ball --vary define.s=0.8..0.9 --target force=1e9",
    "compare FOLDER FOLDER", "compare FOLDER/none FOLDER", "plot FOLDER", "plot FOLDER/none", "scenes nothing",
    "theory 99", "theory x", "hard nothng", "hard --truths", "explain FOLDER/none.toml", "explain ball --of force",
    "cost FOLDER/body.toml --budget 1s", "solve FOLDER/body.toml --bound", "solve FOLDER/body.toml --tol 0.1",
]  # fmt: skip
TEXTS = {  # old and new text of the scene
    "unknown-table": ("[effects]", "[efects]"),
    "unknown-key": ("cells = 6", "cels = 6"),
    "unknown-effect": ("load = -4", "laod = -4"),
    "unknown-shape": ('"rectangle"', '"rectangel"'),
    "no-stiffness": ("tension = 1\n", ""),
    "two-stiffnesses": ("tension = 1\n", "tension = 1\nlarge_slope = 1\n"),
    "negative-tension": ("tension = 1", "tension = -1"),
    "tension-negative-somewhere": ("tension = 1", 'tension = "x - 0.5"'),
    "not-finite": ("load = -4", 'load = "1/(x - x)"'),
    "unknown-name": ("load = -4", 'load = "-4*q"'),
    "syntax": ("load = -4", 'load = "-4*"'),
    "toml": ("load = -4", "load = "),
    "crossing": ("lower = -0.1", "lower = 0.1\nupper = 0"),
    "above-boundary": ("lower = -0.1", "lower = 0.1"),
    "flying": ("value = 0", "flux = 1"),
    "no-support": ("[[boundary]]\nvalue = 0", "[[boundary]]\nflux = 9"),
    "side": ("value = 0", 'on = "letf"\nvalue = 0'),
    "value-and-flux": ("value = 0", "value = 0\nflux = 1"),
    "rate-without-time": ("load = -4", "load = -4\nrate = 1"),
    "report-name": ("[[boundary]]", '[report]\nx = "integral(p)"\n[[boundary]]'),
    "report-formula": ("[[boundary]]", '[report]\nforce = "integral(q)"\n[[boundary]]'),
    "define-name": ("[effects]", '[define]\nsin = 1\n[effects]'),
    "matrix": ("tension = 1", "tension = [[1, 2], [2, 1]]"),
    "not-symmetric": ("tension = 1", "tension = [[1, 0.5], [0, 1]]"),
    "mesh-file": ('shape = "rectangle"\ncells = 6', 'file = "none.msh"'),
    "mesh-both": ("cells = 6", 'cells = 6\nfile = "none.msh"'),
    "data-file": ("lower = -0.1", 'lower = {file = "none.csv"}'),
    "large-foundation": ("load = -4", "load = -4\nfoundation = -1"),
    "power": ("tension = 1", "power_law = {exponent = 9}"),
}  # fmt: skip


def wrong(name: str, line: str, text: str = SCENE, ranks: tuple[int, ...] = ONE) -> None:
    def run(folder: Path) -> Values:
        place(folder)
        if COMM.rank == 0:
            (folder / "wrong.toml").write_text(text)
        COMM.Barrier()
        arguments = [word.replace("FOLDER", str(folder)) for word in line.split()]
        given = (
            []
            if "--output" in line or line.split()[0] not in ("solve", "study", "find")
            else ["--output", str(folder / "out")]
        )
        found = invoke([*arguments, *given], folder)
        return {"status": found["status"], "err": found["err"][:1], "out": found["out"][:1]}

    add(f"wrong/{name}", run, ranks)


for number, option in enumerate(OPTIONS):
    wrong(option, f"solve FOLDER/wrong.toml {option}", ranks=ALL if number % 5 == 0 else ONE)
for number, line in enumerate(LINES):
    wrong(line.replace("FOLDER", "F"), line, ranks=ALL if number % 5 == 4 else ONE)
for name, (old, new) in TEXTS.items():
    assert old in SCENE, old
    wrong(f"scene-{name}", "solve FOLDER/wrong.toml", SCENE.replace(old, new), ranks=ALL)
