"""Distances: to the exact solution, between two states on one mesh, and the dual norm of the pressure error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.data import Data, Weighted
from fenicsx_obstacle.discrete.fields import Symbols
from fenicsx_obstacle.discrete.model import Model
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Sampler, residual
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.quadrature import DEGREE
from fenicsx_obstacle.parallel import largest, total


class ExactData:
    """Data as UFL expressions on a mesh: for `Effect.terms` without sampling.

    Attributes:
        dx: Integration of high degree.
    """

    def __init__(self, data: Data):
        self.data, self.level = data, data.level
        mesh = self.level.mesh
        self.eps = fem.Constant(mesh, PETSc.ScalarType(0.0))
        now = {name: data.number(value) for name, value in data.now.items()}
        self.symbols = Symbols(mesh, {**now, "eps": self.eps})
        self.dx: Any = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": DEGREE})
        if data.model.radial:
            self.dx = Weighted(self.dx, self.symbols.axes[0])

    def cellwise(self, field: Field, *, positive: bool = False, least: float | None = None) -> Any:
        """The datum itself; of materials each within its own cells (then collective)."""
        if field.parts is not None:
            return sum(self._inside(name) * self.cellwise(part) for name, part in field.parts.items())
        return self.data.here(field).expression(self.symbols)

    def number(self, value: float) -> fem.Constant:
        """The number."""
        return self.data.number(value)

    @property
    def motion(self) -> Any:
        """As in the step: differences in time are not exact."""
        return self.data.motion

    def field(self, components: tuple[Field, ...]) -> Any:
        """The data themselves."""
        return ufl.as_vector([self.cellwise(part) for part in components])

    @property
    def cell_size(self) -> Any:
        """0: exact data need no upwinding."""
        return 0.0

    def values(self, field: Field, *, positive: bool = False) -> np.ndarray:
        """Sampled."""
        return self.data.values(field, positive=positive)

    def at_nodes(self, field: Field) -> np.ndarray:
        """Sampled."""
        return self.data.at_nodes(field)

    def matrix(self, rows: tuple[tuple[Field, ...], ...]) -> Any:
        """The data themselves."""
        return ufl.as_matrix([[self.cellwise(entry) for entry in row] for row in rows])

    def eigenvalues(self, rows: tuple[tuple[Field, ...], ...]) -> np.ndarray:
        """Sampled."""
        return self.data.eigenvalues(rows)

    def at_points(self, forces: tuple[tuple[tuple[float, ...], float], ...], place: str) -> np.ndarray:
        """At the nodes of V_h."""
        return self.data.at_points(forces, place)

    def height(self, field: Field) -> Any:
        """The datum itself."""
        return self.cellwise(field)

    @property
    def dI(self) -> Any:
        """Integration of high degree."""
        return self.dx

    def on_part(self, field: Field, part: int, *, least: float | None = None) -> Any:
        """The datum itself."""
        return self.cellwise(field)

    def over(self, part: int, key: str, *, nodal: bool = False) -> Any:
        """Integration over a part, exactly (collective on first use)."""
        return self.data.parts.over(part, key)

    def _inside(self, name: str) -> fem.Function:
        inside = fem.Function(self.level.W)
        inside.x.array[:] = self.level.indicator(name)
        return inside


def squared_energy_norm(model: Model, e: Any, data: Sampler) -> Any:
    """||mu^(1/2) grad e||^2 as a form, mu the tension where it does not depend on the slope: a(e, e) then."""
    return sum(cast(Any, effect.squared_norm(e, data)) for effect in model.effects if effect.elastic)


@dataclass(frozen=True, eq=False)
class ExactSolution:
    """A solution that is known.

    Attributes:
        u: The solution; may depend on eps.
        pressure: The contact pressure, where it is a function.
    """

    u: Field
    pressure: Field | None = None


class Exact:
    """An exact solution on one problem; forms compile on first use."""

    def __init__(self, problem: Problem, solution: ExactSolution):
        """Compile the norms (collective).

        Args:
            problem: Where errors are measured.
            solution: The exact one.

        Raises:
            InputError: If it is not finite at a node, or cannot be differentiated.
        """
        self.problem, self.solution = problem, solution
        self.data = ExactData(problem.data)
        problem.data.nodal(solution.u, {"eps": 1.0})  # refuses what is not finite at a node
        self.u = fem.Function(problem.level.V)
        ue = self.data.cellwise(solution.u)
        error, dx = ue - self.u, self.data.dx
        energy = squared_energy_norm(problem.model, error, self.data)
        self._l2 = releases.form(error**2 * dx)
        self._gradient = releases.form(ufl.inner(ufl.grad(error), ufl.grad(error)) * dx)
        self._energy = releases.form(energy)
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
        self.data.eps.value = eps or 0.0
        self.u.x.array[:] = u.x.array
        l2, gradient, energy = (
            total(comm, fem.assemble_scalar(form)) for form in (self._l2, self._gradient, self._energy)
        )
        _refuse_nan(l2, self.solution.u, "it is")
        _refuse_nan(gradient, self.solution.u, "its gradient is")
        return {
            "energy": math.sqrt(energy), "h1": math.sqrt(l2 + gradient), "l2": math.sqrt(l2),
            "max": largest(comm, np.abs(self.nodal(eps) - u.x.array)), **self._of_pressure(pressure),
        }  # fmt: skip

    def _of_pressure(self, pressure: fem.Function) -> dict[str, float]:
        """||p - p_h||_0, (5.7), where p is known (collective)."""
        if self.solution.pressure is None:
            return {}
        if self._p is None:
            self._p = fem.Function(pressure.function_space)
            error = self.data.cellwise(self.solution.pressure) - self._p
            self._pressure_l2 = releases.form(error**2 * self.data.dx)
        self._p.x.array[:] = pressure.x.array
        squared = total(self.problem.level.comm, fem.assemble_scalar(self._pressure_l2))
        _refuse_nan(squared, self.solution.pressure, "it is")
        return {"pressure_l2": math.sqrt(squared)}

    def nodal(self, eps: float | None) -> np.ndarray:
        """Exact values at local dofs."""
        return self.problem.data.nodal(self.solution.u, {"eps": eps or 0.0}).x.array

    @cached_property
    def dual(self) -> DualNorm:
        """Dual norm of pressure errors (first use is collective)."""
        return DualNorm(self.problem.data, self.solution.u)


def _refuse_nan(squared: float, field: Field, what: str) -> None:
    if math.isnan(squared):
        raise InputError(f"{field}: {what} not a number somewhere between the nodes")


class DualNorm:
    """||p - p_h||_1* = sup (p - p_h, v) / ||v||_1, by the Riesz map on polynomials one degree higher than V_h.

    The exact pressure needs no formula: (p, v) = a(u, v) - f(v) with the exact u, which holds for measures too.
    """

    def __init__(self, data: Data, u: Field):
        level = data.level
        self.p = fem.Function(level.Q)
        exact, richer = ExactData(data), releases.functionspace(level.mesh, "Lagrange", level.pair.degree + 1)
        v, trial = ufl.TestFunction(richer), ufl.TrialFunction(richer)
        self.eps = exact.eps
        ue = exact.cellwise(u)
        reaction = residual(data.model.effects, ue, v, exact)
        self._error = releases.form(reaction - self.p * v * exact.dx)
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
        self._ksp.getPC().setType(releases.AMG)
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
    """Norms of differences on one problem; forms compile once."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.e, self.d = fem.Function(problem.level.V), fem.Function(problem.level.Q)
        energy = squared_energy_norm(problem.model, self.e, problem.data)
        self._energy = releases.form(energy)
        self._l2 = releases.form(self.e**2 * problem.data.dx)
        self._pressure = releases.form(self.d**2 * problem.data.dx)

    def energy(self, values: np.ndarray) -> float:
        """||mu^(1/2) grad e|| of nodal values, ghosts included (collective)."""
        return self._norm(self._energy, self.e, values)

    def l2(self, values: np.ndarray) -> float:
        """||e||_0 of nodal values, ghosts included (collective)."""
        return self._norm(self._l2, self.e, values)

    def pressure(self, values: np.ndarray) -> float:
        """||d||_0 of values at the dofs of Q_h, ghosts included (collective)."""
        return self._norm(self._pressure, self.d, values)

    def _norm(self, form: Any, function: fem.Function, values: np.ndarray) -> float:
        function.x.array[:] = values
        return math.sqrt(max(total(self.problem.level.comm, fem.assemble_scalar(form)), 0.0))
