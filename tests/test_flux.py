"""The flux of a solution, tension times slope, at points and along lines; of live solutions and of read ones."""

import numpy as np
import pytest
from dolfinx import fem

from fenicsx_obstacle import Answer, InputError, Scene, Solution, releases, solve
from tests.conftest import COMM, membrane
from tests.helpers import Membrane

STRING = {"mesh": {"shape": "interval", "cells": 8}, "load": -1, "lower": -10, "boundary": [{"value": 0}]}
PLANE = {"mesh": {"shape": "rectangle", "cells": 8}, "load": -2, "lower": -0.1, "boundary": [{"value": 0}]}
POINTS = np.array([[0.21, 0.13], [0.47, 0.52], [0.83, 0.37], [0.71, 0.94]])


def test_a_strip_whose_tension_jumps():
    """-(mu u')' = -1, mu = 1 and then 3: the flux is x - 3/8. P2 has the solution: the flux is exact everywhere, also
    where mu and u' jump."""
    mesh = {"shape": "rectangle", "cells": 4}
    sides = [{"on": ["left", "right"], "value": 0}]
    answer = solve(Scene(mesh=mesh, tension="where(x < 1/2, 1, 3)", load=-1, lower=-10, boundary=sides), element="P2")
    line = answer.along([0.03, 0.41], [0.97, 0.41], n=11)  # the sixth point has x = 1/2
    assert np.abs(line.flux - np.column_stack([line.points[:, 0] - 3 / 8, np.zeros(11)])).max() < 1e-11


def slope_law(factor):
    return lambda slope: factor(np.sum(slope**2, axis=1))[:, None] * slope


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        ({"tension": 2.5}, lambda slope: 2.5 * slope),
        ({"tension": [[2, "1/2"], ["1/2", 1]]}, lambda slope: slope @ np.array([[2, 0.5], [0.5, 1]])),
        ({"large_slope": 3}, slope_law(lambda squared: 3 / np.sqrt(1 + squared))),
        ({"power_law": {"exponent": 3, "coefficient": 2}}, slope_law(lambda squared: 2 * np.sqrt(squared + 1e-12))),
    ],
)
def test_every_tension(effect, law, folder):
    """The flux is what each law makes of the slope; of a read answer it is the same."""
    scene = Scene(**PLANE, **effect)
    answer = solve(scene)
    flux, slope = answer.at(POINTS, "flux"), answer.at(POINTS, "slope")
    assert np.allclose(flux, law(slope), rtol=1e-12, atol=1e-14) and np.abs(flux).max() > 0.01
    problem = scene.problem(COMM).solve(eps=answer.eps)
    assert np.allclose(problem.at(POINTS, "flux"), flux, atol=1e-6)
    answer.save(folder)
    assert np.allclose(Answer.read(folder).at(POINTS, "flux"), flux, atol=1e-13)


def test_the_next_solve_leaves_the_flux_of_the_last():
    """A tension that depends on the slope is that of the solution's own u."""
    problem = Scene(large_slope=1, **PLANE).problem(COMM)
    first = problem.solve(eps=1e-6)
    flux = first.at(POINTS, "flux")
    assert np.abs(problem.solve(eps=1.0).at(POINTS, "flux") - flux).max() > 0.01
    assert np.array_equal(first.at(POINTS, "flux"), flux)


@pytest.mark.parametrize("element", ["P2", "Q1", "Q2"])
def test_read_with_other_elements(element, folder):
    """Where u and the tension are polynomials in a cell the flux is their product; it is read as it was."""
    cell = "quadrilateral" if element[0] == "Q" else "triangle"
    scene = membrane(mesh={"shape": "rectangle", "cells": 6, "cell": cell}, tension="1 + x", load=-4, lower=-0.1)
    answer = solve(scene, element=element)
    # the tension has one value in a cell, or as many as V_h has, at points that are moved into the cell by 1e-6 of it
    x = POINTS[:, 0]
    mu = 1 + ((np.floor(6 * x) + 0.5) / 6 if element == "Q1" else x)
    flux = answer.at(POINTS, "flux")
    assert np.allclose(flux, mu[:, None] * answer.at(POINTS, "slope"), rtol=1e-6)
    answer.save(folder)
    assert np.allclose(Answer.read(folder).at(POINTS, "flux"), flux, rtol=1e-10, atol=1e-13)


def test_a_tension_that_depends_on_time(folder):
    """Of a scene with [time] it is the flux at the end, read as it was."""
    answer = solve(Scene(tension="1 + 3*t", time={"end": 1, "steps": 2}, **STRING))
    x = (np.arange(8) + 0.5)[:, None] / 8
    assert np.abs(answer.at(x, "flux") - (x - 1 / 2)).max() < 1e-12
    assert np.abs(answer.along(x[0], x[-1], n=8).flux - (x - 1 / 2)).max() < 1e-12
    assert answer.at(x[0], "flux").shape == (1,)
    answer.save(folder)
    assert np.abs(Answer.read(folder).at(x, "flux") - (x - 1 / 2)).max() < 1e-12


@pytest.mark.slow
def test_where_the_tension_is_not_known(folder):
    """A form hides it, and a file has no tension that was a Python object: a message in place of values."""
    own = Membrane(cells=4, load=-4.0)
    mesh, found = own.mesh, own.problem(lower=-1).solve()
    for solution in (found, _saved(found, folder, Solution)):
        with pytest.raises(InputError, match="the tension of a form is not known"):
            solution.at([0.3, 0.4], "flux")
        line = solution.along([0, 0], [1, 1], n=5)
        assert line.flux is None and np.isfinite(line.slope).all()
    mu = fem.Function(releases.functionspace(mesh, "DG", 0))
    mu.x.array[:] = 2
    answer = solve(Scene(**{**PLANE, "mesh": mesh}, tension=mu))
    assert np.allclose(answer.at(POINTS, "flux"), 2 * answer.at(POINTS, "slope"), rtol=1e-12)
    with pytest.raises(InputError, match="tension was given in Python and is not in the file"):
        _saved(answer, folder, Answer).at(POINTS, "flux")


def _saved(solution, folder, kind):
    solution.save(folder)
    return kind.read(folder)
