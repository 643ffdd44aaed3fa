"""Error norms: to the exact solution, between two functions on one mesh, and the dual norm of the pressure error."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.releases import AMG
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import Symbols
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.effects.effect import Sampler, residual
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.quadrature import DEGREE
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import largest, total


class ExactData:
    """Data as UFL expressions on a mesh, for `Effect.terms` without sampling.

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
            from fenicsx_obstacle.data.measures import Weighted  # only with axial symmetry

            self.dx = Weighted(self.dx, None, self.symbols.axes[0])

    def cellwise(self, field: Field, *, positive: bool = False, least: float | None = None) -> Any:
        """The datum itself; of materials each within its own cells (then collective)."""
        if field.parts is not None:
            return sum(self._inside(name) * self.cellwise(part) for name, part in field.parts.items())
        return self.data.here(field).expression(self.symbols)

    def number(self, value: float | np.ndarray) -> fem.Constant:
        """The number."""
        return self.data.number(value)

    @property
    def axial(self) -> bool:
        """As sampled."""
        return self.data.axial

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

    def matrix(self, rows: tuple[tuple[Field, ...], ...]) -> Any:
        """The data themselves."""
        return ufl.as_matrix([[self.cellwise(entry) for entry in row] for row in rows])

    def eigenvalues(self, rows: tuple[tuple[Field, ...], ...]) -> np.ndarray:
        """Sampled."""
        return self.data.eigenvalues(rows)

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
    elastic = model.elastic
    if elastic.affine:
        return elastic.terms(e, e, data)
    return data.cellwise(elastic.value, positive=True) * ufl.inner(ufl.grad(e), ufl.grad(e)) * data.dx


@dataclass(frozen=True, eq=False)
class ExactSolution:
    """A known exact solution.

    Attributes:
        u: The solution; may depend on eps.
        pressure: The contact pressure, where it is a function.
    """

    u: Field
    pressure: Field | None = None


class Integrals:
    """Several integrals over the cells of a mesh in one pass, with common subexpressions evaluated once."""

    def __init__(self, level: Level, integrals: Mapping[str, Any]):
        """Compile (collective).

        Args:
            level: The mesh.
            integrals: Forms without arguments, by name.
        """
        self.level, self.names = level, list(integrals)
        # each is tested with its own component of a constant on each cell
        self._space = releases.functionspace(level.mesh, "DG", 0, len(integrals))
        v = ufl.TestFunction(self._space)
        parts = [part.reconstruct(integrand=part.integrand() * v[k])
                 for k, form in enumerate(integrals.values()) for part in form.integrals()]  # fmt: skip
        self._form = releases.form(ufl.Form(parts), reordered=True)

    def values(self) -> dict[str, float]:
        """The integrals by name (collective)."""
        cells = self._space.dofmap.index_map
        found = np.zeros((cells.size_local + cells.num_ghosts, len(self.names)))
        fem.assemble_vector(found.reshape(-1), self._form)
        return {name: total(self.level.comm, column) for name, column in zip(self.names, found.T, strict=True)}


class Exact:
    """An exact solution on one problem."""

    def __init__(self, problem: Problem, solution: ExactSolution):
        """Compile the norms (collective).

        Args:
            problem: Where errors are measured.
            solution: The exact one.

        Raises:
            InputError: If it cannot be differentiated.
        """
        self.problem, self.solution = problem, solution
        self.data = ExactData(problem.data)
        self.u, self.p = fem.Function(problem.level.V), fem.Function(problem.level.Q)
        error, dx = self.data.cellwise(solution.u) - self.u, self.data.dx
        squares = {
            "l2": error**2 * dx,
            "gradient": ufl.inner(ufl.grad(error), ufl.grad(error)) * dx,
            "energy": squared_energy_norm(problem.model, error, self.data),
        }
        self._pressure = None if problem.data.thin else solution.pressure  # on parts it is a force per length
        if self._pressure is not None:
            squares["pressure"] = (self.data.cellwise(self._pressure) - self.p) ** 2 * dx
        self._squares = Integrals(problem.level, squares)

    def errors(
        self, u: fem.Function, pressure: fem.Function, eps: float | None
    ) -> tuple[dict[str, float], fem.Function]:
        """Errors of a solution in several norms (collective).

        Args:
            u: Solution, in V.
            pressure: Contact pressure, in Q; 0 where u is given, whatever the exact one is.
            eps: Of the penalty, None without.

        Returns:
            Energy, H1, L2 and nodal maximum error of u, and the L2 error of p, (5.7), where p is known; and the
            difference of u and the nodal interpolant of the exact solution.

        Raises:
            InputError: If the exact solution, its gradient or pressure is not a number somewhere.
        """
        difference = self.problem.data.nodal(self.solution.u, {"eps": eps or 0.0})  # rejects values that are not finite
        np.subtract(u.x.array, difference.x.array, out=difference.x.array)
        self.data.eps.value = eps or 0.0
        self.u.x.array[:], self.p.x.array[:] = u.x.array, pressure.x.array
        squares = self._squares.values()
        _refuse_nan(squares["l2"], self.solution.u, "it is")
        _refuse_nan(squares["gradient"], self.solution.u, "its gradient is")
        errors = {
            "energy": math.sqrt(squares["energy"]), "h1": math.sqrt(squares["l2"] + squares["gradient"]),
            "l2": math.sqrt(squares["l2"]), "max": largest(self.problem.level.comm, np.abs(difference.x.array)),
        }  # fmt: skip
        if self._pressure is not None:
            _refuse_nan(squares["pressure"], self._pressure, "it is")
            errors["pressure_l2"] = math.sqrt(squares["pressure"])
        return errors, difference

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
        self._b = releases.create_vector(richer)
        self._ksp = PETSc.KSP().create(level.comm)
        self._ksp.setOperators(self._H)
        self._ksp.setType("cg")
        self._ksp.getPC().setType(AMG)
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

    def of_u(self, values: np.ndarray) -> dict[str, float]:
        """The energy norm, ||e||_0 and the maximum of nodal values, ghosts included (collective)."""
        largest_value = largest(self.problem.level.comm, np.abs(values))
        return {"energy": self.energy(values), "l2": self.l2(values), "max": largest_value}

    def _norm(self, form: Any, function: fem.Function, values: np.ndarray) -> float:
        function.x.array[:] = values
        return math.sqrt(max(total(self.problem.level.comm, fem.assemble_scalar(form)), 0.0))
