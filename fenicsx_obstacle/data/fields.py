"""Data from numbers, Constants, Functions, UFL expressions, callables, and these by the names of cells."""

from __future__ import annotations

import inspect
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import (
    ComplexValue,
    Derivative,
    GeometricFacetQuantity,
    GeometricQuantity,
    Imag,
    Restricted,
    SpatialCoordinate,
)
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle import polynomials, releases
from fenicsx_obstacle.data.measured.surface import Table
from fenicsx_obstacle.effects.field import Bounds, ByCells, Enclosed, Field, Names
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import ROUND_OFF, nearby, values_of
from fenicsx_obstacle.mesh.shared_dofs import share
from fenicsx_obstacle.mesh.validation import place
from fenicsx_obstacle.parallel import agree, first_given, largest, total
from fenicsx_obstacle.text import one_line, plain, shown

EXPECTED = "a number, a Constant, a Function, a UFL expression, a callable of x as Function.interpolate takes it, a \
Table, or a dict of these by the names of cells"


HUGE = 1e20  # round-off of an interpolation times it is no round-off
LARGEST = 1e300  # a sum over the cells around a point is finite
SAME = 1e-8  # of the largest value: what values of cells at a common node may differ by


Cellwise: TypeAlias = fem.Function | fem.Constant  # a datum in cells, as forms take it


def array_of(function: Cellwise) -> np.ndarray:
    """Values at local dofs, or the one there is."""
    return np.atleast_1d(function.value) if isinstance(function, fem.Constant) else function.x.array


class Symbols:
    """The building blocks of UFL expressions of data on one mesh.

    Attributes:
        mesh: The mesh.
        axes: x, y and z.
        names: Constants for t and eps.
        made: Expressions made so far, for fields that share some.
    """

    def __init__(self, mesh: Any, names: Mapping[str, fem.Constant]):
        self.mesh, self.names = mesh, names
        x = ufl.SpatialCoordinate(mesh)
        self.zero = x[0] - x[0]  # gives expressions without coordinates a domain, which grad needs
        self.axes = [x[i] if i < mesh.geometry.dim else self.zero for i in range(3)]
        self.radius = ufl.sqrt(ufl.inner(x, x))
        self.made: dict[Any, Any] = {}


@dataclass(frozen=True, eq=False)
class Evaluated(Enclosed):
    """A datum by its values at points of simplices, on each of which it is a polynomial of one degree.

    Attributes:
        here: The datum on the mesh.
        degree: Of the polynomials.
        names: As for `Field.at`.
        cells: The local cell that each simplex lies in.
    """

    here: Field
    degree: int
    corners: np.ndarray
    names: Names
    cells: np.ndarray

    def once(self) -> Bounds:
        every = np.arange(len(self.cells))
        low, high = polynomials.bounds(self.values(self.degree, every), self.corners.shape[1], self.degree)
        defined = np.isfinite(low) & np.isfinite(high)
        return Bounds(low, high, np.full(len(every), self.degree), np.ones(len(every), dtype=bool), defined)

    def values(self, degree: int, cells: np.ndarray) -> np.ndarray:
        points = polynomials.inner_points(self.corners.shape[1], degree)
        x, dim = np.zeros((3, len(cells) * len(points))), self.corners.shape[2]
        x[:dim] = (points @ self.corners[cells]).reshape(-1, dim).T
        return self.here.at(x, self.names, np.repeat(self.cells[cells], len(points))).reshape(len(cells), len(points))


class Number(Field):
    """A number, or the value that a Constant has when it is asked for."""

    uniform = True
    continuous = True

    def __init__(self, value: float | fem.Constant, source: str):
        self.value, self.source = value, source

    @property
    def text(self) -> str:  # type: ignore[override]
        return plain(self._number)

    @property
    def _number(self) -> float:
        return float(self.value.value if isinstance(self.value, fem.Constant) else self.value)

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return np.full(x.shape[1:], self._number)

    def on(self, level: Level) -> Field:
        return Number(self._number, self.source)  # a Constant may have another value later

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed:
        return Evaluated(self, 0, corners, names, cells)

    def expression(self, symbols: Symbols) -> Any:
        return self.value + symbols.zero


