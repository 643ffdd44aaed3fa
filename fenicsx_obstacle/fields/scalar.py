"""The fields of a scalar solution: u, its pressure, contact set and obstacles, as Functions and as arrays."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.cut import Cut, OnNodes, cut, on_nodes
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import values_of
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.text import nearest

PARTITION = 1e-9  # round-off of a partition of unity
NO_TENSION = (
    "at() has no flux here: the tension of a form is not known, nor that of a solution read without "
    "a scene; 'slope' is the gradient of u"
)


@dataclass(frozen=True)
class Force:
    """The contact force on each obstacle: the integral of the absolute value of the contact pressure.

    Attributes:
        lower: Force on the lower obstacle, >= 0; None if there is no lower obstacle.
        upper: Force on the upper obstacle, >= 0; None if there is no upper obstacle.
    """

    lower: float | None
    upper: float | None


@dataclass(frozen=True, eq=False)
class Fields:
    """The fields of a scalar solution.

    Attributes:
        level: The mesh and its spaces.
        u: Solution, in the unit of the obstacles.
        pressure: Contact pressure p, in the unit of the load, in Q_h.
        contact: 1 at the contact nodes where u is in contact, 0 at the others, in Q_h.
        lower: Lower obstacle at the nodes, or None.
        upper: Upper obstacle at the nodes, or None.
        error: Difference from the exact solution at the nodes; None if the exact solution is not known.
    """

    level: Level
    u: fem.Function
    pressure: fem.Function
    contact: fem.Function
    lower: fem.Function | None = None
    upper: fem.Function | None = None
    error: fem.Function | None = None

    def __post_init__(self) -> None:
        # the names that ParaView shows; XDMFFile cannot write two Functions with one name
        for name in ("pressure", "contact", "lower", "upper", "gap", "von_mises"):
            function = getattr(self, name, None)
            if function is not None:
                function.name = name

    def functions(self) -> dict[str, fem.Function]:
        """The scalar fields by name, those that exist."""
        named = {key: getattr(self, key) for key in ("u", "pressure", "contact", "lower", "upper", "error")}
        return {key: function for key, function in named.items() if function is not None}

    def by_cell(self) -> dict[str, fem.Function]:
        """Further fields that have one value in each cell, by name."""
        return {}

    def tables(self) -> dict[str, np.ndarray]:
        """Further arrays of fields.h5 by their names, the same on every rank."""
        return {}

    def force(self, lower: float | None, upper: float | None) -> Force:
        """The contact forces, of the force on each obstacle."""
        return Force(lower, upper)

    # on P1 simplices

    def on_nodes(self) -> OnNodes | None:
        """On simplices between the dofs of V_h; None where these need other nodes (collective)."""
        return on_nodes(self.level, self.functions())

    @cached_property
    def cut(self) -> Cut:
        """The subdivision of the cells from which `plain` is made, for elements other than P1 (first use is
        collective)."""
        return cut(self.level.scalar, self.functions())

    @cached_property
    def plain(self) -> Self:
        """Their interpolants on P1 simplices, for pictures and ParaView (first use is collective)."""
        return self if self.level.pair.nested_hierarchy else self._on_pieces(self.cut)

    def _on_pieces(self, pieces: Cut) -> Self:
        """These fields on the P1 simplices that their cells were cut into (local)."""
        pieces.functions["u"].name = self.u.name
        return replace(self, level=pieces.level, **pieces.functions)

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields on P1 simplices at owned nodes, as files and pictures have them (local)."""
        owned = self.level.owned
        return with_gap({name: function.x.array[:owned].real for name, function in self.functions().items()})

    # at points

    def shape(self, of: str) -> tuple[int, ...]:
        """The shape of a quantity at a point."""
        return (self.level.mesh.geometry.dim,) if of in ("slope", "flux") else ()

    def values(self, points: np.ndarray, of: str = "u", tension: Any = None) -> np.ndarray:
        """Values at points, shape (n, 3), the same on every rank; not-a-number outside the mesh (collective).

        Args:
            points: The same on every rank.
            of: As for `Solution.at`.
            tension: In UFL, for the flux.

        Raises:
            InputError: If there is no such quantity, or the tension is not given.
        """
        found = [self._with_infinities(function, points) for function in self._components(of, tension)]
        return found[0] if not self.shape(of) else np.column_stack(found)

    def along(self, points: np.ndarray, tension: Any) -> dict[str, Any]:
        """All quantities at points, by name (collective); the flux only if the tension is given.

        Args:
            points: As for `values`.
            tension: In UFL, or None.
        """
        values: dict[str, Any] = {name: self.values(points, name) for name in ("u", "pressure", "slope")}
        free = self.lower is None and self.upper is None
        values["gap"] = np.full(len(points), np.inf) if free else self.values(points, "gap")
        with suppress(InputError):
            values["flux"] = self.values(points, "flux", tension)
        return values

    def obstacles_at(self, points: np.ndarray) -> list[np.ndarray]:
        """The obstacles at points, shape (n, 3), infinite where there are none (collective)."""
        return [self._with_infinities(one, points) for one in (self.lower, self.upper) if one is not None]

    def touches_at(self, points: np.ndarray) -> np.ndarray:
        """Whether there is contact at points: between nodes, half-way (collective)."""
        return self._evaluated(self.contact, points) >= 0.5

    def _components(self, of: str, tension: Any) -> list[fem.Function]:
        """A quantity as Functions of this mesh (collective)."""
        known = ("u", "pressure", "gap", "slope", "flux")
        if of not in known:
            raise InputError(f"at() has no quantity '{of}'" + nearest(of, known))
        if of == "gap":
            gap = fem.Function(self.level.V)
            gap.x.array[:] = np.inf
            for obstacle, sign in ((self.lower, 1), (self.upper, -1)):
                if obstacle is not None:
                    np.minimum(gap.x.array, sign * (self.u.x.array - obstacle.x.array), out=gap.x.array)
            return [gap]
        if of in ("slope", "flux"):
            pair = self.level.pair
            smaller = pair.nested_hierarchy or pair.has_p1_coarse_space  # on other cells gradients have terms like xy
            vector, degree = ufl.grad(self.u), pair.degree - 1 if smaller else pair.degree
            if of == "flux":
                if tension is None:
                    raise InputError(NO_TENSION)
                # the sampled tension is of `Level.W`
                vector, degree = tension * vector, degree + (0 if pair.degree == 1 else pair.degree)
            space = releases.functionspace(self.level.mesh, "DG", degree)
            components = [fem.Function(space) for _ in range(self.level.mesh.geometry.dim)]
            for axis, component in enumerate(components):
                component.interpolate(releases.expression(vector[axis], space))
            return components
        return [getattr(self, of)]

    def _with_infinities(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        """Values of a Function on this mesh, infinite where it is infinite at a node that counts there (collective)."""
        values = function.x.array
        if total(self.level.comm, np.count_nonzero(np.isinf(values))) == 0:
            return self._evaluated(function, points)
        finite, infinite = fem.Function(function.function_space), fem.Function(function.function_space)
        finite.x.array[:] = np.where(np.isinf(values), 0.0, values)
        infinite.x.array[:] = np.isinf(values)
        there = np.abs(self._evaluated(infinite, points)) > PARTITION
        return np.where(there, np.inf, self._evaluated(finite, points))

    def _evaluated(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        """Values of a Function on this mesh (collective)."""
        return values_of(function, points, level=self.level.scalar)


def with_gap(own: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Fields at owned nodes, and with them the distance of u to the nearest obstacle (local)."""
    gaps = [sign * (own[name] - own["u"]) for name, sign in (("lower", -1), ("upper", 1)) if name in own]
    if gaps:
        own["gap"] = gaps[0] if len(gaps) == 1 else np.minimum(*gaps)
    return own
