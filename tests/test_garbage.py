"""Memory of problems that Python has let go of is given back: PETSc's objects wait until all ranks ask for it."""

import ctypes
import gc
import resource
from pathlib import Path

import pytest
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from tests.conftest import COMM
from tests.helpers import Membrane

CELLS, TIMES = 128, 4
PROBLEM = 700 * CELLS**2 / COMM.size  # bytes of one, measured


def resident():
    """Bytes of this process that are in memory, at most on any rank."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return COMM.allreduce(pages * resource.getpagesize(), MPI.MAX)


def membrane(mesh):
    own = Membrane(mesh, load=-8.0)
    ends = fem.locate_dofs_geometrical(own.V, lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9))
    return own.problem(bcs=[fem.dirichletbc(0.0, ends, own.V)], lower=-0.3)


def square():
    return dmesh.create_unit_square(COMM, CELLS, CELLS)


@pytest.mark.slow
@pytest.mark.parametrize("meshes", ["one mesh", "a mesh for each"])
def test_problems_that_are_gone_leave_nothing(meshes):
    """A loop over problems needs the memory of two: the new one, and the one before."""
    mesh, found = square(), []
    for _ in range(TIMES):
        membrane(mesh if meshes == "one mesh" else square()).solve(method="vi")
        found.append(resident())
    assert found[-1] - found[1] < PROBLEM


@pytest.mark.slow
def test_solves_leave_nothing():
    """A loop over solves of one problem keeps one solver."""
    problem, found = membrane(square()), []
    for _ in range(4 * TIMES):
        problem.solve()
        found.append(resident())
    assert found[-1] - found[2] < 4 * TIMES * CELLS**2 * 8 / COMM.size  # a vector for each solve
