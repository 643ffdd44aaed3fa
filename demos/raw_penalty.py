"""A penalty with a constant k, as it is often written in DOLFINx, compared with ObstacleProblem.

A rigid cylinder of radius R is pressed on an elastic block in plane strain (Hertz). Let u_y be the displacement of the
block along y, v_y the test function, and g the gap. The penalty term int k max(u_y - g, 0) v_y ds is integrated by a
Gauss rule. The pressure at the nodes is k max(u_y - g, 0). The modulus E* = E/(1 - nu^2) is 1, and the half-width of
the contact is about 1. The unit of k is E* per half-width.

If k is too small, the cylinder penetrates the block. If k is large, u_y = g holds nearly exactly at the Gauss points,
which lie between the nodes. The piecewise linear u_y then differs from the curved gap g at the nodes by up to
h^2/(8R), with the cell size h. Multiplied by a large k, this difference is much larger than the true pressure. The
contact force is then right, but the pressure at the nodes is meaningless. Newton's method starts from u = 0, and takes
more steps for a larger k.

This file prints the Newton steps, the contact force and the error of the pressure, for ObstacleProblem and for five
values of k. Run this file with

    mpirun -n 2 python3 raw_penalty.py
"""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, releases

comm, radius, side, nu, cells = MPI.COMM_WORLD, 20.0, 40.0, 0.3, 52
mesh = dmesh.create_rectangle(comm, [np.zeros(2), np.ones(2)], [cells, cells])


def stretched(t):  # small cells of equal size within 1.6 of the corner at the origin
    return np.where(t < 0.6, t * 1.6 / 0.6, 1.6 * (side / 1.6) ** ((t - 0.6) / 0.4))


x = mesh.geometry.x
x[:, 0], x[:, 1] = stretched(x[:, 0]), -stretched(1 - x[:, 1])
V = releases.functionspace(mesh, "Lagrange", 1, 2)
u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
young = 1 - nu**2  # so that E* = E/(1 - nu^2) = 1
mu, lam = young / 2 / (1 + nu), young * nu / (1 + nu) / (1 - 2 * nu)
strain = ufl.sym(ufl.grad(u))
F = ufl.inner(2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(2), ufl.sym(ufl.grad(v))) * ufl.dx


def held(where, axis, value):
    dofs = fem.locate_dofs_topological(V.sub(axis), 1, dmesh.locate_entities_boundary(mesh, 1, where))
    return fem.dirichletbc(PETSc.ScalarType(value), dofs, V.sub(axis))


bcs = [held(lambda x: np.isclose(x[0], 0), 0, 0.0), held(lambda x: np.isclose(x[1], -side), 1, 0.118)]
top = np.sort(dmesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0) & (x[0] < 3.2)))
ds = ufl.Measure("ds", domain=mesh, subdomain_data=dmesh.meshtags(mesh, 1, top, np.full(len(top), 3, np.int32)))
gap = x[0] ** 2 / (2 * radius)
problem = ObstacleProblem(F, u, bcs=bcs, upper=gap, of=u[1], measure=ds(3))


def raw(k, limit=40):
    """Newton's method with full steps and a direct solver, until the residual is below 1e-8 of the first one."""
    u.x.array[:] = 0.0
    form = F + k * ufl.max_value(u[1] - gap, 0) * v[1] * ds(3)
    residual, jacobian = releases.form(form), releases.form(ufl.derivative(form, u))
    ksp = PETSc.KSP().create(comm)
    ksp.setType("preonly")
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    first = 0.0
    for step in range(limit):
        A = fem.petsc.assemble_matrix(jacobian, bcs=bcs)
        A.assemble()
        b = fem.petsc.assemble_vector(residual)
        fem.petsc.apply_lifting(b, [jacobian], [bcs], [releases.vec(u)], -1.0)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem.petsc.set_bc(b, bcs, releases.vec(u), -1.0)
        size = b.norm()
        first = first or size
        if step and size < 1e-8 * first:
            return step
        ksp.setOperators(A)
        correction = b.duplicate()
        ksp.solve(b, correction)
        releases.vec(u).axpy(-1.0, correction)
        u.x.scatter_forward()
    return None


def error(x, p, force):
    """Largest error of p at nodes with x < 0.8 a (a: half-width), divided by Hertz's largest p for the same force."""
    a = np.sqrt(4 * force * radius / np.pi)
    inner = x < 0.8 * a
    hertz = 2 * force / (np.pi * a) * np.sqrt(1 - (x[inner] / a) ** 2)
    return np.abs(p[inner] - hertz).max() / hertz.max()


def told(way, steps, x, p, force):
    if comm.rank == 0:
        steps = "not in 40 steps" if steps is None else f"{steps} steps"
        print(f"{way:16s} {steps:16s} force {force:.5f}, error of p {error(x, p, force):.1%}")


solution = problem.solve()
nodes = solution.nodes
told("ObstacleProblem", solution.iterations, nodes.points[:, 0], -nodes.pressure, -2 * nodes.resultant[1])
Q = releases.functionspace(mesh, "Lagrange", 1)
own = fem.locate_dofs_topological(Q, 1, top)
own = own[own < Q.dofmap.index_map.size_local]
for k in (1, 1e2, 1e4, 1e6, 1e8):
    steps = raw(k)
    pressure = fem.Function(Q)
    pressure.interpolate(releases.expression(k * ufl.max_value(u[1] - gap, 0), Q))
    places, p = (
        np.concatenate(comm.allgather(one[own])) for one in (Q.tabulate_dof_coordinates()[:, 0], pressure.x.array)
    )
    force = 2 * comm.allreduce(fem.assemble_scalar(releases.form(k * ufl.max_value(u[1] - gap, 0) * ds(3))))
    told(f"by hand, k = {k:.0e}", steps, places, p, force)
