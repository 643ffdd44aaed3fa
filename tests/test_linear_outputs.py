"""Guaranteed errors of linear output quantities: |Q(u) - Q(u_h)| <= ||Q||_* B."""

import math

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.scenes import catalogue
from tests.conftest import COMM, slow_except

SQUARE = {"shape": "rectangle", "cells": 16}
BUBBLE = "x*(1 - x)*y*(1 - y)"  # integral 1/36, with x 1/72; -Laplace is 2 x (1 - x) + 2 y (1 - y)
WITHOUT = "2*x*(1 - x) + 2*y*(1 - y)"
LOAD = f"{WITHOUT} + 3*{BUBBLE}"  # with foundation = 3


def outputs(answer):
    """Value and guaranteed error of each linear quantity."""
    return answer.record["bound"]["outputs"]


@pytest.mark.parametrize("cells", slow_except([8, 32], 8))
@pytest.mark.parametrize("eps", ["h", "h^2", "auto", 1e-10])
def test_string_over_an_obstacle(cells, eps):
    """A string that load presses on a flat obstacle: int u in closed form, for every penalty parameter."""
    load, depth = 8.0, 0.3
    scene = Scene(mesh={"shape": "interval", "cells": cells}, tension=1, load=-load, lower=-depth,
                  report={"volume": "integral(u)", "twice": "2*integral(u) - 1/integral(1 + 0*x)"})  # fmt: skip
    width = math.sqrt(2 * depth / load)  # u = -depth + load/2 (width - x)^2 beside the contact
    exact = -depth + 2 * load / 6 * width**3
    found = outputs(solve(scene, bound=True, eps=eps))
    assert abs(found["volume"]["value"] - exact) <= found["volume"]["error"]
    if eps == "auto":
        assert found["volume"]["error"] <= 3 / cells * abs(exact)
    assert "twice" not in found  # a quotient of integrals is not linear


@pytest.mark.slow
@pytest.mark.parametrize("eps", ["auto", "h"])
@pytest.mark.parametrize("name", slow_except(catalogue.names(), "ball", "string_wedge"))
def test_scenes_with_exact_solutions(name, eps):
    """On every scene of the catalogue the guaranteed errors of two moments of u are above the true ones."""
    scene = catalogue.scene(name)
    weights = {"volume": "1", "moment": "(x + 0.3)^2"}
    report = {key: f"integral({weight}*u)" for key, weight in weights.items()}
    exact = {f"exact_{key}": f"integral({weight}*({scene.tables.exact.u}))" for key, weight in weights.items()}
    fine = solve(scene.change({"mesh.cells": 48, "report": exact}))  # the true value by quadrature; u is not used
    found = outputs(solve(scene.change({"mesh.cells": 12, "report": report}), eps=eps, bound=True))
    for key in weights:
        assert abs(found[key]["value"] - fine.report[f"exact_{key}"]) <= found[key]["error"]


def test_the_norm_of_the_functional_is_sharp():
    """int u on (0, 1) with tension 1 has the norm (1/12)^(1/2), which is the factor of the bound to 2 %."""
    scene = Scene(mesh={"shape": "interval", "cells": 64}, tension=1, load=-1, report={"volume": "integral(u)"})
    answer = solve(scene, bound=True)
    factor = outputs(answer)["volume"]["error"] / answer.bound.total
    assert math.sqrt(1 / 12) <= factor <= 1.02 * math.sqrt(1 / 12)


@pytest.mark.slow
@pytest.mark.parametrize(("element", "foundation"), [("P1", 3.0), ("P1", 0.0), ("P2", 0.0)])
def test_sums_of_integrals(element, foundation):
    """Values of a known u: factors, signs, constants, definitions and polynomial weights."""
    report = {"volume": "integral(u)", "sum": "scale*integral(x*u) - integral(u + y)/2 + pi", "minus": "-integral(u)"}
    more = {"foundation": foundation} if foundation else {}
    scene = Scene(mesh=SQUARE, tension=1, load=f"{WITHOUT} + {foundation}*{BUBBLE}", define={"scale": 4},
                  report=report, **more)  # fmt: skip
    found = outputs(solve(scene, bound=True, element=element))
    exact = {"volume": 1 / 36, "sum": 4 / 72 - 1 / 72 - 1 / 4 + math.pi, "minus": -1 / 36}
    for name, value in exact.items():
        assert abs(found[name]["value"] - value) <= found[name]["error"] <= 0.01
    assert found["volume"]["error"] == pytest.approx(found["minus"]["error"], rel=1e-6)


