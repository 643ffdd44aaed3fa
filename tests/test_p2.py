"""P2 with contact at the middles of edges: solved by multigrid, bounded, refined where the error is."""

from contextlib import closing

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene, polynomials, solve
from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation import rt1
from fenicsx_obstacle.estimation.contact import touching
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import COMM, DEMOS, membrane, slow_except

PLANE = ("ball", "biactive", "biactive_power", "cone", "disk_flat", "disk_mu_jump", "halfplane", "nsv", "ring_wedge",
         "smooth_square", "torsion_disk", "two_obstacle_square")  # fmt: skip
NAMES = sorted(PLANE)[:: COMM.size]  # on several ranks they differ by round-off only


def quadratic(name, **changes):
    return catalogue.scene(name).change({"solve.element": "P2", "mesh.cells": 16, **changes})


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(["penalty", "vi"], "vi"))
def test_steps_do_not_grow(method):
    """Multigrid of P1 below P2: from P1 on the same mesh few Newton and CG steps lead to the cold solution."""
    for name in ("ball", "nsv"):
        scene = quadratic(name, **{"solve.method": method, "mesh.cells": 32})
        nested, cold = solve(scene), solve(scene, start="cold")
        assert nested.record["newton_iterations"] <= 4 and nested.record["krylov_iterations"] <= 25
        for key in ("energy", "l2", "max"):
            assert nested.record["errors"][key] == pytest.approx(cold.record["errors"][key], rel=1e-7)


def test_moments_determine_a_flux():
    """The eight functions of RT1 are dual to their moments, and a linear field is found again from its own."""
    inside = polynomials.exponents(3, 4) / 4
    x = inside[:, 1:]
    # the field (1 + 2x, y) on the reference triangle: fluxes and first moments of its edges, and its integral
    fields = rt1._monomials(x)
    field = fields[0] + 2 * fields[2] + fields[5]
    s, w = np.polynomial.legendre.leggauss(3)
    s, w = (s + 1) / 2, w / 2
    corners, found = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), []
    for i in range(3):
        start, end = corners[(i + 1) % 3], corners[(i + 2) % 3]
        at = start + s[:, None] * (end - start)
        flux = (1 + 2 * at[:, 0]) * (end - start)[1] - at[:, 1] * (end - start)[0]
        found += [flux @ w, flux @ (w * (2 * s - 1))]
    moments = np.array([*found, 1 / 2 + 1 / 3, 1 / 6])
    assert np.allclose(np.einsum("d,dpx->px", moments, rt1.reference_fields(inside)), field)


@pytest.mark.slow
@pytest.mark.parametrize("perturb", [0.0, 0.3])
def test_the_flux_is_in_balance(perturb):
    """div sigma = -(Pi_1 f + lambda - nu + rho) in each cell, the normal part and its moment are continuous, and the
    patches of free vertices close."""
    for name in ("ball", "two_obstacle_square"):
        with closing(SolverContext(quadratic(name, **{"mesh.perturb": perturb}))) as context:
            context.answer(bound=True)
            element, problem = context.estimator.element, context.problem
            flux = element.equilibration.flux(problem.solution().x.array, *touching(problem))
            simplices = element.simplices
            load = element.equilibration.load.moments.sum(axis=(1, 2))
            others = (flux.lower - flux.upper + flux.rest).mean(axis=1) * simplices.area
            scale = largest(COMM, np.abs(flux.normal))
            assert largest(COMM, np.abs(flux.normal.sum(axis=1) + load + others)) < 1e-14 * max(scale, 1)
            facets, count = simplices.facets.ravel(), np.bincount(simplices.facets.ravel())
            inside = count == 2
            both = np.bincount(facets, weights=flux.normal.ravel())[inside]
            # out of the other cell, along the other direction: the moment is the same number
            moments = flux.moments[:, [1, 3, 5]].ravel()
            order = np.argsort(facets, kind="stable")
            twice = np.flatnonzero(facets[order][1:] == facets[order][:-1])
            jump = moments[order][twice] - moments[order][twice + 1]
            assert largest(COMM, np.abs(both)) < 1e-14 * scale and largest(COMM, np.abs(jump)) < 1e-14 * scale
            assert largest(COMM, np.abs(flux.rest)) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(NAMES, *NAMES[:3]))
