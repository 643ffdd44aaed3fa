"""Where there is no obstacle, its value does not matter; nor does that of a bound that is too far off to act."""

import re

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import InputError, NotConverged, ObstacleProblem, Scene, releases, solve
from fenicsx_obstacle.parallel import largest, smallest, total
from tests.conftest import COMM, slow_except
from tests.helpers import Membrane, outline

FAR = [1e3, 1e6, 1e12, 1e16, 1e20, 1e30, float(PETSc.INFINITY), np.inf] if COMM.size == 1 else [1e12, np.inf]
CELLS = {"P1": ("triangle", 1), "P2": ("triangle", 2), "Q1": ("quadrilateral", 1), "Q2": ("quadrilateral", 2)}


class Plate(Membrane):
    """A membrane with u = 1.25 + 0.3 x on the edge of a square, over a plate at 1.6 in its middle."""

    def __init__(self, element="P1", cells=12, load=0.0):
        cell, degree = CELLS[element]
        super().__init__(dmesh.create_unit_square(COMM, cells, cells, getattr(dmesh.CellType, cell)), degree, load)
        self.edge.interpolate(lambda x: 1.25 + 0.3 * x[0])

    @staticmethod
    def over(far, height=1.6):
        """The plate as a callable."""
        return lambda x: np.where(abs(x[:2] - 0.5).max(axis=0) < 0.3, height, -far)

    def solve(self, lower, method="penalty", **more):
        self.u.x.array[:] = 0.0
        return self.problem(lower=lower).solve(method=method, **more)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["penalty", "vi", "successive"])
@pytest.mark.parametrize("element", CELLS)
def test_its_value_changes_nothing(element, method):
    """Force, steps and boundary values are those with a bound just out of reach."""
    own = Plate(element)
    near, *others = (own.solve(own.over(one), method) for one in (10.0, *FAR))
    for found in others:
        assert found.force.lower == pytest.approx(near.force.lower, rel=1e-9)
        assert largest(COMM, np.abs(found.u.x.array - near.u.x.array)) < 1e-11
        assert found.iterations == near.iterations
        assert largest(COMM, np.abs(found.u.x.array - own.edge.x.array)[outline(own.V)]) <= 4e-16  # ghosts may differ


@pytest.mark.parametrize("eps", [1e-4, 1e-12])
def test_pressures_keep_their_digits(eps):
    """w = -eps p in contact, whatever the bound beside it."""
    own = Plate()
    near, found = (own.solve(own.over(far), eps=eps) for far in (10.0, 1e15))
    assert largest(COMM, np.abs(found.pressure.x.array - near.pressure.x.array)) < 1e-8 * near.force.lower


@pytest.mark.parametrize("method", slow_except(["penalty", "vi", "successive"], "penalty"))
def test_a_constant_bound_out_of_reach(method):
    """As without an obstacle, from a constant start too."""
    own = Plate(load=-3.0)
    expected = own.solve(-10.0, method).at([0.5, 0.5])
    for far in FAR:
        found = own.solve(-far, method)
        assert (found.force.lower, found.area) == (0.0, 0.0)
        assert found.at([0.5, 0.5]) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("element", slow_except(["P1", "P2", "Q1"], "P1"))
def test_contradictions_beside_it(element):
    """An obstacle above the boundary values, and obstacles that cross, are rejected."""
    own = Plate(element)
    for far in (10.0, 1e12, np.inf):
        wrong = {
            "lies below the lower obstacle": {"lower": lambda x, far=far: np.where(x[0] < 0.4, 1.5, -far)},
            "lies above the upper obstacle": {
                "upper": lambda x, far=far: np.where(x[0] < 0.4, 1.2, far),
                "lower": -far,
            },
            "lower is above upper": {
                "lower": lambda x, far=far: np.where(x[0] < 0.4, -0.1, -far),
                "upper": lambda x, far=far: np.where(x[1] < 0.4, -0.1 - 1e-6, far),
            },
        }
        for words, sides in wrong.items():
            with pytest.raises(InputError, match=words):
                own.problem(**sides)


