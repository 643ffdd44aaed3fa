"""Bounds of components of blocked and mixed spaces, against dense active sets by NumPy on one rank."""

import warnings
from contextlib import nullcontext as nothing

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import InputError, NotConverged, ObstacleProblem, PenetrationWarning, releases
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM, by_hand
from tests.helpers import BUBBLES, Membrane, grid, mixed_space

BEGIN, STEP = (lambda x: x[0] * (1 - x[1]), lambda x: 0.4 * x[1] ** 2 + 0 * x[0]), 0.05


def square(comm, cells=6):
    return dmesh.create_unit_square(comm, cells, cells)


class Reaction:
    """Implicit Euler for two species that consume each other; each is removed at a rate that may exhaust it."""

    def __init__(self, comm, mesh=None):
        mesh = square(comm) if mesh is None else mesh
        V = releases.functionspace(mesh, "Lagrange", 1, 2)
        self.u, v, old = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
        old.interpolate(lambda x: np.vstack([begin(x) for begin in BEGIN]))
        self.u.x.array[:] = old.x.array
        x, (a, b) = ufl.SpatialCoordinate(mesh), ufl.split(self.u)
        self.F = ufl.inner((self.u - old) / STEP, v) * ufl.dx + 0.02 * ufl.inner(ufl.grad(self.u), ufl.grad(v)) * ufl.dx
        self.F += ((5 * a * b**2 + 3 * x[0]) * v[0] + (2 * a * b - 4 * x[1] * (1 - x[0]) + 1) * v[1]) * ufl.dx
        self.bcs, self.bounds = [], {"lower": {0: 0.0, 1: 0.0}, "upper": {1: 0.3}}


class Seepage:
    """A viscous fluid whose pressure cannot be negative: where it is 0, div u >= 0."""

    element = ("Lagrange", 2, 2)  # Taylor-Hood

    def __init__(self, comm, sign=1.0):
        mesh = square(comm, 4)
        W = mixed_space(mesh, self.element, ("Lagrange", 1, None))
        self.u = fem.Function(W)
        (u, p), (v, q), x = ufl.split(self.u), ufl.TestFunctions(W), ufl.SpatialCoordinate(mesh)
        load = ufl.as_vector((4 * (x[0] - 0.5), 2 * x[0] - 3 * x[1] ** 2))
        self.F = (ufl.inner(ufl.grad(u), ufl.grad(v)) - p * ufl.div(v) + sign * q * ufl.div(u)) * ufl.dx
        self.F -= ufl.inner(load, v) * ufl.dx
        self.bcs = [fem.dirichletbc(*with_space(W, 0, mesh, lambda x: np.isclose(x[0], 0)))]
        self.bounds = {"lower": {1: 0.0}}


class Mini(Seepage):
    """The same with the element of Arnold, Brezzi and Fortin."""

    element = BUBBLES


def with_space(W, sub, mesh, where):
    """The arguments of a Dirichlet condition u = 0 of a sub-space."""
    V, _ = W.sub(sub).collapse()
    facets = dmesh.locate_entities_boundary(mesh, mesh.topology.dim - 1, where)
    return fem.Function(V), fem.locate_dofs_topological((W.sub(sub), V), mesh.topology.dim - 1, facets), W.sub(sub)


class Damage:
    """A monolithic step of AT2 with the displacement in the plane; damage does not heal, and is at most 1."""

    def __init__(self, comm, height=0.2):
        mesh = square(comm, 5)
        W = mixed_space(mesh, ("Lagrange", 1, 2), ("Lagrange", 1, None))
        self.u = fem.Function(W)
        u, d = ufl.split(self.u)
        strain = ufl.sym(ufl.grad(u))
        elastic = 10 * ufl.inner(strain, strain) + 5 * ufl.tr(strain) ** 2
        grown = d**2 / 0.2 + 0.2 * ufl.inner(ufl.grad(d), ufl.grad(d))
        self.energy = (((1 - d) ** 2 + 1e-3) * elastic + grown) * ufl.dx
        self.F = ufl.derivative(self.energy, self.u, ufl.TestFunction(W))
        self.bcs = [fem.dirichletbc(*with_space(W, 0, mesh, lambda x: np.isclose(x[1], 0)))]
        up = with_space(W, 0, mesh, lambda x: np.isclose(x[1], 1))
        up[0].interpolate(lambda x: np.vstack([0 * x[0], height + 0 * x[0]]))
        self.bcs.append(fem.dirichletbc(*up))
        self.u.sub(0).interpolate(lambda x: np.vstack([0 * x[0], height * x[1]]))
        self.old = fem.Function(W.sub(1).collapse()[0])
        self.old.interpolate(lambda x: np.maximum(0, 0.7 - 2 * abs(x[0] - 0.3) - x[1]))
        self.bounds = {"lower": {1: self.old}, "upper": {1: 1.0}}


