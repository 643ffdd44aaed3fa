"""Evaluation of the rows of `cost`: the fastest method for an error, and the time for one more digit.

Errors are relative. Along the rows of a choice, log error is taken to be linear in log seconds between two rows, and
beyond the last one with the slope of the last three.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Rows = Sequence[Mapping[str, Any]]
NORMS = {
    "energy": "energy norm",
    "l2": "L2 norm",
    "max": "maximum norm",
    "force": "contact force",
    "area": "contact area",
}
TOLERANCES = tuple(10.0**-k for k in range(1, 7))
FAR = 20.0  # times beyond the last error of a choice its line is continued: to a tenth of twice the smallest, at most
TRUSTED = 3.0  # smaller errors, relative to the uncertainty of the reference, are not used
NEGLIGIBLE_SIZE = 1e-9  # of the largest area or force in all rows: no contact to be measured
STEEPEST = 1.5  # errors that fall faster than unknowns^-1.5, order 3 in h, are accidental: the error changes its sign
FLAT = 0.02  # slope of log error over log seconds below which it does not fall


@dataclass(frozen=True)
class Curve:
    """Errors of one choice in one norm, falling along its rows.

    Attributes:
        name: Of the choice.
        rows: Those with such an error, cheapest first.
        error: Relative; of each row the largest of its own and all slower rows, and none that falls steeper than
            `STEEPEST`, so that lucky hits do not count.
        slope: Of log error over log seconds at the end; 0 where it does not fall.
        failed: Whether it did not converge on the next mesh: its line is not continued.
    """

    name: str
    rows: Rows
    error: np.ndarray
    slope: float
    failed: bool = False

    def cost(self, error: float, key: str = "seconds") -> float | None:
        """Seconds, or another figure, for an error; None beyond `FAR` (local)."""
        e, cost = np.log(self.error), np.log([max(row[key], 1e-300) for row in self.rows])
        target = math.log(error)
        if target >= e[0]:
            return float(np.exp(cost[0]))
        if target >= e[-1]:
            return float(np.exp(np.interp(-target, -e, cost)))
        if self.failed or self.slope >= -FLAT or error * FAR < self.error[-1] * (1 - 1e-9):
            return None
        # small meshes cost the same whatever their size: nothing grows less than the unknowns
        of_size = _slope(self.rows, self.error, "dofs")
        slope = max(_slope(self.rows, self.error, key), of_size)
        return None if slope >= -FLAT else float(np.exp(cost[-1] + (target - e[-1]) / slope))

    def measured(self, error: float) -> bool:
        """Whether its rows go so far."""
        return error >= self.error[-1]


@dataclass(frozen=True)
class Price:
    """The cost of one more digit in one norm.

    Attributes:
        line: The cheapest of the choices that came within a factor of 2 of the smallest error.
        error: Its error.
        seconds: What it took.
        way: The cheapest choice for error/10, None where none is in sight.
        factor: Its seconds over those, None without it.
    """

    line: Curve
    error: float
    seconds: float
    way: Curve | None
    factor: float | None


def solved(rows: Rows) -> list[Mapping[str, Any]]:
    """Rows of choices that have errors: neither the truth nor the map, nor failures."""
    return [row for row in rows if row["choice"] not in ("", "map") and "errors" in row]


def failures(rows: Rows) -> list[Mapping[str, Any]]:
    """Rows that have a reason in place of errors."""
    return [row for row in rows if row["choice"] not in ("", "map") and "errors" not in row]


def truth(rows: Rows) -> Mapping[str, Any]:
    """The row of the reference solution."""
    return next(row for row in rows if row["choice"] == "")


def relative(row: Mapping[str, Any], norm: str) -> float | None:
    """Error over the size of the solution; None where either is not known or there is nothing to measure."""
    error, size = row.get("errors", {}).get(norm), row.get("sizes", {}).get(norm)
    if error is None or not size or not math.isfinite(error):
        return None
    return error / size


def norms(rows: Rows) -> list[str]:
    """The norms that these rows contain."""
    return [
        norm for norm in NORMS if any((relative(row, norm) or 0) > 0 for row in solved(rows)) and _there(rows, norm)
    ]


def _there(rows: Rows, norm: str) -> bool:
    """Whether there is anything to measure: no area where contact is a point."""
    size = truth(rows).get(norm, solved(rows)[-1]["sizes"].get(norm))
    most = max(abs(row["sizes"].get(norm) or 0.0) for row in solved(rows))
    return norm not in ("force", "area") or abs(size or 0.0) > NEGLIGIBLE_SIZE * most


def curves(rows: Rows, norm: str) -> list[Curve]:
    """One for each choice with rows that can be trusted."""
    found, failed = [], {row["choice"] for row in failures(rows)}
    for name, given in trusted(rows, norm).items():
        part = sorted(given, key=lambda row: row["seconds"])
        errors = np.array([relative(row, norm) for row in part])
        for k in range(1, len(part)):
            fall = (part[k - 1]["dofs"] / part[k]["dofs"]) ** STEEPEST
            errors[k] = max(errors[k], errors[k - 1] * min(fall, 1.0))
        errors = np.maximum.accumulate(errors[::-1])[::-1]
        found.append(Curve(name, part, errors, _slope(part, errors, "seconds"), name in failed))
    return found


def trusted(rows: Rows, norm: str) -> dict[str, list[Mapping[str, Any]]]:
    """The rows of each choice with an error that can be trusted."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in solved(rows):
        if (relative(row, norm) or 0) > 0 and _is_trusted(truth(rows), row, norm):
            found.setdefault(row["choice"], []).append(row)
    return found


