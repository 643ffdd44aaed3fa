"""Tables and plots of studies: one line for each value of the other keys, columns that stay where they are."""

import csv
import json

import numpy as np
import pytest

from fenicsx_obstacle import InputError
from fenicsx_obstacle.answers.time_history import Frame
from fenicsx_obstacle.show.figures import digits, steady, style
from fenicsx_obstacle.show.plots import drawings
from fenicsx_obstacle.show.study import report_study
from fenicsx_obstacle.show.tables import StudyTable
from fenicsx_obstacle.show.time_history import _chosen
from fenicsx_obstacle.studies.convergence import Study
from tests.conftest import COMM, membrane
from tests.theory.show import drawing
from tests.theory.statement import Curve, Found, Panel

BUMP = {"load": -4, "lower": "-c", "define": {"c": 0.1}}


# the pictures of the last rows are not what is tested here
pytestmark = pytest.mark.usefixtures("matplotlib_draws")


def rows_of(scene, vary, folder):
    said = []
    rows = report_study(Study(scene, vary, {}), folder / "out", said.append)
    return rows, said


def curves(figure):
    """Measured lines of all panels: abscissas and ordinates of what has markers and points."""
    lines = [line for axes in figure.axes for line in axes.lines if line.get_marker() != "None"]
    return [tuple(np.asarray(data, dtype=float) for data in line.get_data()) for line in lines if len(line.get_xdata())]


GRIDS = {
    "eps": {"eps": [1e-2, 1e-3, 1e-4], "cells": [4, 8]},
    "cells": {"method": ["vi", "penalty"], "cells": [4, 8, 16]},
    "levels": {"cells": [4, 8], "refine": [0, 1]},
    "sweep": {"method": ["vi", "penalty"], "define.c": [0.2, 0.1, 0.05]},
    "words": {"method": ["vi", "penalty"], "start": ["cold", "nested"]},
}


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.slow
def test_no_line_goes_to_and_fro(name, disk, folder):
    """In a grid each line has one value of the other keys: its abscissas rise or fall, and it has its own legend."""
    scene = disk if name in ("eps", "cells", "levels") else membrane(**BUMP)
    rows, _ = rows_of(scene, GRIDS[name], folder)
    if COMM.rank != 0:
        return
    drawn = dict(drawings(rows, GRIDS[name]))
    assert list(drawn) == (["convergence", "cost"] if scene is disk else ["sweep"])
    main = next(iter(drawn.values()))
    for x, _ in curves(main):
        steps = np.diff(x)
        assert len(x) > 1
        assert np.all(steps > 0) or np.all(steps < 0), x
    (legend,) = [axes.get_legend() for axes in main.axes if axes.get_legend() is not None]
    assert len(legend.get_texts()) >= 2


@pytest.mark.slow
def test_a_balance_is_drawn_as_zero():
    """A sum that is round-off beside its terms is drawn as 0: axes would magnify it."""
    rows = [{"vary": {"c": c}, "report": {"a": 1 + c, "b": 1 + c, "left": 1e-15 * c}, "title": "", "scene": "s"}
            for c in (1.0, 2.0)]  # fmt: skip
    ((_, page),) = drawings(rows, {"c": [1.0, 2.0]}, {"a": "f(x)", "b": "g(x)", "left": "a - b"})
    *_, left = curves(page)
    assert left[1].tolist() == [0, 0]


@pytest.mark.slow
def test_a_sweep_plots_the_figures_of_the_report(folder):
    """Each figure of [report] against the key in the scene's words; without a report contact area, force, energy."""
    report = {"deepest": "inf(u)", "force": "integral(p)"}
    vary = {"define.c": [0.05, 0.1, 0.2]}
    for scene, labels in (
        (membrane(**BUMP, report=report), ["deepest", "force"]),
        (membrane(**BUMP), ["contact area", "force on lower obstacle", "energy"]),
    ):
        rows, said = rows_of(scene, vary, folder)
        if COMM.rank != 0:
            continue
        assert (folder / "out" / "sweep.png").exists()
        assert "sweep.png" in said[-1]
        ((_, figure),) = drawings(rows, vary)
        assert [axes.get_ylabel() for axes in figure.axes] == labels
        assert {axes.get_xlabel() for axes in figure.axes} == {"c"}
        assert len(curves(figure)) == len(labels)
        assert all(list(x) == vary["define.c"] for x, _ in curves(figure))
        force = [row["contact"]["lower"]["force"] for row in rows]
        assert np.allclose(curves(figure)[1][1], force, rtol=1e-9)
        assert all(label.removesuffix(" obstacle") in said[0] for label in labels)  # and columns of the table
        assert "<img" in (folder / "out" / "report.html").read_text()


