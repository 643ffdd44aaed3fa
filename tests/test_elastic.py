"""Elastic bodies on rigid obstacles: ObstacleProblem for vector-valued u, against exact states."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import (
    Elasticity,
    InputError,
    NotConverged,
    ObstacleProblem,
    Solution,
    ball_gap,
    compare,
    plane_gap,
    releases,
)
from fenicsx_obstacle.forms.elasticity import NO_OBSTACLE
from fenicsx_obstacle.parallel import total
from tests.conftest import COMM

Cell = dmesh.CellType
ELEMENTS = [(cell, degree) for cell in (Cell.triangle, Cell.quadrilateral, Cell.tetrahedron, Cell.hexahedron)
            for degree in (1, 2)]  # fmt: skip


def stress(strain, poisson):
    """Hooke's law for E/(1 - nu^2) = 1."""
    young = 1 - poisson**2
    mu, lam = young / 2 / (1 + poisson), young * poisson / (1 + poisson) / (1 - 2 * poisson)
    return 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(strain.ufl_shape[0])


def strain_of(u, radius=None):
    """In plane strain and in space; with a radius in axial symmetry."""
    e = ufl.sym(ufl.grad(u))
    return e if radius is None else ufl.as_matrix([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, u[0] / radius]])


class Body:
    """A box, held or on rollers, with facets tagged 3 above and 4 below."""

    def __init__(self, cell, degree, counts, shape=lambda x: x):
        box = [np.zeros(len(counts)), np.array(counts, dtype=float)]
        make = dmesh.create_rectangle if len(counts) == 2 else dmesh.create_box
        self.mesh = mesh = make(COMM, box, counts, cell)
        mesh.geometry.x[:] = shape(mesh.geometry.x / np.max(counts))
        self.dim = dim = len(counts)
        self.V = releases.functionspace(mesh, "Lagrange", degree, dim)
        self.u, self.v = fem.Function(self.V), ufl.TestFunction(self.V)
        self.x = ufl.SpatialCoordinate(mesh)

    def facets(self, where):
        return dmesh.locate_entities_boundary(self.mesh, self.dim - 1, where)

    def tagged(self, **where):
        """ds with the tags 3 above and 4 below."""
        found = [self.facets(one) for one in where.values()]
        numbers = np.concatenate([np.full(len(f), tag, np.int32) for f, tag in zip(found, (3, 4), strict=False)])
        facets = np.concatenate(found)
        order = np.argsort(facets)
        tags = dmesh.meshtags(self.mesh, self.dim - 1, facets[order], numbers[order])
        return ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)

    def held(self, where, axis, value=0.0):
        """u[axis] = value."""
        space = self.V.sub(axis)
        dofs = fem.locate_dofs_topological(space, self.dim - 1, self.facets(where))
        return fem.dirichletbc(PETSc.ScalarType(value), dofs, space)


@pytest.mark.parametrize(("cell", "degree"), ELEMENTS)
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_patch(cell, degree, method):
    """A uniform pressure presses a body that contact alone holds against a plane: p_i is that pressure at every node,
    nodes of weight 0 included, to 1e-10; on cells of unequal size, with the normals of the facets."""

    def uneven(x):
        x[:, 0] += 0.3 * x[:, 0] * (1 - x[:, 0]) * (0.5 + x[:, 1])
        return x

    body = Body(cell, degree, [3] * (2 if cell in (Cell.triangle, Cell.quadrilateral) else 3), uneven)
    top = body.dim - 1
    ds = body.tagged(above=lambda x: np.isclose(x[top], 1), below=lambda x: np.isclose(x[top], 0))
    q, n, u, v = 0.01, ufl.FacetNormal(body.mesh), body.u, body.v
    F = ufl.inner(stress(strain_of(u), 0.3), strain_of(v)) * ufl.dx + q * ufl.dot(n, v) * ds(4)
    bcs = [body.held(lambda x, axis=axis: np.isclose(x[axis], 0), axis) for axis in range(top)]
    problem = ObstacleProblem(F, u, bcs=bcs, upper=1e-3, of=ufl.dot(u, n), measure=ds(3))
    solution = problem.solve(method=method, eps=1e-3 if method == "penalty" else "auto", rtol=1e-13)
    assert np.allclose(solution.nodes.pressure, -q, rtol=1e-10)
    assert np.allclose(solution.nodes.resultant, [0] * top + [-q], atol=1e-10 * q)
    points = np.array([[0.0] * top + [1.0], [0.4] * top + [1.0]])
    assert np.allclose(solution.at(points, "pressure"), -q, rtol=1e-9)
    assert np.allclose(solution.at(points, "gap"), -q * solution.eps if solution.eps else 0.0, atol=1e-9)
    middle = solution.nodes.areas @ solution.nodes.points  # of a top of area 1
    moment = -q * middle[0] if top == 1 else [-q * middle[1], q * middle[0], 0]
    assert np.allclose(solution.force.moment, moment, atol=1e-10 * q)


