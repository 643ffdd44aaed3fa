# %% [markdown]
# # An irreversible phase field: fracture in antiplane shear
#
# A phase-field model of fracture has two unknowns: the displacement $w$, which is perpendicular to the plane in
# antiplane shear, and the damage $d \in [0, 1]$. The damage is 1 on a crack and decreases to 0 over a distance of
# $2\ell$, where $\ell$ is a given length. Damage is irreversible: $d \ge d_{\text{old}}$, where $d_{\text{old}}$ is the
# damage of the previous load. At each load the damage therefore solves an obstacle problem with the lower obstacle
# $d_{\text{old}}$.
#
# With the shear modulus $\mu$, the fracture energy $G_c$ and a small number $\kappa$, the total energy of the model AT1
# (Ambrosio and Tortorelli) is
#
# $$ F(w, d) = \int \tfrac12 \left((1 - d)^2 + \kappa\right) \mu\,|\nabla w|^2
#    + \frac{3 G_c}{8} \int \left(\frac d\ell + \ell\,|\nabla d|^2\right), \qquad
#    d_{\text{old}} \le d \le 1 . $$
#
# The energy is quadratic in $w$ for a given $d$, and quadratic in $d$ for a given $w$. The staggered scheme minimises
# the energy alternately over $w$ and over $d$, until $d$ no longer changes. The problem for $w$ is linear, and the
# problem for $d$ is an obstacle problem.
#
# ## A crack that grows in proportion to the load
#
# The body is a strip of height $2H$. An initial crack of length $a_0$ on its middle line starts at the left side. The
# crack separates an upper and a lower arm. At the left side the displacement is prescribed: $w = t$ on the upper arm
# and $w = -t$ on the lower arm. We call $t$ the load. Let $a$ be the current crack length. If $a \gg H$, the
# displacement is $w = t\,(1 - x/a)$ along the upper arm, and its negative along the lower arm. The
# elastic energy $E$ of both arms and the energy release rate $G$ are then
#
# $$ E = \mu H\,\frac{t^2}{a}, \qquad G = -\frac{\partial E}{\partial a} = \mu H\,\frac{t^2}{a^2} . $$
#
# $G$ decreases with $a$. The crack therefore grows stably, and $G = G_c$ during the growth. This gives the crack length
#
# $$ a = t\,\sqrt{\mu H/G_c} . $$
#
# In this tutorial the load rises to $t = 3.25$ and then decreases. While the crack grows, $da/dt$ must be
# $\sqrt{\mu H/G_c}$. When the load decreases, the length must not change.
#
# $w$ is odd and $d$ is even in $y$. It is therefore enough to compute the upper half, with $w = 0$ at $y = 0$. This
# condition holds along the crack too, because in the phase-field model $w$ is continuous. In place of a jump at the
# crack, $w$ changes steeply in the damaged cells beside the line $y = 0$.
#
# Run this tutorial in a clone with `.venv/bin/python demos/phase_field.py`.

# %%
from mpi4py import MPI  # before dolfinx: DOLFINx from pip requires that MPI is already loaded

# isort: split
import dolfinx.fem.petsc  # noqa: F401  (not imported by dolfinx.fem in newer releases)
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, releases

comm = MPI.COMM_WORLD
mu, G_c, H, a_0, ell, kappa = 1.0, 1.0, 1.0, 1.5, 0.1, 1e-5
domain = mesh.create_rectangle(comm, [np.array([0.0, 0.0]), np.array([5.0, 1.0])], [125, 16])
domain.geometry.x[:, 1] **= 1.7  # cells of height 0.009 beside the crack
V = releases.functionspace(domain, "Lagrange", 1)
w, d, d_old = fem.Function(V, name="w"), fem.Function(V, name="d"), fem.Function(V)
test, trial = ufl.TestFunction(V), ufl.TrialFunction(V)

elastic = 0.5 * ((1 - d) ** 2 + kappa) * mu * ufl.inner(ufl.grad(w), ufl.grad(w)) * ufl.dx
surface = 3 * G_c / 8 * (d / ell + ell * ufl.inner(ufl.grad(d), ufl.grad(d))) * ufl.dx

# %% [markdown]
# ## The two problems
#
# The forms of both problems are derivatives of the same energy. The problem for the damage is an `ObstacleProblem`. The
# argument `lower=d_old` makes the damage irreversible. `d_old` is a Function, and each call of `damage.solve()` uses
# the current values of this Function. The problem for the displacement is an ordinary linear problem.
#
# The damage is solved with `method="vi"`, which keeps $d_{\text{old}} \le d \le 1$ to round-off. The default method
# penetrates the obstacles by $\varepsilon p$: $d$ would decrease a little in each step, and exceed 1. With that method
# copy the values between the obstacles, `d_old.x.array[:] = np.clip(d.x.array, d_old.x.array, 1.0)`.

# %%
damage = ObstacleProblem(ufl.derivative(elastic + surface, d, test), d, lower=d_old, upper=1.0)


def on(where):
    """Dofs of the boundary facets where `where(x)` holds."""
    return fem.locate_dofs_topological(V, 1, mesh.locate_entities_boundary(domain, 1, where))


