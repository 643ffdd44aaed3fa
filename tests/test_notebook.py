"""The seminar and the tutorials run as a whole; what they assert holds on any number of ranks."""

import runpy

import matplotlib
import matplotlib.pyplot as plt
import pytest

from fenicsx_obstacle.effects import effect
from tests.conftest import COMM, DEMOS, slow_except

SEMINAR = DEMOS.parent / "docs" / "kikuchi_in_an_hour.py"
TUTORIALS = sorted(file for file in DEMOS.glob("*.py") if "# %% [markdown]" in file.read_text())
QUICK = {"membrane", "one_added_line"}


@pytest.fixture(autouse=True)
def no_effects_stay():
    """Effects that a tutorial registers are not there for other tests of this process."""
    yield
    for key, one in list(effect._register.items()):
        if not one.__module__.startswith("fenicsx_obstacle."):
            del effect._register[key]


@pytest.mark.slow
@pytest.mark.parametrize(
    "file", slow_except([SEMINAR, *TUTORIALS], SEMINAR, *(file for file in TUTORIALS if file.stem in QUICK)),
    ids=lambda file: file.stem,
)  # fmt: skip
def test_tutorial(file, folder, monkeypatch):
    """Its assertions hold, and its pictures are written, of the seminar one for each section."""
    monkeypatch.chdir(folder)
    if COMM.rank == 0:
        (folder / "demos").symlink_to(DEMOS)
    COMM.barrier()
    plt.switch_backend("Agg")
    with matplotlib.rc_context():
        runpy.run_path(str(file), run_name="__main__")
    plt.close("all")
    COMM.barrier()
    names = [f"{file.stem}.png"] if file != SEMINAR else [f"out/kikuchi/{n}_*.png" for n in range(1, 9)]
    pictures = [next(folder.glob(name)) for name in names]
    assert all(picture.stat().st_size > 10000 for picture in pictures)
