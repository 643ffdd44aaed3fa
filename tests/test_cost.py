"""Cost of accuracy: prices follow from rows, rows survive, every choice has its errors or a reason; clouds."""

import json
import math
from contextlib import closing

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.cloud import Cloud, Nearby
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.exact_contact import exact_contact
from fenicsx_obstacle.estimation.norms import Distance
from fenicsx_obstacle.parallel import before, forget_peak_memory, largest, on_root, peak_memory_mb
from fenicsx_obstacle.scenes import catalogue, meshes
from fenicsx_obstacle.show.tables import duration, megabytes
from fenicsx_obstacle.studies import cost, price
from fenicsx_obstacle.studies.cost import CostStudy
from fenicsx_obstacle.studies.reference_solution import Reference
from fenicsx_obstacle.studies.rows import RowStore
from tests.conftest import COMM, DEMOS, membrane
from tests.helpers import inside

SMALL = "600s, 1500 unknowns"  # what clocks say must not decide


def line(name, order, *, first=0.1, rows=5, element="P1", lucky=()):
    """Rows whose energy error falls like seconds^-order, from 0.1 at 1 s on, each four times as dear."""
    found = []
    for k in range(rows):
        error = first * 4.0 ** (-order * k) * (1e-3 if k in lucky else 1)
        found.append({"choice": name, "element": element, "seconds": 4.0**k, "dofs": 100 * 4**k, "memory_mb": 4.0**k,
                      "errors": {"energy": error}, "sizes": {"energy": 1.0}, "floor": 1e-10,
                      "poisson_seconds": 4.0**k / 3})  # fmt: skip
    return found


EXACT = {"choice": "", "exact": True}


def test_units_have_no_exponents():
    """Two digits and a unit."""
    assert (megabytes(5.6e6), megabytes(560e3), duration(119.0)) == ("5.6 TB", "560 GB", "120 s")
    assert (megabytes(5.6), duration(1.19e-3), duration(1.19e8)) == ("6 MB", "0.0012 s", "1400 days")


def test_price_of_a_digit_is_ten_to_the_order():
    """error ~ t^-1/2: a digit costs 100 times the time; t^-1: 10 times; a cheaper line wins where lines cross."""
    rows = [EXACT, *line("slow", 0.5), *line("fast", 1.0, first=0.4)]
    p = price.price(rows, "energy")
    assert p.line.name == "fast" and p.factor == pytest.approx(10) and p.way.cost(p.error / 10) == pytest.approx(2560)
    assert price.price([EXACT, *line("slow", 0.5)], "energy").factor == pytest.approx(100)
    names = [price.cheapest(rows, "energy", e)[0][0].name for e in (0.09, 0.005)]
    assert names == ["slow", "fast"]  # they cross at 16 s and 0.025
    assert price.cheapest(rows, "energy", 1e-5) == []  # too far to tell
    assert price.digits(rows[1], "energy") == (1.0, 2.0, 1.0)
    assert price.unit(rows) == pytest.approx(256 / 3)


def test_lucky_hits_do_not_count():
    """An error that happens to be small once, in the middle or at the end, makes no price."""
    for lucky in ((2,), (4,)):
        curve = price.curves([EXACT, *line("a", 0.5, lucky=lucky)], "energy")[0]
        assert np.all(np.diff(np.log(curve.error)) <= 1e-12)
        assert curve.error[2] >= 0.1 * 4.0**-1.5 * 0.5 and curve.error[4] > 0.1 * 4.0**-2 / 8


def test_small_meshes_do_not_make_digits_cheap():
    """Where start-up hides the growth of time, the next digit takes at least as many times longer as unknowns grow."""
    rows = [{**row, "seconds": 1.0 + 0.01 * k} for k, row in enumerate(line("a", 0.5))]
    assert price.price([EXACT, *rows], "energy").factor >= 99


@pytest.mark.parametrize("unit", [1.0, 1e-12])
def test_a_contact_area_is_there_in_any_unit(unit):
    """But not where it is a point."""
    rows = [{**row, "errors": {"area": 0.1 * unit}, "sizes": {"area": unit}} for row in line("a", 0.5)]
    assert price.norms([{**EXACT, "area": unit}, *rows]) == price.norms([EXACT, *rows]) == ["area"]
    assert price.norms([{**EXACT, "area": 0.0}, *rows]) == []


