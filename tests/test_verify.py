"""Solutions are checked against their discrete problem: right ones pass, and no wrong one does."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, ObstacleProblem, Scene, solve
from fenicsx_obstacle.algebra.stopping import Stopping
from fenicsx_obstacle.check.finding import violated
from fenicsx_obstacle.check.reference import FreeRows, active_sets
from fenicsx_obstacle.check.verification import Reason, solved_again, verify
from fenicsx_obstacle.checkout import ROOT
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM, slow_except
from tests.helpers import Membrane, inside, outline
from tests.test_elastic import Box, strain_of, stress


def membrane(cells=12, kind="triangle", degree=1, method="penalty", law="linear", upper=None, eps="auto"):
    """A problem of the caller's own, its solution, and the data that a test may change."""
    own = Membrane(cells=cells, cell=getattr(dmesh.CellType, kind), degree=degree, load=-8.0)
    u, v, lower, x = own.u, own.v, fem.Function(own.V), ufl.SpatialCoordinate(own.mesh)
    lower.interpolate(lambda x: -0.1 - 0.2 * (x[0] - 0.4) ** 2 - 0.1 * x[1])
    grad = ufl.grad(u)
    stiffness = {
        "linear": 1.0,
        "film": 1 / ufl.sqrt(1 + ufl.inner(grad, grad)),
        "power": (1e-2 + ufl.inner(grad, grad)) ** 0.5,
        "layers": ufl.conditional(ufl.lt(x[0], 0.5), 1.0, 100.0),
        "drift": 1.0,
    }[law]
    shape = 1 if upper is None else 6 * ufl.cos(3 * np.pi * x[0])  # presses on both sides
    F = ufl.inner(stiffness * grad, ufl.grad(v)) * ufl.dx - shape * own.f * v * ufl.dx
    if law == "drift":
        F += ufl.dot(ufl.as_vector((3.0, 1.0)), grad) * v * ufl.dx
    problem = ObstacleProblem(F, u, bcs=[own.bc], lower=lower, upper=upper)
    return problem, problem.solve(method=method, eps=eps), {"load": own.f, "lower": lower, "edge": own.edge}


MEMBRANES = [{}, {"method": "vi"}, {"eps": 1e-3}, {"eps": 1e-12}, {"degree": 2}, {"kind": "quadrilateral"},
             {"upper": 0.01}, {"law": "layers"}, {"law": "drift"}, {"law": "film"},
             {"law": "power", "method": "vi"}]  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*penetration is:UserWarning")
@pytest.mark.parametrize("options", MEMBRANES, ids=str)
def test_own_forms(options):
    problem, solution, _ = membrane(**options)
    found = solution.verify()
    assert found, str(found)
    assert problem.verify(problem.solve(eps=options.get("eps", "auto"), method=options.get("method", "penalty")))
    names = {finding.name for finding in found.findings}
    assert {Reason.ENERGY_NORM, Reason.UNITS_COUNTS, Reason.UNITS_VALUES, Reason.RANKS} <= names


QUICK = ("awning", "bearing", "foam", "two_sided", "stamp")
SLOW = ("dam", "hertz_cylinder", "lift_off", "creep", "hertz_sphere", "l_shape", "pollutant", "soap", "wall")


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_demos(name):
    found = solve(ROOT / "demos" / f"{name}.toml").verify()
    assert found, str(found)


@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "P1-voronoi", "Q1-gauss"])
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_elements(element, method):
    found = solve("ball", cells=10, element=element, method=method).verify()
    assert found, str(found)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_the_load_of_error_bounds(element):
    """A bound needs the means of the load in the cells, which differ from its samples: solutions with and without one
    are right, saved ones too, and one solve of a problem does not change the next."""
    mesh = {"shape": "rectangle", "cells": 6}
    scene = Scene(mesh=mesh, tension=1, load="where(x < 0.503, -20, 0)", lower=-0.1).change({"solve.element": element})
    assert all(solve(scene, **options).verify() for options in ({"bound": True}, {"tol": 0.4}))
    problem = scene.problem()
    solutions = [problem.solve(bound=bound) for bound in (False, True, False, True)]
    assert all(solution.verify() for solution in solutions)
    energies = [solution.energy for solution in solutions]
    assert np.allclose(energies[2:], energies[:2], rtol=1e-9) and abs(energies[1] / energies[0] - 1) > 1e-9


def with_fields(solution, **fields):
    return replace(solution, fields=replace(solution.fields, **fields))


def recorded(solution, contact=None, **figures):
    contact = {**solution.record["contact"], **(contact or {})}
    return replace(solution, record={**solution.record, **figures, "contact": contact})


