"""The protocol of effects, and their register.

An effect is one class: its data, its part of the residual and of the energy, and what solvers must know of them.
Residual, energy and the choice of the solver are folds over the effects of a model; what no scene names is not even
imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import ufl

from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError

# Which term with the `value` of the effect it is, for what bounds, checks and solvers know of these terms:
# tension int mu grad u . grad v, its matrix int (A grad u) . grad v, film int mu grad u . grad v/sqrt(1 + |grad u|^2),
# load -int f v, reaction int k u v with k >= 0, drift int (b . grad u) v; load and reaction of a part of the boundary
# are integrals over it; soft obstacle int k ((u - upper)^+ - (lower - u)^+) v; point forces -sum F v(x), which are no
# form; radial weight: the factor x of all integrals
Role = Literal["", "tension", "matrix tension", "film", "load", "reaction", "drift", "part load", "part reaction",
               "soft obstacle", "point forces", "radial weight"]  # fmt: skip
OF_VALUE = ("tension", "matrix tension", "load", "reaction", "drift", "part load", "part reaction", "point forces")
_UPWINDED = ("load", "reaction", "drift")  # terms whose test functions are upwinded where there is drift


class Reader(Protocol):
    """Converts entries of a scene into data."""

    @property
    def source(self) -> str:
        """Where the scene comes from, for messages."""

    @property
    def of_body(self) -> bool:
        """Whether u is the displacement of an elastic body."""

    def field(self, value: Any, place: str) -> Field:
        """A number or a formula."""

    def value(self, value: Any, place: str) -> Field:
        """The same, or one for the cells of each material."""

    def number(self, value: float | str, place: str) -> float:
        """One finite number."""

    def components(self, raw: Any, place: str, counts: Sequence[int] = ..., wanted: str = ...) -> tuple[Field, ...]:
        """The components of a vector."""

    def table(
        self, raw: Any, place: str, needed: Sequence[str], optional: Sequence[str] = ..., one_of: Sequence[str] = ...
    ) -> dict[str, Any]:
        """A table with checked keys."""


class Sampler(Protocol):
    """Samples the data of effects on a mesh: Functions and Constants, so that all models share compiled forms."""

    def cellwise(self, value: Field, *, positive: bool = False, least: float | None = None) -> Any:
        """Function with one value per cell, or for quadratic elements one per node of each cell, or a Constant."""

    def number(self, value: float | np.ndarray) -> Any:
        """A number, or a vector, that is not compiled into forms."""

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
    equation: ClassVar[str] = ""  # how it enters the equation, for `explain`
    term: ClassVar[str] = ""  # its part of a(u, v) - f(v), for `explain`; with a minus it is on the right side there
    unit: ClassVar[str] = ""
    role: ClassVar[Role] = ""
    order: ClassVar[int] = 0  # of its derivative in time
    affine: ClassVar[bool] = True  # the term is linear in u plus a constant
    symmetric: ClassVar[bool] = True  # a(u, v) = a(v, u)
    convex: ClassVar[bool] = True  # it has a convex energy
    vector_valued: ClassVar[bool | None] = False  # whether u is a displacement; None: it does not matter

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        """The effect from its entry in the scene, by default a number, a formula or {material = value}.

        Args:
            raw: There.
            place: Where, for messages.
            reader: The scene.
            **more: Of [[boundary]]: `part`, which of them, counted from 0.

        Raises:
            InputError: If it is not what the effect takes.
        """
        return cls(reader.value(raw, place), **more)

    def terms(self, u: ufl.core.expr.Expr, v: ufl.core.expr.Expr, data: Sampler) -> ufl.Form | None:
        """Its part of the residual a(u, v) - f(v), as far as it is a form."""
        return None

    def derivative(self, u: ufl.core.expr.Expr, v: ufl.Argument, data: Sampler) -> ufl.Form | None:
        """The derivative of `terms` with respect to u, a bilinear form, if it is not computed by UFL."""
        return None

    def energy(self, u: ufl.core.expr.Expr, data: Sampler) -> ufl.Form | None:
        """The energy whose derivative is `terms`, or None; that of a symmetric affine term by itself."""
        at_u = self.terms(u, u, data) if self.affine and self.symmetric else None
        if at_u is None:
            return None
        # terms(u, v) = a(u, v) - f(v), so that a(u, u)/2 - f(u) = (terms(u, u) + terms(0, u))/2
        return 0.5 * (at_u + self.terms(data.number(np.zeros(u.ufl_shape)), u, data))

    def conflict(self, effects: Sequence[Effect]) -> str | None:
        """A message if it cannot be combined with the other effects of a scene; otherwise None."""
        return None

    def __str__(self) -> str:
        """Its data as the user wrote them."""
        return _text(self.value)


@dataclass(frozen=True)
class OnPart(Effect):
    """An effect on the part of a [[boundary]].

    Attributes:
        part: Which [[boundary]], counted from 0.
    """

    part: int

    @classmethod
    def read(cls, raw: Any, place: str, reader: Reader, **more: Any) -> Effect:
        return cls(reader.field(raw, place), **more)


class Elastic(Effect):
    """An effect that is the stiffness, the main part of a(u, v): each model has exactly one."""

    def tension_at(self, u: ufl.core.expr.Expr, data: Sampler) -> Any:
        """Its tension where the solution is u, a number or a matrix, so that its part of a(u, v) is the integral of
        (tension grad u) . grad v; None where it has none. The flux of a solution is this times grad u."""
        return None

    def stiffness(self, data: Sampler) -> np.ndarray | None:
        """Its tension in local cells where it is a number or has a largest eigenvalue, for the scale of eps."""
        return None


class WithTension(Elastic):
    """An elastic effect of a scalar u with a tension that is a number, and may depend on |grad u|."""

    unit = "force/length"

    def terms(self, u: Any, v: Any, data: Sampler) -> ufl.Form:
        return self.tension_at(u, data) * ufl.inner(ufl.grad(u), ufl.grad(v)) * data.dx

    def stiffness(self, data: Sampler) -> np.ndarray:
        return data.values(self.value, positive=True)


def _text(value: Any) -> str:
    """A datum, or several in lists, in words."""
    return f"[{', '.join(map(_text, value))}]" if isinstance(value, tuple) else value.text


def residual(effects: Sequence[Effect], u: Any, v: Any, data: Sampler) -> ufl.Form:
    """a(u, v) - f(v), the sum over the effects."""
    drift = next((effect for effect in effects if effect.role == "drift"), None)
    elastic = next((effect for effect in effects if isinstance(effect, Elastic)), None)
    along = v
    if drift is not None and elastic is not None:
        from fenicsx_obstacle.effects.upwinding import upwinded  # only where there is drift

        b, tension = data.field(drift.value), elastic.tension_at(None, data)  # type: ignore[arg-type]
        along = upwinded(v, b, tension, data.cell_size)
    forms = (effect.terms(u, along if effect.role in _UPWINDED else v, data) for effect in effects)
    return sum(form for form in forms if form is not None)


def is_support(effect: Effect) -> bool:
    """Whether it keeps u from floating away where u is given nowhere: it draws u towards 0, or to where it was."""
    return effect.role in ("reaction", "part reaction") or effect.order > 0


def of_model_problem(effect: Effect) -> bool:
    """Whether it is a term of (2.2), -div(mu grad u) = f: a linear tension mu (or a matrix), or a load per area f."""
    return (isinstance(effect, Elastic) and effect.affine) or effect.role == "load"


_register: dict[str, type[Effect]] = {}


@cache
def _modules() -> dict[str, str]:
    """Module of each effect of this package, by its key, which is the file's name."""
    folders = ("domain", "boundary")
    files = ((folder, file.name) for folder in folders for file in iter_modules([str(Path(__file__).parent / folder)]))
    return {name: f"{__package__}.{folder}.{name}" for folder, name in files}


def register(effect: type[Effect]) -> type[Effect]:
    """Class decorator: scenes may name this effect by its `key`.

    Raises:
        InputError: If it has none, or one of this package's own.
    """
    if not effect.key.isidentifier() or effect.__module__ != _modules().get(effect.key, effect.__module__):
        raise InputError(f"effect {effect.__name__}: key = {effect.key!r} is taken, or no name")
    _register[effect.key] = effect
    return effect


def known(table: str = "effects") -> set[str]:
    """The keys of all effects that [effects] or [[boundary]] can name, imported or not."""
    of_parts = {key for key, module in _modules().items() if ".boundary." in module}
    return of_parts if table == "boundary" else {*_modules(), *_register} - of_parts


def find(key: str) -> type[Effect]:
    """The effect of a known key; its module is imported now."""
    if key not in _register:
        import_module(_modules()[key])
    return _register[key]
