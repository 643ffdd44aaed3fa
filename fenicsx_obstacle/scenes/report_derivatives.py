"""Derivatives of output quantities of [report] with respect to the solution, for goal-oriented error estimates.

A quantity Q depends on u and on the nodal forces F_i = a(u, phi_i) - f(phi_i): contact forces, which are pressure times
weight, and reactions where u is given. Integrands and what is computed from integrals are differentiated by central
differences, so that any formula will do whose derivative exists.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from copy import deepcopy

import numpy as np
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.definitions import JUMP, NORMAL_FLUX
from fenicsx_obstacle.scenes.formulas import FUNCTIONALS, Formula
from fenicsx_obstacle.scenes.functionals import Numbers, Points, Report, name_of
from fenicsx_obstacle.scenes.scene import Scene

STEP = 1e-5  # relative, of central differences


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


class DifferentiableReport(Report):
    """A [report] whose quantities have derivatives at the state of the last `evaluate`."""

    def derivative(self, name: str, per_force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The derivative of a quantity with respect to u and to the nodal forces, at owned dofs (collective).

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
