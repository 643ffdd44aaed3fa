# %% [markdown]
# # Two species that consume each other: bounds of both components
#
# The concentrations $u_0$ and $u_1$ diffuse, react with each other, and are extracted at given rates. A given rate
# ends where a species is used up: both concentrations are bounded, $u_0 \ge 0$ and $u_1 \ge 0$. For one step of the
# implicit Euler method, with $u^{n-1}$ the concentrations before the step, the residual is
#
# $$ F(u; v) = \int \frac{u - u^{n-1}}{\tau} \cdot v + D\, \nabla u : \nabla v + k\, u_0 u_1 (v_0 + v_1)
#    + q_0 v_0 + q_1 v_1 . $$
#
# The pressure of a component is the rate of extraction that is missing where the species is used up.
#
# Run this tutorial in a clone with `.venv/bin/python demos/two_species.py`.

# %%
from mpi4py import MPI  # before dolfinx: DOLFINx from pip requires that MPI is already loaded

# isort: split
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square

from fenicsx_obstacle import ObstacleProblem, releases

mesh = create_unit_square(MPI.COMM_WORLD, 32, 32)
V = releases.functionspace(mesh, "Lagrange", 1, 2)  # two components
u, old, v = fem.Function(V), fem.Function(V), ufl.TestFunction(V)
u.interpolate(lambda x: np.vstack([x[0], 1 - x[0]]))
tau, D, k, q = 0.05, 0.01, 4.0, (0.5, 0.3)
F = (ufl.inner(u - old, v) / tau + D * ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx
F += (k * u[0] * u[1] * (v[0] + v[1]) + q[0] * v[0] + q[1] * v[1]) * ufl.dx

# %% [markdown]
# ## Ten steps
#
# The keys of `lower` are the numbers of the components. The coupling is not linear; Newton's method and the active sets
# of both components converge together. There is no flux through the boundary. Therefore, in each step and for each
# species, the decrease is the reaction and the extraction, less the missing extraction.

# %%
problem = ObstacleProblem(F, u, lower={0: 0.0, 1: 0.0})


def integral(f):
    """The integral over the domain, on all ranks."""
    return mesh.comm.allreduce(fem.assemble_scalar(fem.form(f * ufl.dx)))


for _ in range(10):
    old.x.array[:] = u.x.array
    solution = problem.solve(method="vi")
    for i in (0, 1):
        taken = k * integral(u[0] * u[1]) + q[i] - solution.force[i].lower
        assert np.isclose(integral(old[i] - u[i]), tau * taken, rtol=1e-8)

if mesh.comm.rank == 0:
    print(solution.summary())
assert u.x.array.min() >= 0
assert 0 < solution.area[0] < 1 and solution.force[0].lower < q[0]

# %% [markdown]
# Where a species is used up the missing extraction is at most $q$, since no reaction is left to consume it.

# %%
for i in (0, 1):
    p = solution.pressure[i].x.array
    assert np.all(p >= 0) and np.all(p <= q[i] + 1e-8)

# %% [markdown]
# ## Picture
#
# The concentrations along the middle of the domain, where the data do not depend on y. Dots are nodes at which a
# species is used up.

# %%
x = V.tabulate_dof_coordinates()
row = np.flatnonzero((np.abs(x[:, 1] - 0.5) < 1e-9) & (np.arange(len(x)) < V.dofmap.index_map.size_local))
lines = [np.column_stack([x[row, 0], u.x.array.reshape(-1, 2)[row, i]]) for i in (0, 1)]
lines = [np.concatenate(mesh.comm.allgather(line)) for line in lines]
if mesh.comm.rank == 0:
    page, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
    for i, (line, color) in enumerate(zip(lines, ("#0072B2", "#D55E00"), strict=True)):
        at, value = line[np.argsort(line[:, 0])].T
        axes.plot(at, value, "-", color=color, label=f"$u_{i}$")
        axes.plot(at[value == 0], value[value == 0], ".", color=color)
    axes.set(xlabel="x", ylabel="concentration")
    axes.legend(frameon=False)
    page.savefig("two_species.png", dpi=120)
