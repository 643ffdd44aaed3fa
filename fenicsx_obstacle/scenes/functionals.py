"""Output quantities of [report]: integrals, point values and extremes of the solution, and their derivatives with
respect to it for goal-oriented error estimates, by NumPy only.

A functional needs values of Lagrange functions at chosen places of chosen cells, so that a report compiles nothing. A
quantity depends on u and on the nodal forces F_i = a(u, phi_i) - f(phi_i): contact forces, which are pressure times
weight, and reactions where u is given. Integrands and what is computed from integrals are differentiated by central
differences, so that any formula will do whose derivative exists.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property, partial, reduce

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.normal_flux import NormalFlux, outward_flux
from fenicsx_obstacle.estimation.quadrature import AT_ONCE, blocks, rule
from fenicsx_obstacle.mesh.cells import corners, own_cells, sides
from fenicsx_obstacle.mesh.points import locate, mean_over_cells
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.definitions import JUMP, NORMAL_FLUX
from fenicsx_obstacle.scenes.formulas import FUNCTIONALS, Formula
from fenicsx_obstacle.scenes.report import BODY_QUANTITIES
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import counted, nearest

EQUAL = 1e-9  # relative difference of values that count as the same extreme
OF_CONTACT = ("p", "contact")  # fields with nodes of their own
FEW_POINTS = 12  # of quadrature in a cell
GAUSS_DEGREE = 7  # of the rule along each axis of quadrilaterals and hexahedra
STEP = 1e-5  # relative, of central differences


@dataclass(frozen=True, eq=False)
class Points:
    """Points in cells, in each the same number.

    Attributes:
        cells: The cells, shape (n,).
        where: Weights of their vertices at the points, shape (n or 1, points, vertices).
        sizes: What the points stand for in an integral, shape (n, points).
        on_facets: What facets alone have, by its name.
    """

    cells: np.ndarray
    where: np.ndarray
    sizes: np.ndarray = field(default_factory=lambda: np.empty(0))
    on_facets: Mapping[str, Callable[[], np.ndarray]] = field(default_factory=dict)


class Report:
    """The [report] of a scene on one level.

    Attributes:
        values: Values so far, by name.
    """

    def __init__(self, data: Data, scene: Scene):
        self.data, self.scene, self.level = data, scene, data.level
        self.values: dict[str, float] = {}
        self._places: dict[str, list[float]] = {}
        self._corners, self._reference = corners(self.level.mesh), Reference(self.level.mesh)
        self._every = np.arange(own_cells(self.level.mesh))
        self._nodal: dict[str, fem.Function] = {}
        self._normal: NormalFlux | None = None

    def check(self) -> None:
        """Check [report] with the mesh, before anything is solved (collective).

        Raises:
            InputError: For an unknown part of the mesh, a wrong number of coordinates, a point outside, a distance on a
                mesh that has none.
        """
        dim, with_flux = self.level.mesh.geometry.dim, self.data.model.elastic.role == "tension"
        for formula in self.scene.report.values():
            if not with_flux and {"flux", NORMAL_FLUX, JUMP} & formula.names:
                raise InputError(f"{formula.place}: flux needs an isotropic tension that does not depend on the slope")
            if "distance" in self.scene.needs(formula):
                try:
                    _ = self.data.boundary_distance  # rejects a mesh on which there is none
                except InputError as error:
                    raise InputError(f"{formula.place}: {error}") from None
            if self.data.model.radial and NORMAL_FLUX in formula.names:
                raise InputError(f"{formula.place}: {NORMAL_FLUX} is for plane problems, not for axial symmetry")
            for node in ast.walk(formula.tree):
                match node:
                    case ast.Call(func=ast.Name(id="integral")):
                        self._check_integral(formula, node)
                    case ast.Call(func=ast.Name(id="at"), args=[_, *coordinates]):
                        if len(coordinates) != dim:
                            message = f"at() needs {counted(dim, 'coordinate')} here, not {len(coordinates)}"
                            raise InputError(formula.pointing(node, message))
                        if all(self._is_known(formula.part(coordinate)) for coordinate in coordinates):
                            self._locate(formula, node, coordinates)

    @property
    def extremes(self) -> dict[str, dict[str, list[float]]]:
        """`report_places` of a record: where the extremes are that stand alone in an entry, by its name; {} without."""
        return {"report_places": self._places} if self._places else {}

    def evaluate(
        self, fields: Mapping[str, fem.Function], forces: np.ndarray | None = None, known: Mapping[str, float] = {}
    ) -> dict[str, float | None]:
        """All output quantities, in order; None if one is not finite (collective).

        Args:
            fields: u, p and contact, which is 1 at nodes in contact; of an elastic body its fields, by their names.
            forces: Of scalar u, a(u, phi_i) - f(phi_i) at owned dofs.
            known: Numbers that are known without a functional.

        Raises:
            InputError: If a point that depends on other figures is outside.
        """
        self._nodal = dict(fields)
        if forces is not None and any(NORMAL_FLUX in formula.names for formula in self.scene.report.values()):
            self._normal = NormalFlux(
                self.data, self._reference, self._rule(self._reference.dim - 1), self._tension, fields["u"], forces
            )  # fmt: skip
        self.values, self._places = dict(known), {}
        for name, formula in self.scene.report.items():
            self._last_place: list[float] = []
            tree = Numbers(partial(self.functional, formula), inner=True).visit(deepcopy(formula.tree))
            if isinstance(formula.tree, ast.Call) and name_of(formula.tree) in ("sup", "inf"):
                self._places[name] = self._last_place
            self.values[name] = self._number(formula.part(tree))
        found = {name: self.values[name] for name in self.scene.report}
        return {name: value if np.isfinite(value) else None for name, value in found.items()}

    def functional(self, formula: Formula, call: ast.Call) -> float:
        """Value of integral, at, sup or inf; those within it have become numbers already (collective)."""
        expression = formula.part(call.args[0])
        if name_of(call) == "integral":
            sums = [
                (self._inside(expression, points) * points.sizes).sum(axis=1)
                for points in self.quadrature(expression, call)
            ]
            return total(self.level.comm, np.concatenate(sums))
        if name_of(call) == "at":
            rows, cells, weights = self._locate(formula, call, call.args[1:])
            values = self._inside(expression, Points(cells, weights[:, None]))[:, 0]
            return float(mean_over_cells(self.level.comm, 1, rows, values)[0])
        return self._extreme(expression, 1.0 if name_of(call) == "sup" else -1.0)

    def _extreme(self, expression: Formula, sign: float) -> float:
        """The largest or least value at nodes, of what contact enters at its own; its place is kept, of equal ones the
        first by coordinates."""
        named = self.scene.needs(expression) & self._nodal.keys()
        space = next((self._nodal[name].function_space for name in OF_CONTACT if name in named), self.level.V)
        nodes = self._reference.nodes(space)[None]
        mine: list[tuple[float, list[float]]] = []
        for block in _parts(self._every):
            values = sign * self._inside(expression, Points(block, nodes))
            if not values.size:
                continue
            if np.isnan(values).any():
                mine.append((np.nan, [np.nan]))
                continue
            best = values.max()
            cells, points = np.nonzero(values >= _nearly(best))
            x = np.einsum("cv,cvi->ci", nodes[0][points], self._corners[block][cells])
            x = x[:, : self.level.mesh.geometry.dim]
            mine.append((float(best), x[np.lexsort(x.T[::-1])[0]].tolist()))
        found = [one for part in self.level.comm.allgather(mine) for one in part]
        best = max((value for value, _ in found), default=-np.inf)
        if any(np.isnan(value) for value, _ in found):
            return np.nan
        self._last_place = min((place for value, place in found if value >= _nearly(best)), default=[])
        return sign * best

    def _rule(self, dim: int) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the vertices at points of quadrature of cells or facets, shape (n, vertices), and weights of sum
        1."""
        if self._reference.simplex or dim < 2:
            return rule(dim)
        ends, weights = rule(1, GAUSS_DEGREE)
        return reduce(np.kron, [ends] * dim), reduce(np.kron, [weights] * dim)

    def quadrature(self, expression: Formula, call: ast.Call) -> Iterator[Points]:
        """The points of the integral of an expression that a call names."""
        names = [str(node.value) for node in call.args[1:] if isinstance(node, ast.Constant)]
        if names and (len(names) > 1 or not self.over_cells(expression, names[0])):
            yield self._on_facets(self.level.facets[names[0]], self.level.groups[names[1]] if len(names) > 1 else None)
            return
        points, weights = self._rule(self._reference.dim)
        cells = self.level.groups[names[0]] if names else self._every
        alone = isinstance(expression.tree, ast.Name) and expression.tree.id in OF_CONTACT
        if alone and self._lumped is not None:  # integral(p) is the contact force
            yield Points(cells, np.eye(self._lumped.shape[1])[None], self._lumped[cells])
            return
        for block in _parts(cells, len(weights)):
            yield Points(block, points[None], self._reference.measures(block, points[None]) * weights)

    @cached_property
    def _lumped(self) -> np.ndarray | None:
        """Weights of the vertices in owned cells, shape (cells, vertices), where these, which the pressure has, differ
        from integrals of the basis functions: Voronoi areas, and those of quadrilaterals and hexahedra that are no
        parallelograms; None elsewhere (collective)."""
        pair, reference = self.level.pair, self._reference
        if pair.own_weights:
            return pair.cell_weights(self._corners[self._every])
        if reference.simplex or not pair.at_vertices:
            return None
        sizes = reference.measures(self._every, np.eye(2**reference.dim)[None])
        bent = total(self.level.comm, np.count_nonzero(np.ptp(sizes, axis=1) > EQUAL * sizes.max(axis=1, initial=0.0)))
        return sizes / sizes.shape[1] if bent > 0 else None

    def _on_facets(self, facets: np.ndarray, seen_from: np.ndarray | None) -> Points:
        """Points on facets. On a curve inside slope and flux are means of both sides, the normal flux and the jump
        their sums. From some cells alone they are what is there, and the normal flux is that of the gradient."""
        cells, numbers, shares = sides(self.level.mesh, facets)
        if seen_from is not None:
            kept = np.isin(cells, seen_from)
            cells, numbers, shares = cells[kept], numbers[kept], np.ones(np.count_nonzero(kept))
        points, weights = self._rule(self._reference.dim - 1)
        inside = self._reference.on_facets(numbers, points)
        sizes = shares[:, None] * self._reference.facet_measures(cells, numbers, points) * weights
        of_gradient = lambda: outward_flux(  # noqa: E731
            self._reference, self._tension, self._nodal["u"], cells, numbers, inside
        )  # fmt: skip
        normal: Callable[[], np.ndarray] = of_gradient
        if self._normal is not None and seen_from is None:
            normal = partial(self._normal.values, cells, numbers, shares, inside)
        on_facets = {NORMAL_FLUX: normal, JUMP: lambda: of_gradient() / shares[:, None]}
        return Points(cells, inside, sizes, on_facets)

    def _inside(self, expression: Formula, points: Points) -> np.ndarray:
        """Values at points, shape (cells, points); collective where it is the first to need the distance."""
        shape, values = self.fields(expression, points)
        return self.pointwise(expression, points, values).reshape(shape)

    def fields(self, expression: Formula, points: Points) -> tuple[tuple[int, int], dict[str, np.ndarray]]:
        """The fields that an expression needs, each flat, and the shape of the points, as `_inside` has them."""
        cells, where, values_of = points.cells, points.where, self._reference.values
        shape = len(cells), where.shape[1]
        known: dict[str, Callable[[], np.ndarray]] = {
            **{name: partial(values_of, function, cells, where) for name, function in self._nodal.items()},
            "distance": lambda: values_of(self.data.distance, cells, where),
            "slope": lambda: self._slope(cells, where),
            "flux": lambda: self._tension(cells, where) * self._slope(cells, where),
            **points.on_facets,
        }
        named = sorted(self.scene.needs(expression) & set(known))  # in the same order on every rank
        return shape, {name: np.broadcast_to(known[name](), shape).ravel() for name in named}

    def pointwise(self, expression: Formula, points: Points, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Values of an expression, flat, from those of its fields."""
        x = (points.where @ self._corners[points.cells]).reshape(-1, 3).T
        return self.scene.at_points(expression, x, {**self.data.now, **self.values, **values})

    def _slope(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray:
        """|grad u|; along the surface, for a surface."""
        return np.linalg.norm(self._reference.gradients(self._nodal["u"], cells, where), axis=2)

    def _tension(self, cells: np.ndarray, where: np.ndarray) -> np.ndarray | float:
        values = self.data.cellwise(self.data.model.elastic.value, positive=True)
        if isinstance(values, fem.Constant):
            return float(values.value)
        return self._reference.values(values, cells, where)

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
        calls = any(isinstance(node, ast.Call) and name_of(node) in FUNCTIONALS for node in ast.walk(formula.tree))
        return not calls and not formula.names & {*self.scene.report, *BODY_QUANTITIES}

    def _check_part(self, formula: Formula, expression: Formula, node: ast.expr, name: str) -> None:
        facets, groups = self.level.facets, self.level.groups
        if name in facets and self.over_cells(expression, name):
            message = (
                f"'{name}' is the name of cells and of facets, such as groups of a mesh file with the same number: "
                f'give one of them another name (in Gmsh: Physical Curve("edge", {name if name.isdigit() else 7}) = '
                "{...};)"
            )
            raise InputError(formula.pointing(node, message))
        if name not in facets and name not in groups:
            message = f"no part of the mesh named '{name}'" + nearest(name, {*facets, *groups})
            raise InputError(formula.pointing(node, message))
        if name not in facets and NORMAL_FLUX in expression.names:
            raise InputError(formula.pointing(node, f"'{name}' is a part of the domain: it has no {NORMAL_FLUX}"))
        if NORMAL_FLUX in self.scene.needs(expression):
            self._check_normal_flux(formula, node, name)

    def _check_integral(self, formula: Formula, call: ast.Call) -> None:
        """Reject parts that the mesh does not have, and integrals over cells of what is on parts of the boundary only
        (collective)."""
        expression = formula.part(Numbers(lambda _: 0.0).visit(deepcopy(call.args[0])))
        parts, model = [node for node in call.args[1:] if isinstance(node, ast.Constant)], self.data.model
        over_cells = not parts or (len(parts) == 1 and self.over_cells(expression, str(parts[0].value)))
        found = [name for name in OF_CONTACT if name in self.scene.needs(expression)]
        if found and over_cells and (model.thin or model.vector_valued):
            message = f'the obstacle is on a part of the boundary: integral({found[0]}, "name of the part")'
            raise InputError(formula.pointing(call, message))
        if len(parts) == 1:
            self._check_part(formula, formula.part(call.args[0]), parts[0], str(parts[0].value))
        elif parts:
            self._check_side(formula, *parts)

    def over_cells(self, expression: Formula, name: str) -> bool:
        """Whether a name means cells in an integral: what facets alone have is integrated over facets of that name."""
        on_facets = bool({NORMAL_FLUX, JUMP} & self.scene.needs(expression)) and name in self.level.facets
        return name in self.level.groups and not on_facets

    def _check_side(self, formula: Formula, curve: ast.Constant, side: ast.Constant) -> None:
        """A curve, and the cells on one side of it."""
        facets, groups = self.level.facets, self.level.groups
        for node, known, what in ((curve, facets, "curve or side"), (side, groups, "material")):
            if node.value not in known:
                message = f"no {what} named '{node.value!s}'" + nearest(str(node.value), known)
                raise InputError(formula.pointing(node, message))
        cells, _, _ = sides(self.level.mesh, facets[str(curve.value)])
        if total(self.level.comm, np.count_nonzero(np.isin(cells, groups[str(side.value)]))) == 0:
            raise InputError(formula.pointing(side, f"'{side.value!s}' is not next to '{curve.value!s}'"))

    def _check_normal_flux(self, formula: Formula, node: ast.expr, name: str) -> None:
        """Reject the normal flux on parts where it is not the reaction force (collective)."""
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
                f'there; from one side it is integral({NORMAL_FLUX}, "{name}", "name of the cells there")'
            )
            raise InputError(formula.pointing(node, message))

    def derivative(self, name: str, per_force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The derivative of a quantity with respect to u and to the nodal forces, at owned dofs, in the state of the
        last `evaluate` (collective).

        Args:
            name: Of a quantity that `check_differentiable` accepts.
            per_force: Derivative of the nodal pressure with respect to the nodal force, 0 where there is no contact.
        """
        self._of_u, self._of_p, self._of_flux = (fem.Function(self.level.V) for _ in range(3))
        self._add(self.scene.report[name], 1.0)
        for function in (self._of_u, self._of_p, self._of_flux):
            releases.add_ghosts(function)
        own = self.level.owned
        of_forces = self._of_p.x.array[:own] * per_force
        if self._normal is not None:
            lengths = self._normal.lengths
            of_forces[lengths > 0] += (self._of_flux.x.array[:own] / np.where(lengths > 0, lengths, 1.0))[lengths > 0]
        return self._of_u.x.array[:own].copy(), of_forces

    def _add(self, formula: Formula, factor: float) -> None:
        """Add the derivative of a formula, times a factor (collective)."""
        calls: list[ast.Call] = []

        def noted(call: ast.Call) -> float:
            calls.append(call)
            return 0.0

        rest = Numbers(noted).visit(deepcopy(formula.tree))
        values = [self.functional(formula, call) for call in calls]
        names = {node.id for node in ast.walk(rest) if isinstance(node, ast.Name)}
        earlier = sorted(names & set(self.scene.report))
        size = max([abs(value) for value in values], default=0.0) or 1.0
        kept = dict(self.values)

        def value(numbers: list[float], changes: Mapping[str, float]) -> float:
            self.values = {**kept, **changes}
            following = iter(numbers)
            found = self._number(formula.part(Numbers(lambda _: next(following)).visit(deepcopy(formula.tree))))
            self.values = dict(kept)
            return found

        for k, (call, middle) in enumerate(zip(calls, values, strict=True)):
            step = STEP * (abs(middle) or size)
            ends = [value([*values[:k], middle + way * step, *values[k + 1 :]], {}) for way in (1, -1)]
            self._add_functional(formula, call, factor * (ends[0] - ends[1]) / (2 * step))
        for name in earlier:
            step = STEP * (abs(kept[name]) or size)
            ends = [value(values, {name: kept[name] + way * step}) for way in (1, -1)]
            self._add(self.scene.report[name], factor * (ends[0] - ends[1]) / (2 * step))

    def _add_functional(self, formula: Formula, call: ast.Call, factor: float) -> None:
        """Add the derivative of an integral or of a value at a point, times a factor (collective)."""
        expression = formula.part(call.args[0])
        if name_of(call) == "at":
            _, cells, weights = self._locate(formula, call, call.args[1:])
            shares = np.full((len(cells), 1), 1.0 / total(self.level.comm, len(cells)))
            self._add_points(expression, Points(cells, weights[:, None], shares), factor)
            return
        for points in self.quadrature(expression, call):
            self._add_points(expression, points, factor)

    def _add_points(self, expression: Formula, points: Points, factor: float) -> None:
        """Add the sum over points of the derivative of an expression, times their sizes and a factor."""
        shape, values = self.fields(expression, points)
        cells, where, sizes = points.cells, points.where, factor * points.sizes
        dofs, phi = releases.cell_dofs(self.level.V)[cells], self._reference.basis(self.level.V, where)
        phi = np.broadcast_to(phi, (*shape, phi.shape[2]))
        for name in set(values) - {"distance"}:
            step = STEP * np.where(values[name] != 0, np.abs(values[name]), 1.0)
            ends = [self.pointwise(expression, points, {**values, name: values[name] + way * step})
                    for way in (1, -1)]  # fmt: skip
            slope = sizes * ((ends[0] - ends[1]) / (2 * step)).reshape(shape)
            if name in ("u", "p", NORMAL_FLUX):
                target = {"u": self._of_u, "p": self._of_p, NORMAL_FLUX: self._of_flux}[name]
                np.add.at(target.x.array, dofs, np.einsum("cp,cpn->cn", slope, phi))
                continue
            if name == "flux":
                slope = slope * self._tension(cells, where)
            gradient = self._reference.gradients(self._nodal["u"], cells, where)
            size = np.linalg.norm(gradient, axis=2, keepdims=True)
            way = np.divide(gradient, size, out=np.zeros_like(gradient), where=size > 0)
            along = np.einsum("cpi,cpid->cpd", way, self._reference.duals(cells, where))
            slopes = self._reference.slopes(self.level.V, where)
            of_nodes = np.einsum("cp,cpd,cpnd->cn", slope, along, np.broadcast_to(slopes, (*shape, *slopes.shape[2:])))
            np.add.at(self._of_u.x.array, dofs, of_nodes)


def check_differentiable(scene: Scene, name: str) -> None:
    """Reject a quantity of [report] that has no derivative with respect to u.

    Raises:
        InputError: Saying why.
    """
    formula = scene.report[name]
    for node in ast.walk(formula.tree):
        if isinstance(node, ast.Name) and node.id in scene.report:
            check_differentiable(scene, node.id)
        if not (isinstance(node, ast.Call) and name_of(node) in FUNCTIONALS):
            continue
        if reason := _why_not(scene, formula, node):
            raise InputError(formula.pointing(node, f"no tolerance for '{name}': {reason}"))


def _why_not(scene: Scene, formula: Formula, call: ast.Call) -> str | None:
    """Why a functional has no derivative; None if it has one."""
    if name_of(call) in ("sup", "inf"):
        return "a maximum or minimum is not differentiable"
    needs = scene.needs(formula.part(call.args[0]))
    if "contact" in needs:
        return "the contact set does not depend on u differentiably"
    if any(isinstance(node, ast.Call) and name_of(node) in FUNCTIONALS for node in ast.walk(call) if node is not call):
        return "it has an integral within an integral"
    if {node.id for node in ast.walk(call) if isinstance(node, ast.Name)} & set(scene.report):
        return "an integrand depends on another quantity"
    if name_of(call) == "at" and needs & {"p", "slope", "flux"}:
        return "of values at a point only those of u have an estimate"
    if JUMP in needs or (NORMAL_FLUX in needs and len(call.args) > 2):
        return "fluxes from one side of a curve have no estimate"
    return None


class Numbers(ast.NodeTransformer):
    """Replaces the functionals of a formula by numbers, innermost first, or the outer ones without a look into them."""

    def __init__(self, number: Callable[[ast.Call], float], *, inner: bool = False):
        self._number, self._inner = number, inner

    def visit_Call(self, node: ast.Call) -> ast.expr:
        is_functional = name_of(node) in FUNCTIONALS
        if self._inner or not is_functional:
            self.generic_visit(node)
        return ast.copy_location(ast.Constant(self._number(node)), node) if is_functional else node


def name_of(call: ast.Call) -> str:
    """The function that a call names."""
    assert isinstance(call.func, ast.Name)
    return call.func.id


def _parts(cells: np.ndarray, points: int = 1) -> list[np.ndarray]:
    """Cells, at most AT_ONCE at a time, of many points fewer; one empty part where there are none."""
    return [cells[block] for block in blocks(len(cells), max(1, AT_ONCE * FEW_POINTS // max(points, FEW_POINTS)))] or [
        cells
    ]


def _nearly(best: float) -> float:
    """From which on values count as this one."""
    return best - EQUAL * abs(best) if np.isfinite(best) else best
