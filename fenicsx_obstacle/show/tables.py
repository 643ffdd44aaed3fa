"""Tables: rows of studies with their observed orders beside the paper's, also in LaTeX; scenes; two results."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from fenicsx_obstacle.problems.summary import lookup, remarks_in_words, with_uncertainty
from fenicsx_obstacle.scenes import catalogue
from fenicsx_obstacle.studies.orders import Vary, along, figures_of, last_part, line_of, order, parameter, quantities
from fenicsx_obstacle.text import columns, counted, short

_COST = (
    ("newton_iterations", "Newton", "d"),
    ("krylov_iterations", "CG", "d"),
    ("seconds.solve", "seconds", ".3f"),
    ("poisson_units", "Poisson", ".1f"),
    ("memory_mb", "MB", ".0f"),
)
_LEGEND = (
    "Newton, CG: steps on the finest mesh; seconds: the whole solve; Poisson: the same in solves of one linear Poisson "
    "problem on that mesh; MB: memory of all ranks at its peak."
)
_ORDERS = (
    "Orders are those of the quantity to the left; below them what to expect: what the paper proves, or the best that "
    "P1 can give."
)
_LATEX = str.maketrans({"\\": r"\textbackslash{}", "_": r"\_", "^": r"\^{}", "%": r"\%", "|": r"$|$"})
_EARLIER = "* timed in an earlier run: compare its Poisson solves, not its seconds, with the other rows."


class Cell(NamedTuple):
    """One cell of a row; `width` is what its column needs at least, should the first row leave it empty."""

    head: str
    expected: str
    value: str
    width: int = 5


class StudyTable:
    """Lines of text for the rows of one study.

    Attributes:
        rows: The cells of all rows so far.
        run: The number of the present run; None where rows are not kept.
    """

    def __init__(self, vary: Vary, run: int | None = None, *, penalised: bool = True):
        """An empty table; `penalised` gives it a column for eps, empty in rows of the variational inequality."""
        self.varied, self.by, self.run, self.penalised = list(vary), parameter(list(vary)), run, penalised
        self._along = along(vary)
        self._widths = {key: max(len(short(value)) for value in values) for key, values in vary.items()}
        self.rows: list[list[Cell]] = []
        self._measured: list[Any] | None = None
        self._earlier = False  # whether a row was timed in an earlier run
        self._remarks: dict[str, list[str]] = {}  # by their words without numbers: each with the row that it is of
        self._last: dict[str, Mapping[str, Any]] = {}  # the last row on each line of the grid

    def lines(self, row: Mapping[str, Any]) -> list[str]:
        """The lines this row adds: before the first row the heads as well."""
        cells = list(self._cells(row))
        heads = not self.rows
        self.rows.append(cells)
        of = ", ".join(f"{key} = {short(row['vary'][key])}" for key in self.varied)
        for name, words in remarks_in_words(row):
            self._remarks.setdefault(re.sub(r"[\d.]+", "", words), []).append(f"{of or 'the row'}: {name}: {words}")
        widths = [max(len(cell.head), len(cell.value), cell.width) for cell in self.rows[0]]
        lines = [[cell.head for cell in cells], [cell.expected for cell in cells]] if heads else []
        return [_line(parts, widths) for parts in [*lines, [cell.value for cell in cells]] if any(parts)]

    def notes(self) -> list[str]:
        """Notes about the columns, and what should be known of rows: of remarks of one kind the first."""
        orders = any(cell.head == "order" for cell in self.rows[0])
        remarks = [
            first + (f"; likewise {counted(len(others), 'further row')}" if others else "")
            for first, *others in self._remarks.values()
        ]
        return [_LEGEND, *[_ORDERS] * orders, *[_EARLIER] * self._earlier, *remarks]

    def _cells(self, row: Mapping[str, Any]) -> Iterator[Cell]:
        if self._measured is None:
            self._measured = quantities(self.varied, row)
        line = line_of(row, self._along)
        for key in self.varied:
            yield Cell(last_part(key), "", short(row["vary"][key]), self._widths[key])
        if self.by == "h":
            yield Cell("h", "", f"{row['h']:.3e}")
        if self.by != "eps" and self.penalised:
            yield Cell("eps", "", "" if row["eps"] is None else f"{row['eps']:.1e}", 7)
        for key, name in (figures_of(row) if not self.by or row.get("report") else {}).items():
            value = lookup(row, key)
            words = "" if value is None else with_uncertainty(row, key, ".6g", short=True)
            width = 22 if "uncertainty" in row else 11
            yield Cell(name.removesuffix(" obstacle"), "", words, width)
        for quantity in self._measured:
            value, source = lookup(row, quantity.key), ("paper:" if quantity.stated else "best:") if self.by else ""
            yield Cell(quantity.label, source, "" if value is None else f"{value:.3e}", 9)
            if self.by:
                seen = order(quantity.key, row, self._last.get(line), self.by)
                yield Cell("order", f"{quantity.order:g}", "" if seen is None else f"{seen:.2f}")
        for key, label, form in _COST:
            value = lookup(row, key)
            earlier = label == "seconds" and self.run is not None and row.get("run") != self.run
            self._earlier |= earlier
            yield Cell(label, "", "" if value is None else format(value, form) + "*" * earlier)
        self._last[line] = row

    def latex(self) -> str:
        """The whole table as a LaTeX tabular (package booktabs)."""
        heads = [cell.head for cell in self.rows[0]]
        lines = [f"\\begin{{tabular}}{{{'r' * len(heads)}}}", "\\toprule"]
        lines.append(" & ".join(head.translate(_LATEX) for head in heads) + r" \\")
        lines.append("\\midrule")
        lines += [" & ".join(cell.value.translate(_LATEX) for cell in cells) + r" \\" for cells in self.rows]
        return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""])


def list_scenes() -> str:
    """The catalogue of scenes, one line for each."""
    rows = [("name", "title", "free boundary", "regularity")]
    for name in catalogue.names():
        tables = catalogue.scene(name).tables
        assert tables.exact is not None
        rows.append((name, tables.title, tables.exact.free, tables.exact.regularity))
    return "\n".join(columns(rows))


def duration(value: float) -> str:
    """Seconds in the unit that fits."""
    if value < 120:
        return f"{_two_digits(value)} s"
    if value < 7200:
        return f"{_two_digits(value / 60)} min"
    return f"{_two_digits(value / 3600)} h" if value < 48 * 3600 else f"{_two_digits(value / 86400)} days"


def megabytes(value: float) -> str:
    """Memory in the unit that fits."""
    if value < 1000:
        return f"{value:.0f} MB"
    return f"{_two_digits(value / 1e3)} GB" if value < 1e6 else f"{_two_digits(value / 1e6)} TB"


def _two_digits(value: float) -> str:
    """A number with two digits, without an exponent: 560, not 5.6e+02."""
    return f"{float(f'{value:.2g}'):.15g}"


def difference(found: Mapping[str, Any], first: str, second: str) -> str:
    """The values of `compare` in lines of text."""
    norms = ", ".join(f"{name} {value:.4g}" for name, value in found["u"].items())
    contact = found["contact"]
    gap = "none" if contact["hausdorff"] is None else f"{contact['hausdorff']:.4g}"
    lines = [
        f"{first} and {second}",
        f"  difference of u: {norms}",
        "  of pressure: " + ", ".join(f"{name} {value:.4g}" for name, value in found["pressure"].items()),
        f"  contact sets: Jaccard {contact['jaccard']:.4g}, Hausdorff distance {gap}",
        "  contact area: " + " and ".join(f"{area:.6g}" for area in contact["area"]),
    ]
    for side, forces in found["force"].items():
        if None not in forces:
            lines.append(f"  force on {side} obstacle: " + " and ".join(f"{force:.6g}" for force in forces))
    if None not in found["energy"]:
        lines.append("  energy: " + " and ".join(f"{energy:.8g}" for energy in found["energy"]))
    if found["outside"]:
        lines.append(f"  {counted(found['outside'], 'node')} of the finer mesh outside of the other mesh: not counted")
    return "\n".join(lines)


def _line(parts: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(part.rjust(width) for part, width in zip(parts, widths, strict=False)).rstrip()