@pytest.mark.parametrize("changed", ["of", "measure"])
def test_what_is_evaluated_once_must_stay(changed):
    """A Constant in `of` or in the factor of the measure changes after the first solve: the next ones refuse."""
    body = Body(Cell.triangle, 1, [3, 3])
    ds = body.tagged(above=lambda x: np.isclose(x[1], 1))
    values = {key: fem.Constant(body.mesh, PETSc.ScalarType(1.0)) for key in ("of", "measure")}
    F = ufl.inner(stress(strain_of(body.u), 0.3), strain_of(body.v)) * ufl.dx - 0.1 * body.v[1] * ds(3)
    bcs = [body.held(lambda x: np.isclose(x[1], 0), axis) for axis in range(2)]
    of, measure = body.u[1] + values["of"], values["measure"] * ds(3)
    problem = ObstacleProblem(F, body.u, bcs=bcs, upper=1.01, of=of, measure=measure)
    solution = problem.solve()
    assert solution.verify()
    values[changed].value = 0.5
    for call in (problem.solve, solution.verify):
        with pytest.raises(InputError, match="evaluated once"):
            call()


def test_a_measure_that_is_a_sum():
    """Parts of a sum have one factor and the same MeshTags, and each facet once."""
    body = Body(Cell.triangle, 1, [3, 3])
    first, other = (body.tagged(one=lambda x, k=k: np.isclose(x[k], 1)) for k in (1, 0))
    F = ufl.inner(stress(strain_of(body.u), 0.3), strain_of(body.v)) * ufl.dx
    r, bcs = body.x[0], [body.held(lambda x: np.isclose(x[1], 0), axis) for axis in range(2)]
    for measure in (r * first(3) + r * other(3), r * first(3) + r * first(3), r * first + r * first(3)):
        with pytest.raises(InputError, match="factor times it"):
            ObstacleProblem(F, body.u, bcs=bcs, upper=1.0, of=body.u[1], measure=measure)


@pytest.mark.parametrize(("cell", "degree"), ELEMENTS[::3])
def test_saved_and_read(cell, degree, folder):
    """A solution that is read has the same u, pressure, gap and von Mises stress at any point, to 1e-12; that of a
    body in uniaxial stress is its pressure."""
    body = Body(cell, degree, [3] * (2 if cell in (Cell.triangle, Cell.quadrilateral) else 3))
    top, u = body.dim - 1, body.u
    ds = body.tagged(above=lambda x: np.isclose(x[top], 1))
    bcs = [body.held(lambda x, k=k: np.isclose(x[k], 0), k, 0.01 * (k == top)) for k in range(body.dim)]
    s = stress(strain_of(u, 1.0 if body.dim == 2 else None), 0.3)  # in the plane e_zz = u_x: any tensor with three rows
    uniaxial = stress(strain_of(u), 0.0)
    F = ufl.inner(uniaxial, strain_of(body.v)) * ufl.dx
    for given in (s, uniaxial):
        u.x.array[:] = 0.0
        problem = ObstacleProblem(F, u, bcs=bcs, upper=0.0, of=u[top], measure=ds(3), stress=given)
        solution = problem.solve(eps=1e-8)
    assert np.allclose(solution.von_mises.x.array, 0.01, rtol=1e-6)
    solution.save(folder)
    again = Solution.read(folder)
    points = np.random.default_rng(1).random((9, body.dim))
    points[:4, top] = 1.0
    for of in ("u", "pressure", "gap", "von_mises"):
        assert np.allclose(solution.at(points, of), again.at(points, of), rtol=1e-12, atol=1e-15, equal_nan=True), of
    assert np.isfinite(again.at(points[:4], "gap")).all() and np.isnan(again.at(points[4:], "gap")).all()
    assert np.array_equal(again.force.resultant, solution.force.resultant)
    line = again.along([0.1] * body.dim, [0.9] * body.dim, n=5)
    assert np.allclose(line.u[:, top], 0.01 * (1 - line.points[:, top]), atol=1e-8)
    with pytest.raises(InputError, match="has no quantity 'slope'"):
        again.at(points, "slope")
    with pytest.raises(InputError, match="vector-valued solutions are not compared"):
        compare(again, solution)


