"""ObstacleProblem and Scenes on the caller's mesh: own forms, kinds of data, second solves, saved folders, errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from cases import ALL, COMM, ONE, Values, add, case, digest, flat, norms, plain
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import (
    Answer,
    Elasticity,
    InputError,
    NotConverged,
    ObstacleProblem,
    Scene,
    Solution,
    Table,
    ball_gap,
    compare,
    contact_pressure,
    find,
    nodal_rule,
    penalty,
    plane_gap,
    releases,
    solve,
    study,
)

CELLS = dmesh.CellType
KINDS = {
    "P1": ("triangle", 1), "P2": ("triangle", 2), "Q1": ("quadrilateral", 1), "Q2": ("quadrilateral", 2),
    "P1-solid": ("tetrahedron", 1), "Q1-solid": ("hexahedron", 1), "Q2-solid": ("hexahedron", 2),
    "P1-string": ("interval", 1), "P2-string": ("interval", 2),
}  # fmt: skip


def mesh_of(cell: str, n: int = 0) -> dmesh.Mesh:
    """A unit interval, square or cube."""
    if cell == "interval":
        return dmesh.create_unit_interval(COMM, n or 20)
    if cell in ("tetrahedron", "hexahedron"):
        n = n or 4
        return dmesh.create_box(COMM, [np.zeros(3), np.ones(3)], [n, n, n], getattr(CELLS, cell))
    n = n or 8
    return dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [n, n], getattr(CELLS, cell))


class Membrane:
    """tension mu and load f on a unit mesh, u = 0 on its boundary."""

    def __init__(self, cell: str = "triangle", degree: int = 1, n: int = 0, load: float = -6.0):
        self.mesh = mesh_of(cell, n)
        self.V = releases.functionspace(self.mesh, "Lagrange", degree)
        self.u, self.v, self.x = fem.Function(self.V), ufl.TestFunction(self.V), ufl.SpatialCoordinate(self.mesh)
        self.mu = fem.Constant(self.mesh, PETSc.ScalarType(1))
        self.f = fem.Constant(self.mesh, PETSc.ScalarType(load))
        self.edge = fem.Function(self.V)
        self.bc = fem.dirichletbc(self.edge, boundary(self.V))
        self.F = self.mu * ufl.inner(ufl.grad(self.u), ufl.grad(self.v)) * ufl.dx - self.f * self.v * ufl.dx

    def problem(self, **more: Any) -> ObstacleProblem:
        return ObstacleProblem(more.pop("F", self.F), self.u, **{"bcs": [self.bc], "lower": -0.1, **more})


def boundary(V: fem.FunctionSpace) -> np.ndarray:
    """Dofs on the boundary."""
    mesh = V.mesh
    mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    return fem.locate_dofs_topological(V, mesh.topology.dim - 1, dmesh.exterior_facet_indices(mesh.topology))


def form(name: str, make: Callable[[], ObstacleProblem], *, ranks: tuple[int, ...] = ALL, **how: Any) -> None:
    """A case that solves an ObstacleProblem."""
    add(f"form/{name}", lambda folder: digest(make().solve(**how)), ranks)


def own_forms() -> None:
    for name, (cell, degree) in KINDS.items():
        for method in ("penalty", "successive", "vi"):
            form(f"{name}-{method}", lambda c=cell, d=degree: Membrane(c, d, load=-10).problem(), method=method)
        form(f"{name}-both", lambda c=cell, d=degree: Membrane(c, d, load=9).problem(lower=-0.5, upper=0.06), ranks=ONE)
        if "hedron" not in cell:
            n = 400 if cell == "interval" else 40
            form(
                f"{name}-large",
                lambda c=cell, d=degree, n=n: Membrane(c, d, n).problem(),
                ranks=ALL if degree == 1 else ONE,
            )
    for eps in (1e-3, 1e-8, 1e-12):
        form(f"eps-{eps}", lambda: Membrane().problem(), eps=eps)
    form("rtol", lambda: Membrane().problem(), rtol=1e-6)
    for kind, lower in OBSTACLES.items():
        form(f"lower-{kind}", lambda g=lower: _with_obstacle(g))

    def nonlinear(**more: Any) -> ObstacleProblem:
        one = Membrane(load=-3)
        slope = ufl.grad(one.u)
        root = ufl.sqrt(1 + ufl.inner(slope, slope))
        F = ufl.inner(slope, ufl.grad(one.v)) / root * ufl.dx - one.f * one.v * ufl.dx
        if more.pop("energy", False):
            more["energy"] = root * ufl.dx - one.f * one.u * ufl.dx
        return one.problem(F=F, **more)

    for method in ("penalty", "vi"):
        form(f"nonlinear-{method}", nonlinear, method=method)
        form(f"nonlinear-energy-{method}", lambda: nonlinear(energy=True), method=method)
        form(f"cubic-{method}", lambda: with_term(lambda u, v, x: 50 * u**3 * v), method=method)
        form(f"drift-{method}", lambda: with_term(lambda u, v, x: 5 * u.dx(0) * v), method=method)
        form(f"reaction-{method}", lambda: with_term(lambda u, v, x: 30 * x[0] * u * v), method=method)
        form(f"thin-{method}", _thin, method=method)
        form(f"boundary-measure-{method}", lambda: _robin(), method=method)
    form("nodal-rule", lambda: with_term(lambda u, v, x: 30 * u * v, nodal=True))
    form("options-lu", lambda: Membrane().problem(petsc_options={"ksp_type": "preonly", "pc_type": "lu"}), ranks=ONE)
    form("options-cg", lambda: Membrane().problem(petsc_options={"pc_type": "jacobi", "ksp_rtol": 1e-12}))
    form("jacobian", lambda: _with_jacobian())
    for degree in (1, 2):
        for method in ("penalty", "vi"):
            form(f"elastic-P{degree}-{method}", lambda d=degree: elastic(d), method=method)
    form("elastic-stress", lambda: elastic(1, plane="stress", stressed=True))
    form("elastic-axial", lambda: elastic(1, plane="axial"))
    form("elastic-ball", lambda: elastic(1, rigid="ball"))
    form("elastic-plane", lambda: elastic(1, rigid="plane"))
    form("elastic-solid", lambda: elastic(1, cell="tetrahedron"))
    form("elastic-Q1", lambda: elastic(1, cell="quadrilateral"))


OBSTACLES: dict[str, Callable[[Membrane], Any]] = {
    "number": lambda one: -0.1,
    "constant": lambda one: fem.Constant(one.mesh, PETSc.ScalarType(-0.1)),
    "callable": lambda one: lambda x: -0.1 - 0.1 * x[0] + 0.05 * np.sin(5 * x[1]),
    "ufl": lambda one: -0.1 - 0.1 * one.x[0] * ufl.exp(one.x[1]),
    "function": lambda one: _function(one.V),
    "function-p2": lambda one: _function(releases.functionspace(one.mesh, "Lagrange", 2)),
    "function-other-mesh": lambda one: _function(releases.functionspace(mesh_of("triangle", 5), "Lagrange", 1)),
    "function-other-cells": lambda one: _function(releases.functionspace(mesh_of("quadrilateral", 6), "Lagrange", 2)),
}


def _function(V: fem.FunctionSpace) -> fem.Function:
    g = fem.Function(V)
    g.interpolate(lambda x: -0.1 - 0.2 * (x[0] - 0.5) ** 2 + 0.1 * x[1])
    return g


def _with_obstacle(lower: Callable[[Membrane], Any]) -> ObstacleProblem:
    one = Membrane()
    return one.problem(lower=lower(one))


def with_term(term: Callable[..., Any], *, nodal: bool = False) -> ObstacleProblem:
    one = Membrane()
    measure = nodal_rule("triangle").on(ufl.dx) if nodal else ufl.dx
    return one.problem(F=one.F + term(one.u, one.v, one.x) * measure)


def _with_jacobian() -> ObstacleProblem:
    one = Membrane()
    F = one.F + 50 * one.u**3 * one.v * ufl.dx
    return one.problem(F=F, J=ufl.derivative(F, one.u))


def _sides(one: Any, where: Callable[[np.ndarray], np.ndarray], tag: int = 3) -> ufl.Measure:
    dim = one.mesh.topology.dim - 1
    facets = np.sort(dmesh.locate_entities_boundary(one.mesh, dim, where))
    tags = dmesh.meshtags(one.mesh, dim, facets, np.full(len(facets), tag, np.int32))
    return ufl.Measure("ds", domain=one.mesh, subdomain_data=tags)


def _thin() -> ObstacleProblem:
    one = Membrane(load=1)
    ds = _sides(one, lambda x: np.isclose(x[0], 1))
    left = fem.locate_dofs_geometrical(one.V, lambda x: np.isclose(x[0], 0))
    upper = 0.35 * (1 - one.x[1])
    return one.problem(bcs=fem.dirichletbc(PETSc.ScalarType(0), left, one.V), lower=None, upper=upper, measure=ds(3))


def _robin() -> ObstacleProblem:
    one = Membrane(load=-4)
    ds = _sides(one, lambda x: np.isclose(x[0], 1))
    left = fem.locate_dofs_geometrical(one.V, lambda x: np.isclose(x[0], 0))
    F = one.F + 3 * one.u * one.v * ds(3)
    return one.problem(F=F, bcs=fem.dirichletbc(PETSc.ScalarType(0), left, one.V), lower=-0.2)


class Body:
    """What `_sides` needs."""

    def __init__(self, cell: str, degree: int):
        self.mesh = mesh_of(cell, 3 if cell == "tetrahedron" else 8)
        self.dim = self.mesh.geometry.dim
        self.V = releases.functionspace(self.mesh, "Lagrange", degree, self.dim)
        self.u, self.v = fem.Function(self.V), ufl.TestFunction(self.V)

    def held(self, side: int, axis: int) -> Any:
        facets = dmesh.locate_entities_boundary(self.mesh, self.dim - 1, lambda x: np.isclose(x[side], 0))
        dofs = fem.locate_dofs_topological(self.V.sub(axis), self.dim - 1, facets)
        return fem.dirichletbc(PETSc.ScalarType(0), dofs, self.V.sub(axis))


def elastic(
    degree: int, *, plane: str = "strain", cell: str = "triangle", stressed: bool = False, rigid: str = "gap"
) -> ObstacleProblem:
    """A block under a rigid cylinder or sphere."""
    one = Body(cell, degree)
    law = Elasticity(one.u, young=10, poisson=0.3, plane=None if one.dim == 3 else plane)
    top = one.dim - 1
    ds = _sides(one, lambda x: np.isclose(x[top], 1))
    x = ufl.SpatialCoordinate(one.mesh)
    gap: Any = sum((x[i]) ** 2 for i in range(top)) / 4 - 0.03
    n = ufl.as_vector([1.0 if i == top else 0.0 for i in range(one.dim)])
    if rigid == "ball":
        gap = ball_gap(x, n, [0.0, 2.97], 2.0)
    if rigid == "plane":
        gap = plane_gap(x, n, [0.0, 0.99], [0.1, -1.0])
    weight = x[0] if plane == "axial" else 1
    bcs = [one.held(i, i) for i in range(one.dim)]
    more = {"stress": law.stress} if stressed else {}
    return ObstacleProblem(law.residual(one.v), one.u, bcs=bcs, upper=gap, of=ufl.dot(one.u, n), measure=weight * ds(3),
                           **more)  # fmt: skip


def second_solves() -> None:
    @case("again/same")
    def _(folder: Path) -> Values:
        problem = Membrane().problem()
        first, second = problem.solve(), problem.solve()
        return {"first": first.iterations, **digest(second)}

    def again(name: str, change: Callable[[Membrane], Any], **more: Any) -> None:
        def run(folder: Path) -> Values:
            one = Membrane()
            given = {key: make(one) for key, make in more.items()}
            problem = one.problem(**given)
            before = problem.solve()
            change(one)
            after = problem.solve()
            change_back = problem.solve(eps=1e-7)
            return {"first": before.iterations, "third": change_back.iterations, **digest(after),
                    "third.energy": plain(change_back.energy)}  # fmt: skip

        add(f"again/{name}", run)

    again("load", lambda one: setattr(one.f, "value", PETSc.ScalarType(-9)))
    again("tension", lambda one: setattr(one.mu, "value", PETSc.ScalarType(3)))
    again("boundary", lambda one: one.edge.x.array.__setitem__(slice(None), 0.05))
    level: dict[str, fem.Constant] = {}

    def obstacle(one: Membrane) -> fem.Constant:
        level["g"] = fem.Constant(one.mesh, PETSc.ScalarType(-0.1))
        return level["g"]

    again("obstacle", lambda one: setattr(level["g"], "value", PETSc.ScalarType(-0.05)), lower=obstacle)

    @case("again/methods")
    def _(folder: Path) -> Values:
        problem, values = Membrane(n=24).problem(), {}
        for method in ("penalty", "vi", "successive", "penalty"):
            found = problem.solve(method=method)
            values[f"{len(values)}.{method}"] = plain([found.energy, found.area, found.force.lower])
            values[f"{len(values)}.steps"] = found.iterations
        return values

    @case("again/continuation")
    def _(folder: Path) -> Values:
        problem, values = Membrane(n=16).problem(), {}
        for eps in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
            found = problem.solve(eps=eps)
            values[f"{eps}"] = plain([found.energy, found.area, found.penetration / eps])
            values[f"{eps}.steps"] = found.iterations
        return values

    @case("again/start-given")
    def _(folder: Path) -> Values:
        one = Membrane(n=24)
        one.u.interpolate(lambda x: -0.2 * np.sin(np.pi * x[0]) * np.sin(np.pi * x[1]))
        return digest(one.problem().solve())

    @case("again/start-bad")
    def _(folder: Path) -> Values:
        one = Membrane(n=40)
        one.u.interpolate(lambda x: np.sin(40 * x[0]) * np.cos(37 * x[1]))
        return digest(one.problem().solve(eps=1e-8))

    @case("again/load-steps")
    def _(folder: Path) -> Values:
        one = Membrane(n=16)
        problem, values = one.problem(), {}
        for load in (-2, -4, -8, -16, -8, -2, 3):
            one.f.value = PETSc.ScalarType(load)
            found = problem.solve()
            values[f"{len(values)}"] = plain([found.energy, found.area, found.force.lower])
            values[f"{len(values)}.steps"] = found.iterations
        return values

    @case("again/elastic")
    def _(folder: Path) -> Values:
        problem = elastic(1)
        first = problem.solve()
        second = problem.solve(eps=1e-6)
        third = problem.solve(method="vi")
        return {"steps": [first.iterations, second.iterations, third.iterations], **digest(third)}

    @case("again/monitor")
    def _(folder: Path) -> Values:
        seen: list[Any] = []
        Membrane(n=16).problem().solve(monitor=lambda number, step: seen.append([number, step.active, step.changed]))
        return {"steps": seen}


def data() -> None:
    def datum(name: str, make: Callable[[Path, dmesh.Mesh], dict[str, Any]], bound: bool = False) -> None:
        def run(folder: Path) -> Values:
            mesh = mesh_of("triangle")
            given = {"tension": 1, "load": -6, "lower": -0.1, **make(folder, mesh)}
            return digest(solve(Scene(mesh=mesh, **given), bound=bound))

        add(f"datum/{name}", run)

    P1 = lambda mesh: releases.functionspace(mesh, "Lagrange", 1)  # noqa: E731
    DG0 = lambda mesh: releases.functionspace(mesh, "DG", 0)  # noqa: E731

    def function(V: fem.FunctionSpace, of: Callable[[np.ndarray], np.ndarray]) -> fem.Function:
        f = fem.Function(V)
        f.interpolate(of)
        return f

    datum("own-mesh", lambda folder, mesh: {})
    datum("own-mesh-bound", lambda folder, mesh: {}, bound=True)
    datum("load-callable", lambda folder, mesh: {"load": lambda x: -6 - x[0]})
    datum("load-ufl", lambda folder, mesh: {"load": -6 - ufl.SpatialCoordinate(mesh)[0] ** 2})
    datum("load-function", lambda folder, mesh: {"load": function(P1(mesh), lambda x: -6 - x[0])})
    datum("load-dg0", lambda folder, mesh: {"load": function(DG0(mesh), lambda x: -6 - x[0])})
    datum("tension-function", lambda folder, mesh: {"tension": function(P1(mesh), lambda x: 1 + x[0])})
    datum("tension-dg0", lambda folder, mesh: {"tension": function(DG0(mesh), lambda x: 1 + (x[0] > 0.5))})
    datum("tension-callable", lambda folder, mesh: {"tension": lambda x: 1 + x[0] * x[1]})
    datum("tension-ufl", lambda folder, mesh: {"tension": 1 + ufl.SpatialCoordinate(mesh)[1]})
    datum("lower-function", lambda folder, mesh: {"lower": _function(P1(mesh))}, bound=True)
    datum("lower-function-p2", lambda folder, mesh: {"lower": _function(releases.functionspace(mesh, "Lagrange", 2))})
    datum("lower-other-mesh", lambda folder, mesh: {"lower": _function(P1(mesh_of("triangle", 5)))})
    datum("lower-callable", lambda folder, mesh: {"lower": lambda x: -0.1 - 0.1 * x[0]}, bound=True)
    datum("lower-constant", lambda folder, mesh: {"lower": fem.Constant(mesh, PETSc.ScalarType(-0.1))})
    datum("boundary-function", lambda folder, mesh: {"boundary": [{"value": function(P1(mesh), lambda x: 0.1 * x[0])}]})
    datum("time-callable", lambda folder, mesh: {"load": lambda x, t: -6 * t - x[0], "time": {"end": 1, "steps": 3}})
    datum("array", lambda folder, mesh: {"lower": Table(**_grid())})
    datum("array-bound", lambda folder, mesh: {"lower": Table(**_grid())}, bound=True)
    datum("array-load", lambda folder, mesh: {"load": Table(**_grid(), scale=[1, 1, 60])})
    datum("array-shifted", lambda folder, mesh: {"lower": Table(**_grid(), rotate=30, shift=[0.3, -0.3, -0.02],
          scale=[2, 2, 1])})  # fmt: skip
    datum("array-smooth", lambda folder, mesh: {"lower": Table(**_grid(), smooth=0.1)})
    for kind in ("csv", "npy", "npz", "png", "stl", "scattered"):
        datum(f"file-{kind}", lambda folder, mesh, kind=kind: {"lower": _written(folder, kind)}, bound=kind != "stl")

    @case("datum/tags")
    def _(folder: Path) -> Values:
        mesh = mesh_of("triangle")
        facets = np.sort(dmesh.locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0], 0) | np.isclose(x[1], 0)))
        cells = np.sort(dmesh.locate_entities(mesh, 2, lambda x: x[0] < 0.5 + 1e-9))
        rim = dmesh.meshtags(mesh, 1, facets, np.full(len(facets), 7, np.int32))
        material = dmesh.meshtags(mesh, 2, cells, np.full(len(cells), 2, np.int32))
        others = np.setdiff1d(
            np.arange(mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts), cells
        )
        every = np.argsort(np.concatenate([cells, others]))
        tags = np.concatenate([np.full(len(cells), 2), np.full(len(others), 5)])[every].astype(np.int32)
        material = dmesh.meshtags(mesh, 2, np.arange(len(tags), dtype=np.int32), tags)
        scene = Scene(mesh=mesh, facet_tags=rim, cell_tags=material, facet_names={"rim": 7},
                      cell_names={"steel": 2, "tin": 5}, tension={"steel": 1, "tin": 3}, load=-3, lower=-0.2,
                      boundary=[{"on": "rim", "value": 0}], report={"half": "integral(u, 'steel')"})  # fmt: skip
        return digest(solve(scene))


def _grid() -> dict[str, np.ndarray]:
    axis = np.linspace(-1, 2, 31)
    x, y = np.meshgrid(axis, axis)
    return {"x": axis, "y": axis, "z": -0.1 + 0.04 * np.sin(5 * x + 2 * y) * np.cos(3 * y - x)}


def _written(folder: Path, kind: str) -> Table:
    """The same surface in a file."""
    axis = np.linspace(0, 1, 17)
    x, y = np.meshgrid(axis, axis)
    z = -0.1 + 0.04 * np.sin(5 * x + 2 * y) * np.cos(3 * y - x)
    columns = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    file = folder / f"rough.{'csv' if kind == 'scattered' else kind}"
    if COMM.rank == 0:
        if kind == "csv":
            np.savetxt(file, columns, delimiter=",", header="x,y,z", comments="")
        elif kind == "npy":
            np.save(file, columns)
        elif kind == "npz":
            np.savez(file, x=axis, y=axis, z=z)
        elif kind == "png":
            from PIL import Image

            Image.fromarray(np.round((z[::-1] + 0.2) / 0.2 * 65535).clip(0, 65535).astype(np.uint16)).save(file)
        elif kind == "stl":
            at = np.arange(17 * 17).reshape(17, 17)
            a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
            corners = columns[np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])]
            facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
            facets["corners"] = corners
            file.write_bytes(bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes())
        else:
            points = np.random.default_rng(0).random((400, 2))
            points = np.concatenate([points, [[0, 0], [0, 1], [1, 0], [1, 1]]])
            np.savetxt(file, np.column_stack([points, -0.1 + 0.05 * points[:, 0] * points[:, 1]]))
    COMM.Barrier()
    image = {"x": [0, 1], "y": [0, 1], "range": [-0.2, 0]} if kind == "png" else {}
    return Table(str(file), **image)


SCENE: dict[str, Any] = {"mesh": {"shape": "rectangle", "cells": 8}, "tension": 1, "load": -4, "lower": "-0.1 - 0.1*x",
                         "report": {"mean": "integral(u)"}, "define": {"a": 1}}  # fmt: skip
TARGET = {**SCENE, "load": "-4*a", "report": {"force": "integral(p)"}}
POINTS = np.array([[0.3, 0.4], [0.51, 0.77], [0.5, 0.5], [0.1, 0.9], [2.0, 2.0]])


def values_at(solution: Any, dim: int = 2) -> Values:
    """Values at points of all quantities (collective)."""
    names = ("u", "pressure", "gap", "slope", *(["flux"] if solution.tension is not None else []))
    return {f"at.{name}": plain(solution.at(POINTS[:, :dim], name)) for name in names}


def folders() -> None:
    def saved(name: str, make: Callable[[], Any], read: Callable[[Path], Any], points: bool = True) -> None:
        def run(folder: Path) -> Values:
            first = make()
            first.save(folder)
            again = read(folder)
            values = digest(again) | (values_at(again) if points else {})
            if points:
                values |= {f"first.{key}": value for key, value in values_at(first).items()}
            found = [path.name for path in sorted(folder.iterdir())] if COMM.rank == 0 else []
            return {**values, "files": COMM.bcast(found)}

        add(f"saved/{name}", run)

    for element in ("P1", "P2"):
        saved(f"scene-{element}", lambda e=element: solve(Scene(**SCENE), element=e), Answer.read)
    for element in ("Q1", "Q2", "Q1-gauss"):
        mesh = {"shape": "rectangle", "cells": 8, "cell": "quadrilateral"}
        saved(
            f"scene-{element}", lambda e=element, m=mesh: solve(Scene(**{**SCENE, "mesh": m}), element=e), Answer.read
        )
    saved("scene-bound", lambda: solve(Scene(**SCENE), bound=True), Answer.read)
    saved("scene-tol", lambda: solve(Scene(**SCENE), tol=0.3), Answer.read)
    saved("scene-time", lambda: solve(Scene(**{**SCENE, "load": "-4*t", "time": {"end": 1, "steps": 3}})), Answer.read)
    for element, (cell, degree) in KINDS.items():
        if "solid" not in element and "string" not in element:
            saved(f"form-{element}", lambda c=cell, d=degree: Membrane(c, d).problem().solve(), Solution.read)
    saved("form-elastic", lambda: elastic(1).solve(), Solution.read, points=False)

    @case("saved/along")
    def _(folder: Path) -> Values:
        line = solve(Scene(**SCENE)).along([0.1, 0.2], [0.9, 0.7], 9)
        return {name: plain(getattr(line, name)) for name in ("s", "u", "pressure", "gap", "slope", "flux")}

    @case("saved/compare")
    def _(folder: Path) -> Values:
        a, b = solve(Scene(**SCENE)), solve(Scene(**SCENE), cells=12)
        a.save(folder / "a")
        b.save(folder / "b")
        return flat(compare(folder / "a", folder / "b")) | {f"live.{k}": v for k, v in flat(compare(a, b)).items()}

    @case("saved/compare-forms")
    def _(folder: Path) -> Values:
        return flat(compare(Membrane().problem().solve(), Membrane(degree=2).problem().solve()))

    @case("saved/restart")
    def _(folder: Path) -> Values:
        data = {**SCENE, "rate": 1, "time": {"end": 1, "steps": 6, "start": 0}}
        half = Scene(**{**data, "time": {"end": 0.5, "steps": 3, "start": 0}})
        solve(half, keep=folder).save(folder)
        return digest(solve(Scene(**data), restart=folder))


def studies() -> None:
    def rows(name: str, run: Callable[[], list[Any]], ranks: tuple[int, ...] = ALL) -> None:
        add(f"study/{name}", lambda folder: flat({str(i): row for i, row in enumerate(run())}), ranks)

    rows("cells", lambda: study("ball", {"cells": [4, 8, 16]}))
    rows("eps", lambda: study("disk_flat", {"eps": [1e-1, 1e-3, 1e-5]}, cells=12))
    rows("grid", lambda: study(Scene(**SCENE), {"cells": [4, 8], "method": ["penalty", "vi"]}), ONE)
    rows("element", lambda: study("ball", {"cells": [4, 8]}, element="P2"))
    rows("define", lambda: study(Scene(**{**SCENE, "load": "-4*a"}), {"define.a": [1, 2]}))
    rows("uncertainty", lambda: study(Scene(**SCENE), {"cells": [8, 16]}, uncertainty=True), ONE)
    rows("find", lambda: find(Scene(**TARGET), {"define.a": (1, 4)}, "force = 3"))
    rows("find-area", lambda: find(Scene(**TARGET), {"define.a": (1, 4)}, "area = 0.5", within=1e-2))


def lines() -> None:
    """The one-line penalty, by the caller's Newton method."""

    @case("line/penalty")
    def _(folder: Path) -> Values:
        one = Membrane()
        F = one.F + penalty(one.u, one.v, lower=-0.1, eps=1e-4)
        residual, slope = fem.form(F), fem.form(ufl.derivative(F, one.u))
        for _ in range(8):
            A = fem.petsc.assemble_matrix(slope, [one.bc])
            A.assemble()
            b = fem.petsc.assemble_vector(residual)
            b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
            dofs = one.bc.dof_indices()[0]
            b.array[dofs[dofs < one.V.dofmap.index_map.size_local]] = 0.0
            ksp = PETSc.KSP().create(COMM)
            ksp.setType("cg")
            ksp.pc.setType("jacobi")
            ksp.setTolerances(rtol=1e-13)
            ksp.setOperators(A)
            step = b.duplicate()
            ksp.solve(b, step)
            one.u.vector.axpy(-1.0, step)
            one.u.x.scatter_forward()
        p = contact_pressure(one.u, lower=-0.1, eps=1e-4)
        return {"u": plain(norms(one.u)), "p": plain(norms(p))}

    def mistake(name: str, make: Callable[[], Any]) -> None:
        def run(folder: Path) -> Values:
            try:
                make()
            except (InputError, NotConverged) as error:
                return {"error": type(error).__name__, "words": str(error).splitlines()[0]}
            return {"error": "none"}

        add(f"mistake/{name}", run)

    mistake("lower-above-upper", lambda: Membrane().problem(lower=0.2, upper=0.1).solve())
    mistake("lower-above-boundary", lambda: Membrane().problem(lower=0.2).solve())
    mistake("method", lambda: Membrane().problem().solve(method="newton"))
    mistake("eps", lambda: Membrane().problem().solve(eps=-1))
    mistake("rtol", lambda: Membrane().problem().solve(rtol=2))
    mistake("degree-3", lambda: Membrane(degree=3).problem())
    mistake("floating", lambda: Membrane(load=1).problem(bcs=[]).solve())
    mistake("nan-load", lambda: Membrane(load=np.nan).problem().solve())
    mistake("no-measure", lambda: ObstacleProblem(*_vector_form(), upper=1))
    mistake("no-of", lambda: ObstacleProblem(*_vector_form(), upper=1, measure=ufl.ds))
    for name, sub in (("mixed", 1), ("mixed-vector", 2)):
        mistake(name, lambda sub=sub: _mixed(sub))
    mistake("scene-effect", lambda: Scene(mesh={"shape": "disk"}, tensoin=1))
    mistake("scene-mesh", lambda: Scene(mesh={"shape": "disc"}, tension=1))
    mistake("scene-datum", lambda: Scene(mesh={"shape": "disk"}, tension=[1, 2, 3]))
    beside = [{"on": "left", "value": 0}]
    mistake("scene-boundary", lambda: solve(Scene(mesh={"shape": "disk"}, tension=1, boundary=beside)))
    mistake("scene-nowhere", lambda: solve(Scene(mesh={"shape": "disk"}, tension="x", load=-1)))
    mistake("form-bound", lambda: Membrane().problem().solve(bound=True))
    mistake("options", lambda: Membrane().problem(petsc_options={"snes_max_it": 1}).solve())
    mistake("read", lambda: Solution.read("/nonexistent"))
    mistake("at", lambda: Membrane().problem().solve().at([0.5, 0.5, 0.5, 0.5]))
    mistake("at-name", lambda: Membrane().problem().solve().at([0.5, 0.5], "pressur"))
    mistake("flux-of-form", lambda: Membrane().problem().solve().at([0.5, 0.5], "flux"))


def _mixed(second: int) -> ObstacleProblem:
    """Two unknowns in one space, of which the second has so many components."""
    mesh = mesh_of("triangle")
    one = ufl.FiniteElement("Lagrange", mesh.ufl_cell(), 1)
    V = fem.FunctionSpace(mesh, ufl.MixedElement([one, one if second == 1 else ufl.VectorElement(one, second)]))
    u, v = fem.Function(V), ufl.TestFunction(V)
    return ObstacleProblem(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, u, upper=1)


def _vector_form() -> tuple[Any, Any]:
    one = Body("triangle", 1)
    return ufl.inner(ufl.grad(one.u), ufl.grad(one.v)) * ufl.dx, one.u


for subject in (own_forms, second_solves, data, folders, studies, lines):
    subject()