class OfCallable(Field):
    """A Python function of x, shape (3, n), or of x and t, that returns n values.

    Where it raises it has no value, so that all ranks go on; `interpolate` tells why.
    """

    everywhere = False  # it may be a table that ends with the domain

    def __init__(self, function: Callable[..., Any], source: str):
        self.function, self.source = function, source
        self.text = getattr(function, "__name__", type(function).__name__)
        self.moves = _arguments(function) == 2

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        try:
            return self._values(x, names)
        except InputError:
            return np.full(x.shape[1:], np.nan)

    def _values(self, x: np.ndarray, names: Names) -> np.ndarray:
        if x.shape[1] == 0:
            return np.empty(0)
        given = (x.copy(), names.get("t", 0.0)) if self.moves else (x.copy(),)
        try:
            values = np.asanyarray(self.function(*given))
            if np.iscomplexobj(values):
                raise TypeError("complex values, where real ones are expected")
            values = np.ma.filled(values.astype(np.float64), np.nan)  # a masked value is none
            return np.array(np.broadcast_to(values, x.shape[1:]))
        except Exception as error:
            got = f"{type(error).__name__}: {error}"
            wanted = "takes x of shape (3, n), as Function.interpolate does, and returns n values"
            raise InputError(f"{self.source}: the callable {wanted}; the call failed: {got}") from error

    def interpolate(self, V: fem.FunctionSpace, x: np.ndarray, names: Names) -> np.ndarray:
        with agree(V.mesh.comm):
            values = self._values(x, names)
        return values


class OfFunction(Field):
    """A Function of this mesh or of another one; at points, within the cells of this rank."""

    everywhere = False

    def __init__(self, function: fem.Function, source: str, *, interpolated: bool = False):
        """Take it.

        Args:
            function: It.
            source: What messages call it.
            interpolated: Whether it stands for a datum that it does not equal everywhere.
        """
        self.function, self.source, self.text = function, source, function.name
        self._interpolated = interpolated
        if function.ufl_shape != ():
            count = int(np.prod(function.ufl_shape))
            raise InputError(f"{source} is a Function with {count} components: expected a scalar Function")

    @property
    def _mesh(self) -> Any:
        return self.function.function_space.mesh

    def on(self, level: Level) -> Field:
        if self._mesh.ufl_domain() == level.mesh.ufl_domain():
            return self
        own = self.function.function_space
        V = level.V if _continuous(own) else level.W
        taken = fem.Function(V, name=self.function.name)
        taken.x.array[:] = self._elsewhere(level, level.points_of(V))
        # a polynomial in each cell of a mesh is one in each cell of its refinements
        nested = level.shape is None and any(one.mesh.ufl_domain() == self._mesh.ufl_domain() for one in level.downward)
        # in W, whose points are moved into the cells, constants alone stay what they are
        most = releases.polynomial_degree(V) if V is level.V else 0
        degree = releases.polynomial_degree(own)
        same = nested and degree is not None and most is not None and degree <= most
        return OfFunction(taken, self.source, interpolated=self._interpolated or not same)

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        if cells is not None:
            return np.ravel(self.function.eval(x.T, cells)) if len(cells) else np.empty(0)
        extent = float(np.ptp(self._mesh.geometry.x, axis=0).max(initial=0.0))
        rows, cells, _, gap, size = nearby(self._mesh, x.T, ROUND_OFF * extent)
        nearest = np.lexsort((gap, rows))
        nearest = nearest[(gap <= ROUND_OFF * size)[nearest]]
        rows, cells = rows[nearest], cells[nearest]
        found = np.full(x.shape[1], np.nan)
        first = np.unique(rows, return_index=True)[1]
        if len(first):
            found[rows[first]] = np.ravel(self.function.eval(x.T[rows[first]], cells[first]))
        return found

    def interpolate(self, V: fem.FunctionSpace, x: np.ndarray, names: Names) -> np.ndarray:
        own = self.function.function_space
        if own == V:
            return self.function.x.array
        if _continuous(V) and not _continuous(own):
            raise InputError(
                f"{self.source} is a Function that is not continuous: it has several values at a vertex; "
                "interpolate it into a continuous space"
            )
        taken = fem.Function(V)

        def evaluate(function: fem.Function) -> np.ndarray:
            taken.interpolate(releases.expression(function, V))
            return taken.x.array.copy()

        return self._without_leaks(evaluate)

    @property
    def continuous(self) -> bool:  # type: ignore[override]
        return _continuous(self.function.function_space)

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed | None:
        degree = releases.polynomial_degree(self.function.function_space)
        if self._interpolated or degree is None or degree > polynomials.MAX_DEGREE:
            return None
        return Evaluated(self, degree, corners, names, cells)

    def expression(self, symbols: Symbols) -> Any:
        return self.function + symbols.zero

    def _without_leaks(self, evaluate: Callable[[fem.Function], np.ndarray]) -> np.ndarray:
        """Values of the function at points, where a huge nodal value counts only if its basis function there is more
        than round-off: an obstacle is huge or infinite where there is none (collective).

        Args:
            evaluate: Values at the points of a Function of the same space.
        """
        given, own = self.function.x.array, self.function.function_space
        huge = np.abs(given) >= HUGE
        if total(self._mesh.comm, np.count_nonzero(huge)) == 0:
            return evaluate(self.function)
        part, found = fem.Function(own), []
        for values in (huge, np.where(huge, 0.0, given), np.clip(given, -LARGEST, LARGEST)):
            part.x.array[:] = values
            found.append(evaluate(part))
        weight, others, everything = found
        everything = np.where(np.abs(everything) >= SAME * LARGEST, np.copysign(np.inf, everything), everything)
        return np.where(np.abs(weight) > SAME, everything, others)

    def _elsewhere(self, level: Level, points: np.ndarray) -> np.ndarray:
        """Values at points (3, n) of the cells of another mesh (collective)."""
        comm = level.comm
        if MPI.Comm.Compare(self._mesh.comm, comm) not in (MPI.IDENT, MPI.CONGRUENT):
            raise InputError(
                f"{self.source} is a Function on a mesh with another communicator; create that mesh with the "
                "communicator of the mesh of u"
            )
        parts = comm.allgather(points.T)
        everywhere, start = np.vstack(parts), sum(len(part) for part in parts[: comm.rank])
        values = self._without_leaks(lambda function: values_of(function, everywhere))
        lost = np.flatnonzero(np.isnan(values))
        if len(lost):
            where = place(min(everywhere[lost].tolist())[: level.mesh.geometry.dim])
            words = f"with no finite value at {where}: is this point outside of its mesh?"
            raise InputError(f"{self.source} is a Function on another mesh, {words}")
        return values[start : start + len(parts[comm.rank])]


