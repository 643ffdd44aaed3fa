"""Bounds of components of blocked and mixed spaces, against dense active sets by NumPy on one rank."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import ObstacleProblem, releases
from tests.conftest import COMM

BEGIN, STEP = (lambda x: x[0] * (1 - x[1]), lambda x: 0.4 * x[1] ** 2 + 0 * x[0]), 0.05


def square(comm, cells=6):
    return dmesh.create_unit_square(comm, cells, cells)


def mixed_space(mesh, *elements):
    """Of elements as (family, degree, components or None)."""
    if releases.OLD:
        make = {None: lambda f, d: ufl.FiniteElement(f, mesh.ufl_cell(), d)}
        parts = [make[None](f, d) if n is None else ufl.VectorElement(f, mesh.ufl_cell(), d, n) for f, d, n in elements]
        return fem.FunctionSpace(mesh, ufl.MixedElement(parts))
    import basix.ufl

    cell = mesh.basix_cell()
    return fem.functionspace(mesh, basix.ufl.mixed_element(
        [basix.ufl.element(f, cell, d, shape=() if n is None else (n,)) for f, d, n in elements]))  # fmt: skip


class Reaction:
    """Implicit Euler for two species that consume each other; each is removed at a rate that may exhaust it."""

    def __init__(self, comm):
        mesh = square(comm)
        V = releases.functionspace(mesh, "Lagrange", 1, 2)
        self.u, v, old = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
        old.interpolate(lambda x: np.vstack([begin(x) for begin in BEGIN]))
        self.u.x.array[:] = old.x.array
        x, (a, b) = ufl.SpatialCoordinate(mesh), ufl.split(self.u)
        self.F = ufl.inner((self.u - old) / STEP, v) * ufl.dx + 0.02 * ufl.inner(ufl.grad(self.u), ufl.grad(v)) * ufl.dx
        self.F += ((5 * a * b**2 + 3 * x[0]) * v[0] + (2 * a * b - 4 * x[1] * (1 - x[0]) + 1) * v[1]) * ufl.dx
        self.bcs, self.bounds = [], {"lower": {0: 0.0, 1: 0.0}, "upper": {1: 0.3}}


class Seepage:
    """A viscous fluid with Taylor-Hood elements whose pressure cannot be negative: where it is 0, div u >= 0."""

    def __init__(self, comm, sign=1.0):
        mesh = square(comm, 4)
        W = mixed_space(mesh, ("Lagrange", 2, 2), ("Lagrange", 1, None))
        self.u = fem.Function(W)
        (u, p), (v, q), x = ufl.split(self.u), ufl.TestFunctions(W), ufl.SpatialCoordinate(mesh)
        load = ufl.as_vector((4 * (x[0] - 0.5), 2 * x[0] - 3 * x[1] ** 2))
        self.F = (ufl.inner(ufl.grad(u), ufl.grad(v)) - p * ufl.div(v) + sign * q * ufl.div(u)) * ufl.dx
        self.F -= ufl.inner(load, v) * ufl.dx
        self.bcs = [fem.dirichletbc(*with_space(W, 0, mesh, lambda x: np.isclose(x[0], 0)))]
        self.bounds = {"lower": {1: 0.0}}


def with_space(W, sub, mesh, where):
    """The arguments of a Dirichlet condition u = 0 of a sub-space."""
    V, _ = W.sub(sub).collapse()
    facets = dmesh.locate_entities_boundary(mesh, mesh.topology.dim - 1, where)
    return fem.Function(V), fem.locate_dofs_topological((W.sub(sub), V), mesh.topology.dim - 1, facets), W.sub(sub)


class Damage:
    """A monolithic step of AT2 with the displacement in the plane; damage does not heal, and is at most 1."""

    def __init__(self, comm):
        mesh = square(comm, 5)
        W = mixed_space(mesh, ("Lagrange", 1, 2), ("Lagrange", 1, None))
        self.u = fem.Function(W)
        u, d = ufl.split(self.u)
        strain = ufl.sym(ufl.grad(u))
        elastic = 10 * ufl.inner(strain, strain) + 5 * ufl.tr(strain) ** 2
        energy = ((1 - d) ** 2 + 1e-3) * elastic * ufl.dx + (
            d**2 / 0.2 + 0.2 * ufl.inner(ufl.grad(d), ufl.grad(d))
        ) * ufl.dx
        self.F = ufl.derivative(energy, self.u, ufl.TestFunction(W))
        self.bcs = [fem.dirichletbc(*with_space(W, 0, mesh, lambda x: np.isclose(x[1], 0)))]
        up = with_space(W, 0, mesh, lambda x: np.isclose(x[1], 1))
        up[0].interpolate(lambda x: np.vstack([0 * x[0], 0.12 + 0 * x[0]]))
        self.bcs.append(fem.dirichletbc(*up))
        self.old = fem.Function(W.sub(1).collapse()[0])
        self.old.interpolate(lambda x: np.maximum(0, 0.7 - 2 * abs(x[0] - 0.3) - x[1]))
        self.bounds = {"lower": {1: self.old}, "upper": {1: 1.0}}


CASES = {"reaction": Reaction, "seepage": Seepage, "damage": Damage}


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
    comm = u.function_space.mesh.comm
    V, dofs = u.function_space.sub(k).collapse()
    own, size = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    found = (u.x.array if values is None else values)[np.asarray(dofs)][: own * size].reshape(own, size)
    return ordered(comm, V.tabulate_dof_coordinates()[:own], found)


def ordered(comm, points, found):
    points, found = (np.concatenate(comm.allgather(one)) for one in (points, found))
    return found[np.lexsort(np.round(points, 9).T)]


def truth_of(name):
    return dense(CASES[name](MPI.COMM_SELF))


@pytest.mark.parametrize("name", CASES)
def test_the_inequality_is_solved(name):
    """u of SNES VI is that of dense active sets, at all nodes of all components; so are the contact forces."""
    (truth, forces), case = truth_of(name), CASES[name](COMM)
    solution = ObstacleProblem(case.F, case.u, bcs=case.bcs, **case.bounds).solve(method="vi")
    for k in range(truth.function_space.num_sub_spaces):
        ours, theirs = by_place(solution.u, k), by_place(truth, k)
        assert np.abs(ours - theirs).max() <= 1e-9 * max(np.abs(theirs).max(), 1e-3)
    for k, force in solution.force.items():
        reaction = by_place(truth, k, forces)
        assert force.lower == pytest.approx(np.maximum(reaction, 0).sum(), rel=1e-8)
        if force.upper is not None:
            assert force.upper == pytest.approx(np.maximum(-reaction, 0).sum(), rel=1e-8, abs=1e-10)
        assert solution.penetration[k] == 0
    assert np.array_equal(case.u.x.array, solution.u.x.array)
