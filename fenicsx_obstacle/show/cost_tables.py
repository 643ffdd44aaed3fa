"""Tables of `cost`: rows, time for one more digit, fastest methods, best eps, where methods end (one rank)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fenicsx_obstacle.studies import price
from fenicsx_obstacle.studies.cost import CostStudy
from fenicsx_obstacle.studies.price import NORMS, TOLERANCES, Rows

HEADS = ("choice", "unknowns", "eps", "seconds", "MB", *NORMS, "DoA", "DoS", "DoE")
THEORY = {"energy": "4/3", "l2": "2", "max": "2", "force": "2", "area": "2", "pressure": "2"}
NEXT = ["next digit of", "error so far", "by", "in", "a tenth of it", "by", "more time", "unknowns", "memory",
        "round-off at"]  # fmt: skip
BEST = ["error in", "best eps ~ h^q: q", "theory", "h", "best eps", "paper's eps", "auto"]


def cells(row: Mapping[str, Any]) -> list[str]:
    """A row below `HEADS`."""
    errors = [price.relative(row, norm) for norm in NORMS]
    digits = price.digits(row, "energy")
    return [
        row["choice"], str(row["dofs"]), "none" if row["eps"] is None else f"{row['eps']:.1e}", f"{row['seconds']:.3g}",
        f"{max(row['memory_mb'], 0):.0f}", *("" if e is None else f"{e:.1e}" for e in errors),
        *(["", "", ""] if digits is None else [f"{digit:.2f}" for digit in digits]),
    ]  # fmt: skip


def measured(rows: Rows) -> list[list[str]]:
    """All rows with errors."""
    return [cells(row) for row in price.solved(rows)]


def next_digit(rows: Rows) -> list[list[str]]:
    """Time for one more digit, a line for each norm."""
    found = []
    for norm in price.norms(rows):
        p = price.price(rows, norm)
        if p is None:
            continue
        after = ["not in sight", "", "", "", ""]
        if p.factor is not None and p.next_seconds is not None:
            size = [f"{p.next_dofs:.2g}" if p.next_dofs else "", megabytes(p.next_memory or 0.0)]
            after = [duration(p.next_seconds), p.next_choice, f"x {p.factor:.2g}", *size]
        found.append([NORMS[norm], f"{p.error:.1e}", p.choice, duration(p.seconds), *after, f"{p.floor:.0e}"])
    return found


def tolerance_heads(rows: Rows) -> list[str]:
    """The heads of `by_tolerance`."""
    return ["relative error", *(NORMS[norm] for norm in price.norms(rows))]


def by_tolerance(rows: Rows) -> list[list[str]]:
    """The cheapest choice for each tolerance and norm."""
    found = []
    for tolerance in TOLERANCES:
        cells = []
        for norm in price.norms(rows):
            first = next(iter(price.cheapest(rows, norm, tolerance)), None)
            text = "-"
            if first is not None:
                line, seconds = first
                text = f"{line.name}, {duration(seconds)}"
                text = text if line.measured(tolerance) else f"({text})"
            cells.append(text)
        if any(text != "-" for text in cells):
            found.append([f"{tolerance:g}", *cells])
    return found


def best_eps(rows: Rows) -> list[list[str]]:
    """The largest eps without effect on the error, read off the map, beside theory and the two rules."""
    found, places = [], [row for row in rows if row["choice"] == "map"]
    for norm in (*price.norms(rows), "pressure"):
        pairs = price.largest_harmless_eps(rows, norm)
        power = price.power_of_h(pairs)
        if power is None:
            continue
        h, eps = pairs[-1]
        row = next(row for row in places if row["h"] == h)
        found.append([NORMS.get(norm, "pressure"), f"{power:.2f}", THEORY[norm], f"{h:.3g}", f"{eps:.1e}",
                      f"{row['paper']:.1e}", f"{row['auto']:.1e}"])  # fmt: skip
    return found


def against(rows: Rows) -> str:
    """A text about the reference solution of the errors."""
    first = price.truth(rows)
    if first["exact"]:
        parts = [f"contact {name} {first[name]:.9g}" for name in ("area", "force") if name in first]
        return "Errors are measured against the exact solution" + (f": {', '.join(parts)}." if parts else ".")
    changed = ", ".join(f"{NORMS[norm]} {value:.1e}" for norm, value in first["changed"].items())
    bound = first.get("bound")
    if bound is None:
        how = "No bound of its own error is known for this scene."
    else:
        kind = "at most" if bound["words"].startswith("certified") else "about"
        how = f"Its own energy error is {kind} {bound['total']:.2e} ({bound['words']})."
    return (
        "No exact solution is known: errors are measured against a reference solution with "
        f"{first['dofs']} unknowns. {how} Its last refinement changed it by: {changed}. "
        f"Errors within {price.TRUSTED:g} times that, or in the energy norm within the bound, are not included in "
        "curves and tables."
    )


def ended(rows: Rows, study: CostStudy) -> list[tuple[str, str]]:
    """The reason why each method has no further row."""
    failed = {row["choice"] for row in price.failures(rows)}
    return [
        (choice.name, ("failed: " if choice.name in failed else "ends: ") + study.ends[choice.name])
        for choice in study.choices
        if choice.name in study.ends
    ]


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
