"""The Newton loop, its stopping test, SNES VI and (3.4)*: right answers at every eps, in every unit, or none."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import ufl

from fenicsx_obstacle import NotConverged, ObstacleProblem, Scene, solve
from fenicsx_obstacle.algebra import newton
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.algebra.nested import begin_from
from fenicsx_obstacle.algebra.snes import Outcome
from fenicsx_obstacle.algebra.stopping import CYCLING
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.scenes import meshes
from tests.conftest import COMM, DEMOS, MORE_ON_SEVERAL_RANKS, membrane, slow_except
from tests.hard.cases import case
from tests.helpers import Membrane
from tests.theory.iteration import entered

SMALL = [("penalty", "h^2"), ("penalty", 1e-8), ("penalty", 1e-12), ("vi", 1.0)]
TRUE_MAXIMUM = 6.0e-4  # nodal error of the discrete solution on 64 cells; what is more is the solver's


def both(scene, eps):
    """The penalty's answer and the reference on one mesh: two meshes of one scene can be partitioned differently."""
    context = SolverContext(scene.change({"solve.eps": eps}))
    return context.answer(), context.answer(scene.options_with(method="vi"))


@pytest.mark.parametrize("eps", [1e-8, 1e-12, 1e-14])
def test_small_eps_equals_vi(ball, eps):
    """Theorem 3.1 down to eps = 1e-14: the gap form keeps the digits of w = -eps p."""
    answer, reference = both(ball.change({"solve.start": "cold"}), eps)
    assert 8 <= reference.record["newton_iterations"] <= 9
    for key in ("l2", "max", "energy"):
        assert np.isclose(answer.record["errors"][key], reference.record["errors"][key], rtol=1e-3)
    assert np.isclose(reference.record["errors"]["l2"], 1.435e-3, rtol=1e-3)
    assert abs(reference.record["errors"]["max"] - TRUE_MAXIMUM) < 1e-6
    distance = largest(COMM, np.abs(answer.pressure.x.array - reference.pressure.x.array))
    assert distance < max(10 * eps * 4 / reference.level.h**2, 1e-7)


def test_two_obstacles_keep_their_digits_at_tiny_eps():
    """Contact with the obstacle that w did not count from is counted anew: no round-off of heights in p."""
    scene = Scene.read(DEMOS / "two_sided.toml")
    penalty, vi = both(scene, 1e-14)
    assert largest(COMM, np.abs(penalty.pressure.x.array - vi.pressure.x.array)) < 1e-6


def test_another_reference_leaves_u():
    """w is counted from the obstacle that u touches, and u = w + r stays."""
    problem = SolverContext(membrane(load=1, lower=-0.5, upper=0.25)).problem
    fixed, x = problem.fixed, problem.level.points[0, : problem.owned]
    problem.set_reference(0.2 * x - 0.4)
    assert largest(COMM, np.abs(problem.state.r[(x < 0.4) & ~fixed] + 0.5)) == 0  # the nearest obstacle
    u_values = np.where(fixed, 0.0, 0.25 + 0.1 * x)
    problem.w[:] = u_values - problem.state.r
    assert problem.update_reference()
    assert largest(COMM, np.abs(problem.u - u_values)) <= 1e-15
    assert largest(COMM, np.abs(problem.state.r[~fixed] - 0.25)) == 0


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_unconverged_is_no_answer(ball, method):
    with (defaults(f"{method}_", {"snes_max_it": 3}), defaults("penalty_", {"snes_linesearch_type": "basic"}),
          pytest.raises(NotConverged, match="limit of steps") as caught):  # fmt: skip
        solve(ball, method=method, eps=1e-8, start="cold")
    assert caught.value.iterations == 3
    assert caught.value.exit_status == 3


def test_state_of_an_eps_ladder_is_independent_of_its_order(ball):
    """Each value starts cold: a row does not depend on the rows before it."""
    context = SolverContext(ball)
    first = context.answer(ball.options_with(eps=1e-3)).record
    context.answer(ball.options_with(eps=1e-9))
    again = context.answer(ball.options_with(eps=1e-3)).record
    assert first["newton_iterations"] == again["newton_iterations"]
    assert np.isclose(first["energy"], again["energy"], rtol=1e-12)


