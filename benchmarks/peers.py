"""What one would use without this package, on the same mesh in one run: a table, a picture, JSON lines.

    .venv/bin/pip install scikit-fem             # its row is left out without it
    .venv/bin/python benchmarks/peers.py --cells 64,128,256,512 --json peers.jsonl --picture peers.png

The scene is the membrane over a ball on DOLFINx's rectangle of triangles. Every code gets the mesh, the boundary values
and the obstacle at the nodes; assembly and set-up count, the mesh does not. The fastest of `--times` solves counts, by
processor time. The unit is one linear Poisson solve on the same mesh in the same process. `u - u_VI` is the largest
difference from the solution of the variational inequality at a node, as this package has it. A code that needs more
than `--patience` seconds is left out on finer meshes. On one rank: scikit-fem has no other way.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, penalty, releases, solve_system
from fenicsx_obstacle.algebra.releases import AMG
from fenicsx_obstacle.answers.poisson_baseline import poisson_seconds
from fenicsx_obstacle.mesh.levels import of_mesh
from fenicsx_obstacle.show.figures import figure, save

COARSEST = 16  # cells a side, where nested iteration begins
MAX_STEPS = 400


def obstacle(x: np.ndarray) -> np.ndarray:
    """The ball, continued by a cone (Bueler 2021, chapter 12)."""
    r = np.hypot(x[0], x[1])
    cone = np.sqrt(1 - 0.9**2) - 0.9 / np.sqrt(1 - 0.9**2) * (r - 0.9)
    return np.where(r < 0.9, np.sqrt(np.maximum(1 - r**2, 0)), cone)


def boundary_value(x: np.ndarray) -> np.ndarray:
    """The exact solution beside the ball."""
    return 0.471519893402110 - 0.680259411891719 * np.log(np.maximum(np.hypot(x[0], x[1]), 0.1))


@dataclass(frozen=True)
class Result:
    """What a code found.

    Attributes:
        u: Values at the nodes.
        steps: Newton steps, or iterations of the optimiser.
    """

    u: np.ndarray
    steps: int


class Case:
    """The problem on one mesh, without anything assembled."""

    def __init__(self, cells: int):
        """Make the mesh."""
        self.cells = cells
        self.mesh = mesh.create_rectangle(MPI.COMM_SELF, [np.array([-2.0, -2.0]), np.array([2.0, 2.0])], [cells, cells])
        self.V = releases.functionspace(self.mesh, "Lagrange", 1)
        self.psi, self.g = fem.Function(self.V), fem.Function(self.V)
        self.psi.interpolate(obstacle)
        self.g.interpolate(boundary_value)
        self.mesh.topology.create_connectivity(1, 2)
        facets = mesh.exterior_facet_indices(self.mesh.topology)
        self.boundary = fem.locate_dofs_topological(self.V, 1, facets)
        self.bc = fem.dirichletbc(self.g, self.boundary)

    def residual(self, u: fem.Function) -> Any:
        """F(u; v) in UFL, without contact."""
        return ufl.inner(ufl.grad(u), ufl.grad(ufl.TestFunction(self.V))) * ufl.dx

    def cold_start(self) -> np.ndarray:
        """The boundary values, and inside the larger of obstacle and 0."""
        start = np.maximum(self.psi.x.array, 0.0)
        start[self.boundary] = self.g.x.array[self.boundary]
        return start

    @cached_property
    def coarse(self) -> Case | None:
        """The next coarser mesh."""
        return Case(self.cells // 2) if self.cells > COARSEST and self.cells % 2 == 0 else None

    def interpolated(self, coarse: Case, u: np.ndarray) -> np.ndarray:
        """Values on the next coarser grid, interpolated to the nodes here."""
        from scipy.interpolate import RegularGridInterpolator

        n = coarse.cells
        axis = np.linspace(-2.0, 2.0, n + 1)
        column, row = (np.rint((x + 2) * n / 4).astype(int) for x in coarse.V.tabulate_dof_coordinates()[:, :2].T)
        grid = np.empty((n + 1, n + 1))
        grid[column, row] = u
        points = np.clip(self.V.tabulate_dof_coordinates()[:, :2], axis[0], axis[-1])  # they have round-off
        found = RegularGridInterpolator((axis, axis), grid)(points)
        found[self.boundary] = self.g.x.array[self.boundary]
        return np.maximum(found, np.where(np.isin(np.arange(len(found)), self.boundary), found, self.psi.x.array))


def by_this_package(method: str) -> Callable[[Case], Result]:
    """`ObstacleProblem`, which makes coarse levels of the matrix."""

    def solve(case: Case) -> Result:
        u = fem.Function(case.V)
        found = ObstacleProblem(case.residual(u), u, bcs=[case.bc], lower=case.psi).solve(method=method)
        return Result(u.x.array.copy(), found.iterations)

    return solve


def iterated(snes: PETSc.SNES, x: PETSc.Vec) -> Result:
    """Solve with conjugate gradients and BoomerAMG."""
    snes.setTolerances(rtol=1e-8, max_it=MAX_STEPS)
    snes.ksp.setType("cg")
    snes.ksp.setTolerances(rtol=1e-8)
    snes.ksp.pc.setType(AMG)
    snes.solve(None, x)
    if snes.getConvergedReason() <= 0:
        raise RuntimeError(f"SNES reason {snes.getConvergedReason()}")
    return Result(x.array.copy(), snes.getIterationNumber())


def snes_vi(case: Case, start: np.ndarray | None = None) -> Result:
    """SNES VI, the matrix assembled once, conjugate gradients with BoomerAMG."""
    u = fem.Function(case.V)
    A = fem.petsc.assemble_matrix(releases.form(ufl.derivative(case.residual(u), u)), [case.bc])
    A.assemble()
    x, lower, upper = A.createVecRight(), A.createVecRight(), A.createVecRight()
    lower.array[:], upper.array[:] = case.psi.x.array, PETSc.INFINITY
    lower.array[case.boundary] = -PETSc.INFINITY
    x.array[:] = case.cold_start() if start is None else start
    given = A.createVecRight()
    given.array[:] = 0.0
    given.array[case.boundary] = case.g.x.array[case.boundary]
    load = given.duplicate()
    stiffness = fem.petsc.assemble_matrix(releases.form(ufl.derivative(case.residual(u), u)))
    stiffness.assemble()
    stiffness.mult(given, load)
    load.scale(-1.0)
    load.array[case.boundary] = case.g.x.array[case.boundary]
    snes = PETSc.SNES().create(MPI.COMM_SELF)
    snes.setType("vinewtonrsls")

    def residual(_: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        A.mult(x, out)
        out.axpy(-1.0, load)

    snes.setFunction(residual, x.duplicate())
    snes.setJacobian(lambda *_: None, A)
    snes.setVariableBounds(lower, upper)
    return iterated(snes, x)


def snes_vi_nested(case: Case) -> Result:
    """SNES VI on each mesh, begun from the solution on the next coarser one."""
    if case.coarse is None:
        return snes_vi(case)
    return snes_vi(case, case.interpolated(case.coarse, snes_vi_nested(case.coarse).u))


def tao(kind: str) -> Callable[[Case], Result]:
    """TAO: the energy u.A u/2 - b.u is minimised between bounds."""

    def solve(case: Case) -> Result:
        u = fem.Function(case.V)
        A = fem.petsc.assemble_matrix(releases.form(ufl.derivative(case.residual(u), u)))
        A.assemble()
        lower, upper, x = A.createVecRight(), A.createVecRight(), A.createVecRight()
        lower.array[:], upper.array[:] = case.psi.x.array, PETSc.INFINITY
        for bound in (lower, upper):
            bound.array[case.boundary] = case.g.x.array[case.boundary]
        x.array[:] = case.cold_start()

        def energy(_: PETSc.TAO, x: PETSc.Vec, gradient: PETSc.Vec) -> float:
            A.mult(x, gradient)
            return 0.5 * gradient.dot(x)

        optimiser = PETSc.TAO().create(MPI.COMM_SELF)
        optimiser.setType(kind)
        optimiser.setObjectiveGradient(energy, A.createVecRight())
        optimiser.setHessian(lambda *_: None, A)
        optimiser.setVariableBounds(lower, upper)
        optimiser.setMaximumIterations(MAX_STEPS)
        optimiser.setTolerances(gatol=0.0, grtol=1e-8, gttol=0.0)
        optimiser.setFromOptions()
        optimiser.solve(x)
        if optimiser.getConvergedReason() <= 0:
            raise RuntimeError(f"TAO reason {optimiser.getConvergedReason()}")
        return Result(x.array.copy(), optimiser.getIterationNumber())

    return solve


def raw_penalty(factor: float) -> Callable[[Case], Result]:
    """A penalty as it is often written: one large factor, the default quadrature, Newton with BoomerAMG, cold."""

    def solve(case: Case) -> Result:
        u, v = fem.Function(case.V), ufl.TestFunction(case.V)
        depth = case.psi - u
        F = case.residual(u) - factor * ufl.conditional(ufl.gt(depth, 0), depth, 0) * v * ufl.dx
        return newton(case, u, F)

    return solve


def one_added_line(eps: float) -> Callable[[Case], Result]:
    """The same code with the penalty of this package."""

    def solve(case: Case) -> Result:
        u = fem.Function(case.V)
        F = case.residual(u) + penalty(u, ufl.TestFunction(case.V), lower=case.psi, eps=fem.Constant(case.mesh, eps))
        return newton(case, u, F)

    return solve


def newton(case: Case, u: fem.Function, F: Any) -> Result:
    """SNES from a cold start on a form."""
    u.x.array[:] = case.cold_start()
    form, derivative = releases.form(F), releases.form(ufl.derivative(F, u))
    A = fem.petsc.create_matrix(derivative)
    x = A.createVecRight()
    x.array[:] = u.x.array

    def residual(_: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        u.x.array[:] = x.array_r
        out.set(0.0)
        fem.petsc.assemble_vector(out, form)
        out.array[case.boundary] = x.array_r[case.boundary] - case.g.x.array[case.boundary]

    def jacobian(_: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        A.zeroEntries()
        fem.petsc.assemble_matrix(A, derivative, [case.bc])
        A.assemble()

    snes = PETSc.SNES().create(MPI.COMM_SELF)
    snes.setType("newtonls")
    snes.setFunction(residual, x.duplicate())
    snes.setJacobian(jacobian, A)
    return iterated(snes, x)


def of_scikit_fem(case: Case) -> tuple[Any, np.ndarray, np.ndarray]:
    """Stiffness and weights of linear elements by scikit-fem, and the nodes, shape (nodes, 2)."""
    import skfem
    from skfem.models.poisson import laplace, unit_load

    points = case.V.tabulate_dof_coordinates()[:, :2]
    basis = skfem.Basis(skfem.MeshTri(points.T, releases.cell_dofs(case.V).reshape(-1, 3).T), skfem.ElementTriP1())
    return laplace.assemble(basis), unit_load.assemble(basis), points


def matrices_of_scikit_fem(method: str, eps: float | str = "auto") -> Callable[[Case], Result]:
    """`solve_system` of this package with matrices of scikit-fem."""

    def solve(case: Case) -> Result:
        A, weights, points = of_scikit_fem(case)
        found = solve_system(A, 0.0, lower=case.psi.x.array, weights=weights, fixed=case.boundary,
                             given=np.where(np.isin(np.arange(len(points)), case.boundary), case.g.x.array, 0.0),
                             points=points, method=method, eps=eps)  # fmt: skip
        return Result(found.u, found.iterations)

    return solve


def scikit_fem(case: Case) -> Result:
    """scikit-fem: primal-dual active sets, each system by SciPy's direct solver."""
    import skfem

    A, _, _ = of_scikit_fem(case)
    u, psi = case.cold_start(), case.psi.x.array
    free = np.ones(len(u), dtype=bool)
    free[case.boundary] = False
    active = np.zeros(len(u), dtype=bool)
    for step in range(MAX_STEPS):
        u[active] = psi[active]
        u = skfem.solve(*skfem.condense(A, x=u, I=np.flatnonzero(free & ~active)))
        new = free & ((A @ u > 0) & active | (u < psi))
        if np.array_equal(new, active):
            return Result(u, step + 1)
        active = new
    raise RuntimeError("the active set does not settle")


