"""Kikuchi's theorems: each statement as `./obstacle theory` measures it; its numbers, its table, its exit status."""

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM, membrane
from tests.theory import show
from tests.theory.limits import approach
from tests.theory.show import conclusion, split, table
from tests.theory.statement import Finding, Found, Statement, find, statements

QUICK = ("3.23", "3.1", "digits", "Example 3")
ON_RANKS = (*QUICK, "4.3")  # the others are variants: the same solves on more meshes
# rows that hold under a further hypothesis only, or after the correction of a misprint; other statements have none
NEEDS = {"2.7": 1, "E_I": 3, "2.10": 3, "3.1": 1, "3.4*": 1, "digits": 1, "3.33": 5, "3.6": 2, "3.3": 7, "3.18": 4,
         "1*": 2, "4.1": 2, "4.3": 1}  # fmt: skip
MISPRINTS = {"3.23": 1, "3.16": 2, "3.4*": 1, "3.27": 2}


def marked(number):
    """A statement as a case of a test."""
    marks = [pytest.mark.slow] * (number not in QUICK) + [pytest.mark.variant] * (number not in ON_RANKS)
    return pytest.param(number, marks=marks)


@pytest.mark.ranks
@pytest.mark.filterwarnings("ignore::fenicsx_obstacle.PenetrationWarning")
@pytest.mark.parametrize("number", [marked(one.number) for one in statements()])
def test_statement(number):
    """No order, constant, sign or count is another than the theory says, nor under other hypotheses."""
    findings = find(number).measure(COMM).findings
    assert findings and not [finding for finding in findings if finding.verdict == "FAILS"]
    verdicts = [finding.verdict for finding in findings]
    assert verdicts.count("needs hypothesis") == NEEDS.get(number, 0)
    assert verdicts.count("misprint") == MISPRINTS.get(number, 0)


@pytest.mark.parametrize(
    "number, of",
    [("(5.5)", "3.3"), ("5.6", "4.1"), ("(5.7)", "4.2"), ("5.8", "4.3"), ("5.9", "5.1"), ("3.3", "3.3")],
)
def test_numbers(number, of):
    assert find(number).number == of


def test_rows_are_grouped_by_scene():
    """The conclusion counts all rows; each scene or pair heads its rows, in the order of their first ones."""
    quantities = ["e in h, N = 8, disk_flat, Q1", "e in h, cone", "d in h, N = 8, disk_flat, Q1", "e, the most"]
    found = [Finding("Thm 3.3", quantity, "order 1", 1.0, 1.0, "sharp") for quantity in quantities]
    assert split(quantities[0]) == ("e in h, N = 8", "disk_flat, Q1")
    assert split(quantities[3]) == (quantities[3], "")
    lines = [line.split("  ")[1:] for line in table(found).splitlines()[1:]]
    assert [line[0] or line[1] for line in lines] == [
        "disk_flat, Q1", "e in h, N = 8", "d in h, N = 8", "cone", "e in h", "e, the most",
    ]  # fmt: skip
    assert conclusion(found).startswith("Conclusion: no value contradicts the theory (4 rows): 4 with exactly")
    failed = Finding("Thm 3.3", "e", "order 1", 1.0, 0.0, "FAILS")
    assert conclusion([*found, failed]) == "Conclusion: FAILS in 1 of 5 rows."


@pytest.mark.parametrize("verdict, status", [("sharp", 0), ("misprint", 0), ("FAILS", 3)])
def test_status_of_the_command(verdict, status, monkeypatch, folder):
    """A statement that fails ends the command with status 3, wherever its row is in the table."""
    found = Found([Finding("Thm 3.3", "e", "order 1", 1.0, 1.0, one) for one in ("holds", verdict, "not sharp")], [])
    monkeypatch.setattr(show, "statements", lambda: [Statement("3.3", "A title", (), lambda _: found)])
    done = CliRunner().invoke(commands, ["theory", "--output", str(folder)], standalone_mode=False)
    assert done.return_value == status and done.exception is None


@pytest.mark.parametrize(
    "data",
    [
        {
            "mesh": {"shape": "rectangle", "diagonal": "union-jack", "cells": 16},
            "lower": "0.1 - (x - 0.4)^2 - (y - 0.5)^2",
        },
        {"mesh": {"shape": "box", "cells": 8}, "load": 10, "upper": 0.2},
        {"tension": "where(x < 0.5, 1, 10)", "load": "100*x", "upper": "0.5 + x*y"},
    ],
    ids=["curved, from below", "box", "two tensions"],
)
def test_bounds(data):
    """M-matrix: 0 <= e = u_eps - u_h <= eps max|p_eps|; on any mesh |p_eps|_I <= |p_h|_I, a(e,e) <= eps/4 |p_h|_I^2."""
    scene = membrane(**{"boundary": [{"value": 0}], **data})
    seen = approach(scene, COMM, (1e-1, 1e-3, 1e-6, 1e-9))
    assert min(seen.lowest) >= -1e-12
    assert max(seen.above) <= 1 + 1e-6
    assert max(seen.below) <= 1 + 1e-6
    assert max(seen.rise) <= 1e-12
    assert max(seen.size) <= 1 + 1e-9
    assert max(seen.work) <= 1
    assert seen.above[-1] > 0.9


def test_no_force_at_all():
    """f = 0 below g > 0: u = 0 and p = 0 at any eps, and for the inequality itself."""
    for change in ({"solve.eps": 1e-14}, {"solve.method": "successive"}, {"solve.method": "vi"}):
        answer = SolverContext(membrane(load=0, upper=0.1, boundary=[{"value": 0}]).change(change)).answer()
        assert largest(COMM, np.abs(answer.u.x.array)) < 1e-16  # the round-off of g
        assert largest(COMM, np.abs(answer.pressure.x.array)) == 0
