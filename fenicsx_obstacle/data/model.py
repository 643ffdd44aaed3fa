"""The problem data without a mesh: effects, obstacles, boundary conditions, time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fenicsx_obstacle.data.time_discretization import TimeDiscretization
from fenicsx_obstacle.effects.effect import OF_VALUE, Effect, Elastic, OnPart
from fenicsx_obstacle.effects.field import Field, fields_in
from fenicsx_obstacle.errors import InputError


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the boundary, or a curve or surface inside, with its data; by default the whole boundary.

    Attributes:
        name: What messages call it.
        on: Names of parts of the mesh, or None.
        where: A condition that holds on its facets: a datum that is not 0 at their vertices; or None.
        value: Of u, where it is given.
        lower: Obstacle there.
        upper: Obstacle there.
        components: Of a vector-valued u, those that are given there; None for one that is free.
    """

    name: str
    on: tuple[str, ...] | None = None
    where: Field | None = None
    value: Field | None = None
    lower: Field | None = None
    upper: Field | None = None
    components: tuple[Field | None, ...] = ()

    @property
    def bears(self) -> bool:
        """Whether it has an obstacle."""
        return self.lower is not None or self.upper is not None


@dataclass(frozen=True, eq=False)
class Model:
    """An obstacle problem.

    Attributes:
        effects: Whose sum is a(u, v) - f(v).
        lower: Obstacle in the domain.
        upper: Obstacle in the domain.
        boundary: Of two parts that meet, the later one counts.
        time: The moments, or None.
        source: Where it comes from, for messages.
    """

    effects: tuple[Effect, ...]
    lower: Field | None = None
    upper: Field | None = None
    boundary: Sequence[Part] = ()
    time: TimeDiscretization | None = None
    source: str = "problem"

    def __post_init__(self) -> None:
        """Reject contradictory data.

        Raises:
            InputError: If not exactly one effect is elastic, obstacles are in the domain and on its boundary, or a
                plug-in gives a term with several data the meaning of one with its value alone.
        """
        if (count := sum(isinstance(effect, Elastic) for effect in self.effects)) != 1:
            raise InputError(f"{self.source}: exactly one effect must be a stiffness, such as tension; {count} do")
        for effect in self.effects:
            if effect.role in OF_VALUE and set(vars(effect)) - {"value", "part"}:
                raise InputError(
                    f"{self.source}: effect '{effect.key}' has several data, but its role '{effect.role}' is that of a "
                    "term with `value` alone, and error bounds would ignore the others: leave the role empty"
                )
        if self.thin and (self.lower is not None or self.upper is not None):
            raise InputError(f"{self.source}: obstacles in the domain and on its boundary: these exclude each other")

    def acts(self, number: int) -> list[str]:
        """Keys of the effects that act on a part of the boundary, counted from 0."""
        return [effect.key for effect in self.effects if isinstance(effect, OnPart) and effect.part == number]

    @property
    def thin(self) -> bool:
        """Whether obstacles are on the boundary, or on curves inside, instead of in the domain."""
        return any(part.bears for part in self.boundary)

    @property
    def data(self) -> list[Field]:
        """All data, those of materials one by one."""
        given = [self.lower, self.upper, *map(vars, self.effects)]
        given += [
            getattr(part, key) for part in self.boundary for key in ("value", "where", "lower", "upper", "components")
        ]
        given += [] if self.time is None else [self.time.start, self.time.velocity]
        found = [list(field.parts.values()) if field.parts is not None else [field] for field in fields_in(given)]
        return [field for part in found for field in part]

    @property
    def elastic(self) -> Elastic:
        """The elastic effect, which is the main part of a(u, v)."""
        return next(effect for effect in self.effects if isinstance(effect, Elastic))

    @property
    def vector_valued(self) -> bool:
        """Whether u is a displacement, with as many components as points have coordinates."""
        return bool(self.elastic.vector_valued)

    @property
    def radial(self) -> bool:
        """Whether all integrals have the weight x."""
        return any(effect.role == "radial weight" for effect in self.effects)
