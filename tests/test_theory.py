"""Kikuchi's theorems: the orders, constants and signs of their statements, on meshes small enough for tests."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.cli import commands
from fenicsx_obstacle.parallel import largest
from tests.conftest import COMM, membrane, slow_except
from tests.theory import in_eps, in_h, show, totals
from tests.theory.digits import EPS, GAP, PLAIN, RESIDUAL, digits
from tests.theory.limits import approach, extremes
from tests.theory.mesh_sequences import JUMP, VI, MeshSequence, errors, gap
from tests.theory.monotone import Line, hat, penalties, ramp
from tests.theory.samples import sample
from tests.theory.show import conclusion, split, table
from tests.theory.statement import Finding, Found, Statement, find

HALFPLANE = MeshSequence("halfplane", "halfplane", JUMP, cells=(16, 32, 64))


@pytest.fixture(scope="module")
def halfplane():
    """Three meshes, with eps far below h^2, above it, and along powers of h."""
    return gap(HALFPLANE, (in_eps.SMALL, "h", "h^2", "h^3"), COMM)


def verdicts(findings):
    return {finding.quantity: finding.verdict for finding in findings}


def all_hold(findings):
    return "FAILS" not in verdicts(findings).values()


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


@pytest.mark.parametrize("name, s", [("disk_flat", 1 / 2), ("smooth_square", 3 / 2), ("ring_wedge", -1 / 2)])
def test_order_in_eps(name, s):
    """Theorem 3.3 at fixed h: order 1 in eps, of u_eps - u_h and of p_eps - p_h, whatever the pressure."""
    findings = in_eps.at_fixed_h(gap(MeshSequence(name, name, s, cells=(16,)), in_eps.DECADES, COMM))
    assert set(verdicts(findings).values()) == {"sharp"}


@pytest.mark.slow
def test_orders_in_h_at_fixed_eps(halfplane):
    """A jump: eps h^(-1/2) and eps h^(-3/2) where (5.5) claims eps/h and eps/h^2."""
    assert set(verdicts(in_eps.at_fixed_eps(halfplane)).values()) == {"not sharp"}


@pytest.mark.slow
def test_orders_along_powers_of_h(halfplane):
    """A jump: 3/4, 3/2, 5/2 for u_eps - u_h and 1/4, 1/2, 3/2 for p_eps - p_h, with eps = h, h^2, h^3."""
    findings = in_eps.together(halfplane, "h")
    assert [finding.expected for finding in findings] == [3 / 4, 1 / 4, 3 / 2, 1 / 2, 5 / 2, 3 / 2]
    assert set(verdicts(findings).values()) == {"not sharp"}


@pytest.mark.slow
def test_paper_is_sharp_for_a_pressure_barely_in_l2():
    """p = -(f + s/r): eps/h and eps/h^2 are what is seen."""
    cone = gap(MeshSequence("cone", "cone", 0.0, cells=(16, 32, 64)), (in_eps.SMALL,), COMM)
    assert set(verdicts(in_eps.at_fixed_eps(cone)).values()) == {"sharp"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    slow_except(
        [{}, {"mesh.diagonal": "crossed"}, {"mesh.cell": "quadrilateral"},
         {"mesh.cell": "quadrilateral", "solve.element": "Q2"}, {"mesh.perturb": 0.25}],
        {"mesh.diagonal": "crossed"},
    ),
    ids=["right", "criss-cross", "Q1", "Q2", "perturbed"],
)  # fmt: skip
def test_energy_of_the_difference(changes):
    """|u_eps - u_h|_a <= eps |p_h|_a for any pair, mesh and eps; above h^2 the pair does not matter."""
    epsilons = (1e-1, 1e-3, 1e-6, "h^2")
    found, right = (
        gap(MeshSequence("", "disk_flat", JUMP, some, cells=(16,)), epsilons, COMM) for some in (changes, {})
    )
    assert all(max(part) <= 1 + 1e-9 for part in found.part.values())
    assert found.e["h^2"][0] == pytest.approx(right.e["h^2"][0], rel=0.05)


def test_pressure_stalls_on_criss_cross_meshes():
    """(5.7) is sharp: under a curved obstacle p_h stays |p|_0 / sqrt(8) from p; p_eps, eps = h^2, comes nearer."""
    bent = errors(replace(in_h.BENT, cells=(16, 32)), [VI, "h^2"], COMM)
    assert verdicts(in_h.plateau([bent])) == {"|p - p_h|_0, smooth_square, criss-cross, N = 32": "sharp"}
    assert set(verdicts(in_h.filtered(bent)).values()) == {"not sharp"}
    assert bent["h^2", "pressure_l2"][1] < bent[VI, "pressure_l2"][1] / 2
    assert all_hold(in_h.claims(in_h.PRESSURES, bent, VI, 0, {"pressure_l2": 0}))


@pytest.mark.slow
@pytest.mark.parametrize("one", slow_except(in_h.CURED, in_h.CURED[0]), ids=lambda one: one.words)
def test_voronoi_areas_cure_it(one):
    """The same meshes with Voronoi areas: order 3/2."""
    seen = errors(replace(one, cells=(16, 32)), [VI], COMM)
    assert all_hold(in_h.claims(in_h.PRESSURES, seen, VI, 0, {"pressure_l2": 3 / 2}))


@pytest.mark.slow
def test_flat_obstacles_hide_it():
    """Under a flat obstacle the same mesh has the order 1/2 of a jump."""
    seen = errors(in_h.FLAT[0], [VI], COMM)
    assert all_hold(in_h.claims(in_h.PRESSURES, seen, VI, 0, {"pressure_l2": 1 / 2}))


@pytest.mark.slow
def test_quadratic_elements():
    """(5.6), (5.8) with Q2: u with a jump of p is in H^(5/2-), order 3/2 in H1 and, of p, in the dual norm."""
    seen = errors(in_h.CEILING_Q2, [VI], COMM, dual=True)
    assert all_hold(in_h.claims(in_h.DISPLACEMENTS, seen, VI, 1, {"h1": 3 / 2, "dual": 3 / 2}))


def test_totals_with_eps_of_order_h_squared():
    """(5.9): order 1 in H1 for u, more in L2 and, for p, in the dual norm; order 1/2 for a jump of p in L2."""
    seen = errors(replace(totals.SEQUENCE, cells=(32, 64, 128)), ["h^2"], COMM, dual=True)
    assert all_hold(in_h.claims(totals.WHERE, seen, "h^2", 1, {"h1": 1, "l2": 2, "dual": 3 / 2, "pressure_l2": 1 / 2}))


def test_ends_of_the_hypotheses():
    """f = 0; g out of reach; contact everywhere; K_h empty."""
    assert [finding.verdict for finding in extremes(COMM)] == ["holds"] * 4 + ["needs hypothesis"]


@pytest.mark.parametrize("name", ["disk", "ball"])
def test_limit(name):
    """u_eps -> u_h and p_eps -> p_h, with order 1 in the end; the nodal bound is sharp."""
    seen = approach(sample(name, 16), COMM, (1e-1, 1e-3, 1e-5, 1e-7, 1e-9))
    assert np.all(np.diff(seen.energy) < 0) and np.all(np.diff(seen.pressure) < 0)
    for falling in (seen.energy, seen.highest, seen.pressure):
        assert falling[-1] / falling[-2] == pytest.approx(1e-2, rel=1e-2)
    assert seen.above[-1] == pytest.approx(1, rel=1e-4)


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
    assert np.all(np.diff(seen.energy) < 0) and np.all(np.diff(seen.pressure) < 0)
    assert seen.above[-1] > 0.9


def test_no_force_at_all():
    """f = 0 below g > 0: u = 0 and p = 0 at any eps, and for the inequality itself."""
    for change in ({"solve.eps": 1e-14}, {"solve.method": "successive"}, {"solve.method": "vi"}):
        answer = SolverContext(membrane(load=0, upper=0.1, boundary=[{"value": 0}]).change(change)).answer()
        assert largest(COMM, np.abs(answer.u.x.array)) < 1e-16  # the round-off of g
        assert largest(COMM, np.abs(answer.pressure.x.array)) == 0


@pytest.mark.slow
def test_monotone_penalties():
    """J((u - g)^+) is not monotone nor J(I - P_K); that one, and the penalty in L2, are monotone."""
    found = penalties(COMM)
    verdicts = [finding.verdict for finding in found.findings]
    assert verdicts == ["needs hypothesis"] * 3 + ["holds"] * 3


def test_counterexample_by_hand():
    """With v <= 0 and a ramp of 1 on the hat it is (u, ramp) - 9 (u, u) in H1: 0.005 - 9 (0.05 + 1/6000)."""
    line = Line(COMM)
    u, v = line.function(hat), line.function(lambda x: 10 * hat(x) - ramp(x))
    value = line.product("H1", line.positive(u), line.combined(1, u, -1, v))
    assert value == pytest.approx(-0.4465, rel=1e-10)


def test_projection_stays_in_the_set_and_is_a_projection():
    """P_K u <= 0, P_K P_K u = P_K u, and u - P_K u is orthogonal to P_K u in H1, K being a cone."""
    line = Line(COMM)
    u = line.random_pairs()[0][0]
    inside = line.projected(u)
    assert largest(COMM, inside.x.array) <= 1e-12
    again = line.combined(1, line.projected(inside), -1, inside)
    assert line.product("H1", again, again) < 1e-18
    size = line.product("H1", u, u)
    assert abs(line.product("H1", line.combined(1, u, -1, inside), inside)) < 1e-9 * size


def test_digits():
    """Down to 1e-14 and beyond, p_eps - p_h falls like eps; stored as u, 3 digits are left at 1e-14."""
    found = digits(COMM)
    assert all(finding.verdict != "FAILS" for finding in found.findings)
    errors = {curve.label: dict(zip(EPS, curve.y, strict=True)) for curve in found.panels[0].curves}
    for form in (GAP, RESIDUAL):
        assert 0.99e-7 < errors[form][EPS[10]] / errors[form][EPS[3]] < 1.01e-7
    assert errors[PLAIN][EPS[10]] > 1e6 * errors[GAP][EPS[10]]
