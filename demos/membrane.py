# %% [markdown]
# # A membrane over an obstacle
#
# A membrane with tension 1 is fixed at the boundary of the square $\Omega = (-2, 2)^2$ and rests on a ball of radius 1.
# Let $\psi$ be the upper side of the ball. The height $u$ of the membrane minimises the energy
# $\frac12 \int |\nabla u|^2$ among all functions that have the given boundary values and satisfy $u \ge \psi$. With the
# contact pressure $p$ the equivalent problem is
#
# $$ -\Delta u = p, \qquad u \ge \psi, \qquad p \ge 0, \qquad p\,(u - \psi) = 0 \quad \text{in } \Omega . $$
#
# The boundary values are those of a known radial solution. Let $r$ be the distance from the origin. For $r \le a$ the
# membrane is in contact with the ball. For $r > a$ it is $u = A \ln(R/r)$ with $R = 2$. At $r = a$ this function has
# the same value and slope as the ball if
#
# $$ a^2 \left(1 + \ln \frac Ra\right) = 1, \qquad A = \frac{a^2}{\sqrt{1 - a^2}} . $$
#
# The solution of these equations is $a = 0.69797$ and $A = 0.68026$. The force on the ball is $2\pi A$.
#
# Run this tutorial in a clone with `.venv/bin/python demos/membrane.py`, or in parallel with
# `mpirun -n 2 .venv/bin/python demos/membrane.py`.

# %%
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from fenicsx_obstacle import ObstacleProblem, releases

a, A, R = 0.6979651482233736, 0.6802594118917189, 2.0
domain = mesh.create_rectangle(MPI.COMM_WORLD, [np.array([-2.0, -2.0]), np.array([2.0, 2.0])], [64, 64])
V = releases.functionspace(domain, "Lagrange", 1)
u, v = fem.Function(V), ufl.TestFunction(V)
F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx

edge = fem.locate_dofs_geometrical(V, lambda x: np.isclose(abs(x[:2]).max(axis=0), 2.0))
held = fem.Function(V)
held.interpolate(lambda x: A * np.log(R / np.maximum(np.hypot(x[0], x[1]), a)))


def ball(x):
    """Height of the ball for r < 0.9; for larger r, where there is no contact, height of its tangent cone."""
    r = np.hypot(x[0], x[1])
    cone = np.sqrt(1 - 0.9**2) - 0.9 / np.sqrt(1 - 0.9**2) * (r - 0.9)
    return np.where(r < 0.9, np.sqrt(np.maximum(1 - r**2, 0)), cone)


solution = ObstacleProblem(F, u, bcs=[fem.dirichletbc(held, edge)], lower=ball).solve()

# %% [markdown]
# `solution.u`, `solution.pressure` and `solution.contact` are DOLFINx Functions. The contact force
# `solution.force.lower` and the contact area `solution.area` are numbers. They are the same on every rank.

# %%
radius = np.sqrt(solution.area / np.pi)
if domain.comm.rank == 0:
    print(f"force {solution.force.lower:.4f}, exact {2 * np.pi * A:.4f}")
    print(f"contact radius {radius:.3f}, exact {a:.3f}; {solution.iterations} Newton steps")
assert np.isclose(solution.force.lower, 2 * np.pi * A, rtol=2e-3)
assert abs(radius - a) < 4 / 64  # one cell

# %% [markdown]
# The picture shows $u$. The colour shows the contact pressure. The black line is the free boundary, that
# is, the edge of the contact set.

# %%
picture = solution.plot("membrane.png")
