"""An elastic body below a rigid ball: Newton steps, linear steps and time in units of one linear elastic solve.

python3 benchmarks/elastic.py 2 79 158 316
python3 benchmarks/elastic.py 3 10 20 40
mpirun -n 2 python3 benchmarks/elastic.py 2 316
"""

import sys
import time

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, releases

comm = MPI.COMM_WORLD
LINEAR = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-10,
    "pc_type": "gamg",
    "mg_levels_pc_type": "jacobi",
    "mg_coarse_pc_type": "lu",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
}


def body(cells, dim):
    """The problem of a unit square or cube, and F, u and bcs of it."""
    make = dmesh.create_unit_square if dim == 2 else dmesh.create_unit_cube
    mesh = make(comm, *[cells] * dim)
    V = releases.functionspace(mesh, "Lagrange", 1, dim)
    u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    mu, lam = 0.35, 0.525  # E/(1 - nu^2) = 1, nu = 0.3
    strain = ufl.sym(ufl.grad(u))
    stress = 2 * mu * strain + lam * ufl.tr(strain) * ufl.Identity(dim)
    F = ufl.inner(stress, ufl.sym(ufl.grad(v))) * ufl.dx
    lifted = fem.Function(V)
    lifted.interpolate(lambda x: np.vstack([np.zeros((dim - 1, x.shape[1])), np.full((1, x.shape[1]), 0.02)]))
    below = dmesh.locate_entities_boundary(mesh, dim - 1, lambda x: np.isclose(x[dim - 1], 0))
    bcs = [fem.dirichletbc(lifted, fem.locate_dofs_topological(V, dim - 1, below))]
    above = np.sort(dmesh.locate_entities_boundary(mesh, dim - 1, lambda x: np.isclose(x[dim - 1], 1)))
    tags = dmesh.meshtags(mesh, dim - 1, above, np.full(len(above), 3, np.int32))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    gap = sum((x[k] - 0.5) ** 2 for k in range(dim - 1)) / 2
    return ObstacleProblem(F, u, bcs=bcs, upper=gap, of=u[dim - 1], measure=ds(3)), F, u, bcs


def motions(V):
    """Orthonormal rigid body motions."""
    dim = V.mesh.geometry.dim
    x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local].T
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    found = [PETSc.Vec().createMPI((dim * x.shape[1], None), bsize=dim, comm=comm) for _ in range(dim + len(pairs))]
    for k, vector in enumerate(found):
        table = vector.array.reshape(-1, dim)
        if k < dim:
            table[:, k] = 1
        else:
            i, j = pairs[k - dim]
            table[:, i], table[:, j] = x[j], -x[i]
        for other in found[:k]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=found, comm=comm)


def linear(F, u, bcs):
    """CPU seconds and steps of one linear elastic solve, without assembly."""
    A = fem.petsc.assemble_matrix(releases.form(ufl.derivative(F, u)), bcs=bcs)
    A.assemble()
    A.setNearNullSpace(motions(u.function_space))
    x, b = A.createVecs()
    b.setRandom()
    database = PETSc.Options("linear_")
    for key, value in LINEAR.items():
        database[key] = value
    start = time.process_time()
    ksp = PETSc.KSP().create(comm)
    ksp.setOperators(A)
    ksp.setOptionsPrefix("linear_")
    ksp.setFromOptions()
    ksp.solve(b, x)
    return time.process_time() - start, ksp.getIterationNumber()


if __name__ == "__main__":
    dim = int(sys.argv[1])
    if comm.rank == 0:
        print("unknowns  Newton steps  linear steps  of one linear solve  work in linear solves")
    for cells in map(int, sys.argv[2:]):
        problem, F, u, bcs = body(cells, dim)
        start = time.process_time()
        solution = problem.solve()
        mine = time.process_time() - start
        alone, steps = linear(F, u, bcs)
        mine, alone = comm.allreduce(mine), comm.allreduce(alone)
        if comm.rank == 0:
            r = solution.record
            print(f"{r['dofs']:8d}  {solution.iterations:12d}  {r['krylov_iterations']:12d}  {steps:19d}  "
                  f"{mine / alone:21.1f}", flush=True)  # fmt: skip