CASES = {"reaction": Reaction, "seepage": Seepage, "mini": Mini, "damage": Damage}


def dense(case):
    """The solution on one rank, by primal-dual active sets and NumPy, with its forces F."""
    V = case.u.function_space
    residual, slope = fem.form(case.F), fem.form(ufl.derivative(case.F, case.u))
    size = len(case.u.x.array)
    low, high, fixed = np.full(size, -np.inf), np.full(size, np.inf), np.zeros(size, dtype=bool)
    for bounds, array in ((case.bounds.get("lower", {}), low), (case.bounds.get("upper", {}), high)):
        for k, g in bounds.items():
            array[V.sub(k).collapse()[1]] = g.x.array if isinstance(g, fem.Function) else g
    for bc in case.bcs:
        fixed[bc.dof_indices()[0]] = True
    u = case.u.x.array
    releases.set_values(u, case.bcs)
    for _ in range(60):
        b = fem.petsc.assemble_vector(residual)
        A = fem.petsc.assemble_matrix(slope)
        A.assemble()
        r, J = b.array.copy(), A[:, :]
        below, above = ~fixed & (r - 100 * (u - low) > 0), ~fixed & (r - 100 * (u - high) < 0)
        change = np.where(below, low - u, np.where(above, high - u, 0.0))
        free = ~(fixed | below | above)
        change[free] = np.linalg.solve(J[np.ix_(free, free)], -r[free] - J[np.ix_(free, ~free)] @ change[~free])
        u += change
        if np.abs(change).max() < 1e-13:
            break
    # the solution, whatever the iteration was
    assert np.abs(r[free]).max() < 1e-11 * np.abs(J).max()
    assert np.all(u >= low - 1e-12) and np.all(u <= high + 1e-12) and below.any()
    assert np.all(r[below] >= 0) and np.all(r[above] <= 0)
    return case.u, np.where(below | above, r, 0.0)


def by_place(u, k, values=None):
    """Values of a component at its nodes in the order of their coordinates, gathered on all ranks."""
    V, dofs = u.function_space.sub(k).collapse()
    return ordered(V, (u.x.array if values is None else values)[np.ravel(dofs)])  # newer releases: an array of one row


def ordered(V, values):
    own, size = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    here = V.tabulate_dof_coordinates()[:own], values[: own * size].reshape(own, size)
    points, found = (np.concatenate(V.mesh.comm.allgather(one)) for one in here)
    return found[np.lexsort(np.round(points, 9).T)]


def truth_of(name):
    return dense(CASES[name](MPI.COMM_SELF))


def error(solution, truth):
    """The largest difference in each component, over its size."""
    count = truth.function_space.num_sub_spaces
    both = [(by_place(solution.u, k), by_place(truth, k)) for k in range(count)]
    return np.array([np.abs(ours - theirs).max() / np.abs(theirs).max() for ours, theirs in both])


def problem_of(case, **given):
    return ObstacleProblem(case.F, case.u, bcs=case.bcs, **case.bounds, **given)


@pytest.mark.parametrize("name", CASES)
def test_the_inequality_is_solved(name):
    """u of SNES VI is that of dense active sets, at all nodes of all components; so are the contact forces."""
    (truth, forces), case = truth_of(name), CASES[name](COMM)
    solution = problem_of(case).solve(method="vi")
    assert np.all(error(solution, truth) <= 1e-9)
    for k, force in solution.force.items():
        reaction = by_place(truth, k, forces)
        assert force.lower == pytest.approx(np.maximum(reaction, 0).sum(), rel=1e-8)
        if force.upper is not None:
            assert force.upper == pytest.approx(np.maximum(-reaction, 0).sum(), rel=1e-8, abs=1e-10)
        assert solution.penetration[k] == 0
    assert np.array_equal(case.u.x.array, solution.u.x.array)


