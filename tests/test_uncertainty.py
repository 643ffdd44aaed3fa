"""The contact area between nodes, and the uncertainty of each quantity from three meshes."""

import json
import math

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene, solve, study
from fenicsx_obstacle.answers.uncertainty import SAFETY, Uncertainty
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import membrane, slow_except

STRING = math.sqrt(0.3 / 4)  # where string_parabola with f = 8, c = 0.3, k = 0 leaves its ceiling
DISK = 0.5777150035509267  # contact radius of disk_flat


@pytest.mark.slow
def test_contact_area_of_a_string():
    """Without a penalty the error of the contact area is below h^2; a count of nodes is off by up to h."""
    scene = catalogue.read("string_parabola").change({"report": {"counted": "integral(contact)"}})
    area, off = 1 - 2 * STRING, []
    for cells in (20, 26, 44, 90):
        answer = solve(scene, cells=cells, method="vi")
        assert abs(answer.area - area) < 1 / cells**2
        off.append(abs(answer.report["counted"] - area) * cells)
    assert max(off) > 1


def test_contact_area_reaches_boundary_values_on_the_obstacle():
    """Nodes where u is given belong to the contact: area 1, but for two corners whose only cell has no node inside."""
    answer = solve(membrane(load=-1, lower=0, mesh={"shape": "rectangle", "cells": 8}))
    assert np.isclose(answer.area, 1 - 2 / (6 * 8**2), rtol=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("order", [0.5, 1, 1.5, 2, 2.2, 2.8, 3, 4])
def test_richardson(order, degree):
    """Values q + c h^k have order k, at most 2 degree, and `SAFETY` times the true error; beyond order 2 more."""
    values = [5 + 0.3 * h**order for h in (1 / 8, 1 / 16, 1 / 32)]
    found, true = Uncertainty.of(values, degree), 0.3 / 32**order
    assert found.verdict == "settled"
    assert found.order is None if order > 2 * degree else abs(found.order - order) < 1e-9
    assert np.isclose(found.error, SAFETY * true) if order <= 2 else found.error > true


def test_a_bound_has_the_same_load_on_all_meshes():
    """For a bound the load has its means in the cells, otherwise its values at their centres."""
    scene = membrane(load="-20*x^8", lower=-9, mesh={"shape": "rectangle", "cells": 16})
    found = solve(scene, bound=True, uncertainty=True).record["uncertainty"]["energy"]["values"]
    assert found[0] == pytest.approx(solve(scene, cells=4, bound=True).record["energy"], rel=1e-9)
    assert found[0] != pytest.approx(solve(scene, cells=4).record["energy"], rel=1e-3)


def test_what_is_not_settled():
    """Powers of 1/h and log(1/h) are unbounded, changes that stay are not settled, round-off is settled."""
    levels = (8, 16, 32)
    assert Uncertainty.of([n**0.5 for n in levels]).verdict == "unbounded"
    assert Uncertainty.of([math.log(n) for n in levels]).verdict == "unbounded"
    wild = Uncertainty.of([1.0, 1.01, 0.999])
    assert wild.verdict == "not settled" and wild.error is None and wild.order is None
    less = Uncertainty.of([1.0, 1.01, 1.006])
    assert less.verdict == "settled" and less.order is None and less.error >= 0.004
    assert Uncertainty.of([3.0, 3 + 1e-13, 3.0]).error < 1e-8
    assert Uncertainty.of([0.0, 0.0, 0.0]).error == 0


JUMPS = {
    "tension": {"tension": "where(x < 0.53, 1, 1e4)"},
    "tension on a curve": {"tension": "where((x - 0.41)^2 + y^2 < 0.1, 1e-3, 1)"},
    "load": {"load": "-10*(x + 0.3*y < 0.6)"},
    "obstacle": {"lower": "-0.1 - floor(2.1*x)"},
}
RESOLVED = {
    "on facets": {"tension": "where(x < 0.5, 1, 1e4)"},
    "kinks": {"load": "-10*max(x, 0.53)", "lower": "-0.1 - abs(x - 0.53)"},
    "steep": {"tension": "1 + exp(-300*(x - 0.5)^2)", "load": "-10*sqrt(x)"},
    "constant": {"load": "-10*(sin(x)^2 + cos(x)^2)"},  # up to round-off
    "constant as well": {"load": "-10*(x + 1)/(x + 1)"},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*JUMPS, *RESOLVED])
