"""Semantic mutants: one wrong line at a time, and whether the tests that cover it see it.

    .venv/bin/python tests/mutants.py --check          every old text stands once in its file
    .venv/bin/python tests/mutants.py --only 3,17      run these mutants
    .venv/bin/python tests/mutants.py --layer bounds   those of a layer
    .venv/bin/python tests/mutants.py                  all, for some hours on one core

The mutants are in mutants.toml. Each runs in a copy of the checkout, with `pytest -x` on one rank, until a test fails.
The table at the end has the share found by layer. A mutant that no test sees is a gap, or an equivalent program: its
line says which where that is known.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("fenicsx_obstacle", "tests", "demos", "benchmarks", "docs", "pyproject.toml", "README.md", "obstacle")
LIMIT = 900  # seconds for the tests of one mutant; a mutant that hangs is found


@dataclass(frozen=True)
class Mutant:
    """A wrong line.

    Attributes:
        number: In the list.
        layer: Part of the package.
        file: Relative to the package.
        old: The text that is replaced; it stands once in the file.
        new: The wrong text.
        tests: Files of tests, and options of pytest, that cover it.
    """

    number: int
    layer: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def path(self) -> str:
        return f"fenicsx_obstacle/{self.file}"


def mutants() -> list[Mutant]:
    """The list."""
    layers = tomllib.loads((ROOT / "tests" / "mutants.toml").read_text())["layer"]
    rows = [(layer, row) for layer in layers for row in layer["mutants"]]
    return [
        Mutant(number, layer["name"], row[0], row[1], row[2], tuple(f"tests/{name}.py" for name in (
            row[3].split() if len(row) > 3 else layer["tests"].split())))
        for number, (layer, row) in enumerate(rows, 1)
    ]  # fmt: skip


def misplaced(every: list[Mutant]) -> list[str]:
    """Mutants whose text has moved or is not unique, and tests that do not exist."""
    found = []
    for one in every:
        file = ROOT / one.path
        count = file.read_text().count(one.old) if file.exists() else 0
        if count != 1:
            found.append(f"{one.number}: {one.file}: {one.old!r} stands there {count} times")
        found += [f"{one.number}: no {test}" for test in one.tests if not (ROOT / test).exists()]
    return found


def seen(one: Mutant, scratch: Path) -> tuple[str, str]:
    """'found', 'missed' or 'hangs', and the test that failed."""
    file = scratch / one.path
    right = file.read_text()
    file.write_text(right.replace(one.old, one.new))
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", *one.tests]
    environment = {**os.environ, "PYTHONPATH": str(scratch), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=scratch, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return "hangs", ""
    finally:
        file.write_text(right)
    if done.returncode == 0:
        return "missed", ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "found", failed[0][:100] if failed else done.stdout[-200:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="Only whether all texts are there.")
    parser.add_argument("--layer")
    parser.add_argument("--only", default="", help="Numbers, such as 3,17.")
    given = parser.parse_args()
    every = mutants()
    wrong = misplaced(every)
    print("\n".join(wrong) or f"{len(every)} mutants, all in their places")
    if given.check or wrong:
        return 1 if wrong else 0
    numbers = {int(text) for text in given.only.split(",") if text}
    chosen = [one for one in every if given.layer in (None, one.layer) and (not numbers or one.number in numbers)]
    counts: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        scratch = Path(folder)
        for name in COPIED:
            source = ROOT / name
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, scratch / name)
        for one in chosen:
            start = time.monotonic()
            verdict, test = seen(one, scratch)
            counts[one.layer, verdict] += 1
            print(f"{one.number:3} {one.layer:10} {verdict:7} {time.monotonic() - start:5.0f} s  "
                  f"{one.file}: {one.new!r} {test}", flush=True)  # fmt: skip
    for layer in dict.fromkeys(one.layer for one in chosen):
        total = sum(count for (name, _), count in counts.items() if name == layer)
        print(f"{layer:10} {total - counts[layer, 'missed']} of {total} found")
    return 1 if any(verdict == "missed" for _, verdict in counts) else 0


if __name__ == "__main__":
    sys.exit(main())
