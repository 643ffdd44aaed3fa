"""Tables that grow row by row: measured values with their observed order beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fenicsx_obstacle.studies.theory import lookup, order, parameter, quantities


@dataclass(frozen=True)
class Column:
    """A column of plain figures."""

    key: str
    label: str
    form: str


_COST = (
    Column("newton_iterations", "Newton", "d"),
    Column("krylov_iterations", "CG", "d"),
    Column("seconds.solve", "seconds", ".3f"),
    Column("poisson_units", "Poisson", ".1f"),
    Column("memory_mb", "MB", ".0f"),
)


class StudyTable:
    """Lines of text for the rows of one study.

    Attributes:
        varied: The keys that vary.
    """

    def __init__(self, varied: Sequence[str]):
        self.varied, self.by = list(varied), parameter(varied)
        self.last: Mapping[str, Any] | None = None

    def lines(self, row: Mapping[str, Any]) -> list[str]:
        """The lines this row adds: before the first row the heads as well."""
        measured = quantities(self.varied, row)
        cells: list[tuple[str, str, str]] = []  # head, the paper's order, value
        for key in self.varied:
            cells.append((key, "", _short(row["vary"][key])))
        if self.by not in self.varied:
            cells.append((self.by, "", f"{row[self.by]:.3e}"))
        if self.by == "h" and row.get("eps") is not None:
            cells.append(("eps", "", f"{row['eps']:.1e}"))
        for quantity in measured:
            cells.append((quantity.label, "paper:" if quantity.stated else "best:", f"{lookup(row, quantity.key):.3e}"))
            seen = order(quantity.key, row, self.last, self.by)
            cells.append(("order", f"{quantity.order:g}", "" if seen is None else f"{seen:.2f}"))
        for column in _COST:
            value = lookup(row, column.key)
            cells.append((column.label, "", "" if value is None else format(value, column.form)))
        widths = [max(len(head), len(value), 5) for head, _, value in cells]
        lines = (
            []
            if self.last is not None
            else [_line([c[0] for c in cells], widths), _line([c[1] for c in cells], widths)]
        )
        self.last = row
        return [*lines, _line([c[2] for c in cells], widths)]


def _line(parts: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(part.rjust(width) for part, width in zip(parts, widths, strict=True)).rstrip()


def _short(value: Any) -> str:
    return f"{value:.1e}" if isinstance(value, float) else str(value)
