"""docs/contributing.md: the calls from `solve()` to the penalty, which are the same for all problems."""

import re
import sys
import traceback

import pytest

from fenicsx_obstacle.checkout import ROOT
from tests.helpers import Membrane
from tests.mutants import misplaced, mutants


def documented():
    """The calls of the table, the first that of the user."""
    text = (ROOT / "docs" / "contributing.md").read_text()
    table = text.split("## From `solve()` to the penalty")[1].split("## ")[0]
    return re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)


def test_the_calls_lead_to_the_penalty():
    """In a solve, the last call of the table is reached through all others, in their order."""
    wanted, found = documented(), []
    problem = Membrane(cells=40, load=-8.0).problem(lower=-0.3)

    def watch(frame, event, _):
        if event == "call" and frame.f_code.co_name == "_excess":
            found.append(stack_of(frame))

    sys.setprofile(watch)
    try:
        problem.solve()
    finally:
        sys.setprofile(None)
    names = [name.rpartition(".")[2] for name in wanted]
    files = [file_of(name) for name in wanted]
    assert len(wanted) == 10
    assert any(contains(stack, list(zip(files, names, strict=True))) for stack in found)


def file_of(name):
    """The module of a dotted name, as a path."""
    parts = name.split(".")
    return "/".join(parts[:2]) + ".py"


def stack_of(frame):
    """Files and functions that have called, the first caller first."""
    return [(one.f_code.co_filename, one.f_code.co_name) for one, _ in traceback.walk_stack(frame)][::-1]


def contains(stack, wanted):
    """Whether the wanted calls are in the stack, in their order."""
    rest = iter(stack)
    return all(any(path.endswith(file) and name == here for path, here in rest) for file, name in wanted)


@pytest.mark.serial
def test_mutants_are_in_their_places():
    """tests/mutants.py: every line that it makes wrong stands in the package once."""
    assert misplaced(mutants()) == []
