"""Truths of the drawn families: closed forms satisfy their equations, and quadrature is exact where it claims to be."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.solve import solve
from tests.conftest import COMM
from tests.random.families.drifts import Radial, Strip
from tests.random.families.elements import Field
from tests.random.families.equilibria import Feeble
from tests.random.families.files import torsion
from tests.random.families.films import Film
from tests.random.families.integrals import Circle, Pieces, energy_error
from tests.random.families.layers import WAVES, LayersInContact, Waves
from tests.random.families.solid_meshes import inscribed_ball, solid
from tests.random.families.solids import Solid

SQUARE = {"shape": "rectangle", "cells": 16, "diagonal": "right", "perturb": 0.0}


def function(degree, cell=dmesh.CellType.triangle, formula=lambda x: x[0]):
    """A function that interpolates a formula on the unit square, 6 x 6 cells."""
    mesh = releases.settle(dmesh.create_unit_square(COMM, 6, 6, cell))
    u = fem.Function(releases.functionspace(mesh, "Lagrange", degree))
    u.interpolate(formula)
    u.x.scatter_forward()
    return u


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", [dmesh.CellType.triangle, dmesh.CellType.quadrilateral])
def test_fields_are_the_functions_they_are_made_of(degree, cell):
    """Polynomials of the space are reproduced with their gradients in every cell, and the area is that of the mesh."""
    field = Field(function(degree, cell, lambda x: (1 + 2 * x[0] - x[1]) ** degree))
    cells, points = np.arange(len(field.vertices)), field.vertices.mean(axis=1, keepdims=True) + 0.01
    s = 1 + 2 * points[..., 0] - points[..., 1]
    assert field.at(cells, points) == pytest.approx(s**degree)
    outer = degree * s ** (degree - 1)
    assert field.gradient(cells, points) == pytest.approx(np.stack([2 * outer, -outer], axis=2))
    assert field.measure() == pytest.approx(1)
    assert field.ends() == pytest.approx((0, 3**degree))


def test_pieces_fill_the_cells():
    """Cut or refined pieces have the area of the mesh, and integrate each side of a jump exactly."""
    field = Field(function(1, formula=lambda x: 0 * x[0]))
    zero = lambda x, y: np.zeros_like(x)  # noqa: E731
    for pieces in (
        Pieces.of(field).cut((0.6, 0.8), [0.123, 0.5, 0.777]),
        Pieces.of(field).along([Circle((0.4, 0.55), 0.31), Circle((0.4, 0.55), 0.13)], [(0.123, 0.5)]),
    ):
        norm = energy_error(field, pieces, lambda x, y: np.ones_like(x), lambda x, y: (x, y))[1]
        assert norm == pytest.approx((2 / 3) ** 0.5)
    pieces = Pieces.of(field).cut((1.0, 0.0), [0.503])
    norm = energy_error(
        field, pieces, lambda x, y: np.where(x < 0.503, 7.0, 1.0), lambda x, y: (1 + zero(x, y), zero(x, y))
    )
    assert norm[0] == norm[1] == pytest.approx((7 * 0.503 + 0.497) ** 0.5)


@pytest.mark.parametrize("middle", [(0.5, 0.5), (0.43, 0.51), (0.0, 0.0)])
@pytest.mark.parametrize("radius", [0.3, 0.0613, 1e-3])
def test_circles_cut_pieces(middle, radius):
    """Area and moment of inertia of a disc, or of its quarter, to round-off: points lie on the right side."""
    field = Field(function(1))
    inner = 0.7 * radius
    nodes = Pieces.of(field).along([Circle(middle, radius), Circle(middle, inner)])
    assert (nodes.weights > 0).all()
    squared = ((nodes.points - middle) ** 2).sum(axis=1)
    share = 1 if any(middle) else 1 / 4
    for R in (inner, radius):
        assert COMM.allreduce(nodes.weights @ (squared < R**2)) == pytest.approx(share * pi * R**2, rel=1e-12)
        assert COMM.allreduce(nodes.weights @ np.where(squared < R**2, squared, 0)) == pytest.approx(
            share * pi * R**4 / 2, rel=1e-12
        )
    assert COMM.allreduce(nodes.weights.sum()) == pytest.approx(1, rel=1e-13)


def test_poles_are_approached():
    """The integral of r^(-1) over the quarter of a disc of radius 1/2 about a corner."""
    nodes = Pieces.of(Field(function(1))).along([Circle((0.0, 0.0), 0.5)], [(0.0, 0.0)], count=10)
    far = np.linalg.norm(nodes.points, axis=1)
    assert COMM.allreduce(nodes.weights @ np.where(far < 0.5, 1 / far, 0)) == pytest.approx(pi / 4, rel=1e-10)


CUBE = {"shape": "box", "x": [-1.0, 1.0], "y": [-1.0, 1.0], "z": [-1.0, 1.0], "perturb": 0.1}
BODY = Solid(CUBE, {}, "half", (0.6, 0.0, 0.8), (0.1, -0.05, 0.0), 0.45, "0", 2.0, "4 + x*y - z", 3.0, 1.0, 0.7, False,
             0.5, "flux", 2.0)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["cube", "fichera", "prism", "random points"])
def test_solids_are_filled(shape):
    """Meshes have the volume of their domain, and so have the pieces of their cells up to those that are omitted."""
    table = {"shape": shape, "cells": 3, "seed": 5, "slope": 0.7, "flat": 0.3, "scatter": 0.2}
    one = replace(BODY, mesh=table, kind="ball", obstacle="0", stiff="1", scale=1.0, foundation=0.0, end="", radius=0.2)
    mesh = solid(table, COMM)
    volume = 0.3 * {"fichera": 7.0, "prism": 6.0}.get(shape, 8.0)
    corners = Field(fem.Function(releases.functionspace(mesh, "Lagrange", 1))).vertices
    own = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
    assert COMM.allreduce(own) == pytest.approx(volume, rel=1e-12)
    centre, radius = inscribed_ball(table)
    straight = np.array([centre[0] - 0.7 * centre[1], centre[1], centre[2] / 0.3])
    assert (np.abs(straight) + radius <= 1 + 1e-12).all()
    # int |grad u|^2 outside of the ball, u = size (R^2/6 + ...), by Monte Carlo with 1e6 points of the domain
    points = np.random.default_rng(1).uniform(-1, 1, (1000000, 3))
    if shape in ("fichera", "prism"):
        points = points[~(points[:, : {"fichera": 3, "prism": 2}[shape]] > 0).all(axis=1)]
    points = points * [1, 1, 0.3] + np.outer(points[:, 1], [0.7, 0, 0])
    far = np.linalg.norm(points - np.array(one.middle), axis=1)
    density = np.where(far < 0.2, 0.0, (one.size * (far / 3 - 0.2**3 / (3 * far**2))) ** 2)
    norm = one.error(Field(fem.Function(releases.functionspace(mesh, "Lagrange", 1))))[1]
    assert norm**2 == pytest.approx(volume * density.mean(), rel=0.01)


def test_layers_in_contact():
    """u' of the truth falls from 0 to the obstacle's depth and comes back; on a fine mesh u_h is near to it."""
    one = LayersInContact({**SQUARE, "cells": 64}, {}, 2, (0.25, 0.75), (3.0, 1.0, 0.5), 4.0, 0.45, 0.8)
    depth, begin, end = one.truth()
    assert 0 < begin < 0.45 < end < 1
    x = (np.arange(100000) + 0.5) / 100000
    mu = np.select([x < 0.25, x < 0.75], [3.0, 1.0], 0.5)
    slope = 4 * (np.minimum(x - begin, 0) + np.maximum(x - end, 0)) / mu
    u = np.cumsum(slope) / len(x)
    assert u[len(x) // 2] == pytest.approx(-depth, rel=1e-4)
    assert u[-1] == pytest.approx(0, abs=1e-4 * depth)
    error, norm = one.error(Field(solve(one.scene(), comm=COMM).u))
    assert error < 0.05 * norm


@pytest.mark.parametrize("kind", list(WAVES))
def test_waves(kind):
    """The norm of the truth: energy = flux times the difference of the ends."""
    waves = Waves(SQUARE, {}, 0, kind, 1.5, 23.0)
    x = (np.arange(400000) + 0.5) / 400000
    flux = 1 / np.mean(1 / waves.tension().at(x, x))
    assert waves.error(Field(function(1)))[1] ** 2 == pytest.approx(flux, rel=1e-4)


def test_drift():
    """Green's function and a dense solution by finite differences agree, and so do closed form and series on a disk."""
    strip = Strip("interval", 400, 0.5, "from a point", 8.0, 0.4)
    x, true = strip.truth()
    n = 800
    h, at = 1 / n, np.arange(1, n) / n
    drift = 8.0 * (at - 0.4)
    matrix = (np.diag(np.full(n - 1, 2 * 0.5 / h**2)) + np.diag((-0.5 / h**2 + drift / (2 * h))[:-1], 1)
              + np.diag((-0.5 / h**2 - drift / (2 * h))[1:], -1))  # fmt: skip
    assert np.interp(at, x, true) == pytest.approx(np.linalg.solve(matrix, np.ones(n - 1)), rel=1e-3)
    radial = Radial("disk", 16, 0.5, 3.0)
    phi = 3.0  # strength/(2 tension)
    terms = [phi**k / k / np.prod(np.arange(1.0, k + 1)) for k in range(1, 60)]  # of (exp(t) - 1)/t
    assert radial.middle(1.0) == pytest.approx(sum(terms) / 6)
    assert Radial("disk", 16, 0.5, 1e-9).middle(1.0) == pytest.approx(0.5)


