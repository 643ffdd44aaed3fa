# %% [markdown]
# # One added line in a DOLFINx code of your own
#
# The code below is ordinary DOLFINx and PETSc, except for the import from `fenicsx_obstacle` and the lines marked
# with <---. Kikuchi's penalty method adds one term to a residual $F(u; v)$: find $u$ in the finite element space $V_h$
# with
#
# $$ F(u; v) - \frac1\varepsilon\, I((g - u)^+, v) = 0 \quad \text{for all } v \in V_h . $$
#
# Here $g$ is a lower obstacle, $\varepsilon$ the penalty parameter, $x^+ = \max(x, 0)$, and $I$ a quadrature rule whose
# points are the nodes. The contact pressure at the nodes is $p = (g - u)^+/\varepsilon$. $F$ may be linear or
# nonlinear in $u$.
#
# Run this tutorial in a clone with `.venv/bin/python demos/one_added_line.py`.

# %%
from mpi4py import MPI  # before dolfinx: DOLFINx from pip requires that MPI is already loaded

# isort: split
import dolfinx.fem.petsc  # noqa: F401  (not imported by dolfinx.fem in newer releases)
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

from fenicsx_obstacle import contact_pressure, penalty

functionspace = getattr(fem, "functionspace", None) or fem.FunctionSpace  # its name in DOLFINx 0.5

# %% [markdown]
# ## A Newton solver as in any DOLFINx code
#
# This function sets up SNES with residual and Jacobian. It contains nothing that is specific to obstacles.


# %%
def newton(F, u, bc, rtol):
    """PETSc SNES with its default convergence tests; returns the reason why it stopped."""
    form, J = fem.form(F), fem.form(ufl.derivative(F, u))
    A = fem.petsc.create_matrix(J)
    owned = u.function_space.dofmap.index_map.size_local

    def residual(snes, x, out):
        x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)  # lifting reads the ghosts
        u.x.array[:owned] = x.array_r
        u.x.scatter_forward()
        with out.localForm() as local:
            local.set(0.0)
        fem.petsc.assemble_vector(out, form)
        fem.petsc.apply_lifting(out, [J], [[bc]], [x], -1.0)
        out.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem.petsc.set_bc(out, [bc], x, -1.0)

    def jacobian(snes, x, A, P):
        A.zeroEntries()
        fem.petsc.assemble_matrix(A, J, [bc])
        A.assemble()

    x = fem.petsc.assemble_vector(form)
    b = x.duplicate()
    x.set(0.0)
    snes = PETSc.SNES().create(MPI.COMM_WORLD)
    snes.setFunction(residual, b)
    snes.setJacobian(jacobian, A)
    snes.setTolerances(rtol=rtol)
    snes.getKSP().setType("cg")
    snes.getKSP().getPC().setType("gamg")
    snes.getKSP().setTolerances(rtol=1e-10)
    snes.setFromOptions()
    snes.solve(None, x)
    u.x.array[:owned] = x.array_r
    u.x.scatter_forward()
    return snes.getConvergedReason()


# %% [markdown]
# ## The residual, and the added line
#
# The residual is $F(u; v) = \int \sigma(\nabla u) \cdot \nabla v$ on $(-2, 2)^2$. The function `over_ball` has two
# arguments: the stress $\sigma$ and the values of $u$ on the boundary. The obstacle is a ball of radius 1 below $u$.


# %%
def ball(x):
    """Height of the ball for r < 0.9; for larger r, where there is no contact, height of its tangent cone."""
    r = np.hypot(x[0], x[1])
    cone = np.sqrt(1 - 0.9**2) - 0.9 / np.sqrt(1 - 0.9**2) * (r - 0.9)
    return np.where(r < 0.9, np.sqrt(np.maximum(1 - r**2, 0)), cone)


