"""The membrane over a ball, with matrices of other codes, solved by `solve_system`.

`solve_system` needs a stiffness matrix A, a load f, bounds of u, the weight of each unknown, and where u is given. With
the coordinates of the unknowns it makes coarse levels, from whose solutions Newton's method begins. So it takes few
steps on any mesh, where an active-set iteration takes about as many as there are layers of nodes to cross.

The matrices are those of

- finite differences on a grid of PETSc (DMDA), on any number of ranks,
- linear elements of scikit-fem, on one rank and if it is installed (pip install scikit-fem). Its own loop over active
  sets with a direct solver solves the same problem for comparison.

Run this file with

    mpirun -n 2 python3 other_codes.py [CELLS]

where CELLS is the number of cells a side.
"""

import sys
import time
from importlib.util import find_spec

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import solve_system

comm = MPI.COMM_WORLD
cells = int(sys.argv[1]) if len(sys.argv) > 1 else 128
a, side = 0.6979651482233736, 2.0  # radius of the contact set; the square is [-2, 2]^2


def obstacle(x, y):  # a ball of radius 1, and the tangent plane of its flank outside of r = 0.9
    r = np.hypot(x, y)
    return np.where(r < 0.9, np.sqrt(np.maximum(1 - r**2, 0)), np.sqrt(0.19) - 0.9 / np.sqrt(0.19) * (r - 0.9))


def exact(x, y):
    r = np.hypot(x, y)
    outside = a**2 / np.sqrt(1 - a**2) * np.log(a * np.exp(1 / a**2 - 1) / np.maximum(r, a))
    return np.where(r > a, outside, obstacle(x, y))


def solved(name, A, x, y, weights):
    """Solve and print a line."""
    edge = np.maximum(np.abs(x), np.abs(y)) > side * (1 - 1e-9)
    u_exact, start = exact(x, y), time.perf_counter()
    found = solve_system(A, 0.0, lower=obstacle(x, y), weights=weights, fixed=edge, given=np.where(edge, u_exact, 0),
                         points=np.stack([x, y], axis=1))  # fmt: skip
    error = comm.allreduce(np.abs(found.u - u_exact).max(initial=0), op=MPI.MAX)
    force = comm.allreduce(np.sum(weights * found.pressure))
    if comm.rank == 0:
        print(f"{name}: {found.levels[-1]} unknowns, {found.iterations} Newton steps, "
              f"{time.perf_counter() - start:.2f} s, error {error:.2g}, contact force {force:.5f}")  # fmt: skip


grid = PETSc.DMDA().create((cells + 1, cells + 1), stencil_width=1, comm=comm)
grid.setUniformCoordinates(-side, side, -side, side)
A = grid.createMatrix()
(first_x, last_x), (first_y, last_y) = grid.getRanges()
row = PETSc.Mat.Stencil()
for j in range(first_y, last_y):
    for i in range(first_x, last_x):
        row.index = (i, j)
        for neighbour in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if min(neighbour) >= 0 and max(neighbour) <= cells:
                column = PETSc.Mat.Stencil()
                column.index = neighbour
                A.setValueStencil(row, column, -1.0)
        A.setValueStencil(row, row, 4.0)  # rows on the edge are those of given values
A.assemble()
x, y = grid.getCoordinates().array_r.reshape(-1, 2).T
solved("finite differences", A, x, y, np.full(len(x), (2 * side / cells) ** 2))

if find_spec("skfem") is not None and comm.size == 1:
    import skfem
    from skfem.models.poisson import laplace, unit_load

    line = np.linspace(-side, side, cells + 1)
    basis = skfem.Basis(skfem.MeshTri.init_tensor(line, line), skfem.ElementTriP1())
    A, weights = laplace.assemble(basis), unit_load.assemble(basis)
    x, y = basis.doflocs
    solved("scikit-fem", A, x, y, weights)

    start, psi, u = time.perf_counter(), obstacle(x, y), exact(x, y)
    edge = basis.get_dofs().all()
    free, active, steps = np.ones(len(u), dtype=bool), np.zeros(len(u), dtype=bool), 0
    free[edge], u[free] = False, 0.0
    while True:
        u[active] = psi[active]
        u, steps = skfem.solve(*skfem.condense(A, x=u, I=np.flatnonzero(free & ~active))), steps + 1
        new = free & ((A @ u > 0) & active | (u < psi))
        if np.array_equal(new, active):
            break
        active = new
    print(f"  its own active sets, direct solver: {steps} steps, {time.perf_counter() - start:.2f} s")
elif comm.rank == 0:
    print("scikit-fem is left out: it is for one rank, and pip install scikit-fem installs it")
