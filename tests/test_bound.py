"""The error bound: its flux is in balance, no known error is above it, and it is near."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import Scene, polynomials, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.contact_set import touching
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import COMM, ON_SEVERAL_RANKS, membrane, slow_except

SQUARE = {"shape": "rectangle", "cells": 16}
ROUND_OFF = 1e-12


def halved_rule(times: int) -> tuple[np.ndarray, np.ndarray]:
    """The rule in each of the 4^times parts of a triangle with its edges halved."""
    (points, weights), parts = rule(2), polynomials.halvings(3, times)
    return (points @ parts).reshape(-1, 3), np.tile(weights, len(parts)) / len(parts)


@cache
def scenes() -> dict[str, Scene]:
    """Scenes with known solutions; all their hypotheses hold."""
    jump = {"w": "sin(2*pi*x)*sin(pi*y)", "d": "hypot(x - 1/4, y - 1/2)", "mu": "where(x < 1/2, 1, 1000)"}
    corner = {"phi": "where(theta < -1e-9, theta + 2*pi, theta)", "s": "r^(2/3)*sin(2*phi/3)"}
    smooth = "sin(pi*x)*sin(pi*y)"
    dome = "1 - x^2 - y^2/2"
    given = {
        "no contact": Scene(mesh=SQUARE, tension=1, load=f"2*pi^2*{smooth}", lower=-10, exact=smooth),
        "perturbed": Scene(mesh={**SQUARE, "perturb": 0.3}, tension=1, load=f"2*pi^2*{smooth}", exact=smooth),
        "free side": Scene(
            mesh=SQUARE, tension=1, load="1.25*pi^2*sin(pi*x/2)*sin(pi*y)", lower=-10, exact="sin(pi*x/2)*sin(pi*y)",
            boundary=[{"on": ["left", "top", "bottom"], "value": 0}],
        ),
        "L-shape": Scene(
            mesh={"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 16}, tension=1, define=corner, lower=-10,
            boundary=[{"value": "s"}], exact="s",
        ),
        "full contact": Scene(mesh=SQUARE, tension=1, load=-1, lower=smooth, exact=smooth),
        "full contact, edge too": Scene(
            mesh={**SQUARE, "cells": 32}, tension=1, lower=dome, boundary=[{"value": dome}], exact=dome
        ),
        "jump of tension": Scene(
            mesh=SQUARE, tension="mu", define=jump, load="5*pi^2*w + 10*max(1 - d^2/0.15^2, 0)",
            upper="w/mu + 20*max(d - 0.15, 0)^2", exact="w/mu",
        ),
        "tension that varies": Scene(
            mesh=SQUARE, tension="1 + x*y", exact=smooth, lower=-10,
            load=f"(1 + x*y)*2*pi^2*{smooth} - pi*y*cos(pi*x)*sin(pi*y) - pi*x*sin(pi*x)*cos(pi*y)",
        ),
    }  # fmt: skip
    for name in ("ball", "biactive", "biactive_power", "cone", "disk_flat", "disk_mu_jump", "halfplane", "nsv",
                 "ring_wedge", "smooth_square", "torsion_disk", "two_obstacle_square"):  # fmt: skip
        given[name] = catalogue.scene(name).change({"mesh.cells": 32})
    return given


EPS = ("h", "h^2", "1e-10")
NAMES = sorted(scenes())[:: COMM.size]  # on several ranks they differ by round-off only
QUADRATIC = sorted(set(catalogue.names()) & set(scenes()))[:: COMM.size]


@cache
def measured(name: str, element: str = "P1") -> dict[str, SimpleNamespace]:
    """Bounds and true errors of a scene by eps; with P2 on half as many cells a side."""
    found, scene = {}, scenes()[name]
    if element == "P2":
        scene = scene.change({"solve.element": element, "mesh.cells": 16})
    context = SolverContext(scene)
    for eps in EPS:
        answer = context.answer(scene.options_with(eps=eps), bound=True)
        of_v, _ = context.exact.errors(answer.bound.admissible, answer.pressure, answer.record["eps"])
        found[eps] = SimpleNamespace(
            bound=answer.bound, error=answer.record["errors"]["energy"], error_v=of_v["energy"]
        )
    context.close()
    return found


@pytest.mark.parametrize("name", slow_except(NAMES, *NAMES[:4]))
def test_no_known_error_is_above_its_bound(name):
    for eps in EPS:
        row = measured(name)[eps]
        # of r^(2/3) no slope is known at the corner
        words = "certified for the sampled boundary value" if name == "L-shape" else "certified"
        assert row.bound.words == words
        assert row.error <= row.bound.total
        assert row.error_v <= row.bound.admissible_total
        assert row.bound.total <= row.bound.admissible_total + row.bound.penalty + row.bound.data + ROUND_OFF


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(QUADRATIC, *QUADRATIC[:3]))
def test_no_known_error_is_above_its_bound_with_p2(name):
    """From a soft obstacle to a hard one, and nowhere more than 6 times the error."""
    rows = measured(name, "P2")
    for row in rows.values():
        assert row.bound.words in ("certified", "certified for the sampled obstacle")
        assert row.error <= row.bound.total <= 6 * row.error
    hard = rows["1e-10"].bound
    assert hard.penalty < 1e-5 * hard.total and hard.algebraic < 1e-8 * hard.total


@pytest.mark.slow
@pytest.mark.serial  # the medians are of all scenes
def test_bounds_are_near():
    """Effectivity with eps <= h^2: of v_h median 1.7 and maximum 3.4, of u_h 2 and 3.3. The maximum of v_h is that of
    full contact up to the boundary, where it is proved and no longer sampled.

    A sharp edge across the cells is left out: half of the bound is then what v_h must keep from it, and u_h need not.
    """
    rows = [measured(name)[eps] for name in NAMES for eps in EPS[1:] if name != "ring_wedge"]
    of_v = [row.bound.admissible_total / row.error_v for row in rows]
    of_u = [row.bound.total / row.error for row in rows]
    assert np.median(of_v) <= 1.7 and max(of_v) <= 3.4
    assert np.median(of_u) <= 2 and max(of_u) <= 3.3


def test_parts_tell_what_to_do():
    """The penalty part is of order eps and vanishes; the discretisation part hardly depends on eps; without a contact
    that bends, indicators add up to the bound."""
    for name in ("disk_flat", "nsv", "two_obstacle_square"):
        coarse, fine = measured(name)["h^2"].bound, measured(name)["1e-10"].bound
        assert fine.penalty < 1e-6 * fine.total < coarse.penalty
        assert 0.8 < fine.discretisation / coarse.discretisation < 1.2
        assert fine.algebraic < 1e-8 * fine.total
        assert 0.8 < total(COMM, fine.indicator) / fine.total < 1.2


def test_given_values_stay_beside_a_boundary_obstacle():
    """v_h is above a concave obstacle on a side, by more than the obstacle at its nodes; not where u is given."""
    sides = [{"on": ["left", "bottom", "top"], "value": 0}, {"on": "right", "lower": "y*(1 - y)/2"}]
    context = SolverContext(membrane(boundary=sides))
    v = context.answer(bound=True).bound.admissible.x.array
    dofs, values = context.problem.data.fixed
    assert largest(COMM, np.abs(v - values.x.array)[dofs]) < ROUND_OFF
    free = np.setdiff1d(np.flatnonzero(context.problem.level.points[0] > 1 - 1e-9), dofs)
    y = context.problem.level.points[1, free]
    assert largest(COMM, -(v[free] - y * (1 - y) / 2)) < -ROUND_OFF


@pytest.mark.parametrize(
    ("boundary", "more"),
    [("0.1*sin(5*x)^2", {}), ("0.3 - x^2 - y^2/2", {}), ("0.1*sin(5*x)^2", {"foundation": "1 + x"})],
)
def test_the_bound_of_the_admissible_state_is_a_root(boundary, more):
    """||u - v_h|| <= x + eta_g + eta_p for the root x > 0 of x^2 = S x + eta_C, where eta_C is the integral of contact
    force times gap; terms that are 0 in one scene are not in the other."""
    dome = "0.3 - x^2 - y^2/2" if boundary.startswith("0.3") else "0.3 - 2*((x - 1/2)^2 + (y - 1/2)^2)"
    context = SolverContext(membrane(lower=dome, boundary=[{"value": boundary}], **more))
    bound = context.answer(bound=True).bound
    problem, element = context.problem, context.estimator.element
    terms = element.terms(problem.solution().x.array, *touching(problem, element.reach))

    def norm(squares):
        return np.sqrt(total(COMM, squares))

    eta_g, eta_p, eta_C = norm(element.rim_energy()), norm(terms.cover), total(COMM, terms.contact)
    assert eta_g > 0 and (eta_p > 0) == (boundary == dome)
    lacking = norm(terms.lacking)
    assert (lacking > 0) == bool(more)
    S = norm(terms.admissible_balanced) + element.friedrichs * (norm(terms.rest) + lacking) + eta_g + eta_p
    root = bound.admissible_total - eta_g - eta_p
    assert root**2 == pytest.approx(S * root + eta_C, rel=1e-9)
    simplices, (points, weights) = element.simplices, halved_rule(2)
    gap = terms.admissible[simplices.dofs] @ points.T - simplices.values(context.scene.field(dome, "lower"), points)
    work = simplices.area * terms.flux.lower.mean(axis=1) * (gap @ weights)
    assert 0.5 * eta_C < total(COMM, work) <= eta_C * (1 + 1e-12)


@ON_SEVERAL_RANKS
@pytest.mark.slow
def test_the_same_on_any_number_of_ranks():
    """Patches cross the ranks: bound and parts agree with those of one rank to 1e-10, with P2 to 1e-9; ranks without
    cells are served."""
    for name, cells, element in (("ball", 32, "P1"), ("two_obstacle_square", 16, "P1"), ("free side", 1, "P1"),
                                 ("ball", 16, "P2"), ("two_obstacle_square", 16, "P2")):  # fmt: skip
        scene = scenes()[name].change({"mesh.cells": cells, "solve.eps": "h^2", "solve.element": element})
        together, alone = (solve(scene, comm=comm, bound=True).bound for comm in (COMM, MPI.COMM_SELF))
        apart = 1e-10 if element == "P1" else 1e-9
        for key in ("total", "admissible_total", "discretisation", "penalty", "data"):
            one, other = getattr(together, key), getattr(alone, key)
            assert abs(one - other) <= apart * alone.total, (name, key)
        assert np.isclose(total(COMM, together.indicator), alone.indicator.sum(), rtol=10 * apart)


def test_units_and_heights_change_nothing():
    """Heights times 1e-9 and tension times 1e11: the relative bound stays; heights may be counted from anywhere."""
    plain = solve(membrane(load=1, upper="0.05 + (x - 0.4)^2"), eps=1e-6, bound=True).bound
    small = solve(membrane(tension=1e11, load=100, upper="1e-9*(0.05 + (x - 0.4)^2)"), eps=1e-17, bound=True).bound
    high = solve(
        membrane(load=1, upper="1000.05 + (x - 0.4)^2", boundary=[{"value": 1000}]), eps=1e-6, bound=True
    ).bound
    assert np.isclose(plain.relative, small.relative, rtol=1e-7)
    assert np.isclose(plain.total, high.total, rtol=1e-6)


def test_of_what_is_no_solution():
    """The bound holds for any u_h, converged or not; of random scenes test_random.py has more."""
    context, noise = SolverContext(scenes()["ball"].change({"mesh.cells": 16})), 0.3
    answer, problem = context.answer(), context.problem
    x, y = problem.level.points[:2]
    free = np.ones(len(x), dtype=bool)
    free[problem.data.fixed[0]] = False
    answer.u.x.array[free] += noise * (np.sin(37 * x + 11 * y) * np.cos(91 * y))[free]
    problem.set_reference(answer.u.x.array[: problem.owned])
    bound = context.estimator.bound()
    errors, _ = context.exact.errors(answer.u, answer.pressure, answer.record["eps"])
    assert bound.words == "certified" and noise / 10 < errors["energy"] <= bound.total * (1 + 1e-9)
    context.close()


@pytest.mark.parametrize(("name", "sign"), [("ball", 1), ("disk_flat", -1)])
def test_nodal_enclosure(name, sign):
    """u_eps - eps max|p_eps| <= u_h <= u_eps at every node where the stiffness is an M-matrix; mirrored for lower."""
    scene = catalogue.scene(name).change({"mesh.cells": 16, "solve.eps": 1e-3})
    context = SolverContext(scene)
    answer, reference = context.answer(bound=True), context.answer(scene.options_with(method="vi"))
    assert "bound" not in reference.record
    enclosure, distance = answer.record["enclosure"], sign * (reference.u.x.array - answer.u.x.array)
    assert enclosure["guaranteed"] and "at most" in answer.summary()
    assert smallest(COMM, distance) >= -1e-10
    assert 0.5 * enclosure["width"] < largest(COMM, distance) <= enclosure["width"] * (1 + 1e-9) + 1e-10
    assert answer.record["bound"]["effectivity"] >= 1
    context.close()
