"""The error bound with axial symmetry, point loads, and obstacles on the boundary: never below the true error."""

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.estimation.axial_flux import AxialFlux
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.parallel import largest

COMM = MPI.COMM_WORLD
HEIGHT = "y^2 - x^2/2"  # on a foundation 3, a flux and springs on the right
STOP = {"on": "right", "lower": -0.2, "upper": 3}
WALL = {"on": "right", "lower": "y*(1 - y)*x - 20*max(abs(y - 0.5) - 0.25, 0)^2",
        "flux": "y*(1 - y) - max(1 - 16*(y - 0.5)^2, 0)"}  # fmt: skip


def meridian(cells, **data):
    """A cylinder around the axis by its meridian, with moved vertices."""
    return Scene(mesh={"shape": "rectangle", "cells": cells, "perturb": 0.2}, axial_symmetry=True, **data)


def ball(cells, x=(0, 1), **data):
    """u = (x^2 + y^2 - R^2)^2 outside of a ball, 0 inside, where the obstacle presses with the force 2 per volume."""
    u = "(x^2 + y^2 - 0.2)^2"
    outside = f"where(x^2 + y^2 < 0.2, 0, {u})"
    return Scene(
        mesh={"shape": "rectangle", "cells": cells, "x": list(x), "y": [-1, 1]}, tension=1, axial_symmetry=True,
        lower=0, load="where(x^2 + y^2 < 0.2, -2, -20*(x^2 + y^2) + 2.4)", exact=outside,
        boundary=[{"on": ["right", "top", "bottom"] + (["left"] if x[0] > 0 else []), "value": outside}], **data,
    )  # fmt: skip


SCENES = {
    "disk": (lambda: Scene(mesh={"shape": "interval", "cells": 32}, tension=1, load=4, axial_symmetry=True,
                           exact="1 - x^2", boundary=[{"on": "right", "value": 0}]), 1 + 1e-6),
    "annulus": (lambda: Scene(mesh={"shape": "rectangle", "cells": 8, "x": [0.1, 1], "perturb": 0.2}, tension=2,
                              axial_symmetry=True, exact="log(x)",
                              boundary=[{"on": ["left", "right"], "value": "log(x)"}]), 2.5),
    "cylinder": (lambda: meridian(8, tension="1 + x*y", load="-(4*y + 6*x*y^2) - x^3", exact="x^2*y",
                                  boundary=[{"on": ["right", "top", "bottom"], "value": "x^2*y"}]), 2.5),
    "support": (lambda: meridian(8, tension=1, load=f"3*({HEIGHT})", foundation=3, exact=HEIGHT, boundary=[
        {"on": ["top", "bottom"], "value": HEIGHT}, {"on": "right", "flux": f"-1 + 2*({HEIGHT})", "spring": 2}]), 3.0),
    "ball": (lambda: ball(8), 2.5),
    "string": (lambda: Scene(mesh={"shape": "interval", "cells": 10}, tension=2, load=-1, boundary=[{"value": 0}],
                             point_load=[{"at": 0.3, "force": 4}, {"at": 0.7, "force": -1}],
                             exact="x^2/4 + x - 2*max(x - 0.3, 0) + max(x - 0.7, 0)/2"), 1 + 1e-6),
    "stop": (lambda: Scene(mesh={"shape": "interval", "cells": 16}, tension=1, load=-1, exact="x^2/2 - 0.7*x",
                           boundary=[{"on": "left", "value": 0}, STOP]), 1.5),
    "wall": (lambda: Scene(mesh={"shape": "rectangle", "cells": 8}, tension=1, load="2*x", exact="y*(1 - y)*x",
                           boundary=[{"on": ["left", "bottom", "top"], "value": 0}, WALL]), 8.0),
}  # fmt: skip


@pytest.mark.parametrize("eps", ["h^2", 1e-10])
@pytest.mark.parametrize("name", SCENES)
def test_certified_bounds_are_above_the_error(name, eps):
    """Closed forms: the bound is certified, not below the true error, and not many times as large."""
    scene, most = SCENES[name]
    bound = solve(scene(), bound=True, eps=eps, comm=COMM).record["bound"]
    assert bound["words"] == "certified" and bound["guaranteed"]
    assert 1 - 1e-9 <= bound["effectivity"] <= most


@pytest.mark.parametrize("at", [0.37, 0.501, 0.5 + 1e-12])
def test_point_load_inside_a_cell(at):
    """The nodal values are exact, and the bound is the error of the cell, F (h t (1 - t)/tension)^(1/2)."""
    scene = Scene(
        mesh={"shape": "interval", "cells": 16}, tension=2, point_load=[{"at": at, "force": 4}], boundary=[{"value": 0}]
    )
    bound = solve(scene, bound=True, comm=COMM).bound
    t = 16 * at % 1
    assert bound.words == "certified"
    assert bound.total == pytest.approx(4 * (t * (1 - t) / 16 / 2) ** 0.5, abs=2e-6 if t < 1e-9 else 1e-9)


