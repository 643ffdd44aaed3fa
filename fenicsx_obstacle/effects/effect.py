"""The protocol of effects, and their register.

An effect is one class: its data, and its part of the residual. Residual, energy and the choice of the solver are folds
over the effects of a model; what no scene names is not even imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import ufl

from fenicsx_obstacle.effects.field import Field, fields_in
from fenicsx_obstacle.errors import InputError

_FOLDERS = {"effects": "domain", "boundary": "boundary"}  # of this package, by the tables that name their effects


# with the `value` of the effect: tension int mu grad u . grad v, its matrix int (A grad u) . grad v, load -int f v,
# reaction int k u v with k >= 0, drift int (b . grad u) v; load and reaction of a part of the boundary are integrals
# over it; point forces -sum F v(x)
Role = Literal["", "tension", "matrix tension", "load", "reaction", "drift", "part load", "part reaction",
               "point forces"]  # fmt: skip


class Reader(Protocol):
    """Converts entries of a scene into data."""

    @property
    def source(self) -> str:
        """Where the scene comes from, for messages."""

    def field(self, value: Any, place: str) -> Field:
        """A number or a formula."""

    def value(self, value: Any, place: str) -> Field:
        """The same, or one for the cells of each material."""

    def number(self, value: float | str, place: str) -> float:
        """One finite number."""

    @property
    def of_body(self) -> bool:
        """Whether u is the displacement of an elastic body."""


class Sampler(Protocol):
    """Samples the data of effects on a mesh: Functions and Constants, so that all models share compiled forms."""

    def cellwise(self, value: Field, *, positive: bool = False, least: float | None = None) -> Any:
        """Function with one value per cell, or for quadratic elements one per node of each cell, or a Constant."""

    def number(self, value: float) -> Any:
        """A number that is not compiled into forms."""

    def field(self, components: tuple[Field, ...]) -> Any:
        """Vector with one value per cell."""

    @property
    def cell_size(self) -> Any:
        """The side h of each cell."""

    def values(self, value: Field, *, positive: bool = False) -> np.ndarray:
        """The values of `cellwise` at local cells, or the one there is."""

    def matrix(self, rows: tuple[tuple[Field, ...], ...]) -> Any:
        """Symmetric, positive definite matrix with one value per cell."""

    def eigenvalues(self, rows: tuple[tuple[Field, ...], ...]) -> np.ndarray:
        """Its eigenvalues in ascending order, shape (cells or 1, rows)."""

    def on_part(self, value: Field, part: int, *, least: float | None = None) -> Any:
        """Nodal Function with the values of a datum on a part of the boundary, counted from 0."""

    def at_points(self, forces: tuple[tuple[tuple[float, ...], float], ...], place: str) -> np.ndarray:
        """Forces at points as forces at owned nodes."""

    def height(self, value: Field) -> Any:
        """Nodal Function with the values of a datum."""

    @property
    def axial(self) -> bool:
        """Whether x is the distance from an axis, the weight of all integrals."""

    @property
    def motion(self) -> Any:
        """Derivatives in time, where the model has time."""

    @property
    def dx(self) -> Any:
        """Integration over the domain."""

    @property
    def dI(self) -> Any:
        """The same by the nodal rule, where the element has one of degree 1."""

    def over(self, part: int, key: str, *, nodal: bool = False) -> Any:
        """Integration over the part of the boundary that has a key, by the nodal rule of its facets if asked for."""


@dataclass(frozen=True)
class Effect:
    """One term of the equation. Subclasses define the form; the defaults contribute nothing.

    Attributes:
        value: Its datum, in the unit `unit`.
    """

    value: Field

    key: ClassVar[str] = ""  # its name in [effects], or in [[boundary]]
    table: ClassVar[str] = "effects"  # or "boundary"
    equation: ClassVar[str] = ""  # how it enters the equation, for `explain`
    left: ClassVar[bool] = False  # on the left side there
    term: ClassVar[str] = ""  # its part of a(u, v) - f(v), for `explain`
    unit: ClassVar[str] = ""
    role: ClassVar[Role] = ""  # which of the terms it is that error bounds and checks know
    holds: ClassVar[bool] = False  # keeps u from floating away where it is given nowhere
    note: ClassVar[str] = ""  # what `explain` adds
    upwinded: ClassVar[bool] = False  # its test functions are upwinded where there is drift
    radial: ClassVar[bool] = False  # gives all integrals the weight x
    elastic: ClassVar[bool] = False  # gives the form a(u, v) its stiffness
    vector_valued: ClassVar[bool | None] = False  # whether u is a displacement; None: it does not matter
    order: ClassVar[int] = 0  # of its derivative in time
    affine: ClassVar[bool] = True  # the term is linear in u plus a constant
    symmetric: ClassVar[bool] = True  # a(u, v) = a(v, u)
    convex: ClassVar[bool] = True  # it has a convex energy
    film: ClassVar[bool] = False  # its force per length is below its value, whatever the slope
    gives_way: ClassVar[bool] = False  # an obstacle that pushes back in proportion to the distance beyond it
    pointwise: ClassVar[bool] = (
        False  # its force at a node depends on u at this node only, and does not decrease with u
    )
    no_bound: ClassVar[str] = ""  # why there is no bound of the error in energy with it
    no_bound_from: ClassVar[int] = 1  # dimension of the meshes for which there is none

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        """The effect from its entry in the scene.

        Args:
            raw: There.
            place: Where, for messages.
            reader: The scene.
            **more: Of [[boundary]]: `part`, which of them, counted from 0.

        Raises:
            InputError: If it is not what the effect takes.
        """
        return cls(reader.value(raw, place), **more)

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        """A message if it cannot be combined with the other effects of a scene; otherwise None."""
        return None

    @property
    def text(self) -> str:
        """Its data as the user wrote them."""
        return _text(self.value)

    @property
    def inputs(self) -> list[Field]:
        """All fields among its data."""
        return fields_in(getattr(self, one.name) for one in fields(self))

    @property
    def integrals(self) -> int:
        """Number of integrals of its part of the residual."""
        return int(type(self).terms is not Effect.terms)

    @property
    def in_model_problem(self) -> bool:
        """Whether it is a term of (2.2), -div(mu grad u) = f: a linear tension mu (or a matrix), or a load per area
        f."""
        return (self.elastic and self.affine) or self.role == "load"

    def outputs(self, data: Sampler) -> dict[str, float]:
        """Output quantities of a result that belong to it, by their names there (collective)."""
        return {}

    def terms(self, u: ufl.core.expr.Expr, v: ufl.Argument, data: Sampler) -> ufl.Form | None:
        """Its part of the residual a(u, v) - f(v), as far as it is a form."""
        return None

    def derivative(self, u: ufl.core.expr.Expr, v: ufl.Argument, data: Sampler) -> ufl.Form | None:
        """The derivative of `terms` with respect to u, a bilinear form, if it is not computed by UFL."""
        return None

    def heights(self, data: Sampler) -> list[Any]:
        """Local nodal values of u at which its part of a(u, v) is zero; empty if it is zero for all constants."""
        return [0.0] if self.holds else []

    def sides(self, data: Sampler) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Local nodal values of the lower and the upper soft obstacle, or None."""
        return None, None

    def push(self, data: Sampler) -> tuple[float, float] | None:
        """Smallest and largest local value of its part of f, for the maximum principle; None if there is no such
        principle.

        (0, 0) says that its part of a(., .) lets constants be compared with solutions: it contains gradients of u, or
        draws u towards `heights`.
        """
        return None

    def energy(self, u: ufl.core.expr.Expr, data: Sampler) -> ufl.Form | None:
        """The energy whose derivative is `terms`, or None."""
        return None

    @property
    def quadratic(self) -> bool:
        """Whether matrix and load of a problem at rest determine its energy, up to that of u = 0."""
        return self.affine and self.order == 0

    def vector(self, data: Sampler) -> np.ndarray | None:
        """Its part of f(v) that is not a form: forces at owned nodes (collective)."""
        return None

    def energy_of_motion(self, velocity: Any, data: Sampler) -> ufl.Form | None:
        """Its part of the energy of motion, where u_t is the velocity."""
        return None

    def upwinding(self, v: Any, elastic: Effect, data: Sampler) -> Any:
        """The term added to upwinded test functions (SUPG), or None."""
        return None

    def tension_at(self, u: ufl.core.expr.Expr, data: Sampler) -> Any:
        """Its tension where the solution is u, a number or a matrix, so that its part of a(u, v) is the integral of
        (tension grad u) . grad v; None where it has none. The flux of a solution is this times grad u."""
        return None

    def stiffness(self, data: Sampler) -> np.ndarray | None:
        """Its tension in local cells where it is elastic, for the scale of eps."""
        return None