@pytest.mark.slow
def test_linear_steps_depend_on_neither_eps_nor_h():
    """Rigid body motions without normal components at closed nodes, and algebraic coarse levels: conjugate gradients
    with GAMG take as many steps for eps = 1e-2 as for 1e-12, and no more on a mesh of four times as many cells; a
    tilted body too."""
    counts = []
    for cells in (32, 64):
        for eps in (1e-2, 1e-12):
            solution = Box(cells, angle=0.5).problem().solve(eps=eps)
            counts.append(solution.record["krylov_iterations"])
    assert max(counts) < 1.5 * min(counts), counts


@pytest.mark.slow
def test_work():
    """All linear steps of a solve on the finest mesh are at most twice those of one without contact, from u = 0, and
    there are at most 4 Newton steps, whatever h; values where u is given are exact."""
    steps = []
    for cells in (32, 64):
        body = Box(cells)
        linear = body.problem(upper=body.gap + 1).solve().record["krylov_iterations"]
        body.u.x.array[:] = 0.0
        solution = body.problem().solve()
        assert solution.record["krylov_iterations"] <= 2 * linear
        steps.append(solution.iterations)
        dofs, given = body.bcs[0].dof_indices()[0], body.bcs[0].g.x.array
        assert np.array_equal(solution.u.x.array[dofs], given[dofs])
    assert max(steps) <= 4, steps


class Box(Body):
    """A unit square or cube that is held below and pressed into a cylinder or ball, all turned by an angle."""

    def __init__(self, cells=6, dim=2, degree=1, angle=0.0, large=False):
        top, turn, cell = dim - 1, np.eye(3), Cell.triangle if dim == 2 else Cell.tetrahedron
        turn[np.ix_([0, top], [0, top])] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        super().__init__(cell, degree, [cells] * dim)
        self.ds = self.tagged(above=lambda x: np.isclose(x[top], 1))
        below = self.facets(lambda x: np.isclose(x[top], 0))
        lifted = fem.Function(self.V)
        normal = turn[:dim, top]
        lifted.interpolate(lambda x: np.outer(0.02 * normal, np.ones(x.shape[1])))
        self.bcs = [fem.dirichletbc(lifted, fem.locate_dofs_topological(self.V, top, below))]
        self.mesh.geometry.x[:] = self.mesh.geometry.x @ turn.T
        self.normal = ufl.as_vector(normal.tolist())
        along = self.x - ufl.dot(self.x, self.normal) * self.normal
        middle = ufl.as_vector((turn[:dim, :top] @ np.full(top, 0.5)).tolist())
        self.gap = ufl.dot(along - middle, along - middle) / 2
        gradient, u = ufl.grad(self.u), self.u
        self.energy = ufl.inner(stress(strain_of(u), 0.3), strain_of(u)) / 2 * ufl.dx
        if large:  # a neo-Hookean body
            D = ufl.Identity(dim) + gradient
            J = ufl.det(D)
            mu, lam = 0.35, 0.525
            self.energy = (mu / 2 * (ufl.inner(D, D) - dim - 2 * ufl.ln(J)) + lam / 2 * ufl.ln(J) ** 2) * ufl.dx
        self.F = ufl.derivative(self.energy, u, self.v)

    def problem(self, **more):
        given = {"bcs": self.bcs, "upper": self.gap, "of": ufl.dot(self.u, self.normal), "measure": self.ds(3), **more}
        return ObstacleProblem(given.pop("F", self.F), self.u, **given)


