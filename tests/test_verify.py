"""Solutions are checked against their discrete problem: right ones pass, and no wrong one does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import InputError, ObstacleProblem, releases, solve
from fenicsx_obstacle.checkout import ROOT
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM
from tests.helpers import inside, outline


def membrane(cells=12, kind="triangle", degree=1, method="penalty", law="linear", upper=None, eps="auto"):
    """A problem of the caller's own, its solution, and the data that a test may change."""
    mesh = dmesh.create_unit_square(COMM, cells, cells, getattr(dmesh.CellType, kind))
    V = releases.functionspace(mesh, "Lagrange", degree)
    u, v, load = fem.Function(V), ufl.TestFunction(V), fem.Constant(mesh, PETSc.ScalarType(-8.0))
    lower, edge = fem.Function(V), fem.Function(V)
    lower.interpolate(lambda x: -0.1 - 0.2 * (x[0] - 0.4) ** 2 - 0.1 * x[1])
    grad = ufl.grad(u)
    stiffness = {
        "linear": 1.0,
        "film": 1 / ufl.sqrt(1 + ufl.inner(grad, grad)),
        "power": (1e-2 + ufl.inner(grad, grad)) ** 0.5,
        "layers": ufl.conditional(ufl.lt(ufl.SpatialCoordinate(mesh)[0], 0.5), 1.0, 100.0),
        "drift": 1.0,
    }[law]
    shape = 1 if upper is None else 6 * ufl.cos(3 * np.pi * ufl.SpatialCoordinate(mesh)[0])  # presses on both sides
    F = ufl.inner(stiffness * grad, ufl.grad(v)) * ufl.dx - shape * load * v * ufl.dx
    if law == "drift":
        F += ufl.dot(ufl.as_vector((3.0, 1.0)), grad) * v * ufl.dx
    bcs = [fem.dirichletbc(edge, outline(V))]
    problem = ObstacleProblem(F, u, bcs=bcs, lower=lower, upper=upper)
    return problem, problem.solve(method=method, eps=eps), {"load": load, "lower": lower, "edge": edge}


MEMBRANES = [
    {},
    {"method": "vi"},
    {"eps": 1e-3},
    {"eps": 1e-12},
    {"degree": 2},
    {"kind": "quadrilateral"},
    {"upper": 0.01},
    {"law": "layers"},
    {"law": "drift"},
    {"law": "film"},
    {"law": "power", "method": "vi"},
]


@pytest.mark.filterwarnings("ignore:.*penetration is:UserWarning")
@pytest.mark.parametrize("options", MEMBRANES, ids=str)
def test_own_forms(options):
    problem, solution, _ = membrane(**options)
    found = solution.verify()
    assert found, str(found)
    assert problem.verify(problem.solve(eps=options.get("eps", "auto"), method=options.get("method", "penalty")))
    linear = options.get("law", "layers") == "layers"
    assert linear == any("direct solver" in finding.name for finding in found.findings)


QUICK = ("awning", "bearing", "dam", "foam", "lift_off", "two_sided", "hertz_cylinder", "stamp")
SLOW = ("creep", "hertz_sphere", "l_shape", "pollutant", "soap", "wall")


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)])
def test_demos(name):
    found = solve(ROOT / "demos" / f"{name}.toml").verify()
    assert found, str(found)


@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "P1-voronoi", "Q1-gauss"])
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_elements(element, method):
    found = solve("ball", cells=10, element=element, method=method).verify()
    assert found, str(found)


def changed(function, node, by):
    """A copy whose value at an owned node of rank 0 is moved."""
    other = function.copy()
    if COMM.rank == 0:
        other.x.array[node] += by
    other.x.scatter_forward()
    return other


def with_fields(solution, **fields):
    return replace(solution, fields=replace(solution.fields, **fields))


def recorded(solution, **figures):
    contact = {**solution.record["contact"], **figures}
    return replace(solution, record={**solution.record, "contact": contact})


def nodes(solution, touching):
    """Owned nodes of rank 0 in contact, or inside and without contact."""
    flags = solution.contact.x.array
    free = np.ones(len(solution.u.x.array), dtype=bool)
    free[outline(solution.u.function_space)] = False
    own = solution.u.function_space.dofmap.index_map.size_local
    return [node for node in range(own) if free[node] and (flags[node] > 0) == touching]