@dataclass(frozen=True)
class WithTension(Effect):
    """An elastic effect of a scalar u with a tension that is a number, and may depend on |grad u|."""

    left = True
    unit = "force/length"
    elastic = True

    def push(self, data: Sampler) -> tuple[float, float] | None:
        return 0.0, 0.0

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return self.tension_at(u, data) * ufl.inner(ufl.grad(u), ufl.grad(v)) * data.dx

    def stiffness(self, data: Sampler) -> np.ndarray:
        return data.values(self.value, positive=True)


@dataclass(frozen=True)
class OfComponents(Effect):
    """An effect on elastic bodies whose datum is a vector.

    Attributes:
        value: Its components.
    """

    value: tuple[Field, ...]  # type: ignore[assignment]

    vector_valued = True


def _text(value: Any) -> str:
    """A datum, or several in lists, in words."""
    return f"[{', '.join(map(_text, value))}]" if isinstance(value, tuple) else value.text


def residual(effects: Sequence[Effect], u: Any, v: Any, data: Sampler) -> ufl.Form:
    """a(u, v) - f(v), the sum over the effects."""
    elastic = next((effect for effect in effects if effect.elastic), None)
    upwinded_test = v
    for effect in effects:
        if elastic is not None and (added := effect.upwinding(v, elastic, data)) is not None:
            upwinded_test = upwinded_test + added
    forms = (effect.terms(u, upwinded_test if effect.upwinded else v, data) for effect in effects)
    return sum(form for form in forms if form is not None)