@pytest.mark.slow
def test_large_strains():
    """A neo-Hookean body: penalty and variational inequality agree as eps -> 0, with a line search on the energy; for
    small displacements the force is that of Hooke's law."""
    forces = {}
    for large in (False, True):
        body = Box(8, large=large)
        problem = body.problem(energy=body.energy if large else None)
        forces[large] = problem.solve(eps=1e-8).force.upper
        exact = problem.solve(method="vi")
        energy = total(COMM, fem.assemble_scalar(releases.form(body.energy)))
        assert not large or exact.energy == pytest.approx(energy, rel=1e-9)
        assert exact.verify()
    assert np.isclose(forces[True], forces[False], rtol=0.05)
    assert np.isclose(forces[True], exact.force.upper, rtol=1e-6)


@pytest.mark.slow
def test_contact_alone_holds_a_body_of_a_nonlinear_law():
    """A block on a slope, with u_x = 0 on one side and large strains: contact bears the load, by either method."""
    body = Body(Cell.triangle, 1, [8, 4])
    ds = body.tagged(above=lambda x: np.isclose(x[1], 0.5), below=lambda x: np.isclose(x[1], 0))
    gradient, unit = ufl.grad(body.u), ufl.Identity(2)
    strain = ((unit + gradient).T * (unit + gradient) - unit) / 2
    F = ufl.derivative(ufl.inner(stress(strain, 0.3), strain) / 2 * ufl.dx, body.u, body.v) + 0.03 * body.v[1] * ds(3)
    problem = ObstacleProblem(F, body.u, bcs=body.held(lambda x: np.isclose(x[0], 0), 0), of=-body.u[1],
                              upper=0.005 + 0.01 * body.x[0], measure=ds(4))  # fmt: skip
    for method in ("penalty", "vi"):
        found = problem.solve(method=method)
        assert found.force.upper == pytest.approx(0.03, rel=1e-6)
        assert found.verify()


@pytest.mark.slow
def test_data_that_change():
    """A second solve takes new values of Constants, of the obstacle and of bcs, and starts from the last contact."""
    body = Box(8)
    level = fem.Constant(body.mesh, PETSc.ScalarType(0.01))
    problem = body.problem(upper=body.gap + level)
    first = problem.solve().force.upper
    level.value = 0.0
    second = problem.solve()
    assert first < second.force.upper
    body.u.x.array[:] = 0.0
    assert np.isclose(second.force.upper, body.problem().solve().force.upper, rtol=1e-9)
    assert problem.solve().iterations <= 1


@pytest.mark.slow
def test_of_may_be_the_present_place():
    """of = (u + x) . n against a plane at a height is u . n against the gap to it."""
    body = Box()
    one = body.problem().solve().force.upper
    shifted = ufl.dot(body.u, body.normal) + body.x[1]
    assert np.isclose(one, body.problem(of=shifted, upper=body.gap + body.x[1]).solve().force.upper, rtol=1e-9)
    below = body.problem(of=-2 * ufl.dot(body.u, body.normal), upper=None, lower=-2 * body.gap).solve()
    assert np.isclose(one, below.force.lower, rtol=1e-9)


