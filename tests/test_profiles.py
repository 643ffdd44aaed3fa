"""[profile.NAME]: known values along lines and named curves, for every element, in time, in studies, on pages."""

import csv

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.answers.profiles import as_columns, profiles_of
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.show.profiles import _Around, _around, _drawn, draw_rows
from fenicsx_obstacle.show.report import report_answer
from fenicsx_obstacle.studies.convergence import Study
from fenicsx_obstacle.studies.rows import as_csv
from tests.conftest import COMM, membrane


def plot(folder, *words):
    """The command, of a saved result."""
    CliRunner().invoke(commands, ["plot", str(folder), *words], catch_exceptions=False)


LINE = {"line": {"from": [0.0, 0.25], "to": [1.0, "3/4"], "n": 9}}


@pytest.mark.parametrize("element", ("P1", "P2", "Q1", "Q2"))
def test_known_values(element):
    """u = 3x with tension 2: its values, slope and flux, and the gap to an obstacle that it does not touch."""
    cell = "quadrilateral" if element[0] == "Q" else "triangle"
    scene = Scene(mesh={"shape": "rectangle", "cells": 4, "cell": cell}, tension=2, lower="-1 + x", profile=LINE,
                  boundary=[{"on": "left", "value": 0}, {"on": "right", "value": 3}])  # fmt: skip
    found = profiles_of(solve(scene, element=element))["line"]
    x = np.linspace(0, 1, 9)
    assert np.allclose(found.points, np.column_stack([x, 0.25 + x / 2])) and np.allclose(found.s, x * np.sqrt(1.25))
    assert np.allclose(found.u, 3 * x) and np.allclose(found.gap, 2 * x + 1) and not found.pressure.any()
    assert np.allclose(found.slope, [3, 0]) and np.allclose(found.flux, [6, 0])


@pytest.mark.slow
def test_along_a_named_curve():
    """A side by its name, and the closed circle of the disk: points at equal distances, u = 0 there."""
    side = solve(membrane(load=-1, profile={"side": {"on": "top", "n": 5}}))
    found = profiles_of(side)["side"]
    assert np.allclose(np.sort(found.points[:, 0]), np.linspace(0, 1, 5)) and np.allclose(found.points[:, 1], 1)
    disk = Scene(mesh={"shape": "disk", "cells": 8}, tension=1, load=-1, profile={"rim": {"on": "circle", "n": 33}})
    found = profiles_of(solve(disk))["rim"]
    assert np.allclose(found.points[0], found.points[-1]) and found.s[-1] == pytest.approx(2 * np.pi, rel=1e-2)
    assert np.abs(found.u).max() < 1e-12 and np.allclose(np.diff(found.s), found.s[1], rtol=1e-2)


@pytest.mark.slow
def test_files_page_and_time(folder):
    """A table with a line for each point and moment, with formulas of comparison, which the plot has dotted; a page."""
    table, time = {**LINE["line"], "compare": {"u": "-t*x", "p": "depth"}}, {"end": 1, "steps": 2}
    answer = solve(membrane(load="-8*t", lower=-0.05, define={"depth": 2}, profile={"line": table}, time=time))
    answer.save(folder)
    report_answer(answer, folder, picture=False)
    rows = list(csv.DictReader((folder / "profile-line.csv").open()))
    assert {float(row["t"]) for row in rows} == {0.0, 0.5, 1.0} and len(rows) == 3 * 9
    last = [float(row["u"]) for row in rows if float(row["t"]) == 1.0]
    assert np.allclose(last, answer.at(profiles_of(answer)["line"].points), atol=1e-7)
    assert all(np.isclose(float(row["u_formula"]), -float(row["t"]) * float(row["x"])) for row in rows)
    assert {row["p_formula"] for row in rows} == {"2"}
    assert (folder / "profile-line.png").stat().st_size > 5000
    assert "Profiles" in (folder / "report.html").read_text()
    above, _ = _drawn({"": as_columns(profiles_of(answer)["line"])}, "u", "line").axes
    (dotted,) = [line for line in above.lines if line.get_linestyle() == ":"]
    assert np.allclose(dotted.get_ydata(), -np.linspace(0, 1, 9))


@pytest.mark.slow
def test_rows_of_a_study(folder):
    """Each row has the columns of its profiles; they are drawn over one another."""
    scene = membrane(load=-8, lower="-depth", define={"depth": 0.1}, profile=LINE)
    vary = {"define.depth": [0.1, 0.05]}
    rows = Study(scene, vary, {}).run()
    on_root(COMM, draw_rows, rows, vary, "u", folder)
    peaks = [min(row["profiles"]["line"]["u"]) for row in rows]
    assert np.allclose(peaks, [-0.1, -0.05], rtol=0.05)
    lines = (folder / "profile-line.csv").read_text().splitlines()
    assert lines[0].startswith("define.depth,x,y,s,u,p,gap") and len(lines) == 1 + 2 * 9
    assert (folder / "profile-line.png").exists() and "profiles." not in as_csv(rows).splitlines()[0]


