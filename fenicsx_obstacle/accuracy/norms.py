"""Distances: to the exact solution, between two states on one mesh, and the dual norm of the pressure error."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, cast

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.accuracy.quadrature import DEGREE
from fenicsx_obstacle.discrete.data import Data, Weighted
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Sampler, residual
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.scenes.formulas import Formula, ufl_alphabet
from fenicsx_obstacle.scenes.materials import Materials, Value
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.vocabulary import CONSTANTS, COORDINATES


class Formulas:
    """The scene's formulas as UFL expressions on a mesh: data for `Effect.terms` without sampling.

    Attributes:
        dx: Integration of high degree.
    """

    def __init__(self, data: Data):
        self.data, self.level, self.scene = data, data.level, data.scene
        mesh = self.level.mesh
        self.dx: Any = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": DEGREE})
        x = ufl.SpatialCoordinate(mesh)
        if data.radial:
            self.dx = Weighted(self.dx, x[0])
        self._zero = x[0] - x[0]  # gives expressions without coordinates a domain, which grad needs
        axes = [x[i] if i < mesh.geometry.dim else self._zero for i in range(3)]
        self.eps = fem.Constant(mesh, PETSc.ScalarType(0.0))
        self.alphabet = ufl_alphabet()
        values = (*axes, ufl.sqrt(ufl.inner(x, x)), releases.atan2(axes[1], axes[0]))
        now = {name: data.number(value) for name, value in data.now.items()}
        self.names: dict[str, Any] = {
            **CONSTANTS,
            **now,
            "eps": self.eps,
            **dict(zip(COORDINATES, values, strict=True)),
        }

    def cellwise(self, value: Value, *, positive: bool = False, least: float | None = None) -> Any:
        """The formula itself; of materials each within its own cells (then collective)."""
        if isinstance(value, Materials):
            return sum(self._inside(name) * self.cellwise(formula) for name, formula in value.parts.items())
        needed = self.scene.needs(value)  # others may hold what UFL cannot differentiate
        try:
            for key in (key for key in self.scene.define if key in needed - set(self.names)):
                self.names[key] = self.scene.define[key].evaluate(self.names, self.alphabet)
            expression = value.evaluate(self.names, self.alphabet) + self._zero
            if not releases.finite(expression):
                raise ValueError("it holds an infinite number, or not a number")
            return expression
        except releases.UFL_ERRORS as error:
            raise InputError(f"{value.place} = {value.text}: cannot be differentiated: {error}") from None

    def number(self, value: float) -> fem.Constant:
        """The number."""
        return self.data.number(value)

    @property
    def motion(self) -> Any:
        """As in the step: differences in time are not exact."""
        return self.data.motion

    def field(self, components: tuple[Formula, ...]) -> Any:
        """The formulas themselves."""
        return ufl.as_vector([self.cellwise(part) for part in components])

    @property
    def cell_size(self) -> Any:
        """0: exact data need no upwinding."""
        return 0.0

    def values(self, value: Value) -> np.ndarray:
        """Sampled."""
        return self.data.values(value)

    def matrix(self, rows: tuple[tuple[Formula, ...], ...]) -> Any:
        """The formulas themselves."""
        return ufl.as_matrix([[self.cellwise(entry) for entry in row] for row in rows])

    def eigenvalues(self, rows: tuple[tuple[Formula, ...], ...]) -> np.ndarray:
        """Sampled."""
        return self.data.eigenvalues(rows)

    def at_points(self, forces: tuple[tuple[tuple[float, ...], float], ...], place: str) -> np.ndarray:
        """At the nodes of V_h."""
        return self.data.at_points(forces, place)

    def height(self, value: Formula) -> Any:
        """The formula itself."""
        return self.cellwise(value)

    @property
    def dI(self) -> Any:
        """Integration of high degree."""
        return self.dx

    def on_part(self, value: Formula, part: int, *, least: float | None = None) -> Any:
        """The formula itself."""
        return self.cellwise(value)

    def over(self, part: int, key: str, *, nodal: bool = False) -> Any:
        """Integration over a part, exactly (collective on first use)."""
        return self.data.parts.over(part, key)

    def _inside(self, name: str) -> fem.Function:
        inside = fem.Function(self.level.W)
        inside.x.array[:] = self.level.indicator(name)
        return inside


def squared_energy_norm(scene: Scene, e: Any, data: Sampler) -> Any:
    """||mu^(1/2) grad e||^2 as a form, mu the tension where it does not depend on the slope: a(e, e) then."""
    return sum(cast(Any, effect.squared_norm(e, data)) for effect in scene.effects if effect.elastic)


class Exact:
    """The scene's exact solution on one problem; forms compile on first use."""

    def __init__(self, problem: Problem, scene: Scene | None = None):
        """Compile the norms (collective).

        Args:
            problem: Where errors are measured.
            scene: Knows the solution; by default the problem's own.

        Raises:
            InputError: If it does not know one, or it is not finite at a node.
        """
        scene = problem.scene if scene is None else scene
        self.problem = problem
        exact = scene.tables.exact
        if exact is None:
            raise InputError(f"{scene.source}: has no [exact] solution")
        self.formula = scene.formula(exact.u, "[exact] u")
        self.formulas = Formulas(problem.data)
        problem.data.nodal(self.formula, {"eps": 1.0})  # refuses what is not finite at a node
        self.u = fem.Function(problem.level.V)
        ue = self.formulas.cellwise(self.formula)
        error, dx = ue - self.u, self.formulas.dx
        energy = squared_energy_norm(scene, error, self.formulas)
        self._l2 = releases.form(error**2 * dx)
        self._gradient = releases.form(ufl.inner(ufl.grad(error), ufl.grad(error)) * dx)
        self._energy = releases.form(energy)
        self._pressure = None if exact.pressure is None else scene.formula(exact.pressure, "[exact] pressure")
        self._p: fem.Function | None = None

    def errors(self, u: fem.Function, pressure: fem.Function, eps: float | None) -> dict[str, float]:
        """Energy, H1, L2 and nodal maximum error of u, and the L2 error of p where p is known (collective).

        Args:
            u: Solution, in V.
            pressure: Contact pressure, in the same space at every call; 0 where u is given, whatever the exact one is.
            eps: Of the penalty, None without.

        Raises:
            InputError: If the exact solution, its gradient or pressure is not a number somewhere.
        """
        comm = self.problem.level.comm
        self.formulas.eps.value = eps or 0.0
        self.u.x.array[:] = u.x.array
        l2, gradient, energy = (
            total(comm, fem.assemble_scalar(form)) for form in (self._l2, self._gradient, self._energy)
        )
        _refuse_nan(l2, self.formula, "it is")
        _refuse_nan(gradient, self.formula, "its gradient is")
        return {
            "energy": math.sqrt(energy), "h1": math.sqrt(l2 + gradient), "l2": math.sqrt(l2),
            "max": largest(comm, np.abs(self.nodal(eps) - u.x.array)), **self._of_pressure(pressure),
        }  # fmt: skip

    def _of_pressure(self, pressure: fem.Function) -> dict[str, float]:
        """||p - p_h||_0, (5.7), where p is known (collective)."""
        if self._pressure is None:
            return {}
        if self._p is None:
            self._p = fem.Function(pressure.function_space)
            error = self.formulas.cellwise(self._pressure) - self._p
            self._pressure_l2 = releases.form(error**2 * self.formulas.dx)
        self._p.x.array[:] = pressure.x.array
        squared = total(self.problem.level.comm, fem.assemble_scalar(self._pressure_l2))
        _refuse_nan(squared, self._pressure, "it is")
        return {"pressure_l2": math.sqrt(squared)}

    def nodal(self, eps: float | None) -> np.ndarray:
        """Exact values at local dofs."""
        return self.problem.scene.at_points(
            self.formula, self.problem.level.points, {**self.problem.data.now, "eps": eps or 0.0}
        )

    @cached_property
    def dual(self) -> DualNorm:
        """Dual norm of pressure errors (first use is collective)."""
        return DualNorm(self.problem.data, self.formula)


