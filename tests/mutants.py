"""Semantic mutants: one wrong line at a time, and whether the tests that cover it see it.

    .venv/bin/python tests/mutants.py --check          every old text stands once in its file
    .venv/bin/python tests/mutants.py --only 3,17      run these mutants
    .venv/bin/python tests/mutants.py --layer bounds   those of a layer
    .venv/bin/python tests/mutants.py                  all, for half an hour on one core
    .venv/bin/python tests/mutants.py --results FILE   the same; run again, it goes on with those not in FILE

The mutants are in mutants.toml. Each runs in a copy of the checkout, with `pytest -x`, until a test fails. The table at
the end has the share found by layer. A mutant that no test sees is a gap, or an equivalent program: then the comment
above its line says why.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from fenicsx_obstacle.launcher import environment, mpirun

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("fenicsx_obstacle", "tests", "demos", "benchmarks", "docs", "pyproject.toml", "README.md", "obstacle")
LIMIT = 300  # seconds for the tests of one mutant; a mutant that hangs is found


@dataclass(frozen=True)
class Mutant:
    """A wrong line.

    Attributes:
        number: In the list.
        layer: Part of the package.
        file: Relative to the package.
        old: The text that is replaced; it stands once in the file.
        new: The wrong text.
        tests: Files of tests that cover it, or single tests of them.
        ranks: On how many they run.
    """

    number: int
    layer: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    ranks: int = 1

    @property
    def path(self) -> str:
        return f"fenicsx_obstacle/{self.file}"

    @property
    def key(self) -> str:
        """It in a file of results: no number, which changes with the list."""
        return f"{self.file}: {self.old} -> {self.new}"


def mutants() -> list[Mutant]:
    """The list."""
    layers = tomllib.loads((ROOT / "tests" / "mutants.toml").read_text())["layer"]
    rows = [(layer, *row, *(layer["tests"], 1)[len(row) - 3 :]) for layer in layers for row in layer["mutants"]]
    return [
        Mutant(number, layer["name"], file, old, new, tuple(_path(name) for name in tests.split()), ranks)
        for number, (layer, file, old, new, tests, ranks) in enumerate(rows, 1)
    ]


def _path(name: str) -> str:
    """The argument of pytest for a file of tests, `test_a`, or one test, `test_a::test_b`."""
    file, *one = name.split("::")
    return "::".join([f"tests/{file}.py", *one])


def misplaced(every: list[Mutant]) -> list[str]:
    """Mutants whose text has moved or is not unique, and tests that do not exist."""
    found = []
    for one in every:
        file = ROOT / one.path
        count = file.read_text().count(one.old) if file.exists() else 0
        if count != 1:
            found.append(f"{one.number}: {one.file}: {one.old!r} stands there {count} times")
        found += [f"{one.number}: no {test}" for test in one.tests if not _stands(test)]
    return found


def _stands(test: str) -> bool:
    """Whether a file of tests, or a test in it, exists."""
    name, *one = test.split("::")
    file = ROOT / name
    return file.exists() and all(f"def {function}(" in file.read_text() for function in one)


def seen(one: Mutant, scratch: Path) -> tuple[str, str]:
    """'found', 'missed' or 'hangs', and the test that failed.

    Raises:
        RuntimeError: If no test ran.
    """
    file = scratch / one.path
    right = file.read_text()
    file.write_text(right.replace(one.old, one.new))
    named = any("::" in test for test in one.tests)  # such a test runs, slow or not
    quick = () if named else ("-m", "not slow")
    command = [sys.executable, "-m", "pytest", "-x", *quick, *one.tests]
    if one.ranks > 1:
        command = [*mpirun(one.ranks), *command]
    changed = {**environment(), "PYTHONPATH": str(scratch), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=scratch, env=changed, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return "hangs", ""
    finally:
        file.write_text(right)
    if done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED:
        raise RuntimeError(f"{one.number}: no test ran of {', '.join(one.tests)}")
    if done.returncode == 0:
        return "missed", ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "found", failed[0][:100] if failed else done.stdout[-200:]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="Only whether all texts are there.")
    parser.add_argument("--layer")
    parser.add_argument("--only", default="", help="Numbers, such as 3,17.")
    parser.add_argument("--results", type=Path, help="JSON: each verdict is kept there, and not found again.")
    given = parser.parse_args()
    every = mutants()
    wrong = misplaced(every)
    print("\n".join(wrong) or f"{len(every)} mutants, all in their places")
    if given.check or wrong:
        return 1 if wrong else 0
    numbers = {int(text) for text in given.only.split(",") if text}
    chosen = [one for one in every if given.layer in (None, one.layer) and (not numbers or one.number in numbers)]
    verdicts: dict[str, str] = {}
    if given.results is not None and given.results.exists():
        verdicts = json.loads(given.results.read_text())
    with tempfile.TemporaryDirectory(prefix="mutants") as folder:
        scratch = Path(folder)
        for name in COPIED:
            source = ROOT / name
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, scratch / name)
        for one in chosen:
            if one.key in verdicts:
                continue
            start = time.monotonic()
            verdicts[one.key], test = seen(one, scratch)
            print(f"{one.number:3} {one.layer:10} {verdicts[one.key]:7} {time.monotonic() - start:5.0f} s  "
                  f"{one.file}: {one.new!r} {test}", flush=True)  # fmt: skip
            if given.results is not None:
                given.results.write_text(json.dumps(verdicts, indent=1))
    counts = Counter((one.layer, verdicts[one.key]) for one in chosen)
    for layer in dict.fromkeys(one.layer for one in chosen):
        total = sum(count for (name, _), count in counts.items() if name == layer)
        print(f"{layer:10} {total - counts[layer, 'missed']} of {total} found")
    return 1 if any(verdict == "missed" for _, verdict in counts) else 0


if __name__ == "__main__":
    sys.exit(main())