def changed(solution, name, make):
    """A solution with other values of a Function, from a function of its owned values."""
    other = getattr(solution.fields, name).copy()
    space = other.function_space.dofmap
    own = space.index_map.size_local * space.index_map_bs
    other.x.array[:own] = make(other.x.array[:own].copy())
    other.x.scatter_forward()
    return with_fields(solution, **{name: other})


def range_of(function):
    return largest(COMM, function.x.array) + largest(COMM, -function.x.array)


def at_one(draw, by, among=None):
    """Moves one value, on the first rank that has one of those to draw from."""

    def make(values):
        choices = np.arange(len(values)) if among is None else np.flatnonzero(among[: len(values)])
        ranks = COMM.allgather(len(choices))
        if COMM.rank == next((rank for rank, count in enumerate(ranks) if count), -1):
            values[draw.choice(choices)] += by
        return values

    return make


def on_edge(solution, by):
    other = solution.u.copy()
    other.x.array[outline(other.function_space)] += by
    return with_fields(solution, u=other)


def spread(solution):
    """The same force, as one pressure everywhere in contact."""
    flags = solution.contact.x.array > 0
    mean = total(COMM, solution.pressure.x.array[flags]) / max(total(COMM, flags), 1.0)
    return changed(solution, "pressure", lambda p: np.where(flags[: len(p)], mean, p))


def off_the_obstacle(solution):
    """Contact ends at half of the nodes, and their pressure with it."""
    gone = solution.contact.x.array > 0
    gone[::2] = False
    other = changed(solution, "pressure", lambda p: np.where(gone[: len(p)], 0.0, p))
    return changed(other, "contact", lambda flags: np.where(gone[: len(flags)], 0.0, flags))


def in_contact(solution):
    return solution.contact.x.array > 0


WRONG = {
    "u at a node": lambda s, draw: changed(s, "u", at_one(draw, 1e-5 * range_of(s.u))),
    "u everywhere": lambda s, draw: changed(s, "u", lambda u: u + 1e-6 * range_of(s.u)),
    "u scaled": lambda s, draw: changed(s, "u", lambda u: (1 + 1e-7) * u),
    "u is 0": lambda s, draw: changed(s, "u", np.zeros_like),
    "u on the edge": lambda s, draw: on_edge(s, 1e-8),
    "u is no number": lambda s, draw: changed(s, "u", at_one(draw, np.nan)),
    "pressure": lambda s, draw: changed(s, "pressure", lambda p: (1 + 1e-6) * p),
    "sign of the pressure": lambda s, draw: changed(s, "pressure", np.negative),
    "no pressure": lambda s, draw: changed(s, "pressure", np.zeros_like),
    "pressure at a node": lambda s, draw: changed(
        s, "pressure", at_one(draw, 1e-5 * range_of(s.pressure), in_contact(s))
    ),
    "pressure without contact": lambda s, draw: changed(
        s, "pressure", at_one(draw, 1e-5 * range_of(s.pressure), ~in_contact(s))
    ),
    "spread pressure": lambda s, draw: spread(s),
    "pressure that is no number": lambda s, draw: changed(s, "pressure", at_one(draw, np.inf)),
    "u and pressure scaled": lambda s, draw: changed(
        changed(s, "u", lambda u: (1 + 1e-7) * u), "pressure", lambda p: (1 + 1e-7) * p
    ),
    "contact that ends": lambda s, draw: off_the_obstacle(s),
    "contact": lambda s, draw: changed(s, "contact", at_one(draw, -1.0, in_contact(s))),
    "contact everywhere": lambda s, draw: changed(s, "contact", np.ones_like),
    "area": lambda s, draw: recorded(s, {"area": s.area * (1 + 1e-6)}),
    "force": lambda s, draw: recorded(s, {pressed(s): {"force": getattr(s.force, pressed(s)) * (1 + 1e-6)}}),
    "force that is no number": lambda s, draw: recorded(s, {pressed(s): {"force": np.nan}}),
    "penetration": lambda s, draw: recorded(s, penetration=s.penetration + 1e-6 * range_of(s.u)),
    "range": lambda s, draw: recorded(s, u_range=range_of(s.u) * (1 + 1e-6)),
    "energy": lambda s, draw: recorded(s, energy=(s.energy or 1.0) * (1 + 1e-6)),
    "eps": lambda s, draw: recorded(s, eps=2 * (s.eps or 1e-3)),
    "eps below 0": lambda s, draw: recorded(s, eps=-(s.eps or 1e-3)),
    "the other method": lambda s, draw: recorded(s, eps=1e-3 if s.eps is None else None),
}
OF_FIELDS = {
    "lower obstacle": lambda s, draw: changed(s, "lower", lambda g: g + 1e-6 * range_of(s.u)),
    "ghosts of u": lambda s, draw: ghosts(s, "u"),
    "ghosts of the pressure": lambda s, draw: ghosts(s, "pressure"),
}
OF_BODIES = {
    "normals": lambda s, draw: tabled(s, normals=s.nodes.normals[:, ::-1]),
    "areas": lambda s, draw: tabled(s, areas=s.nodes.areas * (1 + 1e-6)),
    "pressure of the table": lambda s, draw: tabled(s, pressure=s.nodes.pressure * (1 + 1e-6)),
    "gap of the table": lambda s, draw: tabled(s, gap=s.nodes.gap + 1e-6),
    "points of the table": lambda s, draw: tabled(s, points=s.nodes.points[:-1]),
    "resultant": lambda s, draw: recorded(s, {"resultant": (s.nodes.resultant * (1 + 1e-6)).tolist()}),
    "moment": lambda s, draw: recorded(s, {"moment": s.nodes.moment() * (1 + 1e-6) + 1e-6}),
    "stress": lambda s, draw: changed(s, "von_mises", lambda stress: stress * (1 + 1e-6)),
    "gap": lambda s, draw: changed(s, "gap", lambda gap: gap + 1e-6),
}
STALE = {
    "load of before": ("load", -0.01),
    "a load that is hardly another": ("load", -1e-7),
    "obstacle of before": ("lower", 1e-3),
    "edge of before": ("edge", 1e-6),
}


