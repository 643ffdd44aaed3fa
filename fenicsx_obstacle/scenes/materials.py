"""Values that differ from material to material: `tension = {steel = 1, rubber = "2 + x"}`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.scenes.formulas import Formula


@dataclass(frozen=True)
class Materials:
    """One formula for each named group of cells; it reads like a `Formula`.

    Attributes:
        parts: Formula of each name.
        place: Where it stands, for messages.
    """

    parts: Mapping[str, Formula]
    place: str

    @property
    def text(self) -> str:
        """As the user wrote it."""
        return "{" + ", ".join(f"{name} = {formula.text}" for name, formula in self.parts.items()) + "}"

    @property
    def names(self) -> set[str]:
        """Names of the values it needs."""
        return set().union(*(formula.names for formula in self.parts.values()))

    def check_names(self, known: Mapping[str, Any] | set[str]) -> None:
        """Refuse names that mean nothing here.

        Raises:
            InputError: As `Formula.check_names`.
        """
        for formula in self.parts.values():
            formula.check_names(known)


Value = Formula | Materials
