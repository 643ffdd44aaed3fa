"""The seminar runs section by section, tutorials as a whole; what they assert holds on any number of ranks."""

import runpy
from pathlib import Path
from typing import NamedTuple

import matplotlib
import matplotlib.pyplot as plt
import pytest

from fenicsx_obstacle.effects import effect
from tests.conftest import COMM, DEMOS, slow_except

NOTEBOOK = Path(__file__).parent.parent / "docs" / "kikuchi_in_an_hour.py"


class Cell(NamedTuple):
    """A code cell: the heading above it, the line where it begins, its source."""

    title: str
    line: int
    source: str


def cells_of(path):
    """Code cells of a file in jupytext's percent format."""
    title, found, start, code = "", [], 0, []
    for number, text in enumerate([*path.read_text().splitlines(), "# %%"], start=1):
        if text.startswith("# ## "):
            title = text.removeprefix("# ## ")
        if not text.startswith("# %%"):
            code.append(text)
            continue
        source = "\n".join(code)
        if start and source.strip():
            found.append(Cell(title, start, source))
        start, code = (0 if "[markdown]" in text else number), []
    return found


FIRST, *SECTIONS = cells_of(NOTEBOOK)
TUTORIALS = sorted(file for file in DEMOS.glob("*.py") if "# %% [markdown]" in file.read_text())
QUICK = {"membrane", "one_added_line"}


@pytest.fixture(autouse=True)
def no_effects_stay():
    """Effects that a tutorial registers are not there for other tests of this process."""
    yield
    for key, one in list(effect._register.items()):
        if not one.__module__.startswith("fenicsx_obstacle."):
            del effect._register[key]


@pytest.fixture(autouse=True)
def quiet_pictures():
    plt.switch_backend("Agg")
    with matplotlib.rc_context():
        yield
    plt.close("all")


@pytest.mark.parametrize("cell", slow_except(SECTIONS, SECTIONS[0]), ids=[cell.title for cell in SECTIONS])
def test_section(cell, folder, monkeypatch):
    """The cell's assertions hold, and its picture is written."""
    monkeypatch.chdir(folder)
    names = {"__name__": "__main__"}
    for one in (FIRST, cell):  # tracebacks name the line of the file
        exec(compile("\n" * one.line + one.source, NOTEBOOK, "exec"), names)
    COMM.barrier()
    number = cell.title.split(".")[0]
    (picture,) = folder.glob(f"out/kikuchi/{number}_*.png")
    assert picture.stat().st_size > 10000


@pytest.mark.slow
@pytest.mark.parametrize(
    "file", slow_except(TUTORIALS, *(file for file in TUTORIALS if file.stem in QUICK)), ids=lambda file: file.stem
)
def test_tutorial(file, folder, monkeypatch):
    """Its assertions hold, and its picture is written."""
    monkeypatch.chdir(folder)
    if COMM.rank == 0:
        (folder / "demos").symlink_to(DEMOS)
    COMM.barrier()
    runpy.run_path(str(file), run_name="__main__")
    COMM.barrier()
    assert (folder / f"{file.stem}.png").stat().st_size > 10000