REJECTED = [
    (lambda body, other: {"of": None}, "u is vector-valued: say what the obstacles bound"),
    (lambda body, other: {"measure": None}, "u is vector-valued: measure"),
    (lambda body, other: {"of": body.u}, "of = .*: expected a scalar UFL expression that is linear in u"),
    (lambda body, other: {"of": body.u[0] ** 2}, "of is not linear in u"),
    (lambda body, other: {"of": body.u[0].dx(0)}, "of holds derivatives of u"),
    (lambda body, other: {"of": body.x[0]}, "of does not depend on u"),
    (lambda body, other: {"of": ufl.dot(body.u, ufl.FacetNormal(body.mesh)), "measure": ufl.ds}, "facets with differ"),
    (lambda body, other: {"F": body.F + body.v[1] * ufl.dx, "bcs": [body.held(lambda x: np.isclose(x[0], 0), 0)]},
     "does not press it against the obstacles"),
    (lambda body, other: {"F": body.F + ufl.sqrt(ufl.dot(body.u, body.u)) * body.v[1] * ufl.dx},
     "the derivative of F is not finite at the start"),
    (lambda body, other: {"upper": -1.0, "measure": ufl.ds}, r"value of u is beyond the upper obstacle by \d.* at \("),
    (lambda body, other: {"measure": -body.x[0] * body.ds(3)}, "its weight is negative"),
    (lambda body, other: {"stress": body.u}, "stress = .*: expected a tensor in UFL with three rows"),
    (lambda body, other: {"measure": other.ds(3)}, "measure is of another mesh than u: take domain="),
    (lambda body, other: {"measure": 2.0 * ufl.Measure("ds", body.mesh, subdomain_data=other.ds.subdomain_data())(3)},
     "measure: subdomain_data: these MeshTags"),
    (lambda body, other: {"measure": other.x[0] * ufl.Measure("ds", body.mesh)}, "the factor of measure"),
    (lambda body, other: {"of": ufl.dot(body.u, ufl.FacetNormal(other.mesh))}, "of holds a FacetNormal"),
    (lambda body, other: {"stress": other.x[0] * ufl.sym(ufl.grad(body.u))}, "stress holds a Function or"),
    (lambda body, other: {"of": fem.Constant(body.mesh, 1 + 1j) * body.u[1]}, "of is complex: .*; take the real part"),
    (lambda body, other: {"stress": fem.Constant(body.mesh, 1j) * ufl.sym(ufl.grad(body.u))}, "stress is complex: exp"),
    (lambda body, other: {"measure": fem.Constant(body.mesh, 1j) * body.ds(3)}, "the factor of measure is complex: ex"),
]  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize(("change", "words"), REJECTED)
def test_what_is_rejected(change, words):
    """One message with the remedy, on all ranks; what is of another mesh, or complex, is named."""
    body, other = Box(), Box()
    with pytest.raises(InputError, match=f"ObstacleProblem: .*{words}"):
        body.problem(**change(body, other))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("cell", [Cell.triangle, Cell.quadrilateral])
def test_a_body_between_two_stops(cell, method):
    """A body on rollers between stops on both sides. Where no contact force acts, the body may be anywhere between
    them, and nothing is returned; stops that press it without any load hold it."""
    body = Body(cell, 1, [6, 6])
    ds, n = body.tagged(sides=lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1)), ufl.FacetNormal(body.mesh)
    left = ufl.conditional(ufl.lt(body.x[0], 0.5), 1.0, -1.0) * body.v[0] * ufl.dx
    F = ufl.inner(stress(strain_of(body.u), 0.3), strain_of(body.v)) * ufl.dx
    given = {"of": ufl.dot(body.u, n), "measure": ds(3), "bcs": [body.held(lambda x: np.isclose(x[1], 0), 1)]}
    for load, gap, force in ((1, 5.0, None), (-1, 0.01, None), (0, 5.0, None), (1, 0.01, 0.4), (0, -0.01, 0.02 * 0.91)):
        body.u.x.array[:] = 0.0
        problem = ObstacleProblem(F + load * left, body.u, upper=gap, **given)
        if force is None:
            with pytest.raises(NotConverged, match="a rigid body motion is resisted by no contact force"):
                problem.solve(method=method)
        else:
            solution = problem.solve(method=method)
            assert abs(solution.force.resultant[0]) < 1e-9 and solution.force.upper > 0.5 * force


def pressed(dim, angle=0.0, hold=(), load=1.0):
    """A box under a load per volume along its last axis, which presses it onto a plane; turned by an angle, with
    components k of u that are 0 where x_i = 0."""
    body = Box(3, dim, angle=angle)
    body.F -= load * ufl.dot(body.normal, body.v) * ufl.dx
    bcs = [body.held(lambda x, i=i: np.isclose(x[i], 0), k) for k, i in hold]
    return body.problem(bcs=bcs, upper=0.01)