def test_errors_below_the_reference_are_left_out():
    changed = {"energy": 0.0, "l2": 0.0}
    first = {"choice": "", "exact": False, "changed": changed, "bound": {"total": 0.02, "guaranteed": True}}
    assert len(price.curves([first, *line("a", 0.5)], "energy")[0].rows) == 3


@pytest.mark.slow
def test_contact_of_exact_solutions():
    """Cells that the free boundary crosses are halved until area and force of the ball, pi a^2 and 2 pi A, are right to
    1e-6; of a string, which leaves its obstacle like d^2, to the root of the round-off of heights."""
    ball, string = catalogue.scene("ball"), catalogue.scene("string_torsion")
    found, a = exact_contact(ball.model, ball.exact, meshes.build(ball, COMM, 0)), 0.6979651482233736
    assert found["area"] == pytest.approx(math.pi * a**2, rel=1e-6)
    assert found["force"] == pytest.approx(2 * math.pi * a**2 / math.sqrt(1 - a**2), rel=1e-6)
    found = exact_contact(string.model, string.exact, meshes.build(string, COMM, 0))
    assert found["area"] == pytest.approx(0.6, abs=2e-7)


def study(scene, folder, budget=SMALL, stop=None):
    """All rows; or those before `stop` of them are there, as if the run were interrupted."""
    found = []

    def on_row(row):
        found.append(row)
        if len(found) == stop:
            raise KeyboardInterrupt

    with closing(RowStore(folder, COMM)) as store:
        one = CostStudy(scene, {}, budget, folder)
        try:
            return one, one.run(on_row, store)
        except KeyboardInterrupt:
            return one, found


@pytest.mark.serial
@pytest.mark.slow
def test_ladder_of_a_string(folder):
    """Every choice has rows or a reason; parts and errors fit; the best eps goes with h^2 for heights, h^(4/3) for
    slopes (THEORY of the map); what was interrupted is not computed again."""
    scene = catalogue.scene("string_parabola")
    _, begun = study(scene, folder, stop=7)
    one, rows = study(scene, folder)
    assert [row["run"] for row in rows[1:8]] == [1] * 7 == [row["run"] for row in begun]
    solved = {row["choice"] for row in price.solved(rows)}
    assert solved >= {"P1 VI", "P1 VI cold", "P1 eps = h^2", "P1 auto", "P1 adaptive"}
    failed = {row["choice"]: row["reason"] for row in price.failures(rows)}
    assert solved >= {"P2 VI", "P2 auto", "P2 adaptive"}
    assert all("round-off" in reason for name, reason in failed.items() if name.startswith("P2"))
    assert set(one.ends) == {choice.name for choice in one.choices}
    for row in price.solved(rows):
        if row["parts"]:
            mesh = next(r for r in rows if r.get("choice") == f"{row['element']} VI" and r["dofs"] == row["dofs"])
            for norm in ("energy", "l2"):
                assert abs(row["errors"][norm] - mesh["errors"][norm]) <= row["parts"]["eps"][norm] * (1 + 1e-6)
    powers = {norm: price.power_of_h(price.largest_harmless_eps(rows, norm)) for norm in ("energy", "l2")}
    assert powers["l2"] == pytest.approx(2, abs=0.3) and powers["energy"] == pytest.approx(4 / 3, abs=0.3)
    refused = [row for row in rows if row["choice"] == "map" and "reason" in row]
    assert refused and all("limit of round-off" in row["reason"] and row["eps"] < row["floor"] for row in refused)


