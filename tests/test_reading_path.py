"""docs/contributing.md: the calls from `solve()` to the penalty, which are the same for all problems."""

import re
import sys
import traceback

import pytest

from fenicsx_obstacle.checkout import ROOT
from tests.helpers import Membrane
from tests.mutants import misplaced, mutants


def test_the_calls_lead_to_the_penalty():
    """In a solve, the last call of the table is reached through all others, in their order."""
    text = (ROOT / "docs" / "contributing.md").read_text()
    table = text.split("## From `solve()` to the penalty")[1].split("## ")[0]
    wanted = [name.split(".") for name in re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)]
    problem, found = Membrane(cells=40, load=-8.0).problem(lower=-0.3), []

    def watch(frame, event, _):
        if event == "call" and frame.f_code.co_name == "_excess":
            found.append([(one.f_code.co_filename, one.f_code.co_name) for one, _ in traceback.walk_stack(frame)][::-1])

    sys.setprofile(watch)
    try:
        problem.solve()
    finally:
        sys.setprofile(None)

    def contains(stack):
        rest = iter(stack)  # each call is sought behind the one before
        return all(
            any(path.endswith("/".join(place[:2]) + ".py") and place[-1] == name for path, name in rest)
            for place in wanted
        )

    assert len(wanted) == 10
    assert any(contains(stack) for stack in found)


@pytest.mark.serial
def test_mutants_are_in_their_places():
    """tests/mutants.py: every line that it makes wrong stands in the package once."""
    assert misplaced(mutants()) == []
