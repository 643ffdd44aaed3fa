"""The quadrature rules (3.5)-(3.6) and the norms they give on Q_h."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh

from fenicsx_obstacle import InputError, nodal_rule, releases
from tests.conftest import COMM

CELLS = {
    "interval": lambda: dmesh.create_unit_interval(COMM, 5),
    "triangle": lambda: dmesh.create_unit_square(COMM, 4, 3),
    "tetrahedron": lambda: dmesh.create_unit_cube(COMM, 2, 2, 2),
    "quadrilateral": lambda: dmesh.create_unit_square(COMM, 4, 3, cell_type=dmesh.CellType.quadrilateral),
    "hexahedron": lambda: dmesh.create_unit_cube(COMM, 2, 2, 2, cell_type=dmesh.CellType.hexahedron),
}


@pytest.mark.parametrize("cell", CELLS)
def test_mass_is_diagonal_and_weighs_the_domain(cell):
    """(3.5): the points are the nodes, so I(q, v) is diagonal; (3.6): weights positive, summing to |Omega| = 1."""
    mesh = releases.settle(CELLS[cell]())
    V = releases.functionspace(mesh, "Lagrange", 1)
    dI = nodal_rule(cell).on(ufl.Measure("dx", domain=mesh))
    form = releases.form(ufl.TrialFunction(V) * ufl.TestFunction(V) * dI)
    M = fem.petsc.create_matrix(form)
    fem.petsc.assemble_matrix(M, form)
    M.assemble()
    D = M.getDiagonal()
    assert D.min()[1] > 0
    assert abs(D.sum() - 1) < 1e-14
    M.setDiagonal(D * 0)
    assert M.norm() < 1e-15


@pytest.mark.parametrize(("cell", "degree"), [("interval", 2), ("quadrilateral", 2), ("hexahedron", 2)])
def test_simpson_weights(cell, degree):
    """Example 1, Q2: Simpson's rule integrates x^3 exactly with positive weights."""
    rule = nodal_rule(cell, degree)
    points, weights = np.array(rule.points), np.array(rule.weights)
    assert weights.min() > 0
    assert abs(weights.sum() - 1) < 1e-15
    assert abs(weights @ points[:, 0] ** 3 - 1 / 4) < 1e-15


def test_quadratic_triangles_are_refused():
    """P2: the degree-2 nodal rule weighs the vertices 0, which (3.6) excludes."""
    with pytest.raises(InputError, match="positive weights"):
        nodal_rule("triangle", 2)


def test_cells_without_a_rule():
    """What is not the name of a cell is rejected, with the names."""
    with pytest.raises(InputError, match="cell = 'prism': expected the name of a cell, one of interval, triangle"):
        nodal_rule("prism")


def test_lumped_norm_is_equivalent_on_every_triangle():
    """(3.21) and (3.28), misprint of (3.27) corrected: ||q||_0^2 <= I(q, q) <= 4 ||q||_0^2, both sharp."""
    consistent = (np.ones((3, 3)) + np.eye(3)) / 24
    lumped = np.diag(nodal_rule("triangle").weights)
    ratio = np.linalg.eigvals(np.linalg.solve(lumped, consistent)).real
    assert np.allclose(np.sort(ratio), [1 / 4, 1 / 4, 1])


def test_element_identity_3_27():
    """(3.27): I(q,q) = 1/3 [(q0-q1)^2 + 2 q0^2 + 2 q2^2] mes, with q2 where the paper prints q1."""
    rng = np.random.default_rng(1)
    corners = np.array([[-1, 0], [0, -1], [0, 1]])  # master element, area 1, centroid (-1/3, 0)
    for q0, q1, q2 in rng.normal(size=(5, 3)):
        nodal = q0 + q1 * (3 * corners[:, 0] + 1) / 2 + q2 * corners[:, 1]
        direct = np.mean(nodal**2)
        centred = [nodal.mean(), (nodal[1] + nodal[2]) / 2, (nodal[2] - nodal[1]) / 2]
        a, b, c = centred[0], centred[1] - centred[0], centred[2]
        assert np.isclose(direct, a**2 + 2 * b**2 + 2 / 3 * c**2)
