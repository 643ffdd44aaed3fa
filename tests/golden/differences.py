"""When two results agree."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

TOLERANCE = 1e-9
# counts of linear steps on several ranks: Gauss-Seidel is that of each rank's own unknowns, and which rank owns a
# shared vertex differs from one call of `create_mesh` to the next
KRYLOV = 2
ONE_RANK = "trace."  # fields that only one rank has
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class Difference:
    """A field with another value than before."""

    name: str
    field: str
    before: Any
    after: Any


def differences(name: str, before: dict[str, Any], after: dict[str, Any], ranks: int) -> list[Difference]:
    """Fields that do not agree.

    Args:
        name: Of the case.
        before: A line of the baseline: values, and perhaps `loose` and `varies`.
        after: Values.
        ranks: On how many they were computed.
    """
    old, loose, varies = before["values"], before.get("loose", {}), before.get("varies", [])
    found = []
    for field in [*old, *(field for field in after if field not in old)]:
        if field in varies:
            continue
        one, other = old.get(field, "(none)"), after.get(field, "(none)")
        if distance(one, other, floor(field, old)) > max(loose.get(field, 0.0), allowance(field, ranks)):
            found.append(Difference(name, field, one, other))
    return found


def agreed(name: str, runs: Sequence[dict[str, Any]], ranks: int) -> dict[str, Any]:
    """A line of the baseline from several runs: values of the first, and what the others say of them."""
    first, loose, varies = runs[0], {}, []
    for field in sorted({field for run in runs for field in run}):
        values = [run.get(field, "(none)") for run in runs]
        spread = max(distance(values[0], value, floor(field, first)) for value in values)
        if spread == math.inf:
            varies.append(field)
        elif spread > 0.1 * allowance(field, ranks):
            loose[field] = float(f"{10 * spread:.1g}")
    kept = {field: value for field, value in first.items() if field not in varies}
    return {"values": kept, **({"loose": loose} if loose else {}), **({"varies": varies} if varies else {})}


def shortened(line: dict[str, Any], first: dict[str, Any] | None, ranks: int) -> dict[str, Any]:
    """A line of the baseline of several ranks, without the values that agree with those of one rank."""
    if first is None:
        return line
    old, new = first["values"], line["values"]
    kept = {
        field: value for field, value in new.items()
        if distance(old.get(field, "(none)"), value, floor(field, old)) > allowance(field, 1)
    }  # fmt: skip
    lacks = [field for field in old if field not in new and not field.startswith(ONE_RANK)]
    rest = {key: value for key, value in line.items() if key != "values"}
    return {"as_on_one_rank_but": kept, **({"without": lacks} if lacks else {}), **rest}


def expanded(line: dict[str, Any], first: dict[str, Any] | None) -> dict[str, Any]:
    """The line that `shortened` has shortened."""
    if first is None or "values" in line:
        return line
    without = line.get("without", [])
    old = {
        field: value for field, value in first["values"].items()
        if field not in without and not field.startswith(ONE_RANK)
    }  # fmt: skip
    return {**line, "values": {**old, **line["as_on_one_rank_but"]}}


def allowance(field: str, ranks: int) -> float:
    """How far values may be apart that count as equal: relative, for counts absolute."""
    if "krylov" in field:
        return KRYLOV if ranks > 1 else 0.0
    return TOLERANCE


def floor(field: str, values: dict[str, Any]) -> float:
    """The scale of values that may be 0 up to round-off: a share of the largest value that stands beside them."""
    if field.startswith("json.") and field.endswith(("observed", "expected")):  # of a statement; many are 0
        return 1e-3
    group = field.rpartition(".")[0]
    if not group:
        return 0.0
    # sums of forces in reports, and algebraic errors in bounds, are differences of larger numbers
    share = 1e-2 if group.endswith(("report", "bound")) else 1e-4
    beside = [value for key, value in values.items() if key.startswith(f"{group}.")]
    numbers = [one for value in beside for one in (value if isinstance(value, list) else [value])]
    return share * max((abs(one) for one in numbers if isinstance(one, float)), default=0.0)


def distance(one: Any, other: Any, scale: float = 0.0) -> float:
    """0 for equal values, the relative difference of floats, the difference of whole numbers, else infinite."""
    if one == other:
        return 0.0
    if isinstance(one, bool) or isinstance(other, bool) or one is None or other is None:
        return math.inf
    if isinstance(one, int) and isinstance(other, int):
        return float(abs(one - other))
    if isinstance(one, int | float) and isinstance(other, int | float):
        return abs(one - other) / max(abs(one), abs(other), scale)
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        numbers = [abs(value) for value in (*one, *other) if isinstance(value, float)]
        scale = max([scale, *numbers])
        return max(distance(a, b, scale) for a, b in zip(one, other, strict=True))
    if isinstance(one, str) and isinstance(other, str) and NUMBER.split(one) == NUMBER.split(other):
        pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
        return 0.0 if all(_same_digits(a, b) for a, b in pairs) else math.inf
    return math.inf


def _same_digits(one: str, other: str) -> bool:
    """Whether numbers in a text differ by at most one in their last digit."""
    if one == other:
        return True
    if "." not in one + other and "e" not in (one + other).lower():
        return False
    units = []
    for text in (one, other):
        digits, _, exponent = text.lower().partition("e")
        units.append(10.0 ** (int(exponent or 0) - len(digits.partition(".")[2])))
    return abs(float(one) - float(other)) <= 1.01 * max(units)
