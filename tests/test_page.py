"""The report page: whole, in one file, and readable in a browser."""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from fenicsx_obstacle import solve
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.show.report import report_answer
from fenicsx_obstacle.show.study import report_study
from fenicsx_obstacle.studies.convergence import Study
from tests.conftest import COMM, membrane

CHROMIUM = shutil.which("chromium")
FLAGS = """--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
--disable-component-update --disable-sync --window-size=1000,2400""".split()  # noqa: SIM905
pytestmark = pytest.mark.usefixtures("matplotlib_draws")


class Page(HTMLParser):
    """Tags with their attributes, the texts, and whether every element is closed."""

    EMPTY = ("meta", "img")

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts, self.open = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture
def study_page(disk, folder, monkeypatch):
    """The page of a small h-study."""
    monkeypatch.setattr(sys, "argv", ["/lib/fenicsx_obstacle/__main__.py", "study", "disk.toml", "--eps", "1/2 * h^2"])
    report_study(Study(disk, {"cells": [8, 16]}, {"eps": "h^2"}), folder / "out", lambda line: None)
    return folder / "out" / "report.html"


def self_contained(page):
    for tag, attributes in page.tags:
        assert tag not in ("script", "link", "iframe", "object")
        assert "href" not in attributes
        assert tag != "img" or attributes["src"].startswith("data:image/png;base64,"), (tag, attributes)


@pytest.mark.slow
def test_study_page_holds_everything(study_page, disk):
    """Title, scene, equation, orders beside the paper's, releases and the command, in one file."""
    text = study_page.read_text()
    assert not re.search(r"https?://|url\((?!#)|@import", text)
    page = Page(text)
    self_contained(page)
    assert [tag for tag, _ in page.tags].count("img") == 3  # two plots, and the last solution
    ranks = f" --ranks {COMM.size}" if COMM.size > 1 else ""
    for part in (disk.tables.title, '[obstacle]\nupper = "c"', "-div(tension grad u) = load + p", "paper: 1", "dolfinx",
                 "petsc", f"./obstacle{ranks} study disk.toml --eps '1/2 * h^2'"):  # fmt: skip
        assert part in " ".join(page.texts)
    assert re.search(r"<tr><td>8</td>(<td>[^<]+</td>){3}<td></td>", text)  # the first row has no order


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: ./obstacle test installs it")
def test_a_browser_shows_it(study_page, tmp_path):
    """Not blank: dark text on white, the colours of the plots and of the contact pressure."""
    from matplotlib.image import imread

    file = tmp_path / "page.png"
    command = [CHROMIUM, *FLAGS, f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={file}"]
    done = subprocess.run([*command, study_page.as_uri()], capture_output=True, timeout=120, check=False)
    assert file.exists(), done.stderr[-2000:]
    picture = imread(file)[..., :3]
    assert 0.5 < np.mean(picture.min(axis=-1) > 0.99) < 0.99
    assert np.count_nonzero(picture.max(axis=-1) < 0.3) > 1000
    blue = np.abs(picture - np.array([0x00, 0x72, 0xB2]) / 255).max(axis=-1) < 0.05
    red = (picture[..., 0] > 0.3) & (picture[..., 1] < 0.2) & (picture[..., 2] < 0.25)
    assert blue.sum() > 200
    assert red.sum() > 1000


@pytest.mark.slow
@pytest.mark.parametrize("scene", [{}, {"load": "-20*(1 + t)", "time": {"end": 1, "steps": 2}}])
def test_the_page_and_a_study_say_what_the_text_says(folder, scene):
    """Warnings, steps of all times, and a tolerance that is not reached: they stood in the text alone."""
    scene = membrane(**{"lower": -0.1, "load": -20, **scene}).change({"solve.eps": 0.1})
    answer = solve(scene) if scene.time else solve(scene, tol=1e-3, budget="100 unknowns")
    answer.save(folder / "out")
    report_answer(answer, folder / "out", picture=False)
    page = " ".join(" ".join(Page((folder / "out" / "report.html").read_text()).texts).split())
    text = " ".join(answer.summary().split())
    said = ["penetration is", *(["2 steps to t = 1", "in all"] if scene.time else ["IS NOT REACHED"])]
    assert all(words in text and words in page for words in said), (text, page)
    lines = []
    report_study(Study(scene, {"effects.load": [-20, -40]}, {}), folder / "study", lines.append)
    note = next(line for line in lines if "penetration is" in line)
    assert note.startswith("effects.load = -20: warning:") and "further row" in note.replace("\n", " ")
    assert "penetration is" in (folder / "study" / "report.html").read_text().partition("</table>")[2]


@pytest.mark.variant
@pytest.mark.slow
def test_no_picture_is_better_than_an_earlier_one(folder):
    """A new answer in the folder of an old one: the old picture goes, and the page shows none."""
    answer = solve(membrane(load=1, report={"mean": "integral(u)", "none": "ln(-1)"}))
    answer.save(folder / "out")
    earlier = ("bound.png", "history.png", "answer.gif", "profile-a.csv", "profile-a.png")
    mine = ("profile-mine.csv", "notes.txt")
    for name in (*earlier, *mine):
        on_root(COMM, (folder / "out" / name).touch)
    for picture in (True, False):
        _, said = report_answer(answer, folder / "out", picture=picture)
        page = Page((folder / "out" / "report.html").read_text())
        assert (folder / "out" / "answer.png").exists() == picture
        assert any(tag == "img" for tag, _ in page.tags) == picture
        self_contained(page)
        COMM.barrier()
    assert said == f"./obstacle plot {folder / 'out'} draws it"
    assert [name for name in (*earlier, *mine) if (folder / "out" / name).exists()] == list(mine)
    # the scene's own figures have a table of their own
    text = " ".join("".join(page.texts).split())
    assert re.search(r"Report mean ?0\.03\d+ none ?not finite Output quantities cells, unknowns", text), text
