"""The documentation: its code runs, its commands parse, what it names is there, what there is is named."""

import contextlib
import io
import json
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from unittest import SkipTest

import click
import matplotlib
import pytest
from sybil import Sybil
from sybil.evaluators.python import PythonEvaluator
from sybil.parsers.markdown import CodeBlockParser, SkipParser

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.forms.pairs import pairs
from fenicsx_obstacle.scenes import tables
from fenicsx_obstacle.scenes.definitions import FIELDS
from fenicsx_obstacle.scenes.formulas import FUNCTIONALS, FUNCTIONS
from tests.conftest import CLEAN, DEMOS, slow_except

pytestmark = pytest.mark.serial

ROOT = DEMOS.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")),
         *sorted((ROOT / "docs" / "tables").glob("*.md"))]  # fmt: skip
OF_LAUNCHER = {"test", "pytest", "docs", "coverage"}  # commands that the command line has not
LAUNCHER = """#!/bin/bash
ranks=1
if [ "$1" = --ranks ]; then ranks=$2; shift 2; fi
[ "$ranks" = 1 ] || exec mpirun -n "$ranks" --oversubscribe --bind-to none "{python}" -m fenicsx_obstacle "$@"
exec "{python}" -m fenicsx_obstacle "$@"
"""


def inline(page):
    """What stands between single backticks outside of blocks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"`([^`\n]+)`", text)


def run_shell(example):
    """A block of commands, each of which has to succeed."""
    environment = {**CLEAN, "PATH": f"{Path.cwd() / 'bin'}:{CLEAN['PATH']}"}
    done = subprocess.run(["bash", "-euo", "pipefail", "-c", example.parsed], env=environment, capture_output=True,
                          text=True, timeout=150, check=False)  # fmt: skip
    assert done.returncode == 0, f"{example.path}:{example.line}: {done.stdout}{done.stderr}"


def write_scene(example):
    """A scene, saved under the name in its first line, if it has one."""
    tomllib.loads(example.parsed)
    name = re.match(r"# ([\w-]+\.toml)\n", example.parsed)
    if name:
        Path(name[1]).write_text(example.parsed)


def run_python(example):
    """Python that is run, or saved under the name in its first line."""
    name = re.match(r"# (\w+\.py)\n", example.parsed)
    if name:
        Path(name[1]).write_text(example.parsed)
        return
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        PythonEvaluator()(example)
    example.namespace["_printed"] = printed.getvalue()


def compare_output(example):
    """A text block below Python is what that Python prints."""
    assert example.parsed == example.namespace["_printed"]


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder like a clone, with a ./obstacle that sets nothing up."""
    for name in ("benchmarks", "demos", "docs", "fenicsx_obstacle", "pyproject.toml", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "bin").mkdir()
    for file in ("obstacle", "bin/fenicsx-obstacle"):
        (tmp_path / file).write_text(LAUNCHER.format(python=sys.executable))
        (tmp_path / file).chmod(0o755)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    return tmp_path


WITH_BLOCKS = [page for page in PAGES if "```" in page.read_text()]
LONG = {"README", "accuracy", "python", "results", "start"}  # pages whose blocks take seconds


@pytest.mark.parametrize(
    "page",
    slow_except(WITH_BLOCKS, *(page for page in WITH_BLOCKS if page.stem not in LONG)),
    ids=lambda page: page.stem,
)
def test_blocks_run(page, workplace):
    """Blocks of a page run in order; one that is skipped says why."""
    evaluators = {"python": run_python, "text": compare_output, "sh": run_shell, "toml": write_scene}
    parsers = [CodeBlockParser(language, evaluator) for language, evaluator in evaluators.items()]
    for example in Sybil([*parsers, SkipParser()]).parse(page).examples():
        with contextlib.suppress(SkipTest):
            example.evaluate()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_parse(page):
    """Commands in the text, and in blocks that are not run, are commands with options that exist."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for line in re.split(r"\n|&&|\|\||;", "\n".join(blocks + inline(page))):
        found = re.match(r"\s*(?:\./obstacle|\S*fenicsx-obstacle)(?: --ranks \d+)? ([a-z].*)", line.replace("\\|", "|"))
        if found is None:
            continue
        name, *arguments = shlex.split(re.split(r" [|>] | -- ", found[1])[0], comments=True)
        if name in OF_LAUNCHER or name not in commands.commands:
            assert name in OF_LAUNCHER, line
            continue
        if "--plugin" in arguments:  # its file is not there
            at = arguments.index("--plugin")
            del arguments[at : at + 2]
        try:
            commands.commands[name].make_context(name, arguments)
        except click.MissingParameter:  # `./obstacle solve` in a sentence
            assert not arguments, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_is_named_is_there(page):
    """Files of the project, and tests, that pages name."""
    tests = "\n".join(file.read_text() for file in (ROOT / "tests").glob("*.py"))
    for words in inline(page):
        for path in re.findall(r"[\w./-]+/[\w.-]+\.(?:py|toml|md)\b", words):
            places = (ROOT, ROOT / "fenicsx_obstacle", ROOT / "docs")
            if path.startswith("out/"):
                continue
            assert any((place / path).exists() for place in places), f"{page.name}: {path}"
        for test in re.findall(r"(?<![\w/])test_\w+(?!\.py)\b", words):
            assert f"def {test}(" in tests, f"{page.name}: {test}"


def test_numbers_are_measured():
    """Tables and numbers of the pages are those of docs/measured."""
    assert runpy.run_path(str(ROOT / "docs" / "_extensions" / "measured.py"))["faults"]() == []


def described(page):
    """Words in code of a page, ways of a dotted name apart."""
    return {word for words in inline(ROOT / "docs" / page) for word in re.findall(r"\w[\w-]*", words)}


def test_scenes_are_described():
    """docs/scenes.md has each table, key and word of a scene; docs/effects.md each effect."""
    words = described("scenes.md")
    text = (ROOT / "docs" / "scenes.md").read_text()
    assert all(f"## [{name}]" in text or f"## [[{name}]]" in text or name in words
               for name in tables.Tables.__struct_fields__)  # fmt: skip
    for table in vars(tables).values():
        if isinstance(table, type) and table.__name__.endswith("Table"):
            assert set(table.__struct_encode_fields__) <= words, table.__name__
    assert {*known(), *known("boundary"), *FUNCTIONS, *FUNCTIONALS, *FIELDS} <= words
    assert set(pairs()) <= words
    names = (ROOT / "docs" / "effects.md").read_text()
    assert all(key in names for key in known() | known("boundary"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"), [("ball", {"tol": 0.5}), ("disk", {"cells": 8, "method": "successive"}),
                          ("pollutant", {"cells": 8}), ("put", {"cells": 8})],
)  # fmt: skip
def test_results_are_described(name, options):
    """docs/results.md has each field of answer.json."""
    record = solve(Scene.read(DEMOS / f"{name}.toml"), **options).record
    kept = {key: value for key, value in record.items() if key not in ("report", "versions")}
    assert set(re.findall(r'"(\w+)":', json.dumps(kept))) <= described("results.md")