def _is_trusted(first: Mapping[str, Any], row: Mapping[str, Any], norm: str) -> bool:
    """Whether an error is larger than what the reference itself may be off."""
    if first["exact"]:
        return True
    if norm == "energy" and "bound" in first:
        return bool(row["errors"][norm] > first["bound"]["total"])
    return bool(row["errors"][norm] > TRUSTED * first["changed"].get(norm, 0.0))


def _slope(rows: Rows, errors: np.ndarray, key: str) -> float:
    """d log error / d log cost over the last three rows, or 0 for one row."""
    e, cost = np.log(errors[-3:]), np.log([max(row[key], 1e-300) for row in rows[-3:]])
    if len(e) < 2 or np.ptp(cost) == 0 or np.ptp(e) == 0:
        return 0.0
    return float(np.polyfit(cost, e, 1)[0])


def price(rows: Rows, norm: str) -> Price | None:
    """The cost of one more digit; None without measurements."""
    lines = curves(rows, norm)
    if not lines:
        return None
    best = min(line.error[-1] for line in lines)
    near = [line for line in lines if line.error[-1] <= 2 * best]
    line = min(near, key=lambda line: line.cost(2 * best) or math.inf)
    seconds, error = line.rows[-1]["seconds"], float(line.error[-1])
    way, then = next(iter(cheapest(rows, norm, error / 10)), (None, None))
    return Price(line, error, seconds, way, None if then is None else then / seconds)


def cheapest(rows: Rows, norm: str, error: float) -> list[tuple[Curve, float]]:
    """Choices with the seconds that they take for an error, the cheapest first."""
    found = [(line, line.cost(error)) for line in curves(rows, norm)]
    return sorted(((line, cost) for line, cost in found if cost is not None), key=lambda pair: pair[1])


def digits(row: Mapping[str, Any], norm: str) -> tuple[float, float, float] | None:
    """Digits of accuracy -log10(error), of size log10(unknowns), of efficacy -log10(error seconds).

    Time-accuracy-size: J. Chang, M. S. Fabien, M. G. Knepley, R. T. Mills (2018).
    """
    error = relative(row, norm)
    if not error:
        return None
    return -math.log10(error), math.log10(row["dofs"]), -math.log10(error * row["seconds"])


def unit(rows: Rows) -> float | None:
    """Seconds of one Poisson solve with linear elements on the finest uniform mesh, the unit of cost."""
    found = [row for row in solved(rows) if row.get("poisson_seconds") and row["element"] != "P2"]
    return max(found, key=lambda row: row["dofs"])["poisson_seconds"] if found else None


def largest_harmless_eps(rows: Rows, norm: str) -> list[tuple[float, float]]:
    """For each mesh of the map, h and the largest eps that makes the error at most a tenth larger than a tiny eps does.

    Between two values of eps, log error is linear in log eps.
    """
    found = []
    for h in sorted({row["h"] for row in rows if row["choice"] == "map"}, reverse=True):
        part = [row for row in rows if row["choice"] == "map" and row["h"] == h and norm in row.get("errors", {})]
        part = sorted(part, key=lambda row: row["eps"])
        errors = np.array([row["errors"][norm] for row in part])
        if len(errors) < 3 or errors[0] <= 0:
            continue
        limit = 1.1 * errors[0]
        above = np.flatnonzero(errors > limit)
        if len(above) and above[0] > 0:
            k = above[0]
            eps, e = np.log([row["eps"] for row in part[k - 1 : k + 1]]), np.log(errors[k - 1 : k + 1])
            found.append((h, float(np.exp(np.interp(math.log(limit), e, eps)))))
    return found


def power_of_h(pairs: Sequence[tuple[float, float]]) -> float | None:
    """q of eps = c h^q through these; None through fewer than two."""
    if len(pairs) < 2:
        return None
    h, eps = np.log(np.array(pairs)).T
    return float(np.polyfit(h, eps, 1)[0])