def _refuse_nan(squared: float, formula: Formula, what: str) -> None:
    if math.isnan(squared):
        raise InputError(f"{formula.place} = {formula.text}: {what} not a number somewhere between the nodes")


class DualNorm:
    """||p - p_h||_1* = sup (p - p_h, v) / ||v||_1, by the Riesz map on polynomials one degree higher than V_h.

    The exact pressure needs no formula: (p, v) = a(u, v) - f(v) with the exact u, which holds for measures too.
    """

    def __init__(self, data: Data, formula: Formula):
        level, scene = data.level, data.scene
        self.p = fem.Function(level.Q)
        formulas, richer = Formulas(data), releases.functionspace(level.mesh, "Lagrange", level.pair.degree + 1)
        v, trial = ufl.TestFunction(richer), ufl.TrialFunction(richer)
        self.eps = formulas.eps
        ue = formulas.cellwise(formula)
        reaction = residual(scene.effects, ue, v, formulas)
        self._error = releases.form(reaction - self.p * v * formulas.dx)
        facets = np.unique(np.concatenate([np.empty(0, np.int32), *data.held])).astype(np.int32)
        dofs = fem.locate_dofs_topological(richer, level.mesh.topology.dim - 1, facets)
        self._zero = fem.Function(richer)
        bc = fem.dirichletbc(self._zero, dofs)
        self.fixed = dofs[dofs < richer.dofmap.index_map.size_local]
        riesz = releases.form(ufl.inner(ufl.grad(trial), ufl.grad(v)) * ufl.dx + trial * v * ufl.dx)
        self._H = fem.petsc.create_matrix(riesz)
        fem.petsc.assemble_matrix(self._H, riesz, [bc])
        self._H.assemble()
        self._b = releases.create_vector(self._error, richer)
        self._ksp = PETSc.KSP().create(level.comm)
        self._ksp.setOperators(self._H)
        self._ksp.setType("cg")
        self._ksp.getPC().setType("hypre")
        self._ksp.setTolerances(rtol=1e-9, atol=0.0)

    def error(self, pressure: fem.Function, eps: float | None) -> float:
        """||p - p_h||_1* of a pressure in Q_h (collective)."""
        self.eps.value = eps or 0.0
        self.p.x.array[:] = pressure.x.array
        with self._b.localForm() as local:
            local.set(0.0)
        fem.petsc.assemble_vector(self._b, self._error)
        self._b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        self._b.array[self.fixed] = 0.0
        z = self._b.duplicate()
        self._ksp.solve(self._b, z)
        squared = z.dot(self._b)
        z.destroy()
        return math.sqrt(max(squared, 0.0))


class Distance:
    """Norms of differences on one problem; forms shared by all scenes."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.e, self.d = fem.Function(problem.level.V), fem.Function(problem.level.Q)
        energy = squared_energy_norm(problem.scene, self.e, problem.data)
        self._energy = releases.form(energy)
        self._l2 = releases.form(self.e**2 * problem.data.dx)
        self._pressure = releases.form(self.d**2 * problem.data.dx)

    def energy(self, values: np.ndarray) -> float:
        """||mu^(1/2) grad e|| of nodal values, ghosts included (collective)."""
        return self._norm(self._energy, self.e, values)

    def l2(self, values: np.ndarray) -> float:
        """||e||_0 likewise (collective)."""
        return self._norm(self._l2, self.e, values)

    def pressure(self, values: np.ndarray) -> float:
        """||d||_0 of values at the dofs of Q_h, ghosts included (collective)."""
        return self._norm(self._pressure, self.d, values)

    def _norm(self, form: Any, function: fem.Function, values: np.ndarray) -> float:
        function.x.array[:] = values
        return math.sqrt(max(total(self.problem.level.comm, fem.assemble_scalar(form)), 0.0))