def pressed(solution):
    return "lower" if solution.force.lower else "upper"


def tabled(solution, **columns):
    return with_fields(solution, nodes=replace(solution.nodes, **columns))


def ghosts(solution, name):
    """Values that other ranks own are moved; on one rank, or without a ghost, the first value."""
    other = getattr(solution.fields, name).copy()
    other.x.array[-1 if COMM.size > 1 else 0] += 1e-5 * range_of(other)
    return with_fields(solution, **{name: other})


def all_fail(judge, solution, kinds):
    """No wrong solution of these kinds passes."""
    for name, wrong in kinds.items():
        found = judge(wrong(solution, np.random.default_rng(len(name))))
        assert not found, f"{name}: {found}"
        assert found.verdict.value == "wrong"
        assert f"{found.reason}" in str(found)
        assert "VIOLATED" in str(found)
    assert judge(solution)


@pytest.mark.parametrize("options", [{}, {"method": "vi"}, {"law": "film"}, {"law": "drift", "kind": "quadrilateral"},
                                     {"upper": 0.01}, {"degree": 2, "method": "vi"}, {"law": "layers"}],
                         ids=str)  # fmt: skip
def test_nothing_wrong_passes(options):
    problem, solution, data = membrane(**{"cells": 8, **options})
    assert total(COMM, in_contact(solution)) > 0
    all_fail(problem.verify, solution, {**WRONG, **OF_FIELDS})
    for name, (key, by) in STALE.items():
        values = data[key].x.array if isinstance(data[key], fem.Function) else data[key].value
        kept = values.copy()
        values[...] += by
        assert not problem.verify(solution), name
        values[...] = kept
    assert problem.verify(solution)
    assert solution.verify().reason is None


@pytest.mark.parametrize(("scene", "options"), [("drum", {"cells": 60}), ("ball", {"cells": 6, "element": "P2"}),
                                                ("ball", {"cells": 6, "element": "P1-voronoi", "method": "vi"}),
                                                ("two_sided", {"cells": 12})], ids=str)  # fmt: skip
def test_nothing_wrong_passes_in_scenes(scene, options):
    answer = solve(ROOT / "demos" / f"{scene}.toml", **options)
    problem = Problem(answer.data())
    all_fail(lambda other: verify(problem, other), answer, {k: w for k, w in WRONG.items() if k != "u on the edge"})


TURNED = ("vi", {"angle": 0.7})


@pytest.mark.parametrize(
    ("method", "options"), slow_except([TURNED, ("penalty", {}), ("penalty", {"large": True, "degree": 2})], TURNED),
    ids=str,
)  # fmt: skip
def test_nothing_wrong_passes_in_bodies(method, options):
    body = Box(4 if "degree" in options else 10, **options)
    problem = body.problem(stress=stress(strain_of(body.u), 0.3))
    few = {name: WRONG[name] for name in list(WRONG)[:: 4 if method == "vi" else 1]}
    all_fail(problem.verify, problem.solve(method=method), {**few, **OF_BODIES})