def test_round_off_is_no_contradiction():
    """sin(pi) is not 0: obstacles that meet the boundary value up to round-off are accepted."""
    scene = Scene(
        mesh={"shape": "rectangle", "cells": 8}, tension=1, load=-1, lower="-100*sin(pi*x)*(2 + y)",
        boundary=[{"on": ["left", "right"], "value": 0}],
    )  # fmt: skip
    assert solve(scene).force.lower == 0
    assert solve(scene.change({"obstacle.upper": "-100*sin(pi*x)*(2 + y)"})).force is not None


@pytest.mark.parametrize("far", slow_except([1e20, 1e30, float(PETSc.INFINITY), np.inf], float(PETSc.INFINITY), np.inf))
def test_every_kind_of_datum(far):
    """Functions of this space, of another one and on another mesh, UFL, callables, Constants and numbers."""
    own = Plate(cells=16)
    spaces = own.V, releases.functionspace(own.mesh, "Lagrange", 2), Membrane(cells=8).V
    same, quadratic, elsewhere, there = (fem.Function(V) for V in (*spaces, own.V))
    there.interpolate(own.over(1.0, 1.0))
    for function in (same, quadratic, elsewhere):
        function.interpolate(own.over(far))
    found, none = own.solve(own.over(10.0)).force.lower, fem.Constant(own.mesh, -far)
    x = ufl.SpatialCoordinate(own.mesh)
    for lower in (same, quadratic, ufl.conditional(ufl.gt(there, 0), 1.6, none) + 0 * x[0]):
        assert own.solve(lower).force.lower == pytest.approx(found, rel=1e-9)
    if np.isfinite(far):  # of a coarser mesh, linear between its nodes
        assert own.solve(elsewhere).force.lower > 0
    for number in (-far, none):
        assert own.solve(number).force.lower == 0


@pytest.mark.parametrize("far", [np.inf, 1e20, 1e30])
def test_on_the_wrong_side(far):
    """A lower obstacle of +1e20 leaves no u, nor does an upper one of -1e20; with the other sign there is none."""
    own = Plate()
    with pytest.raises(InputError, match=r"is not a finite number: it is inf at .*; take -1e20 where"):
        own.problem(lower=own.over(-far))
    g = fem.Function(own.V)
    for side, sign, none in (("lower", 1, "-1e20"), ("upper", -1, "1e20")):
        g.x.array[:] = sign * np.inf
        with pytest.raises(InputError, match=f"take {none} where there is no obstacle"):
            own.problem(**{side: g})
        g.x.array[:] = -sign * far
        assert own.problem(**{side: g}).solve().area == 0


PLATE = "where(max(abs(x - 0.5), abs(y - 0.5)) < 0.2, 1.6, -{})"


def where_far(far, **more):
    """A membrane over a raised plate strictly inside a square, as a scene."""
    return Scene(
        mesh={"shape": "rectangle", "cells": 12}, tension=1, load=-0.1, boundary=[{"value": "1.25 + 0.3*x"}],
        lower=PLATE.format(far),
        report={"edge": "at(u, 0, 0.5)", "force": "integral(p)", "low": "min(u)"}, **more,
    )  # fmt: skip


