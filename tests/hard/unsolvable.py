"""Problems without a solution: solvers must raise the same error on every rank, and never return a result.

`[mpirun -n N] python -m tests.hard.unsolvable` tries each problem once and prints JSON lines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.answers.solve import solve
from fenicsx_obstacle.errors import ObstacleError
from fenicsx_obstacle.parallel import abort_on_uncaught_errors
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.scenes.scene import Scene
from tests.processes import tell


@dataclass(frozen=True)
class Unsolvable:
    """A problem without an answer.

    Attributes:
        name: What is wrong.
        solve: Solves it (collective).
        options: PETSc's options meanwhile.
    """

    name: str
    solve: Callable[[MPI.Comm], object]
    options: Mapping[str, Any]


def attempt(problem: Unsolvable, comm: MPI.Comm) -> tuple[bool, str]:
    """Try to solve a problem (collective).

    Returns:
        Whether all ranks had the same error of ours, and what it says, or what was wrong.
    """
    try:
        with defaults("", problem.options):
            problem.solve(comm)
        mine = "an answer"
    except ObstacleError as error:
        mine = f"{type(error).__name__}: {error}"
    said = comm.allgather(mine)
    same = len(set(said)) == 1
    return same and mine != "an answer", mine if same else f"ranks differ: {' | '.join(said)}"


def problems() -> Iterator[Unsolvable]:
    """All of them."""
    yield from _limits()
    yield from _scenes()
    yield from _forms()


def _limits() -> Iterator[Unsolvable]:
    """One step where more are needed."""
    ball = {"cells": 16, "eps": 1e-8}
    for method in ("penalty", "successive", "vi"):
        for start in ("cold", "nested"):
            if (method, start) != ("successive", "nested"):  # which (3.4)* never is
                one = {f"{'vi' if method == 'vi' else 'penalty'}_snes_max_it": 1}
                given = {"method": method, "start": start, **({} if method == "vi" else ball), "cells": 16}
                yield Unsolvable(f"{method}, {start}: one step", _catalogued("ball", **given), one)
    one = {"penalty_snes_max_it": 1}
    yield Unsolvable("vi by multipliers: one step", _catalogued("ball", method="vi", element="Q1-gauss", cells=16), one)
    yield Unsolvable("with a bound: one step", _catalogued("ball", **ball, start="cold", bound=True), one)
    yield Unsolvable("to a tolerance: one step", _catalogued("ball", tol=0.1, cells=16, start="cold"), one)
    for prefix, method in (("penalty", "penalty"), ("penalty", "successive"), ("vi", "vi")):
        given = {"method": method, "cells": 16, "start": "cold", **({} if method == "vi" else {"eps": 1e-8})}
        none = {f"{prefix}_ksp_type": "preonly", f"{prefix}_pc_type": "none", f"{prefix}_ksp_norm_type": "none",
                f"{prefix}_snes_max_it": 60}  # fmt: skip
        yield Unsolvable(f"{method}: no linear solver at all", _catalogued("ball", **given), none)


def _scenes() -> Iterator[Unsolvable]:
    """Data with a hole at one place."""
    hole = "where(abs(x - 0.53125) < 0.04, where(abs(y - 0.53125) < 0.04, 0/0, -1), -1)"
    rim = "where(x > 0.99, where(abs(y - 1/2) < 0.04, 0/0, 0), 0)"
    cases: list[tuple[str, dict[str, Any]]] = [
        ("load not a number at one place", {"load": hole}),
        ("tension not a number at one place", {"tension": f"2 + {hole}"}),
        ("obstacle not a number at one place", {"lower": f"-0.1 + 0*({hole})"}),
        ("boundary value not a number at one place", {"boundary": [{"value": rim}]}),
        ("load infinite at one place", {"load": hole.replace("0/0", "1e400")}),
        ("held nowhere, lifted off", {"load": 1.0, "boundary": [], "lower": -1}),
    ]
    for what, given in cases:
        for method in ("penalty", "vi"):
            yield Unsolvable(f"{method}: {what}", _squared(method, given), {})


def _forms() -> Iterator[Unsolvable]:
    """Somebody else's residual, which nothing is known of."""
    for method in ("penalty", "vi"):
        way = "SNES VI" if method == "vi" else "penalty"
        for rank in (0, -1):
            where = "first" if rank == 0 else "last"
            for field in ("load", "upper", "value", "start"):
                if field == "start" and method == "vi":
                    continue
                yield Unsolvable(f"form, {way}: {field} not a number at one node of the {where} rank",
                           _form(method, spoilt=field, rank=rank), {})  # fmt: skip
        yield Unsolvable(f"form, {way}: an energy without minimum", _form(method, stiffness=-1.0, energy=True), {})
        yield Unsolvable(f"form, {way}: held nowhere, pulled away", _form(method, held=False, pull=-1.0), {})
        yield Unsolvable(f"form, {way}: no matrix", _form(method, stiffness=0.0), {})
        yield Unsolvable(f"form, {way}: one step", _form(method, pull=3.0), {f"{method}_snes_max_it": 1})


