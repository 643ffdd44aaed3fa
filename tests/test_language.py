"""Plain technical English: words that readers had to decode do not come back, neither in pages nor in code."""

import re
from pathlib import Path
from typing import NamedTuple

import click
import pytest

from fenicsx_obstacle.cli import commands

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parent.parent
CATALOGUE = ROOT / "fenicsx_obstacle" / "catalogue"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs").glob("kikuchi*.py")),
    *sorted(path for path in (ROOT / "demos").iterdir() if path.suffix in (".md", ".py", ".toml")),
    *sorted(CATALOGUE.glob("*.toml")),
]
CODE = sorted((ROOT / "fenicsx_obstacle").rglob("*.py"))


class Word(NamedTuple):
    """A pattern of words, what to write instead, and pages and modules that may have it, each with a reason."""

    pattern: str
    instead: str
    exceptions: dict[str, str] = {}  # noqa: RUF012


EVERYWHERE = [
    Word(r"\b(the house|floors|the way through)\b", "package structure, modules, layers"),
    Word(r"\bWorkbench\b", "solver context"),
    Word(r"\bharden(s|ed)?\b", "continuation in eps"),
    Word(r"\bwhat bends\b", "nonlinear operator"),
    Word(r"\b(counted anew|is blunt|too blunt)\b", "set_reference, update_reference, roundoff_limited"),
    Word(
        r"\b(is told of each step|lend_load|refuse_afloat|refuse_unsound)\b",
        "monitor, use_estimator_load, check_solvability, validate_mesh",
    ),
    Word(r"\b(NOTHING|GREW|ENOUGH|AHEAD|LOST|DEEP)\b", "a constant is named for its quantity"),
    Word(r"\b(what (it|an answer) is worth|how right is|how near it is)\b", "accuracy, error bound, effectivity"),
    Word(r"\bgives? way\b", "penetrates by, moves by"),
    Word(r"\bsoonest\b|\bnever pays?\b|\bdearer\b|\bwho had it\b", "the fastest method, never the cheapest choice"),
    Word(r"\b([Ff]ans|Peaks|Standing|outlets)\b", "vertex patches, ObstacleExcess, Certification, console"),
    Word(r"\b(Bench|Ladder|Trap|Workbench|OfForm|OfSlope|HeldBoundary)\b", "a class is named by a noun of the field"),
    Word(r"\bheights (of u|are rounded|differ|resolve)\b|\b(of|these|present) (the )?heights\b", "u, values of u"),
    Word(
        r"\bholds with room\b|\bnothing has asked for\b|\bis told of\b", "not sharp; that no solver uses; is reported"
    ),
    Word(r"\b(march|marches|begun|stood|whoever)\b", "time stepping, started, was, the fastest method"),
    Word(r"\bgo(es)? on from\b|\bleft out\b", "continue from, not included"),
]
IN_PAGES = [
    *EVERYWHERE,
    Word(r"\brooms?\b", "modules, layers; a margin"),
    Word(
        r"\bfigures?\b(?! \d)",
        "value, output quantity; a figure is a plot",
        {"kikuchi_in_an_hour.py": "names of matplotlib"},
    ),
    Word(r"\b(Bench|March|Watch|Court|Trap)\b", "solver context, TimeStepper, monitor, verifier"),
    Word(r"\b[Ll]eans?\b|\bleaning\b", "streamline upwinding (SUPG)"),
    Word(
        r"\b([Ff]ans|Rim|[Tt]orn|[Dd]ips?|[Ss]urprises?|[Dd]oubts?|[Ll]ends?)\b",
        "vertex patches, Dirichlet data, discontinuous, oscillation, sampling discrepancy, violated hypotheses",
    ),
    Word(r"\b[Cc]omplaints?\b", "check"),
    Word(r"\b[Yy]ardsticks?\b(?<!--yardstick)", "Poisson baseline, Poisson solves"),
    Word(r"\b[Rr]efus(e|es|ed|al|als|ing)\b", "rejected; no solution exists"),
    Word(r"\b[Ll]ikewise\b", "the type and meaning again"),
    Word(r"\bleft out\b|\bleaves? out\b", "not included"),
    Word(r"\bspells? of\b|\bfor ever\b|\bwithout a word\b", "plain words"),
]


HELP = {
    f"{name} --help": command.get_help(click.Context(command, info_name=name))
    for name, command in commands.commands.items()
}


def found(words, name, text):
    """Each place where a word stands, with what to write instead."""
    for word in words:
        if any(name.endswith(end) for end in word.exceptions):
            continue
        for match in re.finditer(word.pattern, text):
            line = text.count("\n", 0, match.start()) + 1
            yield f"{name}:{line}: '{match[0]}': write {word.instead}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages(page):
    """Pages, demos and scenes of the catalogue."""
    assert not list(found(IN_PAGES, page.name, page.read_text()))


def test_help():
    """Help of all commands and options."""
    assert not [place for name, text in HELP.items() for place in found(IN_PAGES, name, text)]


def test_code():
    """Names, docstrings, comments and messages."""
    assert not [place for file in CODE for place in found(EVERYWHERE, str(file.relative_to(ROOT)), file.read_text())]


def test_exceptions_are_needed():
    """No exception stays when its word has gone."""
    for word in IN_PAGES:
        for end in word.exceptions:
            texts = [file.read_text() for file in (*PAGES, *CODE) if str(file).endswith(end)]
            texts += [text for name, text in HELP.items() if name == end]
            assert any(re.search(word.pattern, text) for text in texts), f"{end}: {word.pattern}"