@pytest.mark.slow
def test_without_an_exact_solution(folder, monkeypatch):
    """Errors are against the finest solution, whose own bound is told, and those of fine meshes are smaller."""
    from fenicsx_obstacle.show.cost import against

    monkeypatch.setattr(cost, "MAP_MESHES", 0)
    _, rows = study(membrane(load=1, upper=0.05), folder, budget="600s, 1200 unknowns")
    first = price.truth(rows)
    assert not first["exact"] and first["bound"]["words"] == "certified"
    assert "reference solution" in against(rows) and "at most" in against(rows)
    for name in ("P1 auto", "P1 adaptive"):
        part = [row["errors"]["energy"] for row in price.solved(rows) if row["choice"] == name]
        assert len(part) > 1 and part[-1] < part[0] / 1.5
    for there in (True, False):
        if not there:
            on_root(COMM, (folder / "reference" / "fields.h5").unlink)  # then it is computed anew
        again = study(membrane(load=1, upper=0.05), folder, budget="600s, 1200 unknowns")[1]
        assert [row["key"] for row in again] == [row["key"] for row in rows] and (price.truth(again) == first) == there


@pytest.mark.serial
@pytest.mark.slow
def test_budget_of_nothing(folder, monkeypatch):
    """The reference has two meshes all the same; where it cannot judge a norm, words stand in place of lines."""
    from fenicsx_obstacle.show.cost_plots import drawings

    monkeypatch.setattr(cost, "MAP_MESHES", 1)
    _, rows = study(Scene.read(DEMOS / "soap.toml"), folder, budget="0.001s")
    first = price.truth(rows)
    assert first["bound"]["words"].startswith("an indicator")
    assert all(change > 0 for change in first["changed"].values())
    monkeypatch.setattr(price, "TRUSTED", 1e9)
    page = dict(drawings(rows))["prices"]
    words = [text.get_text() for axes in page.axes for text in axes.texts]
    assert len(words) == 3 and all("all errors are smaller" in text for text in words)


@pytest.mark.slow
def test_peak_memory_begins_anew():
    before = forget_peak_memory(COMM)
    large = np.ones(20_000_000)
    assert peak_memory_mb(COMM) - before > 0.9 * COMM.size * large.nbytes / 1e6
    del large
    assert forget_peak_memory(COMM) - before < 0.2 * COMM.size * 160


@pytest.mark.serial
@pytest.mark.slow
def test_page(tmp_path):
    """The page of the command stands alone; called again, it takes its rows."""
    out = tmp_path / "out"
    words = ["cost", "string_parabola", "--budget", "600s, 100 unknowns", "--output", str(out)]
    kept = []
    for _ in range(2):
        done = inside(*words)
        assert done.returncode == 0, done.stderr
        keys = [json.loads(text)["key"] for text in (out / "rows.jsonl").read_text().splitlines()]
        assert len(set(keys)) == len(keys) > 5 and keys == (kept or keys)
        kept = keys
    assert "next digit of" in done.stdout and "P2 auto: ends: the next mesh would have more" in done.stdout
    page = (out / "report.html").read_text()
    assert page.count("<img") == 4 and "Time for one more digit" in page
    assert "http" not in page.replace("http://www.w3.org", "") and "<script" not in page
    assert all((out / f"{name}.png").stat().st_size > 10_000 for name in ("seconds", "prices", "parts", "map"))


def test_choices_of_a_scene_without_obstacle():
    """No penalty, no inequality: meshes and elements alone are compared."""
    from fenicsx_obstacle.studies.choices import choices

    names = [choice.name for choice in choices(Scene(mesh={"shape": "rectangle"}, tension=1, load=1))]
    assert names == ["P1 auto", "P1 adaptive", "P2 auto", "P2 adaptive"]