@pytest.mark.parametrize("mesh", [{}, {"cell": "quadrilateral"}])
def test_data_that_jump_inside_cells(name, mesh):
    """Three nested meshes may have the jump at the same wrong place: nothing is settled, and the datum is named."""
    data = {"tension": 1, "load": -10, "lower": -0.1, **(JUMPS | RESOLVED)[name]}
    scene = membrane(mesh={"shape": "rectangle", "cells": 16, **mesh}, report={"vol": "integral(u)"}, **data)
    found = solve(scene, uncertainty=True).record["uncertainty"]
    each = [found["energy"], found["contact"]["area"], found["contact"]["lower"]["force"], found["report"]["vol"]]
    if name in JUMPS:
        assert f"] {name.split()[0] if name != 'obstacle' else 'lower'} jumps inside cells" in found["reason"]
        assert all(one["verdict"] == "not settled" and one["error"] is one["order"] is None for one in each)
    else:
        assert "reason" not in found and found["energy"]["verdict"] == "settled"


TOP = {"on": "top", "value": 0}
UNRESOLVED = {
    "a part that ends inside an edge": (
        {"boundary": [TOP, {"where": "y == 0 and x < 0.26", "flux": 1}]}, "not made of whole edges"),
    "a load that changes within a part of a cell": (
        {"load": "-10/(1 + exp(1e3*(x - 0.255)))", "lower": -0.1}, "load changes within a small part of a cell"),
    "a tension that changes within a part of a cell": (
        {"tension": "1 + 1e3*(0.5 + atan(1e4*(x + y - 0.61))/pi)", "load": -10}, "tension changes within"),
    "an obstacle on a part that jumps": (
        {"load": -10, "boundary": [TOP, {"on": "bottom", "lower": "where(x < 0.31, -0.1, -1e20)"}]},
        "lower jumps inside cells"),
    "a load that jumps in time": (
        {"rate": 1, "load": "where(t < 0.31, 1, 0)*(x < 0.5)", "time": {"end": 1, "steps": 16, "start": 0}},
        "load jumps in time"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "element"), [*((name, "P1") for name in UNRESOLVED), (next(iter(UNRESOLVED)), "P2")])
def test_what_three_meshes_have_at_the_same_wrong_place(name, element):
    """Nothing is settled, and the reason is named."""
    data, words = UNRESOLVED[name]
    scene = membrane(report={"vol": "integral(u)"}, **data)
    found = solve(scene, element=element, uncertainty=True).record["uncertainty"]
    assert words in found["reason"] and found["report"]["vol"]["verdict"] == "not settled"


def test_meshes_that_are_coarser_along_one_side_only():
    """Of a strip that is one cell wide no coarser mesh tells anything."""
    scene = membrane(mesh={"shape": "rectangle", "cells": 16, "y": [0, 0.04]}, load=1, report={"vol": "integral(u)"})
    assert "along each side" in solve(scene, uncertainty=True).record["uncertainty"]["reason"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change"),
    slow_except([("ball", {"cells": 64}), ("ball", {"cells": 32, "element": "P2"}), ("string_parabola", {"cells": 64}),
                 ("disk_flat", {"cells": 32, "method": "vi"})], ("ball", {"cells": 64})),
)  # fmt: skip
def test_true_errors(name, change):
    """Within 3 times the stated ones, on levels, on meshes of their own, and with P2; u is what it is without."""
    force = {"ball": 2 * math.pi * 0.680259411891719, "disk_flat": 4 * math.pi * DISK**2,
             "string_parabola": 8 * (1 - 2 * STRING)}[name]  # fmt: skip
    area = {"ball": math.pi * 0.697965148223374**2}.get(name, force / (4 if name == "disk_flat" else 8))
    scene = catalogue.read(name).change({"report": {"held": "integral(abs(p))"}})
    answer, plain = solve(scene, uncertainty=True, **change), solve(scene, **change)
    assert np.allclose(answer.u.x.array, plain.u.x.array, rtol=0, atol=1e-12)  # sums over ranks have no fixed order
    found = answer.record["uncertainty"]
    side = "lower" if name == "ball" else "upper"
    for one, truth in ((found["contact"][side]["force"], force), (found["contact"]["area"], area),
                       (found["report"]["held"], force)):  # fmt: skip
        if one["error"] is not None:
            assert abs(one["values"][-1] - truth) <= 3 * one["error"]
    assert found["penetration"]["error"] == answer.penetration  # its limit is 0, whatever its order
    assert found["energy"]["order"] is None or 1 < found["energy"]["order"] < 4.1
    assert found["energy"]["verdict"] == "settled"
    assert found["energy"]["values"][-1] == pytest.approx(plain.energy, rel=1e-10)
    assert found["contact"]["area"]["values"][-1] == pytest.approx(plain.area, rel=1e-8)
    json.dumps(dict(answer.record))
    assert " +- " in answer.summary() and "(order " in answer.summary()
    assert "uncertainty" not in plain.record and "+-" not in plain.summary()