@pytest.mark.slow
def test_scenes_in_time():
    """The start touches the plate, and lies far above the bound beside it."""
    near, far = (
        solve(where_far(one, rate=1, time={"end": 0.01, "steps": 5, "start": "1.6 + 0*x"})).report
        for one in ("10", "1e20")
    )
    assert far["low"] == pytest.approx(near["low"], rel=1e-12)
    assert far["force"] == pytest.approx(near["force"], rel=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("matplotlib_draws")
def test_gaps_are_infinite_without_an_obstacle(folder):
    """In the solution, along lines, and in saved files; the picture is drawn."""
    answer = solve(where_far("1e20"))
    assert answer.at([0.1, 0.5], "gap") == np.inf
    assert answer.at([0.5, 0.5], "gap") == pytest.approx(0, abs=1e-3)
    gap = answer.along([0, 0.5], [1, 0.5]).gap
    assert np.isinf(gap[0]) and np.isfinite(gap).any() and not np.isnan(gap).any()
    answer.save(folder / "plate")
    assert "drawn by" in answer.plot(folder / "plate.png").said
    again = type(answer).read(folder / "plate")
    assert again.at([0.1, 0.5], "gap") == np.inf
    assert again.area == answer.area


@pytest.mark.parametrize("far", slow_except([1.0, 1e2, 1e3, 1e12, np.inf], 1e3, np.inf))
def test_a_minimal_surface(far):
    """Full Newton steps diverge from u = 0; the line search begins where they did. With the energy it comes first, and
    no far bound is ever met."""
    own = Plate(cells=7)
    own.edge.interpolate(lambda x: (x[0] - 0.5) ** 2 - (x[1] - 0.5) ** 2)
    area = ufl.sqrt(1 + ufl.inner(ufl.grad(own.u), ufl.grad(own.u))) * ufl.dx
    forces, steps = [], []
    for energy in (None, area):
        for lower in (own.over(1e6, 0.3), own.over(far, 0.3)):
            own.u.x.array[:] = 0
            problem = ObstacleProblem(ufl.derivative(area, own.u, own.v), own.u, bcs=own.bc, lower=lower, energy=energy)
            solution = problem.solve()
            forces.append(solution.force.lower)
            steps.append(solution.iterations)
    assert forces[1:] == pytest.approx(3 * forces[:1], rel=1e-8)
    assert steps[2] == steps[3] <= 8


def test_a_flat_start():
    """int |u'|^4/4 is convex, but its second derivative is 0 where u is constant: the message says where."""
    mesh = dmesh.create_interval(COMM, 60, [0, 1])
    V = releases.functionspace(mesh, "Lagrange", 1)
    u, v = fem.Function(V), ufl.TestFunction(V)
    energy = ufl.inner(ufl.grad(u), ufl.grad(u)) ** 2 / 4 * ufl.dx - u * ufl.dx
    ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0] * (1 - x[0]), 0))
    F, bcs = ufl.derivative(energy, u, v), [fem.dirichletbc(0.0, ends, V)]
    u.interpolate(lambda x: np.maximum(0.04 - (x[0] - 0.5) ** 2, 0))
    problem = ObstacleProblem(F, u, bcs=bcs, upper=0.25, energy=energy)
    for method in ("vi", "penalty"):
        with pytest.raises(NotConverged, match=r"derivative of F is zero at the start at 3[0-9] of 61 nodes"):
            problem.solve(method=method)
    u.interpolate(lambda x: x[0] * (1 - x[0]))
    assert problem.solve(method="vi").at([0.5]) == pytest.approx(0.25, abs=1e-12)


@pytest.mark.parametrize("element", CELLS)
def test_irreversible(element):
    """u must not decrease: earlier solutions are copied between the obstacles, and do not heal under the load."""
    cell, degree = CELLS[element]
    mesh = dmesh.create_unit_square(COMM, 6, 6, getattr(dmesh.CellType, cell))
    V = releases.functionspace(mesh, "Lagrange", degree)
    u, v, old, load = fem.Function(V), ufl.TestFunction(V), fem.Function(V), fem.Constant(mesh, 0.0)
    F = ((u - old) * v + ufl.inner(ufl.grad(u), ufl.grad(v)) - load * v) * ufl.dx
    left, right = (fem.locate_dofs_geometrical(V, lambda x, end=end: np.isclose(x[0], end)) for end in (0, 1))
    bcs = [fem.dirichletbc(0.0, left, V), fem.dirichletbc(1.0, right, V)]
    problem = ObstacleProblem(F, u, bcs=bcs, lower=old, upper=1.0)
    heights = []
    for value in (5.0, -5.0, -5.0, -20.0):
        load.value = value
        solution = problem.solve()
        before = old.x.array.copy()
        old.x.array[:] = np.clip(u.x.array, solution.lower.x.array, solution.upper.x.array)
        heights.append(old.x.array.copy())
        assert smallest(COMM, old.x.array - before) >= 0 and largest(COMM, old.x.array) <= 1
    assert total(COMM, solution.force.lower) > 0 and solution.force.upper == 0
    if element != "P2":  # whose vertices are free
        assert largest(COMM, np.abs(heights[-1] - heights[1])) == 0
    old.x.array[:] += 2e-4
    with pytest.raises(InputError, match=re.escape("copy it by np.clip(solution.u.x.array, solution.lower.x.array")):
        problem.solve()