def keys_of(
    raw: Any,
    place: str,
    reader: Reader,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    one_of: Sequence[str] = (),
) -> dict[str, Any]:
    """A table of the scene whose keys are checked.

    Raises:
        InputError: If it is no table, a key is unknown or a needed one is missing, or all of `one_of`.
    """
    wanted = ", ".join((*needed, *optional))
    if not isinstance(raw, dict):
        raise InputError(f"{reader.source}: {place} = {raw!r}: expected a table of {wanted}")
    for key in raw:
        if key not in (*needed, *optional):
            raise InputError(f"{reader.source}: {place} unknown key '{key}' (known: {wanted})")
    for key in needed:
        if key not in raw:
            raise InputError(f"{reader.source}: {place}: the key '{key}' is missing")
    if one_of and not set(one_of) & set(raw):
        raise InputError(f"{reader.source}: {place}: needs {' or '.join(one_of)}")
    return raw


def components_of(raw: Any, place: str, reader: Reader) -> tuple[Field, ...]:
    """The components of a vector in a scene.

    Raises:
        InputError: If it is not a list of two or three numbers or formulas.
    """
    if not isinstance(raw, list | tuple) or len(raw) not in (2, 3) or any(isinstance(one, list | dict) for one in raw):
        raise InputError(f"{reader.source}: {place} = {raw!r}: expected a list of two or three numbers or formulas")
    return tuple(reader.field(one, f"{place}[{k}]") for k, one in enumerate(raw))


_register: dict[str, type[Effect]] = {}


@cache
def _modules(table: str) -> dict[str, str]:
    """Module of each effect of this package that a table can name, by its key, which is the file's name."""
    folder = _FOLDERS[table]
    files = iter_modules([str(Path(__file__).parent / folder)])
    return {file.name: f"{__package__}.{folder}.{file.name}" for file in files}


def register(effect: type[Effect]) -> type[Effect]:
    """Class decorator: scenes may name this effect by its `key`.

    Raises:
        InputError: If it has none, or one of this package's own.
    """
    own = {**_modules("effects"), **_modules("boundary")}
    if not effect.key.isidentifier() or effect.__module__ != own.get(effect.key, effect.__module__):
        raise InputError(f"effect {effect.__name__}: key = {effect.key!r} is taken, or no name")
    _register[effect.key] = effect
    return effect


def known(table: str = "effects") -> set[str]:
    """The keys of all effects that a table can name, imported or not."""
    return {*_modules(table), *(key for key, effect in _register.items() if effect.table == table)}


def find(key: str) -> type[Effect]:
    """The effect of a known key; its module is imported now."""
    if key not in _register:
        import_module({**_modules("effects"), **_modules("boundary")}[key])
    return _register[key]
