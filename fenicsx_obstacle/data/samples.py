"""The data of a model at points and nodes of a mesh, at one moment: samples, and checks that they are finite."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.data.fields import Cellwise, array_of
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.data.time_discretization import Moment
from fenicsx_obstacle.effects.field import Field, Names
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.shared_dofs import share
from fenicsx_obstacle.mesh.validation import place
from fenicsx_obstacle.parallel import first_given

Sampled = TypeVar("Sampled", bound=Cellwise)
ROUND_OFF = 1e-14  # of the largest coordinate of a point: its others are 0 up to that


class Samples:
    """Values of the data of a model on one mesh, now.

    Attributes:
        model: Whose data.
        level: The mesh and V.
        moment: Where it is in time, or None.
        moving: What depends on time, and how it is sampled.
        live: Whether `renew` takes data anew that the caller has changed.
    """

    def __init__(self, model: Model, level: Level, moment: Moment | None = None, *, live: bool = False):
        """Sample nothing yet.

        Args:
            model: What is to be solved.
            level: Mesh and V.
            moment: Of another level of the same mesh; by default the start of the model's time.
            live: Whether `renew` is to take data anew that the caller has changed.
        """
        if model.time is not None and moment is None:
            moment = Moment.at_start(model.time)
        self.model, self.level, self.moment, self.live = model, level, moment, live
        self.moving: dict[Cellwise, Callable[[], Cellwise]] = {}
        self._here: dict[Field, Field] = {}

    @property
    def now(self) -> dict[str, float]:
        """The value of t, where there is time."""
        return {} if self.moment is None else {"t": self.moment.t}

    def here(self, field: Field) -> Field:
        """A datum on this mesh (collective on first use)."""
        if field not in self._here:
            self._here[field] = field.on(self.level)
        return self._here[field]

    def names(self, field: Field) -> Names:
        """Present values on which a datum may depend besides x (collective if it is the first to need the distance).

        Raises:
            InputError: If it needs the distance, and this mesh has none.
        """
        if not field.needs_distance:
            return self.now
        try:
            return {**self.now, "distance": self.boundary_distance}
        except InputError as error:
            raise InputError(f"{field}: {error}") from None

    def at(self, field: Field, x: np.ndarray, cells: np.ndarray | None = None) -> np.ndarray:
        """Values of a datum at points (3, n), of local cells where these are known, now (collective on first use)."""
        return self.here(field).at(x, self.names(field), cells)

    @cached_property
    def boundary_distance(self) -> Callable[[np.ndarray], np.ndarray]:
        """Distance to the boundary of points (n, 3) (first use is collective)."""
        from fenicsx_obstacle.mesh.boundary_distance import BoundaryDistance  # with scipy: only where a datum needs it

        return BoundaryDistance(self.level)

    def nodal(self, field: Field, more: Names | None = None) -> fem.Function:
        """Nodal interpolant in V, with values of further names (collective).

        Raises:
            InputError: If it is not finite somewhere, or given for the cells of each material, which share nodes.
        """
        function = self._interpolant(field, more)
        self.refuse_infinite(function, field)
        return function

    def _interpolant(self, field: Field, more: Names | None = None) -> fem.Function:
        """The same, finite or not (collective)."""
        if field.parts is not None:
            raise InputError(f"{field.source}: element {self.level.pair.name} needs one formula for all materials")
        function = fem.Function(self.level.V)
        self._sample(function, field, more)
        return function

    def _on_dofs(self, field: Field, dofs: np.ndarray) -> fem.Function:
        """A Function with the values of a datum at some local dofs, 0 elsewhere (collective)."""
        function = fem.Function(self.level.V)
        function.x.array[dofs] = self._at_dofs(field, self.level.V, dofs)
        self.refuse_infinite(function, field)
        return function

    def _at_dofs(
        self, field: Field, V: fem.FunctionSpace, dofs: Any = slice(None), more: Names | None = None
    ) -> np.ndarray:
        """Values of a datum at some local dofs, by default at all (collective)."""
        here, names, points = self.here(field), {**self.names(field), **(more or {})}, self.level.points_of(V)
        if not field.everywhere:
            return here.interpolate(V, points, names)[dofs]
        return here.interpolate(V, points[:, dofs], names)

    def _sample(self, function: fem.Function, field: Field, more: Names | None = None) -> None:
        if field.uniform:
            function.x.array[:] = self.here(field).at(np.zeros((3, 1)), {**self.names(field), **(more or {})})
        else:
            function.x.array[:] = self._at_dofs(field, function.function_space, more=more)
            share(function)  # points of ghosts may differ from their owner's in the last digit

    def follow(self, fields: Iterable[Field], sample: Callable[[], Sampled]) -> Sampled:
        """Samples of some data, updated for each time step if the data depend on time (collective)."""
        made = sample()
        if self.live or any(field.moves for field in fields):
            self.moving[made] = sample
        return made

    def _sample_again(self) -> None:
        for made, sample in self.moving.items():
            fresh = sample()  # has to live as long as its values are read
            if isinstance(made, fem.Constant):
                made.value = fresh.value
            else:
                made.x.array[:] = fresh.x.array

    # checks

    def refuse_infinite(
        self, function: Cellwise, field: Field | None = None, *, words: str = "", none: float = 0.0
    ) -> None:
        """All ranks raise if a value is not finite, naming one place (collective).

        Args:
            function: Sampled values.
            field: What was sampled, or None.
            words: What it is, for the message; by default the field.
            none: What an obstacle has for a value where there is none, infinity with its sign.

        Raises:
            InputError: Of all ranks the first place.
        """
        values = array_of(function)
        bad = ~(np.isfinite(values) | (values == none))
        hint = f"; take {'-' * (none < 0)}1e20 where there is no obstacle" if none else ""
        self._refuse(field, function, bad, "is not a finite number: it is", words, hint)

    def _refuse(
        self, field: Field | None, function: Cellwise, bad: np.ndarray, what: str, words: str = "", hint: str = ""
    ) -> None:
        """All ranks raise if any value is bad, naming one place, with a hint if it is infinite (collective)."""
        if isinstance(function, fem.Constant):
            found, where = (float(function.value), np.zeros(3)) if bad.any() else None, ""
        else:
            found = self._first(function, bad)
            where = "" if found is None else f" at {self.place(found[1])}"
        if found is not None:
            because = "" if field is None else field.because(found[1], self.names(field))
            because += hint if np.isinf(found[0]) else ""
            raise InputError(f"{words or f'{field}:'} {what} {found[0]:g}{where}{because}")

    def _first(self, function: fem.Function, bad: np.ndarray) -> tuple[float, np.ndarray] | None:
        """Value and place of the first bad dof, the same on every rank (collective)."""
        points, values = self.level.points_of(function.function_space).T, function.x.array
        mine = (values[np.argmax(bad)], points[np.argmax(bad)]) if bad.any() else None
        return first_given(self.level.comm, mine)

    def place(self, point: np.ndarray) -> str:
        """A point (3,) in words; coordinates that are round-off are 0."""
        least = ROUND_OFF * np.abs(point).max()
        return place(np.where(np.abs(point) > least, point, 0.0)[: self.level.mesh.geometry.dim])