def stale(key, by):
    def wrong(solution, data, draw):
        value = data[key]
        (value.x.array if isinstance(value, fem.Function) else value.value)[...] += by
        return solution

    return wrong


def in_contact(solution, draw):
    some = nodes(solution, True)
    return some[draw.integers(len(some))] if some else 0


WRONG = {
    "u at a node": lambda s, data, draw: with_fields(s, u=changed(s.u, draw.choice(nodes(s, False) or [0]), 1e-6)),
    "u in contact": lambda s, data, draw: with_fields(s, u=changed(s.u, in_contact(s, draw), -1e-6)),
    "u scaled": lambda s, data, draw: with_fields(s, u=_scaled(s.u, 1 + 1e-7)),
    "u on the edge": lambda s, data, draw: with_fields(s, u=_on_edge(s.u, 1e-8)),
    "pressure": lambda s, data, draw: with_fields(s, pressure=_scaled(s.pressure, 1 + 1e-6)),
    "sign of the pressure": lambda s, data, draw: with_fields(s, pressure=_scaled(s.pressure, -1.0)),
    "pressure without contact": lambda s, data, draw: with_fields(
        s, pressure=changed(s.pressure, draw.choice(nodes(s, False) or [0]), 1e-3)
    ),
    "contact": lambda s, data, draw: with_fields(s, contact=changed(s.contact, in_contact(s, draw), -1.0)),
    "no number": lambda s, data, draw: with_fields(s, u=changed(s.u, in_contact(s, draw), np.nan)),
    "area": lambda s, data, draw: recorded(s, area=s.area * (1 + 1e-6)),
    "force": lambda s, data, draw: recorded(s, lower={"force": s.force.lower * (1 + 1e-6)}),
    "load of before": stale("load", -0.01),
    "obstacle of before": stale("lower", 1e-3),
    "edge of before": stale("edge", 1e-6),
}


def _scaled(function, factor):
    other = function.copy()
    other.x.array[:] *= factor
    return other


def _on_edge(function, by):
    other = function.copy()
    other.x.array[outline(function.function_space)] += by
    return other


@pytest.mark.parametrize("options", [{}, {"method": "vi"}, {"law": "film"}, {"law": "drift", "kind": "quadrilateral"},
                                     {"upper": 0.01}], ids=str)  # fmt: skip
def test_nothing_wrong_passes(options):
    problem, solution, data = membrane(**options)
    assert total(COMM, nodes(solution, True)) != 0
    assert solution.verify()
    kept = {key: (one.x.array if isinstance(one, fem.Function) else one.value).copy() for key, one in data.items()}
    for name, wrong in WRONG.items():
        found = problem.verify(wrong(solution, data, np.random.default_rng(len(name))))
        for key, one in data.items():
            (one.x.array if isinstance(one, fem.Function) else one.value)[...] = kept[key]
        assert not found, f"{name}: {found}"
        assert found.verdict.value == "wrong"
        assert "VIOLATED" in str(found)
    assert problem.verify(solution)


def test_wrong_bodies():
    answer = solve(ROOT / "demos" / "stamp.toml")
    assert answer.verify()
    shift = 1e-3 * largest(COMM, np.abs(answer.u.x.array))
    for other in (
        with_fields(answer, u=changed(answer.u, 5, shift)),
        with_fields(answer, pressure=_scaled(answer.pressure, 1.001)),
        with_fields(answer, contact=_scaled(answer.contact, 0.0)),
    ):
        assert not other.verify()


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
    monkeypatch.setattr("fenicsx_obstacle.check.verification.AT_BOUND", -1.0)
    done = inside("solve", "ball", "--cells", 8, "--method", "vi", "--verify", cwd=tmp_path)
    assert done.returncode == 3
    assert done.stdout.splitlines()[-1] == "verdict: wrong"
    done = inside("solve", ROOT / "demos" / "put.toml", "--verify", cwd=tmp_path)
    assert (done.returncode, "[time]: --verify checks equilibria" in done.stderr) == (2, True)