@pytest.mark.parametrize("name", CASES)
def test_the_error_of_the_penalty_is_proportional_to_eps(name):
    """In all components, also where A_ii = 0; the penetration is eps p."""
    (truth, _), problem = truth_of(name), problem_of(CASES[name](COMM))
    errors = []
    for eps in (1e-5, 1e-7):
        solution = problem.solve(eps=eps)
        errors.append(error(solution, truth))
        for k, p in solution.pressure.items():
            size = largest(COMM, np.abs(p.x.array))
            assert solution.penetration[k] == pytest.approx(eps * size, rel=1e-9)
    assert np.all(errors[0] < 1e-3)
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)


@pytest.mark.parametrize("name", CASES)
def test_automatic_eps_fits_the_range_of_each_component(name):
    """The penetration is at most 1 % of the range of that component."""
    solution = problem_of(CASES[name](COMM)).solve()
    for k, beyond in solution.penetration.items():
        values = by_place(solution.u, k)
        assert 0 < beyond <= 0.011 * np.ptp(values)


@pytest.mark.parametrize("size", [1e-6, 1e6])
@pytest.mark.parametrize("method", ["vi", "penalty"])
def test_units_of_components_do_not_matter(size, method):
    """u of the mixed problem in other units, with its test function: forces of one component are then 1e6 times those
    of the other; the balance of their sum would say nothing of the smaller ones."""
    truth, _ = truth_of("seepage")
    case = Seepage(COMM)
    W = case.u.function_space
    u, v = fem.Function(W), case.F.arguments()[0]

    def in_units(f):
        return ufl.as_vector([size * f[0], size * f[1], f[2]])

    F = ufl.replace(case.F, {case.u: in_units(u), v: in_units(v)})
    solution = ObstacleProblem(F, u, bcs=case.bcs, lower={1: 0.0}).solve(method=method)
    found = by_place(solution.u, 0) * size, by_place(solution.u, 1)
    limit = 1e-9 if method == "vi" else 0.011
    for k in (0, 1):
        theirs = by_place(truth, k)
        assert np.abs(found[k] - theirs).max() <= limit * np.abs(theirs).max()


def test_a_stiff_part_does_not_hide_the_others():
    """Its forces are 1e10 times those of the rest of the domain, and the problem is not linear."""
    case = Reaction(COMM)
    x, v = ufl.SpatialCoordinate(case.u.function_space.mesh), case.F.arguments()[0]
    stiff = ufl.conditional(ufl.gt(x[0], 0.5), 1e10, 0.0)
    case.F += stiff * (ufl.inner(ufl.grad(case.u), ufl.grad(v)) + (case.u[0] - 0.2) * v[0]) * ufl.dx
    problem = problem_of(case)
    first = problem.solve(method="vi")
    second = problem.solve(method="vi", rtol=1e-15)
    assert largest(COMM, np.abs(first.u.x.array - second.u.x.array)) <= 1e-9


def test_an_energy_helps_where_newton_does_not():
    """Damage at twice the load: the same solution, in few steps."""
    truth, case = dense(Damage(MPI.COMM_SELF, 0.4))[0], Damage(COMM, 0.4)
    found = problem_of(case, energy=case.energy).solve(eps=1e-9)
    assert found.iterations <= 20
    assert np.all(error(found, truth) <= 1e-7)


def held_by_contact(mesh, load=0.5):
    V = releases.functionspace(mesh, "Lagrange", 1, 2)
    u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    return F + ((load + ufl.sin(7 * x[0])) * v[0] + (1.2 - 2 * x[1]) * v[1]) * ufl.dx, u


@pytest.mark.parametrize("method", ["vi", "penalty"])
def test_contact_alone_may_hold_components(method):
    """Its forces balance the load of each component; without a load towards the bound there is no solution."""
    F, u = held_by_contact(square(COMM))
    solution = ObstacleProblem(F, u, lower={0: 0.0, 1: 0.0}).solve(method=method)
    loads = fem.petsc.assemble_vector(fem.form(ufl.replace(F, {u: fem.Function(u.function_space)})))
    with loads.localForm() as local:
        for k in (0, 1):
            assert solution.force[k].lower == pytest.approx(total(COMM, local.array.reshape(-1, 2)[:, k]), rel=1e-9)
    F, u = held_by_contact(square(COMM), load=-2.0)
    with pytest.raises(NotConverged):
        ObstacleProblem(F, u, lower={0: 0.0, 1: 0.0}).solve(method=method)
    assert largest(COMM, np.abs(u.x.array)) == 0


