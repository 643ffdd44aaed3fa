"""The unit of cost: one linear Poisson solve on the same mesh, ranks and process.

Frozen: figures of different versions are comparable only as long as nothing in here changes. It takes: create and
assemble matrix and load, set up BoomerAMG, CG from zero to 1e-8 of the unpreconditioned residual; minimum of three.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.releases import AMG
from fenicsx_obstacle.mesh.levels import Level

REPETITIONS = 3
TOLERANCE = 1e-8


def poisson_seconds(level: Level, clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of one Poisson solve with u = 0 on the whole boundary and load 1 (collective).

    Args:
        level: Whose mesh it is.
        clock: `time.process_time` on a machine that is shared.
    """
    V, one = level.V, fem.Constant(level.mesh, PETSc.ScalarType(1.0))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a, f = releases.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx), releases.form(one * v * ufl.dx)
    dofs = fem.locate_dofs_topological(V, level.mesh.topology.dim - 1, level.boundary_facets)
    bc = fem.dirichletbc(fem.Function(V), dofs)
    return min(_once(level, a, f, bc, clock) for _ in range(REPETITIONS))


def _once(level: Level, a: object, f: object, bc: object, clock: Callable[[], float]) -> float:
    level.comm.barrier()
    start = clock()
    A = fem.petsc.create_matrix(a)
    fem.petsc.assemble_matrix(A, a, [bc])
    A.assemble()
    b = releases.create_vector(level.V)
    fem.petsc.assemble_vector(b, f)
    b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    fem.petsc.set_bc(b, [bc])
    x = b.duplicate()
    ksp = PETSc.KSP().create(level.comm)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
    ksp.getPC().setType(AMG)  # of hypre's, BoomerAMG is PETSc's default
    ksp.setTolerances(rtol=TOLERANCE, atol=0.0)
    ksp.solve(b, x)
    level.comm.barrier()
    seconds = clock() - start
    for owner in (ksp, x, b, A):
        owner.destroy()
    return seconds