def test_film():
    """Caps and arcs have the curvature of the load; the limit load of a square is between those of disks."""
    for kind, arc in (("cap", False), ("arc", True)):
        film = Film(kind, 40, 2.0, 3.0, 0.8, 1.0, "vi", False)
        reach = film.size / (2 if arc else 1)
        x = np.linspace(0, reach, 20001)
        sine = x * film.load / (film.tension * (1 if arc else 2))  # u'/sqrt(1 + u'^2), by the balance of forces
        slope = sine / np.sqrt(1 - sine**2)
        height = np.sum((slope[1:] + slope[:-1]) / 2) * reach / 20000
        assert film.height(reach, arc=arc) == pytest.approx(height, rel=1e-5)
    square = Film("square", 20, 1.0, 1.0, 1.0, 1.0, "vi", False).load
    assert 2 / pi**-0.5 < square < 4  # of the disk of the same area, and of the inscribed disk
    assert Film("cap", 40, 1.0, 1.0, 1.0, 1.0, "vi", False).load == 2


def test_torsion():
    """The series for a square and for a long rectangle."""
    assert torsion(1.0) == pytest.approx(0.0736713, rel=1e-5)
    assert torsion(30.0) == pytest.approx(1 / 8, rel=1e-5)


def test_strip_that_bears():
    """A foundation on a strip: closed form and finite differences."""
    one = Feeble(16, "interval", "strip", 3.0, 2.0, 5.0, 0.3)
    n = 800
    h = 1 / n
    matrix = 2.0 / h**2 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    matrix[0, 0] = matrix[-1, -1] = 2.0 / h**2
    matrix += np.diag(3.0 * ((np.arange(n) + 0.5) * h < 0.3))
    u = np.linalg.solve(matrix, np.full(n, 5.0))
    assert one.truth()[:2] == pytest.approx((u.min(), u.max()), rel=1e-3)