@pytest.mark.parametrize("method", ["vi", "penalty"])
def test_a_pressure_up_to_a_constant_is_no_answer(method):
    """With u given on the whole boundary p is determined up to a constant, and a bound that does not press is none."""
    case = Seepage(COMM)
    mesh = case.u.function_space.mesh
    case.bcs = [fem.dirichletbc(*with_space(case.u.function_space, 0, mesh, lambda x: x[0] < 2))]
    with pytest.raises(NotConverged, match=r"do not determine|singular"):
        problem_of(case).solve(method=method)
    assert largest(COMM, np.abs(case.u.x.array)) == 0


@pytest.mark.parametrize("stabilised", [0.0, 1e-3])
def test_the_sign_of_a_saddle_point(stabilised):
    """With equal signs off the diagonal the inequality is the opposite one."""
    for sign in (-1.0, 1.0):
        case = Seepage(COMM, sign)
        if stabilised:
            case.F += stabilised * case.u[2] * case.F.arguments()[0][2] * ufl.dx
        if sign > 0:
            assert problem_of(case).solve(method="vi").force[1].lower > 0
            continue
        with pytest.raises(InputError, match="component 1: the terms with its test function have the wrong sign"):
            problem_of(case)


def test_a_second_solve_takes_changed_data():
    """Constants, obstacles and the start: the solution is that of a new problem."""
    case = Reaction(COMM)
    level = fem.Constant(case.u.function_space.mesh, 0.0)
    problem = ObstacleProblem(case.F, case.u, lower={0: level, 1: 0.0}, upper={1: lambda x: 0.3 + 0 * x[0]})
    first = problem.solve(method="vi")
    level.value = 0.1
    second = problem.solve(method="vi")
    case = Reaction(COMM)
    fresh = ObstacleProblem(case.F, case.u, lower={0: 0.1, 1: 0.0}, upper={1: 0.3}).solve(method="vi")
    assert np.abs(second.u.x.array - fresh.u.x.array).max() <= 1e-10
    assert second.force[0].lower > first.force[0].lower
    assert problem.solve(method="vi").iterations == 0


def test_coupling_that_begins_later():
    """A matrix that stops being symmetric is no indefinite energy: no warning, and w0 = -1 - 5 w1 = -3.5."""
    mesh = dmesh.create_unit_interval(COMM, 8)
    W, k = releases.functionspace(mesh, "Lagrange", 1, 2), fem.Constant(mesh, 0.0)
    w, z = fem.Function(W), ufl.TestFunction(W)
    F = (ufl.inner(ufl.grad(w), ufl.grad(z)) + (w[0] + k * w[1] + 1) * z[0] + (w[1] - 1) * z[1]) * ufl.dx
    problem = ObstacleProblem(F, w, lower={0: -5.0}, upper={1: 0.5})
    problem.solve(method="vi")
    k.value = 5.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.solve(method="vi")
    assert np.allclose(w.sub(0).collapse().x.array, -3.5)


def test_what_a_solution_says():
    """Counts, forces and signs; the text names each component."""
    seen = []
    solution = problem_of(Reaction(COMM)).solve(method="vi", monitor=lambda n, step: seen.append((n, step.active)))
    assert [n for n, _ in seen] == list(range(solution.iterations + 1))
    active = sum(total(COMM, owned(one)) for one in solution.contact.values())
    assert seen[-1][1] == active
    for part in ("vi; 98 unknowns", "component 0: contact area", "force on upper bound"):
        assert part in solution.summary() and part in repr(solution)
    assert solution.force[0].upper is None and solution.force[1].upper > 0
    assert total(COMM, owned(solution.pressure[1]) < 0) > 0
    assert solution.eps is None and solution.method == "vi"


def owned(f):
    return f.x.array[: f.function_space.dofmap.index_map.size_local]