@pytest.mark.slow
def test_quadrilaterals_and_rows():
    """Q1 has no geometric levels: two coarser meshes are made; rows of a study have the uncertainties."""
    scene = Scene(mesh={"shape": "rectangle", "cell": "quadrilateral"}, tension=1, load=8, upper=0.2)
    rows = study(scene, {"effects.load": [8, 10]}, cells=16, uncertainty=True)
    assert all(row["uncertainty.energy.order"] > 1 for row in rows)
    assert all(row["uncertainty.contact.upper.force.values"][-1] == row["contact.upper.force"] for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "order"), [("euler", 1), ("bdf2", 2)])
def test_in_time(scheme, order):
    """With [time] the steps are scaled as h: a decay exp(-pi^2 t) sin(pi x) has the order of its scheme at the end."""
    time = {"end": 0.1, "steps": 32, "start": "sin(pi*x)", "scheme": scheme}
    scene = membrane(mesh={"shape": "interval", "cells": 32}, rate=1, time=time, report={"size": "integral(u)"})
    found = solve(scene, uncertainty=True).record["uncertainty"]["report"]["size"]
    true = abs(found["values"][-1] - 2 / math.pi * math.exp(-(math.pi**2) / 10))
    assert true < found["error"] < 3 * true and abs(found["order"] - order) < 0.2


@pytest.mark.slow
def test_equilibria_in_time():
    """A sequence of equilibria has no error in time: at its end it has the uncertainty of the scene at rest."""
    scene, moving = (membrane(load=load, lower=-0.1, **time)
                     for load, time in ((-8, {}), ("-8*t", {"time": {"end": 1, "steps": 1}})))  # fmt: skip
    found = [solve(one, uncertainty=True).record["uncertainty"]["contact"]["lower"]["force"] for one in (scene, moving)]
    assert found[0]["values"] == pytest.approx(found[1]["values"], rel=1e-6)
    assert found[0]["error"] == pytest.approx(found[1]["error"], rel=1e-3)


@pytest.mark.slow
def test_no_uncertainty():
    """Two meshes are too few, and steps must be scaled, too; with a tolerance there is the bound."""
    answer = solve(membrane(load=-1, lower=-0.01), cells=6, uncertainty=True)
    assert "two coarser meshes" in answer.record["uncertainty"]["reason"] and "no uncertainty" in answer.summary()
    moving = Scene(
        mesh={"shape": "interval", "cells": 16}, tension=1, rate=1, time={"end": 1, "steps": 2, "start": "x"}
    )
    assert "that 4 divides" in solve(moving, uncertainty=True).record["uncertainty"]["reason"]
    chosen = moving.change({"time.tolerance": 0.1})
    assert "[time] tolerance" in solve(chosen, uncertainty=True).record["uncertainty"]["reason"]
    with pytest.raises(InputError, match="with a tolerance there is the error bound"):
        solve(membrane(load=-1, lower=-0.1), tol=0.5, uncertainty=True)
