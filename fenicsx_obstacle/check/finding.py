"""What a check found: an invariant by name, with its value and limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


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