def test_nothing_hides_behind_a_residual_that_is_infinite_at_zero():
    """F(0) is no number of 1/u: it is no scale of forces."""
    own = Membrane(cells=6)
    own.u.x.array[:] = own.edge.x.array[:] = 1.0
    F = ufl.inner(ufl.grad(own.u), ufl.grad(own.v)) * ufl.dx + 4 / own.u * own.v * ufl.dx
    problem = ObstacleProblem(F, own.u, bcs=[own.bc], lower=0.8)
    all_fail(problem.verify, problem.solve(), WRONG)


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("start", [1e3, -1e4])
def test_a_far_start_leaves_no_round_off(method, start):
    """An obstacle that was near the start, 1e3 off for a u of 1e-3, is no reference for u."""
    own = Membrane(load=-0.08)
    own.u.interpolate(lambda x: start * np.sin(np.pi * x[0]) * np.sin(np.pi * x[1]))
    problem = own.problem(lower=lambda x: np.where(x[0] < 0.5, -1e-3, -1e3))
    found = problem.verify(problem.solve(method=method))
    assert found, str(found)


def rows_of(cells=8, contrast=1.0, eps=None):
    """The solved rows of a string of two tensions above a floor, whose right half is soft, on one rank."""
    n, floor = 2 * cells - 1, -0.02
    stiff = np.where(np.arange(2 * cells) < cells, 1.0, 1 / contrast)
    A = scipy.sparse.diags([stiff[:-1] + stiff[1:], -stiff[1:-1], -stiff[1:-1]], [0, 1, -1], format="csr")
    load = -0.02 * stiff[1:]
    start = FreeRows(
        A, load, np.ones(n), np.full(n, floor), np.full(n, np.inf), np.zeros(n), *np.zeros((2, n)), eps, False
    )
    w = active_sets(A.tocsc(), load, *start[2:6], eps)
    push = A @ w - load
    return start._replace(w=w, unbalanced=np.where(w <= floor, 0.0, push), noise=1e-15 * (abs(A) @ np.abs(w)))


@pytest.mark.serial
@pytest.mark.parametrize("contrast", [1.0, 1e9])
def test_what_is_solved_again_sees_what_is_small(contrast):
    """A change of the soft part by 1e-5 of the range leaves forces below the tolerance of a balance of sums."""
    rows = rows_of(contrast=contrast)
    assert not violated(solved_again(rows, 0.02, 1e-8))
    moved = rows.w.copy()
    moved[-3] += 2e-7
    other = rows._replace(w=moved, unbalanced=rows.unbalanced + rows.A @ (moved - rows.w))
    assert Reason.LARGEST_DIFFERENCE in {finding.name for finding in violated(solved_again(other, 0.02, 1e-8))}
    hidden = other._replace(unbalanced=rows.unbalanced)  # of a balance that was not computed
    names = {finding.name for finding in violated(solved_again(hidden, 0.02, 1e-8))}
    assert {Reason.ENERGY_NORM, Reason.LARGEST_DIFFERENCE, Reason.RANKS} <= names


@pytest.mark.serial
@pytest.mark.parametrize("eps", [None, 1e-3])
def test_a_constant_with_a_unit_is_found(eps, monkeypatch):
    """A solver with a tolerance of its own unit takes other steps in other units."""
    rows = rows_of(eps=eps)
    assert not violated(solved_again(rows, 0.02, 1e-8))
    old = Stopping.__call__

    def absolute(self, snes, iteration, norms):
        reason = old(self, snes, iteration, norms)
        return 2 if self.history[-1].unbalanced < 1 else reason

    monkeypatch.setattr(Stopping, "__call__", absolute)
    names = {finding.name for finding in violated(solved_again(rows, 0.02, 1e-8))}
    assert names & {Reason.UNITS_COUNTS, Reason.UNITS_VALUES}


@pytest.mark.slow
def test_what_has_no_check():
    problem, solution, _ = membrane()
    del problem
    with pytest.raises(InputError, match="does not exist any more"):
        solution.verify()
    smaller = membrane(cells=6)
    with pytest.raises(InputError, match="of another mesh or element"):
        membrane()[0].verify(smaller[1])
    with pytest.raises(InputError, match="checks equilibria"):
        solve(ROOT / "demos" / "put.toml").verify()


@pytest.mark.serial
def test_command(tmp_path, monkeypatch):
    done = inside("solve", "ball", "--cells", 8, "--verify", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == "verdict: right"
    monkeypatch.setattr("fenicsx_obstacle.check.verification.ROUNDED", -1.0)
    done = inside("solve", "ball", "--cells", 8, "--method", "vi", "--verify", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stdout.splitlines()[-1] == "verdict: wrong"
    done = inside("solve", "ball", "--cells", 8, "--method", "vi", "--verify", "--json", "-", cwd=tmp_path)
    assert done.returncode == 3 and json.loads(done.stdout)["scene"] == "ball"
    assert done.stderr.splitlines()[-1] == "verdict: wrong"
    done = inside("solve", ROOT / "demos" / "put.toml", "--verify", cwd=tmp_path)
    assert (done.returncode, "[time]: --verify checks equilibria" in done.stderr) == (2, True)
