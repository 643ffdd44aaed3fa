"""Data that are not admissible between their samples are rejected too."""

from __future__ import annotations

import pytest

from fenicsx_obstacle import InputError, Scene, solve
from tests.conftest import COMM

SPOT = "hypot(x - 0.503, y - 0.497) < 0.004"
BAD = {
    "matrix": {"tension": [["1", f"where({SPOT}, 2, 0)"], [f"where({SPOT}, 2, 0)", "1"]]},
    "one entry": {"tension": [["1 - 2*exp(-((x - 0.72)^2 + (y - 0.25)^2)/0.0004)", 0], [0, 1]]},
    "tension": {"tension": f"where({SPOT}, -1, 1)"},
    "the other branch": {"tension": f"where(not ({SPOT}), 1, -1)"},
    "defined": {"tension": "1 - 2*spot", "define": {"spot": SPOT}},
    "foundation": {"tension": 1, "foundation": f"where({SPOT}, -1, 1)"},
    "stiffness": {"tension": 1, "soft_obstacle": {"lower": 0, "stiffness": f"where({SPOT}, -1, 1)"}},
    "rate": {"tension": 1, "rate": f"where({SPOT}, -1, 1)", "time": {"end": 1, "steps": 2, "start": 0}},
    "slope": {"large_slope": f"where({SPOT}, -1, 1)"},
    "band": {"tension": "where(x > 0.4999 and x < 0.50001, -2, 1)"},
    "oblique band": {"tension": "1 - 3*(abs(x + y - 0.77) < 0.0003)"},
    "dip": {"tension": "1 - 2*exp(-((x - 0.72)^2 + (y - 0.25)^2)/0.0004)"},
    "lowest of two": {"tension": "max(min(1, 3000*hypot(x - 0.3, y - 0.7) - 2), -1)"},
}


def scene(size=1.0, **more):
    axis = [0, size]
    return Scene(mesh={"shape": "rectangle", "x": axis, "y": axis, "cells": 16}, load=-1, **more)


@pytest.mark.parametrize("name", BAD)
def test_a_spot_between_the_samples(name):
    """A formula out of bounds in a spot that no cell's midpoint meets is rejected, with a place in the spot."""
    with pytest.raises(InputError, match=r"must be (positive|at least 0).* at \(0\.\d+, [01]"):
        solve(scene(**BAD[name]))


@pytest.mark.parametrize("size", [1e-3, 1e6])
def test_the_unit_of_length_does_not_matter(size):
    """Millimetres and metres: the same spot."""
    with pytest.raises(InputError, match="must be positive; it is -1"):
        solve(scene(size, tension=f"where(hypot(x - {0.503 * size}, y - {0.497 * size}) < {0.004 * size}, -1, 1)"))


@pytest.mark.parametrize("element", ["P2", "Q1"])
def test_other_elements(element):
    """The same with quadratic elements and on quadrilaterals."""
    cell = {"cell": "quadrilateral"} if element == "Q1" else {}
    mesh = {"shape": "rectangle", "cells": 6, **cell}
    with pytest.raises(InputError, match="must be positive; it is -1"):
        solve(Scene(mesh=mesh, load=-1, tension=f"where({SPOT}, -1, 1)"), element=element)


@pytest.mark.parametrize("dim", [1, 3])
def test_other_dimensions(dim):
    """Intervals and solids."""
    mesh = {"shape": "interval", "cells": 32} if dim == 1 else {"shape": "box", "cells": 4}
    ball = "abs(x - 0.503) < 1e-4" if dim == 1 else "hypot(hypot(x - 0.503, y - 0.497), z - 0.33) < 0.01"
    with pytest.raises(InputError, match="must be positive; it is -1"):
        solve(Scene(mesh=mesh, tension=f"where({ball}, -1, 1)", load=-1))


ADMISSIBLE = {
    "a spot": {"tension": f"where({SPOT}, 3, 1)"},
    "outside of the domain": {"tension": "where(x > 1.2, -1, 1)"},
    "zero at a point": {"tension": "r"},
    "zero on the boundary": {"tension": "x*(1 - x)"},
    "a pole": {"tension": "1/hypot(x - 0.5, y - 0.5)"},
    "zero in a part": {"tension": 1, "foundation": "max(x - 0.3, 0)"},
    "the distance": {"tension": "0.1 + distance", "foundation": "where(distance < 0.2, 1, 0)"},
    "axis": {"tension": "x", "axial_symmetry": True},
    "matrix": {"tension": [["2", f"where({SPOT}, 1, 0)"], [f"where({SPOT}, 1, 0)", "1"]]},
}


@pytest.mark.parametrize("name", ADMISSIBLE)
def test_what_is_admissible_is_solved(name):
    """Nothing is rejected for values outside of the domain, zeros, poles and jumps."""
    assert solve(scene(**ADMISSIBLE[name]), comm=COMM).record["converged"]
