"""Kikuchi's theorems: each statement as `./obstacle theory` measures it; its numbers, its table, its exit status."""

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle.cli import commands
from tests.conftest import COMM
from tests.theory import algebra, show
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


def test_kite_table():
    """(3.33): .996 .978 .928 .773 .162 for t = .1 .2 .3 .4 .49."""
    found = [finding.observed for finding in algebra.kites(COMM).findings[1:]]
    assert np.allclose(found, [0.996, 0.978, 0.928, 0.773, 0.162], atol=1e-3)


@pytest.mark.parametrize(
    "number, of", [("(5.5)", "3.3"), ("5.6", "4.1"), ("(5.7)", "4.2"), ("5.8", "4.3"), ("5.9", "5.1"), ("3.3", "3.3")]
)
def test_numbers(number, of):
    assert find(number).number == of


@pytest.mark.parametrize("verdict, status", [("sharp", 0), ("misprint", 0), ("FAILS", 3)])
def test_status_of_the_command(verdict, status, monkeypatch, folder):
    """A statement that fails ends the command with status 3, wherever its row is in the table."""
    found = Found([Finding("Thm 3.3", "e", "order 1", 1.0, 1.0, one) for one in ("holds", verdict, "not sharp")], [])
    monkeypatch.setattr(show, "statements", lambda: [Statement("3.3", "A title", (), lambda _: found)])
    done = CliRunner().invoke(commands, ["theory", "--output", str(folder)], standalone_mode=False)
    assert done.return_value == status and done.exception is None
    said = COMM.bcast(done.output)
    assert ("Conclusion: FAILS in 1 of 3 rows." in said) == (verdict == "FAILS")
    assert ("Conclusion: no value contradicts the theory (3 rows)" in said) == (verdict != "FAILS")
