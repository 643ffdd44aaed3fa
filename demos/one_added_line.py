"""A plain Poisson code becomes an obstacle problem by one added line.

Everything below is DOLFINx and PETSc as you know them, except the line marked with <---.
Run it with mpirun -n 2 .venv/bin/python demos/one_added_line.py once ./obstacle has set up .venv.
"""

from mpi4py import MPI  # first: where pip has installed dolfinx, MPI must be loaded before it

# isort: split
import dolfinx.fem.petsc  # noqa: F401  (not imported by dolfinx.fem in newer releases)
import numpy as np
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

from fenicsx_obstacle import contact_pressure, penalty

functionspace = getattr(fem, "functionspace", None) or fem.FunctionSpace  # its name in DOLFINx 0.5


def membrane(cells=64, eps=1e-4, rtol=1e-10):
    """Membrane on (-2, 2)^2 held at the boundary, pushed up by a ball of radius 1; returns u, p, the SNES reason."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, [np.array([-2.0, -2.0]), np.array([2.0, 2.0])], [cells, cells])
    V = functionspace(domain, ("Lagrange", 1))
    u, v, ball = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
    ball.interpolate(_ball)

    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    F += penalty(u, v, lower=ball, eps=eps)  # <--- the one added line

    domain.topology.create_connectivity(1, 2)
    boundary = fem.locate_dofs_topological(V, 1, mesh.exterior_facet_indices(domain.topology))
    held = fem.Function(V)
    held.interpolate(lambda x: 0.471519893402110 - 0.680259411891719 * np.log(np.hypot(x[0], x[1]) + 1e-300))
    reason = newton(F, u, fem.dirichletbc(held, boundary), rtol)
    return u, contact_pressure(u, lower=ball, eps=eps), reason


def _ball(x):
    r = np.hypot(x[0], x[1])
    cone = np.sqrt(1 - 0.9**2) - 0.9 / np.sqrt(1 - 0.9**2) * (r - 0.9)
    return np.where(r < 0.9, np.sqrt(np.maximum(1 - r**2, 0)), cone)


def newton(F, u, bc, rtol):
    """PETSc SNES with its usual tests, as in any DOLFINx code."""
    form, J = fem.form(F), fem.form(ufl.derivative(F, u))
    A = fem.petsc.create_matrix(J)
    owned = u.function_space.dofmap.index_map.size_local

    def residual(snes, x, out):
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
    snes.solve(None, x)
    u.x.array[:owned] = x.array_r
    u.x.scatter_forward()
    return snes.getConvergedReason()


if __name__ == "__main__":
    u, p, reason = membrane()
    own = u.function_space.dofmap.index_map.size_local
    centre = MPI.COMM_WORLD.allreduce(float(u.x.array[:own].max(initial=-np.inf)), op=MPI.MAX)
    largest = MPI.COMM_WORLD.allreduce(float(p.x.array[:own].max(initial=0.0)), op=MPI.MAX)
    if MPI.COMM_WORLD.rank == 0:
        print(f"SNES reason {reason}; largest height {centre:.6f}, largest contact pressure {largest:.4f}")