@pytest.mark.parametrize("eps", [1e-4, 1e-14])
def test_cycling_ends_by_continuation_in_eps(ball, eps, monkeypatch):
    """Where active sets repeat, eps is lowered step by step: the solution is that of a solve that does not cycle."""
    problem = SolverContext(ball.change({"mesh.cells": 16})).problem
    exact = newton.solve_penalty(problem, eps), problem.solution().x.array.copy()
    problem.set_reference(problem.cold_start())
    settled, outcomes, values = newton._settled, list[Outcome](), list[float]()

    def cycles_first(*given):
        values.append(problem.eps)
        outcome = settled(*given)
        outcomes.append(outcome if outcomes else replace(outcome, reason=CYCLING))
        return outcomes[-1]

    monkeypatch.setattr(newton, "_settled", cycles_first)
    found = newton.solve_penalty(problem, eps)
    assert found.converged and len(outcomes) > 2
    steps = [after / before for before, after in pairwise(values[1:])]
    assert values[-1] == eps and min(steps) >= newton.CONTINUATION_FACTOR * (1 - 1e-12) and max(steps) < 1, values
    assert found.iterations == sum(one.iterations for one in outcomes) > exact[0].iterations
    assert largest(COMM, np.abs(problem.solution().x.array - exact[1])) < 1e-12


def test_continuation_in_eps_begins_from_the_start(monkeypatch):
    """Where Newton's method fails, as it may if forms are nonlinear, its last state is no start."""
    problem = SolverContext(Scene(mesh={"shape": "rectangle", "cells": 8}, large_slope=1, load=-1, lower=-0.02)).problem
    start, settled, starts = problem.solution().x.array.copy(), newton._settled, list[np.ndarray]()

    def fails_first(*given):
        starts.append(problem.solution().x.array.copy())
        outcome = settled(*given)
        return outcome if len(starts) > 1 else replace(outcome, reason=CYCLING)

    monkeypatch.setattr(newton, "_settled", fails_first)
    assert newton.solve_penalty(problem, 1e-6).converged
    assert largest(COMM, np.abs(problem.solution().x.array - start)) > 1e-3
    assert largest(COMM, np.abs(starts[1] - start)) <= 1e-15


@pytest.mark.slow
@pytest.mark.parametrize(("method", "eps"), slow_except(SMALL, ("penalty", 1e-8)))
def test_nested_finds_what_a_cold_start_finds_in_few_steps(ball, method, eps):
    """Newton steps on the finest level <= 6, CG steps <= 12, whatever h and eps; the same answer."""
    for cells in (32, 64):
        ours = solve(ball, method=method, eps=eps, cells=cells).record
        cold = solve(ball, method=method, eps=eps, cells=cells, start="cold").record
        assert ours["newton_iterations"] <= 6
        assert ours["krylov_iterations"] <= 12 + MORE_ON_SEVERAL_RANKS
        assert ours["newton_total"] > ours["newton_iterations"]
        for key in ("l2", "max", "energy"):
            assert np.isclose(ours["errors"][key], cold["errors"][key], rtol=1e-6)
        assert np.isclose(ours["contact"]["lower"]["force"], cold["contact"]["lower"]["force"], rtol=1e-9)


# cells for the spiral of Graeser and Kornhuber; for a ridge, where contact is one node wide
HARDLY_SEEN = {"spiral": 128, "ridge": 64}


@pytest.mark.parametrize(("method", "eps"), slow_except(SMALL, ("vi", 1.0)))
@pytest.mark.parametrize("name", HARDLY_SEEN)
def test_contact_that_coarse_meshes_do_not_resolve(name, method, eps):
    """The counts of the ball."""
    record = solve(case(name).base, cells=HARDLY_SEEN[name], method=method, eps=eps).record
    assert record["newton_iterations"] <= 6
    assert record["krylov_iterations"] <= 15 + MORE_ON_SEVERAL_RANKS