@pytest.mark.slow
def test_columns_stay_where_they_are(disk, folder):
    """Rows of the variational inequality have an empty cell for eps, in the table, in LaTeX, CSV and JSON. Orders
    compare rows that differ in the parameter only, wherever they stand in the grid."""
    vary = {"cells": [4, 8, 16], "solve.method": ["vi", "penalty"]}
    rows, said = rows_of(disk, vary, folder)
    table = StudyTable(vary, penalised=True)
    lines = [line for row in rows for line in table.lines(row)]
    heads = [cell.head for cell in table.rows[0]]
    assert all([cell.head for cell in cells] == heads for cells in table.rows)
    place = heads.index("eps")
    assert [bool(cells[place].value) for cells in table.rows] == [False, True] * 3
    assert [bool(cells[heads.index("order")].value) for cells in table.rows] == [False] * 2 + [True] * 4
    assert len({len(line) for line in lines if "paper:" not in line}) == 1, said  # all rows as wide as the head
    latex = [line for line in table.latex().splitlines() if " & " in line]
    assert {line.count(" & ") for line in latex} == {len(heads) - 1}
    assert latex[1].split(" & ")[place].strip() == ""
    if COMM.rank == 0:
        with (folder / "out" / "rows.csv").open() as file:
            assert [bool(row["eps"]) for row in csv.DictReader(file)] == [False, True] * 3
        stored = [json.loads(line) for line in (folder / "out" / "rows.jsonl").read_text().splitlines()]
        assert [row["eps"] is None for row in stored] == [True, False] * 3


@pytest.mark.slow
def test_a_refused_study_leaves_nothing(disk, folder):
    """Also where only the mesh shows the mistake; what was there before stays. One row has no plot."""
    bad = membrane(tension="x - 1/2", upper=1)
    for _ in range(2):
        with pytest.raises(InputError, match="must be positive"):
            report_study(Study(bad, {"cells": [4, 8]}, {}), folder / "a" / "b", lambda line: None)
        COMM.barrier()
        assert not (folder / "a").exists()
        COMM.barrier()
    _, said = rows_of(disk, {"cells": [4]}, folder)
    assert COMM.rank > 0 or said[-1].endswith("rows.csv, rows.jsonl, last/, report.html")
    with pytest.raises(InputError, match="must be positive"):
        report_study(Study(bad, {"cells": [4, 8]}, {}), folder / "out", lambda line: None)
    assert (folder / "out" / "rows.csv").exists()


@pytest.mark.slow
def test_a_legend_of_many_curves_covers_none():
    """Beside the panels, once, where it would not fit into them."""
    if COMM.rank != 0:
        return
    curves = [Curve(f"family {k}", [1e-8, 1e-2], [k, 2 * k]) for k in range(14)]
    page = drawing(Found([], [Panel("one", "eps", "steps", curves), Panel("two", "eps", "steps", curves)]), "many")
    page.canvas.draw()
    (legend,) = [axes.get_legend() for axes in page.axes if axes.get_legend() is not None]
    box = legend.get_window_extent()
    assert not any(box.overlaps(axes.get_window_extent()) for axes in page.axes)
    assert box.x0 >= page.bbox.x0
    assert box.x1 <= page.bbox.x1
    assert box.y0 >= page.bbox.y0


def test_axes_do_not_magnify_round_off():
    """Values that differ by round-off are drawn as their mean; numbers that are round-off are 0, and never -0."""
    noise = 0.1 * (1 + 1e-15 * np.arange(9))
    assert np.ptp(steady(noise)) == 0 and np.isclose(steady(noise)[0], 0.1)
    rising = 5 + 1e-6 * np.arange(9)
    assert np.array_equal(steady(rising), rising)
    assert np.isnan(steady(np.array([np.nan, 1, 1 + 1e-15]))[0])
    assert [digits(value, 1.0) for value in (-0.0, -1e-17, 0.25)] == ["0", "0", "0.25"]


def test_curves_look_different():
    """Sixteen curves of a plot have sixteen pairs of colour and marker."""
    looks = [style(number, 4) for number in range(16)]
    assert len({(look["color"], look["marker"]) for look in looks}) == 16


def test_moments_that_are_drawn():
    """Six moments in the picture of a course are at equal distances, one more has the largest contact set."""
    frames = [Frame(t, {"contact": np.arange(8) < (5 if t == 4 else 0)}) for t in range(31)]
    chosen = _chosen(frames)
    assert 4 in chosen and chosen[0] == 0 and chosen[-1] == 30 and len(chosen) == 7