pulled = fem.Function(V)
bcs = [
    fem.dirichletbc(pulled, on(lambda x: np.isclose(x[0], 0.0))),
    fem.dirichletbc(fem.Function(V), on(lambda x: np.isclose(x[1], 0.0))),  # at the corner this last condition holds
]
K = fem.form(ufl.derivative(ufl.derivative(elastic, w, test), w, trial))
zero = fem.form(fem.Constant(domain, 0.0) * test * ufl.dx)
solver = PETSc.KSP().create(comm)
solver.setType("preonly")
solver.getPC().setType("lu")
solver.getPC().setFactorSolverType("mumps")


def displace():
    """Minimise the energy over w (collective)."""
    A, b = fem.petsc.assemble_matrix(K, bcs=bcs), fem.petsc.assemble_vector(zero)
    A.assemble()
    fem.petsc.apply_lifting(b, [K], bcs=[bcs])
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    fem.petsc.set_bc(b, bcs)
    solver.setOperators(A)
    x = b.duplicate()
    solver.solve(b, x)
    w.x.array[: V.dofmap.index_map.size_local] = x.array_r
    w.x.scatter_forward()


# %% [markdown]
# ## Loading and unloading
#
# The crack length is computed from the elastic energy $E$ of both arms, as $a = \mu H t^2/E$. By symmetry $E$ is twice
# the elastic energy of the upper half. The strip ahead of the crack tip also deforms. The length $a$ is therefore
# larger than the length of the damaged line. While the crack grows, the difference is constant, and a fraction of $H$.


# %%
def total(form):
    """An integral over all ranks, for both halves."""
    return 2 * comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)


energies = fem.form(elastic), fem.form(surface)
d_old.interpolate(lambda x: np.where((x[0] <= a_0) & (x[1] < 1e-9), 1.0, 0.0))
d.x.array[:] = d_old.x.array
loads = [1, 1.5, 2, 2.25, 2.5, 2.75, 3, 3.25, 1.5, 0.5]
lengths, surfaces = [], []
for t in loads:
    pulled.x.array[:] = t
    change, steps = 1.0, 0
    while change > 2e-3:
        before = d.x.array.copy()
        displace()
        damage.solve(method="vi")
        change = comm.allreduce(np.abs(d.x.array - before).max(initial=0.0), op=MPI.MAX)
        steps += 1
    assert comm.allreduce((d.x.array - d_old.x.array).min(initial=0.0), op=MPI.MIN) > -1e-12  # no decrease of d
    d_old.x.array[:] = d.x.array
    lengths.append(mu * H * t**2 / total(energies[0]))
    surfaces.append(total(energies[1]))
    if comm.rank == 0:
        print(f"t = {t:4.2f}  {steps:3d} steps  crack length {lengths[-1]:.3f}  surface energy {surfaces[-1]:.3f}")

# %% [markdown]
# Up to $t = 2.25$ the length increases only slightly, because damage develops around the crack tip. From $t = 2.5$ to
# $t = 3.25$ the crack grows. For these four loads, a straight line is fitted to the crack length over the load. The
# slope of this line agrees with $\sqrt{\mu H/G_c} = 1$ to within 5 %. The surface energy per unit of crack length, also
# from a fit, agrees with $G_c = 1$ to within 5 %. When the load decreases, the length does not change.

# %%
growing = slice(loads.index(2.5), loads.index(3.25) + 1)
slope = np.polyfit(loads[growing], lengths[growing], 1)[0]
cost = np.polyfit(lengths[growing], surfaces[growing], 1)[0]
if comm.rank == 0:
    print(
        f"da/dt = {slope:.3f}, expected {np.sqrt(mu * H / G_c):.3f}; energy per length {cost:.3f}, expected {G_c:.3f}"
    )
assert np.isclose(slope, np.sqrt(mu * H / G_c), rtol=0.05)
assert np.isclose(cost, G_c, rtol=0.05)
assert np.allclose(lengths[-2:], max(lengths), rtol=1e-3)

# %% [markdown]
# ## Picture
#
# Left: the damage at the end. The lower half of the strip is drawn by symmetry. Right: the crack length over the load.

# %%
own = V.dofmap.index_map.size_local
rows = np.column_stack([V.tabulate_dof_coordinates()[:own, :2], d.x.array[:own]])
everywhere = comm.gather(rows)
if comm.rank == 0:
    x, y, values = np.concatenate(everywhere).T
    page, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained", width_ratios=(1.6, 1))
    for sign in (1, -1):
        image = left.tricontourf(x, sign * y, values, levels=np.linspace(0, 1.0001, 21), cmap="Greys")
    left.set(title="damage d", xlabel="x", ylabel="y", aspect="equal")
    page.colorbar(image, ax=left, ticks=[0, 0.5, 1], shrink=0.7)
    up = len(loads) - 2
    right.plot(loads[:up], lengths[:up], "o-", color="#0072B2", label="loading")
    right.plot(loads[up - 1 :], lengths[up - 1 :], "s--", color="#D55E00", label="unloading")
    t = np.array([2.25, 3.25])
    right.plot(t, lengths[up - 1] + t - 3.25, "k:", linewidth=2, label="slope 1")
    right.set(title="crack length a", xlabel="load t")
    right.legend(frameon=False)
    page.savefig("phase_field.png", dpi=120)