CODES: dict[str, Callable[[Case], Result]] = {
    "this package, SNES VI": by_this_package("vi"),
    "this package, penalty, eps = auto": by_this_package("penalty"),
    "SNES VI, BoomerAMG, from coarser meshes": snes_vi_nested,
    "SNES VI, BoomerAMG, cold start": snes_vi,
    "TAO bnls": tao("bnls"),
    "TAO gpcg": tao("gpcg"),
    "one added line, eps = 1e-6, BoomerAMG, cold": one_added_line(1e-6),
    "raw penalty, factor 1e6, BoomerAMG, cold": raw_penalty(1e6),
    "scikit-fem, solve_system, eps = auto": matrices_of_scikit_fem("penalty"),
    "scikit-fem, solve_system, eps = 1e-8": matrices_of_scikit_fem("penalty", 1e-8),
    "scikit-fem, solve_system, SNES VI": matrices_of_scikit_fem("vi"),
    "scikit-fem, active sets, direct solver": scikit_fem,
}


def main() -> None:
    """Run all codes on all meshes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", default="64,128,256,512", help="cells a side: powers of 2")
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--patience", type=float, default=60.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    codes = dict(CODES)
    if find_spec("skfem") is None:
        codes = {name: code for name, code in codes.items() if not name.startswith("scikit-fem")}
        print("scikit-fem is not installed")
    rows: list[dict[str, Any]] = []
    print(f"{'':44} {'unknowns':>9} {'steps':>6} {'s':>8} {'units':>7} {'u - u_VI':>9}")
    for cells in map(int, options.cells.split(",")):
        case = Case(cells)
        unit = poisson_seconds(of_mesh(case.mesh, "benchmark"), time.process_time)
        reference = None
        for name, solve in list(codes.items()):
            seconds, result = np.inf, None
            try:
                for _ in range(options.times):
                    start = time.process_time()
                    result = solve(case)
                    seconds = min(seconds, time.process_time() - start)
                    if seconds > options.patience / options.times:
                        break
            except RuntimeError as error:
                print(f"{name:44} {len(case.psi.x.array):9} {error}")
                del codes[name]
                continue
            assert result is not None
            reference = result.u if reference is None else reference
            row = {
                "code": name, "unknowns": len(result.u), "steps": result.steps, "seconds": seconds,
                "units": seconds / unit, "difference": float(np.abs(result.u - reference).max()),
            }  # fmt: skip
            rows.append(row)
            print(f"{name:44} {row['unknowns']:9} {row['steps']:6} {seconds:8.3f} {row['units']:7.2f} "
                  f"{row['difference']:9.1e}", flush=True)  # fmt: skip
            if seconds > options.patience:
                del codes[name]
    if options.json is not None:
        options.json.write_text("".join(json.dumps(row) + "\n" for row in rows))
    if options.picture is not None:
        draw(rows, options.picture)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Work units over unknowns, a line for each code."""
    page, axes = figure(8.0, 4.6)
    names = dict.fromkeys(row["code"] for row in rows)
    for name, marker in zip(names, cycle("os^vDPX<>*hd"), strict=False):
        mine = [row for row in rows if row["code"] == name]
        ours = name.startswith("this package")
        axes.loglog([row["unknowns"] for row in mine], [row["units"] for row in mine], marker=marker,
                    linewidth=2.5 if ours else 1.2, label=name)  # fmt: skip
    axes.set(xlabel="unknowns", ylabel="linear Poisson solves", title="Membrane over a ball, the same mesh")
    axes.grid(visible=True, which="major", linewidth=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), fontsize=8, frameon=False)
    save(page, path)


if __name__ == "__main__":
    main()