@pytest.mark.parametrize("beyond", [0, 1])
def test_coarse_springs_meet_a_shift_with_the_force_of_the_finer_level(beyond):
    """In one dimension they make the coarse matrix the Galerkin product, wherever the edge of contact lies."""
    mesh = {"shape": "interval", "x": [0, 1], "cells": 2048}
    context = SolverContext(Scene(mesh=mesh, tension=1, load=0, lower=-1))
    context.answer()
    grid = context.multigrid
    assert grid is not None
    level = grid.problem.level
    held = level.points[0, : level.owned] < 0.5 + (beyond + 0.5) * level.h
    grid.truncate(np.where(held & ~grid.problem.fixed, np.inf, 0.0))
    assert grid.coarser is not None
    coarse, galerkin = grid.coarser.problem.A, grid.problem.A.ptap(grid.P)
    moves = grid.coarser._moves
    ours, theirs = moves.duplicate(), moves.duplicate()
    coarse.mult(moves, ours)
    galerkin.mult(moves, theirs)
    scale = largest(COMM, np.abs(theirs.array_r))
    assert 0 < scale == largest(COMM, theirs.array_r * moves.array_r)
    assert largest(COMM, np.abs((ours.array_r - theirs.array_r) * moves.array_r)) <= 1e-12 * scale


def test_between_contact_nodes_gaps_are_interpolated():
    """A coarse solution 0.01 below a curved obstacle starts 0.01 below it on the fine level: not on chords."""
    curve, mesh = "-1 - x^2", {"shape": "interval", "x": [0, 1], "cells": 64}
    context = SolverContext(Scene(mesh=mesh, tension=1, load=-1, lower=curve, boundary=[{"value": curve}]))
    problem, coarse = context.problem, context.multigrid.coarser.problem
    coarse.set_reference(coarse.lower)
    coarse.w[~coarse.fixed] = -0.01
    begin_from(problem, coarse)
    x, gap = problem.level.points[0], problem.solution().x.array - problem.data.lower.x.array
    inside = (x > 0.1) & (x < 0.9)
    assert largest(COMM, np.abs(gap + 0.01)[inside]) <= 1e-14


def test_three_dimensions():
    """Nochetto, Siebert, Veeser in a cube: the same counts as in two dimensions, and order 1 in H1."""
    q = "(x^2 + y^2 + z^2)"
    scene = Scene(mesh={"shape": "box", "x": [-1, 1], "y": [-1, 1], "z": [-1, 1], "cells": 16}, tension=1, lower=0,
                  load=f"where({q} > 0.49, -4*(2*{q} + 3*({q} - 0.49)), -8*0.49*(1.49 - {q}))",
                  boundary=[{"value": f"max({q} - 0.49, 0)^2"}], exact=f"max({q} - 0.49, 0)^2")  # fmt: skip
    coarse, record = (solve(scene, eps=1e-8, cells=cells).record for cells in (8, 16))
    assert record["newton_iterations"] <= 6
    assert record["krylov_iterations"] <= 12 + MORE_ON_SEVERAL_RANKS
    assert record["errors"]["max"] < 0.05 and coarse["errors"]["h1"] / record["errors"]["h1"] > 2**0.85


LAWS = {
    "minimal surface": lambda u, v: ufl.dot(ufl.grad(u), ufl.grad(v)) / ufl.sqrt(1 + ufl.dot(ufl.grad(u), ufl.grad(u))),
    "cubic reaction": lambda u, v: ufl.dot(ufl.grad(u), ufl.grad(v)) + 50 * u**3 * v,
    "porous medium": lambda u, v: (1 + 20 * u**2) * ufl.dot(ufl.grad(u), ufl.grad(v)),
}