def _catalogued(name: str, **given: Any) -> Callable[[MPI.Comm], object]:
    def run(comm: MPI.Comm) -> object:
        scene = catalogue.scene(name)
        if given.get("element") == "Q1-gauss":
            scene = scene.change({"mesh.cell": "quadrilateral"})
        return solve(scene, comm=comm, **given)

    return run


def _squared(method: str, given: Mapping[str, Any]) -> Callable[[MPI.Comm], object]:
    data = {"tension": 1, "load": -1, "lower": -0.05, **given}
    return lambda comm: solve(Scene(mesh={"shape": "rectangle", "cells": 16}, **data), method=method, comm=comm)


def _form(
    method: str, *, stiffness: float = 1.0, pull: float = 20.0, held: bool = True, energy: bool = False,
    spoilt: str = "", rank: int = 0,
) -> Callable[[MPI.Comm], object]:  # fmt: skip
    def run(comm: MPI.Comm) -> object:
        mesh = releases.settle(dmesh.create_unit_square(comm, 12, 12, ghost_mode=releases.FACET_GHOSTS))
        V = releases.functionspace(mesh, "Lagrange", 1)
        u, v, load, upper, value = (fem.Function(V), ufl.TestFunction(V), *(fem.Function(V) for _ in range(3)))
        load.x.array[:], upper.x.array[:] = pull, 0.1
        fields = {"load": load, "upper": upper, "value": value, "start": u}
        mesh.topology.create_connectivity(1, 2)
        rim = fem.locate_dofs_topological(V, 1, dmesh.exterior_facet_indices(mesh.topology))
        if spoilt and comm.rank == rank % comm.size:
            own = V.dofmap.index_map.size_local
            places = [dof for dof in range(own) if (dof in rim) == (spoilt == "value")]
            fields[spoilt].x.array[places[len(places) // 2]] = math.nan
        for field in fields.values():
            field.x.scatter_forward()
        # a constant may not be 0: the form would lose its matrix before it is compiled
        k = fem.Constant(mesh, PETSc.ScalarType(stiffness))
        F = k * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - load * v * ufl.dx
        J = 0.5 * k * ufl.inner(ufl.grad(u), ufl.grad(u)) * ufl.dx - load * u * ufl.dx if energy else None
        bcs = [fem.dirichletbc(value, rim)] if held else []
        return ObstacleProblem(F, u, bcs=bcs, upper=upper, energy=J).solve(eps=1e-6, method=method)

    return run


def main() -> None:
    """All problems, a JSON line each."""
    comm = MPI.COMM_WORLD
    abort_on_uncaught_errors(comm)
    everything = list(problems())
    for problem in everything:
        held, said = attempt(problem, comm)
        if comm.rank == 0:
            last = problem is everything[-1]
            tell({"name": problem.name, "held": held, "said": said, "last": last})


if __name__ == "__main__":
    main()
