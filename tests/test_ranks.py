"""Results on several ranks: meshes without ghost cells, submeshes, and errors that one rank has."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from numpy.testing import assert_allclose

from fenicsx_obstacle import InputError, ObstacleProblem, Scene, Solution, releases, solve
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import ObstacleError
from fenicsx_obstacle.parallel import agree, on_root, warn
from tests.conftest import DEMOS
from tests.helpers import Membrane, run
from tests.test_own_mesh import Own

pytestmark = pytest.mark.ranks
COMM = MPI.COMM_WORLD
GHOSTS = dmesh.GhostMode


class Weld(Own):
    """A unit square with the line x = 1/2 tagged 3 and the side x = 1 tagged 2; u = 0 on this side."""

    def __init__(self, cell: str, ghosts: Any):
        super().__init__(16, cell, ghosts)
        self.dS = ufl.Measure("dS", domain=self.mesh, subdomain_data=self.facet_tags)
        self.V = releases.functionspace(self.mesh, "Lagrange", 1)
        self.top = fem.dirichletbc(0.0, fem.locate_dofs_topological(self.V, 1, self.facet_tags.find(2)), self.V)

    def problem(self, term: Any = None, **how: Any) -> ObstacleProblem:
        u, v = fem.Function(self.V), ufl.TestFunction(self.V)
        F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx + 3 * v * ufl.dx
        return ObstacleProblem(F if term is None else F + term(v), u, bcs=[self.top], **how)

    def scene(self, item: dict[str, Any], **more: Any) -> Scene:
        boundary = [{"on": "top", "value": 0}, {"on": "weld", **item}]
        return super().scene(**{"load": -3, "facet_names": {"weld": 3, "top": 2}, "boundary": boundary, **more})


def right_or_refused(run: Any, right: Any, whole: bool) -> None:
    """The right numbers on any number of ranks, or one message with the remedy on all of them."""
    try:
        found = run()
    except InputError as error:
        assert whole is False and COMM.size > 1 and "GhostMode.shared_facet" in str(error)
        return
    assert_allclose(found, right, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("ghosts", [GHOSTS.none, GHOSTS.shared_facet])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_facets_inside_have_both_sides(kind: Any, ghosts: Any) -> None:
    weld, whole = Weld(kind, ghosts), ghosts == GHOSTS.shared_facet

    def contact() -> list[float]:
        solution = weld.problem(lower=-0.3, measure=weld.dS(3)).solve(method="vi")
        return [solution.force.lower, solution.area]

    right_or_refused(contact, [1.65, 1.0], whole)

    def load() -> np.ndarray:  # u'' = 3, u(1) = 0: the load adds -2 (1 - x) beyond the line
        problem = weld.problem(lambda v: 2 * ufl.avg(v) * weld.dS(3), lower=-9)
        return problem.solve(method="vi").at([0.5, 0.5])

    right_or_refused(load, -2.125, whole)
    for item, right in (({"flux": -2}, -2.125), ({"spring": 5}, -1.125 / 3.5)):
        right_or_refused(lambda item=item: solve(weld.scene(item, lower=-9)).at([0.5, 0.5]), right, whole)


def test_integrals_over_all_facets_inside_need_both_sides() -> None:
    weld = Weld("triangle", GHOSTS.none)
    if COMM.size == 1:
        weld.problem(lambda v: ufl.avg(v) * ufl.dS, lower=-1)
        return
    with pytest.raises(InputError, match=r"F: a measure: .* inside the domain .*GhostMode\.shared_facet"):
        weld.problem(lambda v: ufl.avg(v) * ufl.dS, lower=-1)


@pytest.mark.parametrize("ghosts", [GHOSTS.none, GHOSTS.shared_facet])
def test_outputs_on_facets_inside_need_no_ghosts(ghosts: Any) -> None:
    # u'' = 3, u'(0) = 0, u(1/2) = -0.2, u(1) = 0: the slope is 3/2 before the line and 0.4 - 3/4 beyond it
    report = {"mean": 'integral(u, "weld")', "out": 'integral(normal_flux, "weld")', "kink": 'integral(jump, "weld")'}
    found = solve(Weld("triangle", ghosts).scene({"value": -0.2}, lower=-9, report=report)).report
    assert_allclose(found["mean"], -0.2, rtol=1e-9)
    assert_allclose(found["out"], 3 / 2 - (0.4 - 3 / 4), rtol=1e-6)
    assert found["kink"] == pytest.approx(found["out"], rel=0.2)


REGIONS = {
    "half": lambda x: x[0] <= 0.5 + 1e-9,
    "disk": lambda x: (x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2 < 0.15,
    "ring": lambda x: abs((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2 - 0.1) < 0.06,
    "strip": lambda x: abs(x[1] - 0.42) < 0.11,
}


def region(name: str, ghosts: Any, comm: MPI.Comm) -> dmesh.Mesh:
    whole = dmesh.create_unit_square(comm, 20, 20, ghost_mode=ghosts)
    cells = np.sort(dmesh.locate_entities(whole, 2, REGIONS[name])).astype(np.int32)
    found = dmesh.create_submesh(whole, 2, cells)[0]
    found.topology.create_connectivity(1, 2)
    return found


def membrane_on(mesh: dmesh.Mesh, degree: int, lower: Any) -> Solution:
    own = Membrane(mesh, degree, load=-20.0)
    solution = own.problem(lower=lower).solve()
    assert COMM.allreduce(np.abs(solution.u.x.array - own.u.x.array).max(initial=0.0), MPI.MAX) == 0.0
    return solution


@pytest.mark.slow
@pytest.mark.parametrize("ghosts", [GHOSTS.none, GHOSTS.shared_facet])
@pytest.mark.parametrize("name", REGIONS)
def test_submeshes_where_ranks_have_dofs_of_no_cell(name: str, ghosts: Any) -> None:
    """The force is that which each rank finds alone."""
    mesh, alone = region(name, ghosts, COMM), region(name, ghosts, MPI.COMM_SELF)
    x = ufl.SpatialCoordinate(mesh)
    for degree, lower in ((1, slope), (1, -0.02 - 0.03 * x[0] * x[1]), (2, slope)):
        force = membrane_on(mesh, degree, lower).force.lower
        assert force > 0.5 and force == pytest.approx(membrane_on(alone, degree, slope).force.lower, rel=1e-7)


def slope(x: np.ndarray) -> np.ndarray:
    """An obstacle."""
    return np.asarray(-0.02 - 0.03 * x[0] * x[1])


def body_on(mesh: dmesh.Mesh) -> Solution:
    V = releases.functionspace(mesh, "Lagrange", 1, 2)
    u, v = fem.Function(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    F = ufl.inner(strain, ufl.sym(ufl.grad(v))) * ufl.dx + v[1] * ufl.dx
    sides = [dmesh.locate_entities_boundary(mesh, 1, lambda x, s=s: s * (x[1] - 0.5) > 0.32) for s in (-1, 1)]
    tags = dmesh.meshtags(mesh, 1, np.sort(sides[0]).astype(np.int32), np.ones(len(sides[0]), dtype=np.int32))
    bc = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, sides[1]), V)
    measure = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)
    return ObstacleProblem(F, u, bcs=[bc], of=u[1], lower=-0.005, measure=measure).solve()


@pytest.mark.parametrize("ghosts", [GHOSTS.none, GHOSTS.shared_facet])
def test_bodies_on_submeshes(ghosts: Any) -> None:
    solution, alone = (body_on(region("disk", ghosts, comm)) for comm in (COMM, MPI.COMM_SELF))
    assert_allclose(solution.force.resultant[1], solution.force.lower, rtol=1e-9)
    assert solution.force.lower == pytest.approx(alone.force.lower, rel=1e-7)
    assert len(solution.nodes.gap) == len(alone.nodes.gap) > 4


LAST = COMM.rank == COMM.size - 1


class Odd(Exception):
    """An error that cannot travel between ranks."""

    def __init__(self) -> None:
        super().__init__("odd")
        self.kept = lambda: None


@pytest.mark.parametrize("method", ["penalty", "vi"])
@pytest.mark.parametrize("error", [ValueError("mine"), Odd()])
def test_a_monitor_that_raises_on_one_rank_ends_all(error: Exception, method: str) -> None:
    problem = Weld("triangle", GHOSTS.shared_facet).problem(lower=-0.3)
    right = problem.solve(method=method).force.lower

    def monitor(number: int, step: Any) -> None:
        if LAST:
            raise error

    with pytest.raises((type(error), ObstacleError), match=str(error)) as raised:
        problem.solve(method=method, monitor=monitor)
    assert raised.value is error or not LAST
    assert problem.solve(method=method).force.lower == pytest.approx(right)  # the problem is as good as before


class Torn(Field):
    """Data of a plug-in that raise on one rank."""

    text, source = "torn", "torn"

    def at(self, x: np.ndarray, names: Any, cells: Any = None) -> np.ndarray:
        if LAST:
            raise KeyError("torn")
        return np.zeros(x.shape[1])


@pytest.mark.parametrize("where", ["load", "tension", "lower", "value", "flux"])
def test_data_that_raise_on_one_rank_end_all(where: str) -> None:
    weld = Weld("triangle", GHOSTS.shared_facet)
    item = {where: Torn()} if where in ("value", "flux") else {"value": 0}
    scene = weld.scene(item, **{"lower": -1, **({} if where in item else {where: Torn()})})
    with pytest.raises(KeyError, match="torn"):
        solve(scene)


def test_errors_of_one_rank_are_raised_on_all() -> None:
    with pytest.raises(LookupError, match="here"), agree(COMM):
        if LAST:
            raise LookupError("here")
    with pytest.raises(ZeroDivisionError):
        on_root(COMM, lambda: 1 / 0)
    with pytest.raises(InputError, match="none: No such file"):
        on_root(COMM, lambda: open("none"))  # noqa: SIM115


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_solutions_are_read_on_ranks_without_cells(element: str, folder: Path) -> None:
    scene = Scene(mesh={"shape": "rectangle", "cells": 1}, tension=1, load=-1, lower=-0.05,
                  boundary=[{"on": "left", "value": 0}])  # fmt: skip
    solution = solve(scene.change({"solve.element": element}))
    solution.save(folder)
    again = Solution.read(folder)
    assert again.force.lower == solution.force.lower
    assert_allclose(again.at([0.25, 0.5]), solution.at([0.25, 0.5]))


@pytest.mark.serial
def test_an_error_of_one_rank_ends_the_command_on_all(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from mpi4py import MPI\nif MPI.COMM_WORLD.rank == 1:\n    1 / 0\n")
    done = run("solve", DEMOS / "ball.toml", "--cells", 4, "--plugin", "mine.py", ranks=2, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "mine.py: ZeroDivisionError" in done.stderr and "(rank 1)" in done.stderr


@pytest.mark.parametrize("ghosts", [GHOSTS.none, GHOSTS.shared_facet])
def test_refined_submeshes_of_several_parts(ghosts: Any) -> None:
    whole = dmesh.create_unit_square(COMM, 8, 8, ghost_mode=ghosts)
    cells = dmesh.locate_entities(whole, 2, lambda x: abs(x[0] - 0.5) > 0.2)
    mesh = dmesh.create_submesh(whole, 2, np.sort(cells).astype(np.int32))[0]
    scene = Scene(mesh=mesh, tension=1, load=-20, lower=-0.02)
    fine = solve(scene.change({"mesh.refine": 1}))
    half = solve(Scene(mesh={"shape": "rectangle", "x": [0, 0.25], "cells": 2, "refine": 1}, tension=1, load=-20,
                       lower=-0.02))  # fmt: skip
    assert fine.dofs == 2 * half.dofs and fine.force.lower == pytest.approx(2 * half.force.lower, rel=1e-4)


def test_a_warning_that_is_an_error_is_one_on_all_ranks() -> None:
    """Rank 0 alone warns; with `-W error` it would leave alone."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        warn(COMM, "words", stacklevel=1)
    assert [str(one.message) for one in caught] == ["words"] * (COMM.rank == 0)
    assert all(one.filename == __file__ for one in caught)
    with warnings.catch_warnings(action="error"), pytest.raises(UserWarning, match="words"):
        warn(COMM, "words")


def test_discontinuous_data_on_grid_lines() -> None:
    """Points are those of the mesh to the last digit: no rank sees a step of the obstacle on another side."""
    stairs = "where(x < -0.5, -0.2, where(x < 0, -0.4, where(x < 0.5, -0.6, -0.8)))"
    shape = {"shape": "rectangle", "x": [-1, 1], "y": [-1, 1], "cells": 32}
    scene = Scene(mesh=shape, tension=1, load=-10, lower=stairs)
    energies = [solve(scene, eps=1e-8).record["energy"] for _ in range(2)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