class OfExpression(Field):
    """A UFL expression of Functions, Constants and coordinates on one mesh."""

    everywhere = False

    def __init__(self, expression: Any, source: str):
        self.ufl, self.source, self.text = expression, source, str(expression)
        if expression.ufl_shape != ():
            raise InputError(f"{source} is an expression of shape {expression.ufl_shape}: expected a scalar expression")
        if extract_arguments(expression):
            raise InputError(f"{source} holds a test or trial function: expected {EXPECTED}")
        for node in unique_pre_traversal(expression):
            if isinstance(node, GeometricFacetQuantity | Restricted):
                what = "a restriction to one side of facets" if isinstance(node, Restricted) else type(node).__name__
                raise InputError(f"{source} holds {what}, which has no value at nodes: expected {EXPECTED}")
        self._sampled: OfFunction | None = None

    def on(self, level: Level) -> Field:
        if foreign(self.ufl, level.mesh.ufl_domain()):
            raise InputError(
                f"{self.source} is a UFL expression, which is defined on its own mesh only, not on a refined or "
                "another one; use a formula, a callable or a Function"
            )
        here = OfExpression(self.ufl, self.source)
        sampled = fem.Function(releases.functionspace(level.mesh, "DG", 2))
        sampled.interpolate(here._compiled(sampled.function_space))
        here._sampled = OfFunction(sampled, self.source, interpolated=True)
        return here

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        assert self._sampled is not None  # `on` makes it
        return self._sampled.at(x, names, cells)

    def interpolate(self, V: fem.FunctionSpace, x: np.ndarray, names: Names) -> np.ndarray:
        spaces = [one.function_space for one in extract_coefficients(self.ufl) if isinstance(one, fem.Function)]
        if _continuous(V) and not all(_continuous(one) for one in spaces):
            raise InputError(
                f"{self.source} contains a Function that is not continuous: it has several values at a vertex; "
                "interpolate it into a continuous space"
            )
        taken = fem.Function(V)
        taken.interpolate(self._compiled(V))
        if _continuous(V) and _varies_by_cell(self.ufl):
            self._check_continuous(taken)
        return taken.x.array

    def _check_continuous(self, taken: fem.Function) -> None:
        """Reject an expression whose values at a node differ from cell to cell (collective).

        Args:
            taken: Its interpolant, which has the value of one of these cells.

        Raises:
            InputError: Naming a node, and two of the values there.
        """
        V = taken.function_space
        degree = 2 if V.dofmap.dof_layout.entity_dofs(1, 0) else 1
        by_cell = fem.Function(releases.functionspace(V.mesh, "DG", degree))
        by_cell.interpolate(self._compiled(by_cell.function_space))
        share(taken)
        nodes = releases.cell_dofs(V)
        values, others = taken.x.array[nodes], by_cell.x.array[releases.cell_dofs(by_cell.function_space)]
        comm = V.mesh.comm
        size = largest(comm, np.abs(np.where(np.isfinite(values), values, 0.0)))
        bad = np.argwhere(np.abs(values - others) > SAME * size)[:1]
        points = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
        found = [(points[nodes[i, j]].tolist(), values[i, j], others[i, j]) for i, j in bad]
        places = [one for part in comm.allgather(found) for one in part]
        if places:
            point, value, other = min(places)
            raise InputError(
                f"{self.source} is a UFL expression that is not continuous: at {place(point)} it is {value:.4g} and "
                f"{other:.4g} in two cells; project it onto a continuous space"
            )

    def expression(self, symbols: Symbols) -> Any:
        return self.ufl + symbols.zero

    def _compiled(self, V: fem.FunctionSpace) -> fem.Expression:
        """The expression, compiled for the nodes of a space (collective).

        Raises:
            InputError: If FFCx cannot compile it.
        """
        try:
            return releases.expression(self._on(V.mesh), V)
        except Exception as error:  # DOLFINx raises on all ranks what the compiler raises on one
            why = first_given(V.mesh.comm, one_line(f"{type(error).__name__}: {error}"))
            raise InputError(
                f"{self.source}: FFCx cannot compile this UFL expression; use a callable or a Function; {why}"
            ) from error

    def _on(self, mesh: Any) -> Any:
        """The expression with a domain, which one of numbers alone has not."""
        if ufl.domain.extract_domains(self.ufl):
            return self.ufl
        x = ufl.SpatialCoordinate(mesh)
        return self.ufl + (x[0] - x[0])