PRESSED = {"load": 4, "upper": 0.05}
CLOUDS = {
    "P1": membrane(**PRESSED),
    "P2, mu of the place": membrane(**{**PRESSED, "tension": "1 + x + y"}).change({"solve.element": "P2"}),
    "matrix": membrane(**{**PRESSED, "tension": [["2 + x", 0.5], [0.5, 1]]}),
    "large slopes": Scene(mesh={"shape": "rectangle", "cells": 8}, large_slope=1, load=1),
    "two cells": Scene(mesh={"shape": "interval", "cells": 2}, tension="1 + x", load=1, upper=0.1),
    "solid": Scene(mesh={"shape": "box", "cells": 4}, tension="1 + x", load=9, upper=0.1),
    "meridian": Scene(mesh={"shape": "rectangle", "x": [0, 1], "cells": 8},
                      tension=1, load=1, axial_symmetry=True),
    "surface": Scene.read(DEMOS / "bearing.toml").change({"report": {}}),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", CLOUDS)
def test_norms_are_those_of_the_mesh(name):
    """On one mesh the sum over points is the integral: of slopes wherever the tension is linear in a cell, of heights
    where the rule is exact for them, which it is not in solids, nor with a radius that the solver takes constant."""
    scene = CLOUDS[name]
    with closing(SolverContext(scene, COMM)) as context:
        one = context.answer()
        two = context.answer(scene.options_with(eps=100 * (one.record["eps"] or 1e-3)))
        e = one.u.x.array - 0.9 * two.u.x.array
        two.u.x.array[:] *= 0.9
        found, distance = Nearby(Cloud.of(one), two.level).norms(two.u), Distance(context.problem)
        assert found["energy"] == pytest.approx(distance.energy(e), rel=1e-9) and found["energy"] > 0
        if name not in ("solid", "meridian"):
            assert found["l2"] == pytest.approx(distance.l2(e), rel=1e-9)
        beside = 1.25 if name.startswith("P2") else 1  # between the nodes quadratics may be a quarter higher
        assert 0.5 < found["max"] / largest(COMM, np.abs(e)) <= beside * (1 + 1e-9)
        itself = Nearby(Cloud.of(one), one.level).norms(one.u)
        assert max(itself.values()) <= 1e-12 * largest(COMM, np.abs(one.u.x.array))


def test_points_outside_count_nothing():
    """A disk has points beyond the polygon of a coarse mesh: of 1 the area of the polygon is found, not more."""
    scene = Scene(mesh={"shape": "disk", "cells": 16}, tension=1, load=1)
    with closing(SolverContext(scene, COMM)) as context:
        cloud = Cloud.of(context.answer())
    zero = Cloud(cloud.points, cloud.weights, cloud.tension, 0 * cloud.u, 0 * cloud.slopes)
    with closing(SolverContext(scene.change({"mesh.cells": 4}), COMM)) as context:
        one = context.answer().u
        one.x.array[:] = 1.0
        found, polygon = Nearby(zero, context.problem.level).norms(one), Distance(context.problem).l2(one.x.array)
    assert polygon**2 < 0.99 * cloud.weights.sum() and found["l2"] ** 2 == pytest.approx(polygon**2, rel=3e-3)
    assert found["max"] == pytest.approx(1) and found["energy"] < 1e-12


@pytest.mark.parametrize("cells", [(4, 16), (16, 8)])
def test_the_mesh_with_more_cells_has_the_points(cells):
    """Slopes of P1 jump inside the cells of a reference with fewer cells: the errors are integrals all the same."""
    scene = membrane(load=4).change({"solve.element": "P2"})
    one, two, finer = (scene.change({"mesh.cells": count}) for count in (*cells, max(cells)))
    with closing(SolverContext(one, COMM)) as context, closing(SolverContext(finer, COMM)) as every:
        reference, level = context.answer(), every.problem.level
        with closing(SolverContext(two.change({"solve.element": "P1"}), COMM)) as other:
            answer = other.answer()
            found = Reference(reference, {}).errors(None, answer)
        mine = level.points.T
        points, start = np.concatenate(COMM.allgather(mine)), before(COMM, len(mine))
        e = (answer.at(points) - reference.at(points))[start : start + len(mine)]
        exact = Distance(every.problem).of_u(e)
    for norm in ("energy", "l2"):
        assert found[norm] == pytest.approx(exact[norm], rel=1e-9)


@pytest.mark.parametrize(("dim", "dofs", "ends"), [(3, 200, True), (3, 100, False), (1, 300, False)])
def test_meshes_of_files_have_dimensions(dim, dofs, ends, folder):
    """Halved cells of a solid have eight times the unknowns, those of a string twice as many."""
    mesh = dmesh.create_unit_cube(COMM, 2, 2, 2) if dim == 3 else dmesh.create_unit_interval(COMM, 20)
    one = CostStudy(Scene(mesh=mesh, tension=1, load=1), {}, "600s, 1000 unknowns", folder)
    one._end(one.choices[0], [{"seconds": 1.0, "dofs": dofs, "memory_mb": 1.0}], one.scene)
    assert ("more than the 1000 unknowns" in one.ends.get(one.choices[0].name, "")) == ends