def over_ball(stress, outside, cells=64, eps=1e-4, rtol=1e-10):
    """u, p and the reason of SNES, with u = outside(r) on the boundary (collective)."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [np.array([-2.0, -2.0]), np.array([2.0, 2.0])], [cells, cells])
    V = functionspace(domain, ("Lagrange", 1))
    u, v, g = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
    g.interpolate(ball)

    F = ufl.inner(stress(ufl.grad(u)), ufl.grad(v)) * ufl.dx
    F += penalty(u, v, lower=g, eps=eps)  # <--- the one added line

    domain.topology.create_connectivity(1, 2)
    boundary = fem.locate_dofs_topological(V, 1, mesh.exterior_facet_indices(domain.topology))
    held = fem.Function(V)
    held.interpolate(lambda x: outside(np.maximum(np.hypot(x[0], x[1]), 1.0)))
    reason = newton(F, u, fem.dirichletbc(held, boundary), rtol)
    return u, contact_pressure(u, lower=g, eps=eps), reason  # <--- the pressure


# %% [markdown]
# ## A linear equation: a membrane
#
# For a membrane $\sigma = \nabla u$. Let $r$ be the distance from the origin. Outside of the contact set the exact
# solution is $u = A \ln(2/r)$ with $A = 0.68026$ (see the tutorial *A membrane over an obstacle*). The force on the
# ball is $2 \pi A$.
#
# ## A nonlinear equation: a soap film
#
# The energy of a soap film is its area. Therefore $\sigma = \nabla u / \sqrt{1 + |\nabla u|^2}$. Outside of the contact
# set the film is a catenoid, $u = c - a \,\mathrm{arcosh}(r/a)$ with constants $a$ and $c$. We choose the contact set
# $r \le b$ with $b = 0.6$. At $r = b$ the film and the ball have the same slope if $a = b^2$, and the same value for
# one $c$. The values of this film are prescribed on the boundary. In the code, $a$ is the variable `neck`. The force on
# the ball is $2 \pi a$.

# %%
A, b = 0.680259411891719, 0.6
neck = b**2


def membrane(**options):
    """The membrane (collective)."""
    return over_ball(lambda slope: slope, lambda r: A * np.log(2 / r), **options)


def soap_film(**options):
    """The soap film (collective)."""
    c = np.sqrt(1 - b**2) + neck * np.arccosh(b / neck)
    return over_ball(
        lambda slope: slope / ufl.sqrt(1 + ufl.inner(slope, slope)),
        lambda r: c - neck * np.arccosh(r / neck),
        **options,
    )


# %% [markdown]
# The same Newton solver computes both solutions. The function `line` collects their values along the x-axis for the
# picture.


# %%
def line(function):
    """An array with the rows r and value at all nodes with y = 0, x >= 0: on rank 0; None on other ranks."""
    V, own = function.function_space, function.function_space.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:own]
    mine = np.column_stack([x[:, 0], function.x.array[:own]])[(abs(x[:, 1]) < 1e-9) & (x[:, 0] > -1e-9)]
    rows = MPI.COMM_WORLD.gather(mine)
    return None if rows is None else np.concatenate(rows)[np.argsort(np.concatenate(rows)[:, 0])].T


if __name__ == "__main__":
    page, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name, solver, exact, colour in (
        ("membrane", membrane, 2 * np.pi * A, "#0072B2"),
        ("soap film", soap_film, 2 * np.pi * neck, "#D55E00"),
    ):
        u, p, reason = solver()
        force = MPI.COMM_WORLD.allreduce(fem.assemble_scalar(fem.form(p * ufl.dx)), op=MPI.SUM)
        rows = line(u), line(p)
        if MPI.COMM_WORLD.rank == 0:
            print(f"{name}: SNES reason {reason}, force on the ball {force:.4f}, exact {exact:.4f}")
            axes[0].plot(*rows[0], ".-", color=colour, label=name)
            axes[1].plot(*rows[1], ".-", color=colour, label=name)
        assert reason > 0 and np.isclose(force, exact, rtol=3e-3)
    if MPI.COMM_WORLD.rank == 0:
        r = np.linspace(0, 0.9, 100)
        axes[0].plot(r, np.sqrt(1 - r**2), "k:", label="ball")
        axes[0].set(xlabel="r", title="u")
        axes[1].set(xlabel="r", title="contact pressure")
        for one in axes:
            one.legend(frameon=False)
        page.savefig("one_added_line.png", dpi=120)
