"""A rigid cylinder on an elastic block in plane strain, compared with the formulas of Hertz.

The cylinder is fixed and touches the block at the origin. The bottom of the block is lifted by 0.118. By symmetry only
the half 0 < x < 40, -40 < y < 0 of the block is computed.

Run this file in a clone with `.venv/bin/python demos/hertz.py`, or in parallel with
`mpirun -n 2 .venv/bin/python demos/hertz.py`.
"""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, releases

comm, radius, side, nu = MPI.COMM_WORLD, 20.0, 40.0, 0.3
cells = 26
mesh = dmesh.create_rectangle(comm, [np.zeros(2), np.ones(2)], [cells, cells])


def stretched(t):  # small cells of equal size within 1.6 of the corner at the origin
    return np.where(t < 0.6, t * 1.6 / 0.6, 1.6 * (side / 1.6) ** ((t - 0.6) / 0.4))


x = mesh.geometry.x
x[:, 0], x[:, 1] = stretched(x[:, 0]), -stretched(1 - x[:, 1])
V = releases.functionspace(mesh, "Lagrange", 2, 2)
u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
young = 1 - nu**2  # so that E* = E/(1 - nu^2) = 1
mu, lam = young / 2 / (1 + nu), young * nu / (1 + nu) / (1 - 2 * nu)
strain = ufl.sym(ufl.grad(u))
stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(2)
F = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx


def held(where, axis, value):
    dofs = fem.locate_dofs_topological(V.sub(axis), 1, dmesh.locate_entities_boundary(mesh, 1, where))
    return fem.dirichletbc(PETSc.ScalarType(value), dofs, V.sub(axis))


bcs = [held(lambda x: np.isclose(x[0], 0), 0, 0.0), held(lambda x: np.isclose(x[1], -side), 1, 0.118)]
top = np.sort(dmesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0) & (x[0] < 3.2)))
ds = ufl.Measure("ds", domain=mesh, subdomain_data=dmesh.meshtags(mesh, 1, top, np.full(len(top), 3, np.int32)))
problem = ObstacleProblem(F, u, bcs=bcs, upper=x[0] ** 2 / (2 * radius), of=u[1], measure=ds(3))
nodes = problem.solve().nodes
forces = -2 * nodes.forces[:, 1]  # of both halves
# by Hertz, half-width a with a^2 = 4 force radius/(pi E*)
a = np.sqrt(4 * forces.sum() * radius / np.pi)
# p^2 = peak^2 (1 - x^2/a^2) is linear in x^2: the fit at x = 0 is the computed peak^2
inner = nodes.points[:, 0] < 0.9 * a
peak = np.sqrt(np.polyfit(nodes.points[inner, 0] ** 2, nodes.pressure[inner] ** 2, 1)[1])
if comm.rank == 0:
    print(f"force {forces.sum():.5f}")
    # the mean of x^2 weighted by the forces is a^2/4: the computed half-width is 2 sqrt(mean)
    print(f"half-width {2 * np.sqrt(forces @ nodes.points[:, 0] ** 2 / forces.sum()):.4f}, by Hertz {a:.4f}")
    print(f"peak {peak:.5f}, by Hertz {2 * forces.sum() / (np.pi * a):.5f}")