def test_one_material():
    """The integral over one material; u is known on the unit square, with both materials alike."""
    mesh = dmesh.create_unit_square(COMM, 16, 16)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    left = np.isin(cells, dmesh.locate_entities(mesh, 2, lambda x: x[0] <= 0.5 + 1e-9))
    tags = dmesh.meshtags(mesh, 2, cells, np.where(left, 1, 2).astype(np.int32))
    report = {"half": "integral(u, 'left')", "both": "integral(u) - integral(u, 'right')"}
    scene = Scene(mesh=mesh, cell_tags=tags, cell_names={"left": 1, "right": 2}, tension=1, load=LOAD, foundation=3,
                  report=report)  # fmt: skip
    found = outputs(solve(scene, bound=True))
    for name in report:
        assert abs(found[name]["value"] - 1 / 72) <= found[name]["error"] <= 0.01


@pytest.mark.parametrize("eps", ["h", "h^2", "auto"])
@pytest.mark.parametrize("boundary", [[], [{"on": "left", "flux": 0.001}], [{"on": "left", "spring": 0.1}]])
def test_foundations_and_springs_are_in_the_norm(eps, boundary):
    """A plate on a foundation, pressed against an upper obstacle: u is the obstacle, and int u its mean."""
    scene = Scene(mesh={**SQUARE, "cells": 8}, tension=1, load="10 + x/10", foundation=1, upper=0.5, boundary=boundary,
                  report={"volume": "integral(u)", "moment": "+integral(x*u)"})  # fmt: skip
    found = outputs(solve(scene, bound=True, eps=eps))
    for name, exact in {"volume": 0.5, "moment": 0.25}.items():
        assert 0 < found[name]["value"] - exact <= found[name]["error"] <= 2 * (found[name]["value"] - exact) + 0.1


@pytest.mark.parametrize("cells", [1, 2, 8])
def test_boundary_values_between_the_nodes(cells):
    """u = 0 at the nodes and 4 x (1 - x) between them: the part of the error that u - u_h has on the boundary."""
    weight, steep = "(1 - y)^3", "4*x*(1 - x)"
    scene = Scene(mesh={**SQUARE, "cells": cells}, tension=1, load=0, boundary=[{"on": "bottom", "value": steep}],
                  report={"a": f"integral({weight}*u)", "b": "integral(u)"})  # fmt: skip
    found = outputs(solve(scene, bound=True))
    # u = 2/3 + terms in cos(2 k pi x), which have the mean 0
    for name, exact in {"a": 2 / 3 / 4, "b": 2 / 3}.items():
        assert abs(found[name]["value"] - exact) <= found[name]["error"]


OTHER = {
    "square": "integral(u^2)", "pressure": "integral(p)", "point": "at(u, 0.5, 0.5)", "side": "integral(u, 'left')",
    "weight": "integral(exp(x)*u)", "degree": "integral(x^6*u)", "root": "sqrt(integral(u))",
    "condition": "integral(where(x > y, u, 0))", "product": "integral(u)*integral(u)", "none": "pi",
    "denied": "integral(not u)",
}  # fmt: skip


def test_other_quantities_have_no_guaranteed_error():
    """Nonlinear ones, those that are unbounded in the energy norm, and those whose quadrature is not exact."""
    answer = solve(Scene(mesh=SQUARE, tension=1, load=1, report={**OTHER, "volume": "integral(u)"}), bound=True)
    assert set(outputs(answer)) == {"volume"}
    assert f"(error at most {outputs(answer)['volume']['error']:.2g})" in answer.summary()


def test_only_certified_bounds_give_guaranteed_errors():
    """With drift nothing is proved."""
    scene = Scene(mesh=SQUARE, tension=1, load=1, drift=[1, 0], report={"volume": "integral(u)"})
    assert outputs(solve(scene, bound=True)) == {}


def test_sampled_data_are_named():
    """Samples miss a thin strip of load: the text does not claim more of a quantity than of the bound."""

    def strip(x):
        return np.where(abs(x[0] - 0.4711) < 1e-3, 1e4, 0.0)

    answer = solve(Scene(mesh=SQUARE, tension=1, load=strip, report={"volume": "integral(u)"}), bound=True)
    assert "volume = 0 (error about 0; estimated for the sampled load)" in answer.summary()
    assert outputs(answer)["volume"]["words"] == "estimated for the sampled load"


@pytest.mark.slow
def test_adaptive_meshes():
    """With a tolerance the errors hold on the last mesh."""
    scene = Scene(mesh={**SQUARE, "cells": 8}, tension=1, load=LOAD, foundation=3, report={"volume": "integral(u)"})
    found = outputs(solve(scene, tol=0.05))["volume"]
    assert abs(found["value"] - 1 / 36) <= found["error"] <= 0.06 / 36