@pytest.mark.parametrize(("cells", "at"), [(20, 0.3), (10, 0.7), (20, 0.15)])
def test_a_point_load_beside_its_node_by_round_off(cells, at):
    """It is at the distance d of the node's last digit, and the error F (d/tension)^(1/2) is 1e-8 of u."""
    scene = Scene(mesh={"shape": "interval", "cells": cells}, tension=2, point_load=[{"at": at, "force": 4}],
                  boundary=[{"value": 0}])  # fmt: skip
    solution = solve(scene, bound=True, comm=COMM)
    apart = -largest(COMM, -np.abs(solution.level.points[0] - at))
    assert 0 < apart < 1e-15
    assert 4 * (apart / 2) ** 0.5 * (1 - 1e-9) <= solution.bound.total < 1e-7


def test_flux_with_axial_symmetry():
    """On a mesh with moved vertices the flux r tau is continuous, 0 on the axis, and balances load and contact."""
    context = SolverContext(ball(6).change({"mesh.perturb": 0.2}), COMM)
    context.answer(bound=True)
    problem, element = context.problem, context.estimator.element
    simplices, lower = element.simplices, problem.gaps()[0] <= 0
    flux = element.equilibration.flux(problem.solution().x.array, lower, np.zeros_like(lower))
    force = element.equilibration.load.moments.sum(axis=1)
    force += simplices.area * (flux.lower + flux.rest[simplices.dofs]).mean(axis=1)
    scale = largest(COMM, np.abs(flux.normal))
    assert largest(COMM, np.abs(flux.normal.sum(axis=1) + force)) < 1e-12 * scale
    on_axis = (simplices.radius == simplices.radius.sum(axis=1, keepdims=True)) & (simplices.radius > 0)
    assert largest(COMM, np.abs(flux.normal[on_axis])) <= 1e-12 * scale
    both = np.bincount(simplices.facets.ravel(), weights=flux.normal.ravel())
    inside = np.bincount(simplices.facets.ravel()) == 2
    assert largest(COMM, np.abs(both[inside])) <= 1e-14 * scale
    # the integral of a^2 r (1/r - 1/r_T)^2 is below its bound, also in cells that touch the axis in one vertex
    ring, (points, weights) = AxialFlux(simplices), rule(2, 20)
    r = simplices.radius @ points.T
    kappa = np.sqrt(simplices.area * ((r * (1 / r - (simplices.area / simplices.size)[:, None]) ** 2) @ weights))
    far = np.count_nonzero(simplices.radius == 0, axis=1) < 2
    assert np.all(kappa[far] <= ring.variation[far]) and largest(COMM, ring.variation[far] - 3 * kappa[far]) <= 0
    context.close()


@pytest.mark.slow
def test_what_has_no_bound_with_axial_symmetry():
    """u given on the axis, and effects that no proof covers: an indicator, with the reason."""
    data = {"tension": 1, "load": 4, "axial_symmetry": True}
    square = Scene(mesh={"shape": "rectangle", "cells": 4}, boundary=[{"value": 0}], **data)
    assert "u is given on the axis" in solve(square, bound=True, comm=COMM).bound.words
    steep = Scene(mesh={"shape": "interval", "cells": 8}, boundary=[{"on": "right", "value": 0}], large_slope=1, load=1,
                  axial_symmetry=True)  # fmt: skip
    assert "large_slope is not linear" in solve(steep, bound=True, comm=COMM).bound.words


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "wall"])
def test_a_tolerance_is_reached(name):
    """Adaptive meshes with axial symmetry, and with an obstacle on a side: the true error is below the tolerance."""
    answer = solve(SCENES[name][0](), tol=0.1, comm=COMM)
    assert answer.record["adaptive"]["reached"] and answer.bound.guaranteed
    assert answer.record["errors"]["energy"] <= 0.1 * answer.bound.total / answer.bound.relative


def test_obstacle_on_a_face():
    """Tetrahedra: u = x y (1 - y) z (1 - z) touches a wall at x = 1, which presses with the force 1 per area."""
    u = "x*y*(1 - y)*z*(1 - z)"
    wall = {"on": "right", "lower": u, "flux": "y*(1 - y)*z*(1 - z) - 1"}
    others = {"on": ["left", "front", "back", "bottom", "top"], "value": 0}
    load = "2*x*(y*(1 - y) + z*(1 - z))"
    scene = Scene(mesh={"shape": "box", "cells": 4}, tension=1, load=load, exact=u, boundary=[others, wall])
    bound = solve(scene, bound=True, comm=COMM).record["bound"]
    assert 1 < bound["effectivity"] < 9


def test_an_obstacle_above_what_is_given_beside_it():
    """Beside a node that is held, an obstacle that touches there is above its nodal interpolant: no bound."""
    wall = {"on": "right", "lower": "y*(1 - y)", "flux": "-1"}
    scene = Scene(
        mesh={"shape": "rectangle", "cells": 4},
        tension=1,
        boundary=[{"on": ["left", "bottom", "top"], "value": 0}, wall],
    )
    assert "or what is given" in solve(scene, bound=True, comm=COMM).bound.words
