"""Hooke's law in UFL and gaps to rigid bodies, against formulas; a ball with axial symmetry through both."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Elasticity, InputError, ball_gap, plane_gap, releases
from fenicsx_obstacle.forms.elasticity import NO_OBSTACLE
from tests.test_elastic import COMM

E, NU = 3.0, 0.3


def displacement(dim, degree=1):
    mesh = dmesh.create_unit_square(COMM, 2, 2) if dim == 2 else dmesh.create_unit_cube(COMM, 1, 1, 1)
    return fem.Function(releases.functionspace(mesh, "Lagrange", degree, dim))


def mean(value, u):
    return COMM.allreduce(fem.assemble_scalar(releases.form(value * ufl.dx(domain=u.function_space.mesh))))


@pytest.mark.parametrize(
    ("plane", "sizes"),
    [
        (None, [E, 0, 0]),  # pulled along x, free to contract: the uniaxial state
        ("stress", [E, 0, 0]),
        ("strain", [E / (1 - NU**2), 0, NU * E / (1 - NU**2)]),
        ("axial", [E / (1 - 2 * NU) / (1 + NU), 2 * NU * E / (1 - 2 * NU) / (1 + NU), E / (1 - 2 * NU) / (1 + NU)]),
    ],
)
def test_stresses_of_a_stretched_body(plane, sizes):
    """e_xx = 1 with free sides has the stresses of the books; u_r = r has e_rr = e_tt = 1 and e_zz = 0."""
    u = displacement(3 if plane is None else 2)
    across = {None: NU, "stress": NU, "strain": NU / (1 - NU), "axial": 0.0}[plane]
    u.interpolate(lambda x: np.vstack([x[0], -across * x[1], -across * x[2]][: u.ufl_shape[0]]))
    stress = Elasticity(u, young=E, poisson=NU, plane=plane).stress
    assert np.allclose([mean(stress[k, k], u) for k in range(3)], sizes, atol=1e-12)
    assert abs(mean(stress[0, 1], u)) < 1e-12
    if plane is None:
        energy = Elasticity(u, young=E, poisson=NU).energy
        assert np.isclose(COMM.allreduce(fem.assemble_scalar(releases.form(energy))), E / 2)


@pytest.mark.parametrize("axis", [None, (1.0, 1.0, 0.0)])
def test_gaps_end_on_the_surface(axis):
    """x + gap n is on the near side of the ball or the cylinder, on the plane; beside the ball there is no obstacle."""
    mesh = dmesh.create_unit_cube(COMM, 1, 1, 1)
    x, n = ufl.SpatialCoordinate(mesh), np.array([0.0, 0.6, 0.8])
    centre, outward = np.array([0.5, 1.5, 2.0]), np.array([0.0, -1.0, -2.0])

    def off(gap, distance):
        point = x + gap * ufl.as_vector(n.tolist())
        return COMM.allreduce(fem.assemble_scalar(releases.form(abs(distance(point)) * ufl.dx(domain=mesh))))

    def from_centre(point):
        there = point - ufl.as_vector(centre.tolist())
        if axis is not None:
            along = ufl.as_vector((np.array(axis) / np.linalg.norm(axis)).tolist())
            there = there - ufl.dot(there, along) * along
        return there

    def from_surface(point):
        there = from_centre(point)
        return ufl.sqrt(ufl.dot(there, there)) - 1.3

    def behind_centre(point):
        return ufl.max_value(ufl.dot(from_centre(point), ufl.as_vector(n.tolist())), 0.0)

    def along(direction):
        middle, direction = ufl.as_vector(centre.tolist()), ufl.as_vector(direction.tolist())
        return lambda point: ufl.dot(point - middle, direction)

    assert off(ball_gap(x, n, centre, 1.3, axis), from_surface) < 1e-12
    assert off(ball_gap(x, n, centre, 1.3, axis), behind_centre) < 1e-12
    assert off(plane_gap(x, n, centre, outward), along(outward)) < 1e-12
    centre[0] = 50.0
    beside = fem.assemble_scalar(releases.form(ball_gap(x, n, centre, 1.3) * ufl.dx(domain=mesh)))
    assert np.isclose(COMM.allreduce(beside), NO_OBSTACLE)


def test_measure_with_axial_symmetry():
    """int r over the boundary of the unit square is 0 on the left, 1 on the right, 1/2 on the other sides: 2 in all;
    other plane bodies keep the measure."""
    u = displacement(2)
    ds = ufl.Measure("ds", domain=u.function_space.mesh)
    axial, strain = (Elasticity(u, young=E, poisson=NU, plane=plane).over(ds) for plane in ("axial", "strain"))
    assert np.isclose(COMM.allreduce(fem.assemble_scalar(releases.form(1.0 * axial))), 2.0)
    assert strain is ds


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"plane": None}, "plane = None: a plane body needs 'strain' or 'stress' or 'axial'"),
        ({"plane": "strian"}, "did you mean 'strain'"),
        ({"young": 0.0}, "young = 0: must be positive"),
        ({"poisson": 0.5}, "poisson = 0.5: must be above -1 and below 1/2"),
        ({"poisson": 0.499}, "poisson = 0.499 with elements of degree 1: they lock"),
        ({"poisson": "rubber"}, "expected a number, a Constant, a Function or UFL"),
    ],
)
def test_what_is_rejected(given, words):
    """One message with the remedy; nearly incompressible bodies need degree 2, in plane stress they do not lock."""
    with pytest.raises(InputError, match=words):
        Elasticity(displacement(2), **{"young": E, "poisson": NU, "plane": "strain", **given})
    Elasticity(displacement(2, degree=2), young=E, poisson=0.499, plane="strain")
    Elasticity(displacement(2), young=E, poisson=0.499, plane="stress")


@pytest.mark.serial
def test_a_warning_before_locking():
    """Above 0.45 elements of degree 1 are warned of."""
    with pytest.warns(UserWarning, match="begin to lock"):
        Elasticity(displacement(2), young=E, poisson=0.47, plane="strain")