def test_warnings():
    """Of a large penetration, and of a symmetric form that is not positive definite."""
    with pytest.warns(PenetrationWarning, match="penetration") if COMM.rank == 0 else nothing():
        problem_of(Reaction(COMM)).solve(eps=0.05)
    V = releases.functionspace(square(COMM), "Lagrange", 1, 2)
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = (u[0] * v[0] - u[1] * v[1] + 0.1 * v[0] + v[1]) * ufl.dx
    with pytest.warns(UserWarning, match="not positive definite") if COMM.rank == 0 else nothing():
        ObstacleProblem(F, u, lower={0: -1.0}).solve(method="vi")


WRONG = {
    "a component that is not there": ({"lower": {2: 0.0}}, "u has the components 0 to 1"),
    "a negative number": ({"lower": {-1: 0.0}}, "u has the components 0 to 1"),
    "a flag": ({"lower": {True: 0.0}}, "expected the number of a sub-space"),
    "nothing": ({"lower": {}}, "the dict of bounds is empty"),
    "a number beside a dict": ({"lower": {1: 0.0}, "upper": 1.0}, "expected a dict, as the other bound is"),
    "bounds that cross": ({"lower": {1: 0.5}, "upper": {1: 0.4}}, "component 1: lower|is above upper"),
    "two values for one component": ({"lower": {1: [0.0, 0.1]}}, "lower.1."),
    "not a number": ({"lower": {1: np.nan}}, "lower.1."),
    "a vector": ({"lower": {0: 0.0}}, "component 0 is of .* take degree 1 for this component"),
    "of": ({"lower": {1: 0.0}, "of": 1.0}, "of= has no meaning|of="),
    "measure": ({"lower": {1: 0.0}, "measure": ufl.ds}, "measure= has no meaning"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_bounds(wrong):
    given, words = WRONG[wrong]
    case = Seepage(COMM)
    with pytest.raises(InputError, match=words):
        ObstacleProblem(case.F, case.u, bcs=case.bcs, **given)


def test_other_wrong_input():
    """A scalar u, u itself, degree 2, a condition beyond a bound, and what solutions do not have."""
    with pytest.raises(InputError, match="u is scalar"):
        Membrane().problem(lower={0: 0.0})
    case = Reaction(COMM)
    with pytest.raises(InputError, match=r"lower\[0\] is u itself"):
        ObstacleProblem(case.F, case.u, lower={0: case.u})
    V = releases.functionspace(square(COMM), "Lagrange", 2, 2)
    u, v = fem.Function(V), ufl.TestFunction(V)
    with pytest.raises(InputError, match=r"component 0 is of .* positive weights .* take degree 1"):
        ObstacleProblem(ufl.inner(u, v) * ufl.dx, u, lower={0: 0.0})
    given = with_space(case.u.function_space, 0, case.u.function_space.mesh, lambda x: np.isclose(x[0], 0))
    given[0].x.array[:] = -1.0
    with pytest.raises(InputError, match="component 0: a value of bcs lies below the lower obstacle"):
        ObstacleProblem(case.F, case.u, bcs=fem.dirichletbc(*given), lower={0: 0.0})
    problem = problem_of(case)
    for wrong in ({"bound": True}, {"eps": -1.0}, {"method": "newton"}, {"rtol": 1.0}, {"monitor": 3}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            problem.solve(**wrong)
    solution = problem.solve(method="vi")
    with pytest.raises(InputError, match="verify"):
        problem.verify(solution)
    for name in ("save", "plot", "at", "along", "verify"):
        with pytest.raises(InputError, match="bounds of components"):
            getattr(solution, name)("x")


def test_ranks_without_cells():
    """All cells are on the last rank; `collapse` of DOLFINx would end the process."""
    alone, case = (Reaction(comm, by_hand(*grid(4, 4), comm)) for comm in (MPI.COMM_SELF, COMM))
    truth, _ = dense(alone)
    theirs = ordered(truth.function_space, truth.x.array)
    for method, limit in (("vi", 1e-9), ("penalty", 0.011)):
        ours = ordered(case.u.function_space, problem_of(case).solve(method=method).u.x.array)
        assert np.all(np.abs(ours - theirs).max(axis=0) <= limit * np.abs(theirs).max(axis=0))