@pytest.mark.parametrize(
    ("dim", "given", "words"),
    [
        (2, {}, "1 rigid body motion is free .*: translation along x; prescribe .*half model"),
        (2, {"angle": 0.5}, r"translation along \(0.8776, 0.4794\);"),
        (2, {"hold": [(0, 0)], "load": -1.0}, "only contact supports .* the load moves it: translation along y;"),
        (2, {"hold": [(1, 0)]}, "translation along x;"),
        (2, {"hold": [(1, 1)]}, "translation along x;"),  # the plane is above
        (3, {}, r"3 .* free .*: translation along x, translation along y, .* axis along z through \(0.5, 0.5, 0.5\);"),
        (3, {"angle": 0.5}, r"\(0.8776, 0, 0.4794\).*translation along y.*\(-0.4794, 0, 0.8776\) through"),
        (3, {"hold": [(0, 0)]}, "1 rigid body motion is free .*: translation along y;"),
        (3, {"hold": [(1, 1)]}, "translation along x;"),
    ],
)
def test_free_motions_are_named(dim, given, words):
    with pytest.raises(InputError, match=words):
        pressed(dim, **given).solve()


def test_one_component():
    mesh = dmesh.create_unit_interval(COMM, 8)
    V = releases.functionspace(mesh, "Lagrange", 1, 1)
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + v[0] * ufl.dx
    with pytest.raises(InputError, match="a vector with one component: take a Function of a scalar"):
        ObstacleProblem(F, u, lower=-0.02)


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
    x, n = ufl.SpatialCoordinate(dmesh.create_unit_cube(COMM, 1, 1, 1)), np.array([0.0, 0.6, 0.8])
    centre, outward = np.array([0.5, 1.5, 2.0]), np.array([0.0, -1.0, -2.0])
    along = np.zeros(3) if axis is None else np.array(axis) / np.linalg.norm(axis)
    ball, plane = ball_gap(x, n, centre, 1.3, axis), plane_gap(x, n, centre, outward)
    for point in np.random.default_rng(1).random((20, 3)):
        arm = point + ball(tuple(point)) * n - centre
        arm -= (arm @ along) * along
        assert np.isclose(np.linalg.norm(arm), 1.3) and arm @ n <= 0
        assert abs((point + plane(tuple(point)) * n - centre) @ outward) < 1e-12
    assert ball_gap(x, n, np.array([50.5, 1.5, 2.0]), 1.3)((0, 0, 0)) == NO_OBSTACLE


def test_measure_with_axial_symmetry():
    """int r over the boundary of the unit square is 0 on the left, 1 on the right, 1/2 on the other sides: 2 in all;
    other plane bodies keep the measure."""
    u = displacement(2)
    ds = ufl.Measure("ds", domain=u.function_space.mesh)
    axial, strain = (Elasticity(u, young=E, poisson=NU, plane=plane).over(ds) for plane in ("axial", "strain"))
    assert np.isclose(COMM.allreduce(fem.assemble_scalar(releases.form(1.0 * axial))), 2.0)
    assert strain is ds


def test_what_locks_and_what_does_not():
    """Constants are checked, as in scenes; nearly incompressible bodies need degree 2, but for plane stress."""
    for given, words in (({"poisson": "rubber"}, "expected a number, a Constant, a Function or UFL"),
                         ({"poisson": 0.499}, "poisson = 0.499 with elements of degree 1: they lock")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            Elasticity(displacement(2), **{"young": E, "poisson": NU, "plane": "strain", **given})
    Elasticity(displacement(2, degree=2), young=E, poisson=0.499, plane="strain")
    Elasticity(displacement(2), young=E, poisson=0.499, plane="stress")


@pytest.mark.serial
def test_a_warning_before_locking():
    """Above 0.45 elements of degree 1 are warned of."""
    with pytest.warns(UserWarning, match="begin to lock"):
        Elasticity(displacement(2), young=E, poisson=0.47, plane="strain")
