"""What a check found: invariants by name, each with its value and limit, and the verdict of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Any

import numpy as np

from fenicsx_obstacle.text import columns


class Verdict(Enum):
    """Of all findings together."""

    RIGHT = "right"
    WRONG = "wrong"


class Reason(StrEnum):
    """The invariant that a wrong solution violates; its value is the name of the row."""

    NUMBERS = "values that are no numbers"
    GIVEN_VALUES = "u has the given values"
    OBSTACLES = "u between the obstacles"
    PENALTY = "p = -(u - g)^+/eps"
    COMPLEMENTARITY = "no pressure without contact"
    BALANCE = "forces at nodes balance"
    CORRECTION = "forces that are left move u"
    CONTACT = "nodes in contact that are not, or the reverse"
    AREA = "area of contact"
    FORCE = "contact forces"
    PUBLISHED = "fields and figures, over what they may differ by"
    ENERGY_NORM = "u of active sets and a direct solver"
    LARGEST_DIFFERENCE = "the same, largest difference"
    UNITS_COUNTS = "steps and contact in other units"
    UNITS_VALUES = "u in other units"
    RANKS = "u on one rank, rows reversed"


@dataclass(frozen=True)
class Finding:
    """One invariant of one answer; the same on every rank.

    Attributes:
        name: In a few words; of solutions a `Reason`.
        statement: Of the theory.
        observed: What is measured.
        limit: What it may be at most.
        claimed: Whether the hypotheses hold here; without them nothing is violated.
    """

    name: str
    statement: str
    observed: float
    limit: float
    claimed: bool = True

    @property
    def held(self) -> bool:
        """False also where the figure is not a number."""
        return not self.claimed or bool(self.observed <= self.limit)

    @property
    def record(self) -> dict[str, Any]:
        """As JSON takes it."""
        figures = {key: value if np.isfinite(value) else None for key, value in
                   (("observed", self.observed), ("limit", self.limit))}  # fmt: skip
        return {**vars(self), **figures, "held": self.held}

    def __str__(self) -> str:
        verdict = "held" if self.held else "VIOLATED"
        return f"{self.name} ({self.statement}): {self.observed:.3g}, at most {self.limit:.3g}: {verdict}"


def violated(findings: Sequence[Finding]) -> list[Finding]:
    """Those that should hold and do not."""
    return [finding for finding in findings if not finding.held]


@dataclass(frozen=True)
class Verification:
    """All findings about one solution.

    Attributes:
        findings: In the order in which they were checked.
    """

    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether all that should hold holds."""
        return Verdict.WRONG if violated(self.findings) else Verdict.RIGHT

    @property
    def reason(self) -> Reason | None:
        """The first invariant that is violated; None of a right solution."""
        wrong = violated(self.findings)
        return Reason(wrong[0].name) if wrong else None

    def __bool__(self) -> bool:
        return self.verdict is Verdict.RIGHT

    def __str__(self) -> str:
        heads = ("check", "of", "observed", "at most", "")
        rows = [(finding.name, finding.statement, f"{finding.observed:.3g}", f"{finding.limit:.3g}",
                 ("held" if finding.held else "VIOLATED") if finding.claimed else "not claimed")
                for finding in self.findings]  # fmt: skip
        return "\n".join([*columns([heads, *rows]), f"verdict: {self.verdict.value}"])