def field(value: Any, source: str) -> Field:
    """A Field from a number, Constant, Function, UFL expression, callable or Table.

    Args:
        value: A number, a Constant, a Function, a UFL expression, a callable of x or of (x, t), a Table, a Field, or a
            dict of these by the names of cells.
        source: What messages call it.

    Raises:
        InputError: If it is anything else.
    """
    if isinstance(value, Field):
        return value
    if isinstance(value, Table):
        return value.on(source)
    if isinstance(value, ufl.core.expr.Expr):
        check_real(value, source)
    if isinstance(value, fem.Function):
        return OfFunction(value, source)
    if isinstance(value, fem.Constant) and value.ufl_shape == ():
        return Number(value, source)
    if isinstance(value, ufl.core.expr.Expr):
        return OfExpression(value, source)
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        return Number(float(value), source)
    if isinstance(value, Mapping) and value:
        return ByCells({name: field(part, f"{source}.{name}") for name, part in value.items()}, source)
    if callable(value) and not isinstance(value, type):
        return OfCallable(value, source)
    hint = "; a formula as text is for Scene and scene files" if isinstance(value, str) else ""
    raise InputError(f"{source} = {shown(value)}: expected {EXPECTED}{hint}")


def is_complex(expression: Any) -> bool:
    """Whether a UFL expression holds a complex number, Constant or Function, or an imaginary part."""
    for node in unique_pre_traversal(expression):
        if isinstance(node, ComplexValue | Imag):
            return True
        if isinstance(node, fem.Function | fem.Constant) and np.iscomplexobj(array_of(node)):
            return True
    return False


def check_real(expression: Any, place: str) -> None:
    """Reject a UFL expression with complex data.

    Args:
        expression: What was given.
        place: What messages call it.

    Raises:
        InputError: With the remedy.
    """
    if is_complex(expression):
        raise InputError(f"{place} is complex: expected real values; take the real part of its data")


def foreign(expression: Any, domain: Any) -> bool:
    """Whether any part of an expression lives on another mesh."""
    leaves = (node for node in unique_pre_traversal(expression) if not node.ufl_operands)
    return any(one != domain for leaf in leaves for one in ufl.domain.extract_domains(leaf))


def _continuous(V: fem.FunctionSpace) -> bool:
    return bool(V.dofmap.dof_layout.entity_dofs(0, 0))


def _varies_by_cell(expression: Any) -> bool:
    """Whether an expression has derivatives of Functions, or geometric quantities of cells, so that its values at a
    node may differ from cell to cell."""
    plain = apply_derivatives(apply_algebra_lowering(expression))
    kinds = (
        isinstance(node, Derivative)
        or (isinstance(node, GeometricQuantity) and not isinstance(node, SpatialCoordinate))
        for node in unique_pre_traversal(plain)
    )
    return any(kinds)


def _arguments(function: Callable[..., Any]) -> int:
    """Number of positional arguments that a callable needs; 1 if that is unknown."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 1
    plain_ones = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(one.kind in plain_ones and one.default is inspect.Parameter.empty for one in parameters)
