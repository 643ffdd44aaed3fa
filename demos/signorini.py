# %% [markdown]
# # An obstacle on the boundary (Signorini's problem)
#
# In this tutorial the obstacle acts only on a part $\Gamma_C$ of the boundary: find $u$ with
#
# $$ -\Delta u = 0 \ \text{in } \Omega, \qquad u \ge 0, \quad p = \partial_n u \ge 0, \quad p\,u = 0
#    \ \text{on } \Gamma_C. $$
#
# Let $\Omega = (-1, 1) \times (0, 1)$, let $\Gamma_C$ be the bottom side of $\Omega$, and let $r$ and $\theta$ be polar
# coordinates around the origin. A solution is
#
# $$ u = r^{3/2} \cos \tfrac{3}{2}\theta, \qquad
#    p = \tfrac32 \sqrt{-x} \ \text{for } x < 0, \quad p = 0 \ \text{for } x > 0 . $$
#
# In this tutorial the values of this function $u$ are prescribed on the other three sides.
#
# The contact set is the part of the bottom side with $x \le 0$. The free boundary is a single point, the origin. The
# contact length is 1. The contact force $\int_{-1}^0 \frac32 \sqrt{-x}\,dx$ is also 1.
#
# Run this tutorial in a clone with `.venv/bin/python demos/signorini.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from fenicsx_obstacle import ObstacleProblem, releases

comm = MPI.COMM_WORLD


def exact(x):
    """u at points of shape (3, n)."""
    r, theta = np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])
    return r**1.5 * np.cos(1.5 * theta)


# %% [markdown]
# The facets of the bottom side have the tag 3. `measure=ds(3)` tells `ObstacleProblem` that contact is possible on
# these facets only. The rest is ordinary DOLFINx. The exact values are prescribed on the other three sides, but not at
# the corner $(-1, 0)$, which belongs to the contact set. `method="vi"` solves the variational inequality without a
# penalty. Then there is no error of a penalty, only the error of the discretisation.


# %%
def signorini(cells):
    """Solution on a grid of `2*cells` by `cells` squares, each cut into two triangles (collective)."""
    domain = mesh.create_rectangle(comm, [np.array([-1.0, 0.0]), np.array([1.0, 1.0])], [2 * cells, cells])
    bottom = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(domain, 1, np.sort(bottom), np.full(len(bottom), 3, dtype=np.int32))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)

    V = releases.functionspace(domain, "Lagrange", 1)
    u, v, g = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
    g.interpolate(exact)
    given = fem.locate_dofs_geometrical(
        V, lambda x: np.isclose(x[0], 1.0) | (x[1] > 1e-9) & (np.isclose(x[0], -1.0) | np.isclose(x[1], 1.0))
    )
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = ObstacleProblem(F, u, bcs=[fem.dirichletbc(g, given)], lower=0.0, measure=ds(3))
    return problem.solve(method="vi")


sizes = [8, 16, 32, 64]
solutions = [signorini(n) for n in sizes]


# %% [markdown]
# ## Error, contact force and contact length
#
# $u$ is in $H^s$ for all $s < 5/2$. The error $\|\nabla(u - u_h)\|_0$ of the computed solution $u_h$ in the energy norm
# therefore has order 1 with linear elements. It is computed from the exact gradient with a quadrature rule of
# degree 6. `solution.area` is the measure of the contact set, here a length.


# %%
def energy_error(solution):
    """||grad(u - u_h)||_0 (collective)."""
    x = ufl.SpatialCoordinate(solution.level.mesh)
    r, theta = ufl.sqrt(x[0] ** 2 + x[1] ** 2), releases.atan2(x[1], x[0])
    slope = 1.5 * ufl.sqrt(r) * ufl.as_vector([ufl.cos(theta / 2), -ufl.sin(theta / 2)])
    difference = ufl.grad(solution.u) - slope
    square = fem.form(ufl.inner(difference, difference) * ufl.dx(metadata={"quadrature_degree": 6}))
    return np.sqrt(comm.allreduce(fem.assemble_scalar(square), op=MPI.SUM))


errors = [energy_error(solution) for solution in solutions]
orders = -np.diff(np.log2(errors))
forces = [solution.force.lower for solution in solutions]
lengths = [solution.area for solution in solutions]
if comm.rank == 0:
    print("  1/h  energy error  order  force   length")
    for row in zip(sizes, errors, [np.nan, *orders], forces, lengths, strict=True):
        print("{:5d}  {:12.3e}  {:5.2f}  {:.4f}  {:.4f}".format(*row))
assert np.allclose(orders, 1, atol=0.02)
assert np.isclose(forces[-1], 1, atol=1e-3)
assert np.isclose(lengths[-1], 1, atol=1 / 64)

# %% [markdown]
# ## Picture
#
# Left: $u$ and the pressure along the bottom side, on the second mesh. Right: the energy error over the mesh size $h$.

# %%
line = solutions[1].along((-1, 0), (1, 0), n=33)
if comm.rank == 0:
    page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    x = np.linspace(-1, 1, 401)
    left.plot(x, 1.5 * np.sqrt(np.maximum(-x, 0)), "k-", linewidth=1, label="p, exact")
    left.plot(line.points[:, 0], line.pressure, "o", markersize=4, color="#D55E00", label="p, h = 1/16")
    left.plot(line.points[:, 0], line.u, "s", markersize=4, color="#0072B2", label="u, h = 1/16")
    left.set(xlabel="x on the bottom side", title="u and contact pressure at y = 0")
    left.legend(frameon=False)
    h = 1 / np.array(sizes)
    right.loglog(h, errors, "o-", color="#0072B2", label="energy error")
    right.loglog(h, 1.3 * errors[-1] * h / h[-1], "k:", label="order 1")
    right.set_xticks(h, [f"1/{1 / side:.0f}" for side in h])
    right.minorticks_off()
    right.set(xlabel="h", title="error")
    right.legend(frameon=False)
    page.savefig("signorini.png", dpi=120)