def test_round_off_is_not_magnified():
    """Along a side where u is 0, round-off of u, of its obstacle and of the pressure is drawn as 0."""
    noise = 1e-18 * np.random.default_rng(0).random(9)
    columns = {"s": np.linspace(0, 1, 9), "u": noise, "gap": noise[::-1], "p": 10 * noise}
    around = _Around(1.0, 1.0, [noise[::-1] - noise], np.zeros(9, dtype=bool))
    page = _drawn({"": columns}, "u", "side", around)
    above, below = page.axes
    assert all(not line.get_ydata().any() for axes in page.axes for line in axes.lines)
    assert not above.patches and not below.patches  # nothing is shaded as contact


@pytest.mark.parametrize(
    "sides", [{"upper": 0.4}, {"upper": 0.4, "lower": "-0.3 - x/4"}, {"upper": 0.4, "lower": -1e6}, {"upper": "1 + x"}]
)
def test_obstacles_are_those_of_the_scene(sides):
    """Not u and its gap, which is that of the nearer one; far ones are left out. Contact ends between its nodes."""
    profile = {"line": {"from": [0.0, 0.5], "to": [1.0, 0.5], "n": 65}}
    answer = solve(membrane(load="60*where(x < 0.5, 1, -1)", profile=profile, **sides))
    found = profiles_of(answer)["line"]
    around = _around(answer, found)
    above, _ = _drawn({"": as_columns(found)}, "u", "line", around).axes
    x, dashed = found.points[:, 0], [line.get_ydata() for line in above.lines[1:]]
    known = {0.4: 0.4 + 0 * x, "-0.3 - x/4": -0.3 - x / 4, "1 + x": 1 + x}
    expected = [known[sides[side]] for side in ("lower", "upper") if sides.get(side) in known]
    assert len(dashed) == len(expected) and np.allclose(dashed, expected)
    pressed = np.abs(found.pressure) > 0
    assert around.touching.any() == pressed.any() and not (around.touching & ~pressed).any()


@pytest.mark.slow
@pytest.mark.serial
def test_plot_along(folder):
    """`plot RESULT --along` writes a picture and the table; a line that leaves the mesh is a mistake."""
    solve(membrane(load=-8, lower=-0.1)).save(folder)
    plot(folder, "--along", "0,0.5:1,0.5")
    table = np.genfromtxt(folder / "along.csv", delimiter=",", names=True)
    assert table["gap"].min() < 1e-2 and (folder / "along.png").exists()
    with pytest.raises(InputError, match="expected two points"):
        plot(folder, "--along", "0,0")


BLOCK = {"mesh": {"shape": "rectangle", "cells": 4}, "elasticity": {"young": 1, "poisson": 0, "plane": "strain"}}
PRESSED = [{"on": "left", "value": [0, "free"]}, {"on": "bottom", "value": ["free", 0]},
           {"on": "top", "obstacle": {"plane": [0, -1], "at": [0, 0.99]}}]  # fmt: skip


@pytest.mark.slow
def test_a_body_along_lines(folder):
    """A block pressed by 0.01 with Poisson's ratio 0: u_y = -0.01 y, p = 0.01, von Mises stress 0.01; the formula."""
    lines = {"top": {"on": "top", "n": 9, "compare": {"p": "0.01"}}, "inside": {"from": [0.5, 0], "to": [0.5, 1]}}
    answer = solve(Scene(**BLOCK, boundary=PRESSED, profile=lines, load=[0, 0]), eps=1e-9)
    found = profiles_of(answer)
    top, inside = found["top"], as_columns(found["inside"])
    assert np.allclose(top.pressure, 0.01) and np.allclose(top.gap, 0, atol=1e-8)
    assert np.isnan(inside["gap"][1:-1]).all()
    assert np.allclose(inside["u_y"], -0.01 * np.array(inside["y"])) and np.allclose(inside["u_x"], 0)
    assert np.allclose(inside["von_mises"], 0.01)
    assert len(_drawn({"": as_columns(top)}, "u", "top").axes) == 4  # u_x, u_y, gap, p
    answer.save(folder)
    report_answer(answer, folder, picture=False)
    table = np.genfromtxt(folder / "profile-top.csv", delimiter=",", names=True)
    assert np.allclose(table["p"], table["p_formula"]) and (folder / "profile-inside.png").exists()


@pytest.mark.slow
@pytest.mark.serial
def test_plot_a_body_along(folder):
    """`plot RESULT --along` of a saved body, with a formula; what `--compare` rejects."""
    solve(Scene(**BLOCK, boundary=PRESSED)).save(folder)
    plot(folder, "--along", "0,1:1,1", "--compare", "p = 0.01")
    table = np.genfromtxt(folder / "along.csv", delimiter=",", names=True)
    assert np.allclose(table["p"], table["p_formula"], rtol=1e-2) and (folder / "along.png").exists()
    with pytest.raises(InputError, match="expected a quantity and a formula"):
        plot(folder, "--along", "0,1:1,1", "--compare", "p")
    with pytest.raises(InputError, match="--compare: needs --along"):
        plot(folder, "--compare", "p = 1")


@pytest.mark.slow
@pytest.mark.serial
def test_plot_without_a_scene(folder):
    """`plot` also draws what Solution.save wrote; along a line it names Solution.read, because there is no scene."""
    membrane(load=-8, lower=-0.1).problem().solve().save(folder)
    assert not (folder / "scene.toml").exists()
    plot(folder)
    assert (folder / "answer.png").exists()
    with pytest.raises(InputError, match=r"without a scene .*: read it in Python by Solution\.read"):
        plot(folder, "--along", "0,0.5:1,0.5")
