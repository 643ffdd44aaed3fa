"""What an effect is, and the register of those that scenes can name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:  # the forms are built late; reading a scene imports no finite elements
    import numpy as np
    import ufl

    from fenicsx_obstacle.scenes.materials import Value


class Sampler(Protocol):
    """Gives an effect its data on a mesh."""

    def cellwise(self, value: Value, *, positive: bool = False) -> Any:
        """Function with one value per cell, or for quadratic elements one per node of each cell, or a Constant."""

    @property
    def dx(self) -> Any:
        """Integration over the domain."""


class NodalSampler(Protocol):
    """Gives an effect its data at nodes."""

    def at_nodes(self, value: Value) -> np.ndarray:
        """Values at owned nodes."""


@dataclass(frozen=True)
class Effect:
    """One term of the equation. Subclasses give the form; the defaults say 'nothing'.

    Attributes:
        value: The effect's data from the scene: a number, a formula, or one of these for each material.
    """

    value: Value

    key: ClassVar[str] = ""  # its name in [effects]
    equation: ClassVar[str] = ""  # how it enters the equation, for `explain`
    unit: ClassVar[str] = ""
    elastic: ClassVar[bool] = False  # gives the form a(u, v) its stiffness
    affine: ClassVar[bool] = True  # the term is linear in u plus a constant
    symmetric: ClassVar[bool] = True  # a(u, v) = a(v, u)
    convex: ClassVar[bool] = True  # it has a convex energy

    def terms(self, u: ufl.core.expr.Expr, v: ufl.Argument, data: Sampler) -> ufl.Form:
        """Its part of the residual a(u, v) - f(v)."""
        raise TypeError(f"{type(self).__name__} has no terms")

    def energy(self, u: ufl.core.expr.Expr, data: Sampler) -> ufl.Form | None:
        """Its part of the energy whose derivative `terms` is, or None."""
        return None

    def density(self, data: NodalSampler) -> np.ndarray | None:
        """Its values at owned nodes where it is a load per area, else None: for lumping with other weights."""
        return None


_register: dict[str, type[Effect]] = {}


def register(effect: type[Effect]) -> type[Effect]:
    """Class decorator: scenes may name this effect by its `key`."""
    _register[effect.key] = effect
    return effect


def registered() -> dict[str, type[Effect]]:
    """The effects that scenes can name, by key."""
    from fenicsx_obstacle.effects import membrane  # noqa: F401  (registers its classes)

    return dict(_register)