@pytest.mark.parametrize("eps", [1e-4, 1e-8])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_full_steps_for_nonlinear_forms_without_an_energy(law, degree, eps):
    """The norm of the residual is of the size of 1/eps after the first step: a search on it takes 40 to 130 steps."""
    own = Membrane(degree=degree, cells=24 // degree)
    u, F = own.u, (LAWS[law](own.u, own.v) + 3 * own.v) * ufl.dx
    problem = ObstacleProblem(F, u, bcs=own.bc, lower=-0.1)
    force, steps = [], []
    for how in ({"eps": eps}, {"method": "vi"}):
        u.x.array[:] = 0.0
        solution = problem.solve(**how)
        force.append(solution.force.lower)
        steps.append(solution.iterations)
    assert steps[0] <= 12
    assert force[0] == pytest.approx(force[1], rel=50 * eps + 1e-6)


SQUARES = {"shape": "rectangle", "cell": "quadrilateral", "cells": 8}


def sheared(by):
    """The mesh of `membrane` with x moved by so many y; its diagonals go up to the right."""
    mesh = meshes.build(membrane(), COMM).mesh
    mesh.geometry.x[:, 0] += by * mesh.geometry.x[:, 1]
    return mesh


@pytest.mark.slow
def test_successive_iteration_is_the_same_loop(disk):
    """(3.4)*: from no contact until the active set is the same; the first step is the unconstrained solution."""
    answer = solve(disk, method="successive", eps=1e-6)
    assert answer.history[0].active == 0
    assert answer.history[-1].changed == 0
    unconstrained = solve(disk.change({"obstacle.upper": 10.0}))
    violated = total(COMM, np.count_nonzero(unconstrained.u.x.array[: unconstrained.level.owned] > 0.3 + 1e-12))
    assert answer.history[1].active == violated
    newton = solve(disk, eps=1e-6)
    assert np.isclose(newton.record["energy"], answer.record["energy"], rtol=1e-10)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_nodes_without_obstacle():
    """Most nodes of this scene have no obstacle: their distance to it is infinite, before and after a step."""
    answer = solve(case("valves").on(0), method="successive", eps=1e-6)
    assert answer.record["m_matrix"]
    assert len(answer.history) > 2
    assert entered(answer.history) == 0


@pytest.mark.parametrize(("scene", "holds"), [
    (lambda: membrane(upper=1), True),
    (lambda: membrane(upper=1, mesh={"shape": "rectangle", "y": [0, 50], "diagonal": "crossed", "cells": 8}), True),
    (lambda: membrane(upper=1, mesh=sheared(-0.5)), True),
    (lambda: membrane(upper=1, mesh=sheared(0.5)), False),
    (lambda: membrane(upper=1, mesh={"shape": "box", "cells": 4}), True),
    (lambda: membrane(upper=1, mesh={"shape": "interval"}, tension="1 + 1e6*x"), True),
    (lambda: membrane(upper=1, mesh=SQUARES), True),
    (lambda: membrane(upper=1, mesh=SQUARES).change({"solve.element": "Q2"}), False),
], ids=["right angles", "crossed, stretched", "acute", "obtuse", "box", "interval", "Q1", "Q2"])  # fmt: skip
def test_m_matrix(scene, holds):
    """Off-diagonals of P1 are not positive iff angles opposite to each edge sum to 180 degrees at most."""
    context = SolverContext(scene().change({"boundary": [{"value": 0}]}))
    assert context.problem.m_matrix is holds
    context.answer()
    del context.problem.m_matrix
    assert context.problem.m_matrix is holds  # springs are on the diagonal


@pytest.mark.parametrize("eps", [1e-3, 1e-10])
def test_inexact_systems_are_no_error(disk, eps):
    """Where linear systems are left unsolved, nodes may enter again: the answer is the same."""
    scene = disk.change({"mesh.cells": 32, "solve.method": "successive", "solve.eps": eps})
    with defaults("penalty_", {"ksp_rtol": 0.3, "pc_type": "jacobi"}):
        rough = solve(scene)
    assert entered(rough.history) > 0
    assert np.isclose(rough.record["energy"], solve(scene).record["energy"], rtol=1e-10)