def test_no_known_error_is_above_its_bound(name):
    """From a soft obstacle to a hard one, and nowhere more than 6 times the error."""
    scene = quadratic(name)
    with closing(SolverContext(scene)) as context:
        for eps in ("h", "1e-10"):
            answer = context.answer(scene.options_with(eps=eps), bound=True)
            bound, error = answer.bound, answer.record["errors"]["energy"]
            assert bound.words in ("certified", "certified for the sampled obstacle")
            assert error <= bound.total <= 6 * error
        assert bound.penalty < 1e-5 * bound.total and bound.algebraic < 1e-8 * bound.total


@pytest.mark.variant
@pytest.mark.slow
def test_adaptive_order():
    """Refined where the bound says so, the energy error of the ball falls faster than N^(-1.7/2), with its bound; on
    uniform meshes it is N^(-3/4), since u is in H^(5/2-)."""
    scene = quadratic("ball")
    rows = []
    with closing(Refinement(scene, COMM).meshes(unknowns=8000)) as meshes:
        for context, answer in meshes:
            record = context.measured(answer).record
            rows.append((record["dofs"], record["errors"]["energy"], answer.bound.total))
            assert record["errors"]["energy"] <= answer.bound.total <= 4 * record["errors"]["energy"]
    dofs, error, bound = np.log(np.array(rows)).T
    for values in (error, bound):
        assert np.polyfit(dofs / 2, values, 1)[0] < -1.7
    first, second = (solve(scene, cells=cells).record["errors"]["energy"] for cells in (16, 64))
    assert np.log(first / second) / np.log(4) == pytest.approx(1.5, abs=0.2)


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "two_obstacle_square"])
def test_estimates_from_samples_are_near_the_bound(name):
    """Without enclosures of the obstacles the error is found within 10 %, and is no bound."""
    with closing(SolverContext(quadratic(name))) as context:
        bound = context.answer(bound=True, errors=False).bound
        context.estimator.sampled = True
        estimate = context.estimator.bound()
        assert bound.certified and not estimate.certified and not estimate.guaranteed
        assert 0.9 * bound.total < estimate.total < 1.01 * bound.total
        context.estimator.sampled = False
        assert context.estimator.bound().total == bound.total


@pytest.mark.variant
@pytest.mark.slow
def test_the_last_mesh_has_a_bound():
    """On the meshes before it the error is estimated, unless there is a budget; the ball to 1 % with a tenth of the
    unknowns that P1 needs."""
    answer = solve(quadratic("ball"), tol=0.01)
    record = answer.record
    assert record["adaptive"]["reached"] and record["errors"]["energy"] <= answer.bound.total and answer.dofs < 8000
    path = answer.record["adaptive"]["path"]
    assert [mesh["sampled"] for mesh in path] == [*[True] * (len(path) - 1), False]
    assert (
        answer.bound.certified
        and path[-1]["total"] == answer.bound.total <= 0.01 * answer.bound.total / answer.bound.relative
    )
    limited = solve(quadratic("ball"), tol=0.01, budget="10min")
    assert not any(mesh.sampled for mesh in limited.adaptive.path)
    few = solve(quadratic("ball"), tol=1e-4, budget="2000 unknowns")
    assert not few.adaptive.reached and few.bound.certified and not few.adaptive.path[-1].sampled


@pytest.mark.variant
@pytest.mark.slow
def test_free_sides_and_other_effects():
    """Nothing leaves through free sides; effects besides tension and load are refused, and surfaces in space."""
    exact = "sin(pi*x/2)*sin(pi*y)"
    free = membrane(
        load=f"1.25*pi^2*{exact}", lower=-10, exact=exact,
        boundary=[{"on": ["left", "top", "bottom"], "value": 0}],
    ).change({"solve.element": "P2"})  # fmt: skip
    answer = solve(free, bound=True)
    error = answer.record["errors"]["energy"]
    assert answer.bound.words == "certified" and error <= answer.bound.total <= 1.5 * error
    with pytest.raises(InputError, match="not for foundation"):
        solve(membrane(load=1, upper=0.05, foundation=20).change({"solve.element": "P2"}), bound=True)
    bearing = Scene.read(DEMOS / "bearing.toml").change({"solve.element": "P2", "report": {}})
    with pytest.raises(InputError, match="not for P2 on triangle cells in 3D"):
        solve(bearing, bound=True)
