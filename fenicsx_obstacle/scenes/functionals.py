"""The figures of [report]: integrals, point values and extremes of the solution, by NumPy alone.

P1 fields are linear in a cell, so a functional needs values at chosen barycentric coordinates of chosen cells, and a
report compiles nothing.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from copy import deepcopy
from functools import partial

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.cells import corners, facet_vertices, own_cells, sides, volumes
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.points import locate, mean_over_cells
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.quadrature import blocks, rule
from fenicsx_obstacle.estimation.supports import NormalFlux
from fenicsx_obstacle.parallel import largest, smallest, total
from fenicsx_obstacle.scenes.formulas import FUNCTIONALS, Formula
from fenicsx_obstacle.scenes.report import NORMAL_FLUX
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.words import counted, nearest


class Report:
    """The [report] of a scene on one level.

    Attributes:
        values: Figures so far, by name.
    """

    def __init__(self, data: Data, scene: Scene):
        self.data, self.scene, self.level = data, scene, data.level
        self.values: dict[str, float] = {}
        self._corners, self._dofs = corners(self.level.mesh), releases.cell_dofs(self.level.V)
        self._every = np.arange(own_cells(self.level.mesh))
        self._nodal: dict[str, fem.Function] = {}
        self._normal: NormalFlux | None = None

    def check(self) -> None:
        """Refuse what the mesh shows to be wrong, before anything is solved (collective).

        Raises:
            InputError: For an unknown part of the mesh, a wrong number of coordinates, a point outside.
        """
        dim, pair = self.level.mesh.geometry.dim, self.level.pair
        if not pair.nested_hierarchy:
            raise InputError(f"{self.scene.source}: [report] is for element P1, not for {pair.name}: take P1")
        if self.data.model.elastic.isotropic_tension is None:
            for formula in self.scene.report.values():
                if {"flux", NORMAL_FLUX} & formula.names:
                    raise InputError(f"{formula.place}: flux needs a tension alike in all directions and at all slopes")
        for formula in self.scene.report.values():
            if self.data.model.radial and NORMAL_FLUX in formula.names:
                raise InputError(f"{formula.place}: {NORMAL_FLUX} is for plane problems, not for axial symmetry")
            for node in ast.walk(formula.tree):
                match node:
                    case ast.Call(func=ast.Name(id="integral"), args=[first, ast.Constant(value=str(name)) as part]):
                        self._check_part(formula, formula.part(first), part, name)
                    case ast.Call(func=ast.Name(id="at"), args=[_, *coordinates]):
                        if len(coordinates) != dim:
                            message = f"at() needs {counted(dim, 'coordinate')} here, not {len(coordinates)}"
                            raise InputError(formula.pointing(node, message))
                        if all(self._is_known(formula.part(coordinate)) for coordinate in coordinates):
                            self._locate(formula, node, coordinates)

    def evaluate(
        self, u: fem.Function, p: fem.Function, contact: fem.Function, support: np.ndarray
    ) -> dict[str, float | None]:
        """All figures, in order; None where one is not finite (collective).

        Args:
            u: Solution.
            p: Contact pressure.
            contact: 1 at nodes in contact, else 0.
            support: a(u, phi_i) - f(phi_i) at owned dofs.

        Raises:
            InputError: If a point that depends on other figures is outside.
        """
        self._nodal, self.values = {"u": u, "p": p, "contact": contact}, {}
        if any(NORMAL_FLUX in formula.names for formula in self.scene.report.values()):
            self._normal = NormalFlux(self.data, self._tension, u, support)
        for name, formula in self.scene.report.items():
            tree = _Inner(self, formula).visit(deepcopy(formula.tree))
            self.values[name] = self._number(formula.part(tree))
        return {name: value if np.isfinite(value) else None for name, value in self.values.items()}

    def functional(self, formula: Formula, call: ast.Call) -> float:
        """Value of integral, at, sup or inf; those within it have become numbers already (collective)."""
        expression = formula.part(call.args[0])
        match _name(call), call.args[1:]:
            case "integral", []:
                return self._over_cells(expression, self._every)
            case "integral", [ast.Constant(value=str(name))]:
                if name in self.level.groups:
                    return self._over_cells(expression, self.level.groups[name])
                return self._over_facets(expression, self.level.facets[name])
            case "at", coordinates:
                rows, cells, weights = self._locate(formula, call, coordinates)
                values = self._inside(expression, cells, weights[:, None])[:, 0]
                return float(mean_over_cells(self.level.comm, 1, rows, values)[0])
        vertices = np.eye(self._corners.shape[1])[None]
        values = np.concatenate([self._inside(expression, block, vertices).ravel() for block in _parts(self._every)])
        return (largest if _name(call) == "sup" else smallest)(self.level.comm, values)

    def _over_cells(self, expression: Formula, cells: np.ndarray) -> float:
        points, weights = rule(self.level.mesh.topology.dim)
        parts = [
            volumes(self._corners[block]) @ (self._inside(expression, block, points[None]) @ weights)
            for block in _parts(cells)
        ]
        return total(self.level.comm, parts)

    def _over_facets(self, expression: Formula, facets: np.ndarray) -> float:
        """Integral over facets; slope and flux on a curve inside are means of both sides, the normal flux their sum."""
        dim = self.level.mesh.topology.dim
        cells, numbers, shares = sides(self.level.mesh, facets)
        members = np.array(facet_vertices(dim))[numbers]
        points, weights = rule(dim - 1)
        inside = np.zeros((len(cells), len(points), dim + 1))
        np.put_along_axis(inside, np.repeat(members[:, None], len(points), axis=1), points[None], axis=2)
        sizes = volumes(self._corners[cells[:, None], members])
        normal = None if self._normal is None else partial(self._normal.values, cells, numbers, shares, inside)
        return total(self.level.comm, shares * sizes * (self._inside(expression, cells, inside, normal) @ weights))

    def _inside(
        self, expression: Formula, cells: np.ndarray, where: np.ndarray, normal: Callable[[], np.ndarray] | None = None
    ) -> np.ndarray:
        """Values in cells, shape (cells, points), at barycentric coordinates of shape (cells or 1, points, vertices).

        Collective where it is the first to need the distance. `normal` gives the normal flux, on facets.
        """
        shape = (len(cells), where.shape[1])
        fields: dict[str, Callable[[], np.ndarray]] = {
            "u": lambda: self._linear(self._nodal["u"], cells, where),
            "p": lambda: self._linear(self._nodal["p"], cells, where),
            "contact": lambda: self._linear(self._nodal["contact"], cells, where),
            "distance": lambda: self._linear(self.data.distance, cells, where),
            "slope": lambda: self._slope(cells)[:, None],
            "flux": lambda: (self._tension(cells) * self._slope(cells))[:, None],
        }
        if normal is not None:
            fields[NORMAL_FLUX] = normal
        named = sorted(self.scene.needs(expression) & set(fields))  # in the same order on every rank
        values = {name: np.broadcast_to(fields[name](), shape).ravel() for name in named}
        x = (where @ self._corners[cells]).reshape(-1, 3).T
        return self.scene.at_points(expression, x, {**self.data.now, **self.values, **values}).reshape(shape)

    def _linear(self, function: fem.Function, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        return (where @ function.x.array[self._dofs[cells]][:, :, None])[:, :, 0]

    def _slope(self, cells: np.ndarray) -> np.ndarray:
        """|grad u|, constant in a cell; along the surface, for a surface."""
        vertices, u = self._corners[cells], self._nodal["u"].x.array[self._dofs[cells]]
        edges, rises = vertices[:, 1:] - vertices[:, :1], u[:, 1:] - u[:, :1]
        solved = np.linalg.solve(edges @ edges.transpose(0, 2, 1), rises[:, :, None])[:, :, 0]
        return np.sqrt(np.maximum(np.sum(rises * solved, axis=1), 0.0))

    def _tension(self, cells: np.ndarray) -> np.ndarray | float:
        tension = self.data.model.elastic.isotropic_tension
        assert tension is not None
        values = self.data.cellwise(tension)
        if isinstance(values, fem.Constant):
            return float(values.value)
        return values.x.array[releases.cell_dofs(self.level.W)[cells, 0]]

    def _number(self, formula: Formula) -> float:
        """Value of a formula of constants."""
        return float(self.scene.at_points(formula, np.zeros((3, 1)), {**self.data.now, **self.values})[0])

    def _locate(self, formula: Formula, node: ast.AST, coordinates: list[ast.expr]) -> tuple[np.ndarray, ...]:
        point = np.zeros((1, 3))
        point[0, : len(coordinates)] = [self._number(formula.part(coordinate)) for coordinate in coordinates]
        found = locate(self.level, point)
        if total(self.level.comm, len(found[0])) == 0:
            place = ", ".join(f"{x:g}" for x in point[0, : len(coordinates)])
            raise InputError(formula.pointing(node, f"the point ({place}) is outside the mesh"))
        return found

    def _is_known(self, formula: Formula) -> bool:
        """Whether a coordinate has its value before the solution is there."""
        calls = any(isinstance(node, ast.Call) and _name(node) in FUNCTIONALS for node in ast.walk(formula.tree))
        return not calls and not formula.names & set(self.scene.report)

    def _check_part(self, formula: Formula, expression: Formula, node: ast.expr, name: str) -> None:
        facets, groups = self.level.facets, self.level.groups
        if name in facets and name in groups:
            raise InputError(formula.pointing(node, f"'{name}' is the name of cells and of their sides"))
        if name not in facets and name not in groups:
            message = f"no part of the mesh named '{name}'" + nearest(name, {*facets, *groups})
            raise InputError(formula.pointing(node, message))
        if name in groups and NORMAL_FLUX in expression.names:
            raise InputError(formula.pointing(node, f"'{name}' is a part of the domain: it has no {NORMAL_FLUX}"))
        if NORMAL_FLUX in self.scene.needs(expression):
            self._check_normal_flux(formula, node, name)

    def _check_normal_flux(self, formula: Formula, node: ast.expr, name: str) -> None:
        """Refuse the normal flux where it is not the force by which u is held (collective)."""
        mesh, comm = self.level.mesh, self.level.comm
        facets = self.level.facets[name]
        facets = facets[facets < mesh.topology.index_map(mesh.topology.dim - 1).size_local]
        parts = zip(self.scene.tables.boundary, self.data.facets, strict=True)
        acting = np.concatenate([np.empty(0, np.int32), *(there for part, there in parts if part.value is None)])
        if total(comm, np.count_nonzero(np.isin(facets, acting))) > 0:
            message = f"on '{name}' the {NORMAL_FLUX} is what [[boundary]] gives: flux - spring*u; integrate that"
            raise InputError(formula.pointing(node, message))
        held = np.concatenate([self.level.boundary_facets, *self.data.held])
        if total(comm, np.count_nonzero(~np.isin(facets, held))) > 0:
            message = (
                f"'{name}' is inside the domain and u is not given on it: the {NORMAL_FLUX} of both sides adds up to 0 "
                "there; for the flux through it integrate load and p over the part of the domain on one side of it"
            )
            raise InputError(formula.pointing(node, message))


class _Inner(ast.NodeTransformer):
    """Replaces the functionals of a formula by their values, innermost first (collective)."""

    def __init__(self, report: Report, formula: Formula):
        self.report, self.formula = report, formula

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        if _name(node) not in FUNCTIONALS:
            return node
        return ast.copy_location(ast.Constant(self.report.functional(self.formula, node)), node)


def _name(call: ast.Call) -> str:
    assert isinstance(call.func, ast.Name)
    return call.func.id


def _parts(cells: np.ndarray) -> list[np.ndarray]:
    """Cells, at most AT_ONCE at a time; one empty part where there are none."""
    return [cells[block] for block in blocks(len(cells))] or [cells]
