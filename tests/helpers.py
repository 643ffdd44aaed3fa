"""What tests of several subjects share: commands in processes, meshes of points, a form of the caller's own."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, __main__, releases
from fenicsx_obstacle.checkout import ROOT
from fenicsx_obstacle.launcher import mpirun
from fenicsx_obstacle.show import render
from tests.conftest import CLEAN, COMM

LAUNCHER = ROOT / "obstacle"


def run(
    *arguments: Any, ranks: int = 1, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """A command of the command line in a process of its own, or on several ranks."""
    command = [sys.executable, "-m", "fenicsx_obstacle", *map(str, arguments)]
    return subprocess.run([*(mpirun(ranks) if ranks > 1 else []), *command], capture_output=True, text=True, cwd=cwd,
                          env=env or CLEAN, timeout=250, check=False)  # fmt: skip


def run_python(code: str, *arguments: Any, ranks: int = 1, **options: Any) -> subprocess.CompletedProcess[str]:
    """Python that sees the tests, in a process of its own, or on several ranks."""
    command = [*(mpirun(ranks) if ranks > 1 else []), sys.executable, "-c", code, *map(str, arguments)]
    options = {"env": CLEAN, "cwd": ROOT, "timeout": 150, **options}
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def inside(*arguments: Any, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """What `run` returns, of a command in this process, which draws by matplotlib: others take seconds to begin."""
    out, err = io.StringIO(), io.StringIO()
    words = [str(word) for word in arguments]
    with pytest.MonkeyPatch.context() as patched, chdir(cwd or Path.cwd()), redirect_stdout(out), redirect_stderr(err):
        patched.setattr(sys, "argv", ["fenicsx-obstacle", *words])
        patched.setattr(__main__, "_begin", lambda petsc: None)  # which changes how this process takes signals
        patched.setattr(render, "find_spec", lambda name: None)
        status = __main__._run(words, [])
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


def mesh_of(points: Any, cells: Any, kind: str = "triangle") -> dmesh.Mesh:
    """A mesh of points and cells that all ranks have (collective)."""
    points, cells = np.asarray(points, dtype=float), np.asarray(cells, dtype=np.int64)
    mine = slice(None) if COMM.rank == 0 else slice(0, 0)
    return releases.create_mesh(COMM, cells[mine], points[mine], kind)


def grid(
    n: int, m: int, corner: tuple[float, float] = (0.0, 0.0), size: tuple[float, float] = (1.0, 1.0),
    flip: bool = False,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Points and triangles of a rectangle of n times m squares; flipped, they have the other diagonals."""
    x, y = np.meshgrid(np.linspace(0, size[0], n + 1), np.linspace(0, size[1], m + 1), indexing="ij")
    number = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]))
    cells = [[a, b, c], [b, d, c]] if flip else [[a, b, d], [a, d, c]]
    points = np.column_stack([x.ravel() + corner[0], y.ravel() + corner[1]])
    return points, np.concatenate([np.column_stack(triangle) for triangle in cells])


def cut(points: Any, cells: Any, along: np.ndarray, beyond: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles with second nodes along a line, for the cells beyond it."""
    twice = np.flatnonzero(along)
    other = np.arange(len(points))
    other[twice] = len(points) + np.arange(len(twice))
    return np.vstack([points, points[twice]]), np.where(beyond[:, None], other[cells], cells)


# a unit square with the parts "sides", left and right, "ends", bottom and top, and "wire", along x = 1/2
WIRE = str(ROOT / "tests/hard/scenes/wire.geo")


def outline(V: fem.FunctionSpace) -> np.ndarray:
    """The dofs on the boundary (collective)."""
    topology = V.mesh.topology
    topology.create_connectivity(topology.dim - 1, topology.dim)
    return fem.locate_dofs_topological(V, topology.dim - 1, dmesh.exterior_facet_indices(topology))


class Membrane:
    """mu grad u . grad v - f v as a form of the caller's own, u = 0 around.

    Attributes:
        mesh, V, u, v: The mesh, by default a unit square; space, unknown and test function.
        mu, f: Constants in the form.
        edge: The Function of the boundary values.
        bc: The condition with them.
        F, energy: The form, and the functional whose derivative it is.
    """

    def __init__(
        self, mesh: dmesh.Mesh | None = None, degree: int = 1, load: float = 8.0, cells: int = 16,
        cell: Any = dmesh.CellType.triangle,
    ):  # fmt: skip
        square = [np.zeros(2), np.ones(2)]
        self.mesh = dmesh.create_rectangle(COMM, square, [cells, cells], cell) if mesh is None else mesh
        self.V = releases.functionspace(self.mesh, "Lagrange", degree)
        self.u, self.v, self.edge = fem.Function(self.V), ufl.TestFunction(self.V), fem.Function(self.V)
        self.mu, self.f = (fem.Constant(self.mesh, PETSc.ScalarType(value)) for value in (1.0, load))
        slope = ufl.grad(self.u)
        self.F = self.mu * ufl.inner(slope, ufl.grad(self.v)) * ufl.dx - self.f * self.v * ufl.dx
        self.energy = self.mu / 2 * ufl.inner(slope, slope) * ufl.dx - self.f * self.u * ufl.dx
        self.bc = fem.dirichletbc(self.edge, outline(self.V))

    def problem(self, **given: Any) -> ObstacleProblem:
        """With obstacles, and other arguments of ObstacleProblem."""
        return ObstacleProblem(self.F, self.u, **{"bcs": [self.bc], **given})


BUBBLES = ("P1 and bubbles", 1, 2)


def mixed_space(mesh: dmesh.Mesh, *elements: Any) -> fem.FunctionSpace:
    """Of elements as (family, degree, components or None), the last one P1."""
    if releases.OLD:
        parts = [ufl.FiniteElement("Lagrange", mesh.ufl_cell(), degree) for _, degree, _ in elements]
        sizes = [size for _, _, size in elements]
        if BUBBLES in elements:
            parts[elements.index(BUBBLES)] = parts[-1] + ufl.FiniteElement("Bubble", mesh.ufl_cell(), 3)
        parts = [part if n is None else ufl.VectorElement(part, n) for part, n in zip(parts, sizes, strict=True)]
        return fem.FunctionSpace(mesh, ufl.MixedElement(parts))
    import basix.ufl

    cell = mesh.basix_cell()
    parts = [basix.ufl.element("Lagrange", cell, 1 if one is BUBBLES else one[1]) for one in elements]
    if BUBBLES in elements:
        bubble = basix.ufl.element("Bubble", cell, 3)
        parts[elements.index(BUBBLES)] = basix.ufl.enriched_element([parts[-1], bubble])
    pairs = zip(parts, elements, strict=True)
    blocked = [part if n is None else basix.ufl.blocked_element(part, shape=(n,)) for part, (_, _, n) in pairs]
    return fem.functionspace(mesh, basix.ufl.mixed_element(blocked))
