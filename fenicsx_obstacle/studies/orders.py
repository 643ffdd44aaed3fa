"""Orders of the measured quantities according to the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """A measured quantity that tends to zero.

    Attributes:
        key: Dotted name in a row.
        label: Head of its column.
        tex: The same for pictures.
        order: The order to expect in the varied parameter.
        stated: Whether the paper states it; otherwise it is the best that P1 can give.
    """

    key: str
    label: str
    tex: str
    order: float
    stated: bool


IN_EPS = (  # h fixed: (5.5), Theorem 3.3, and (3.7) for the penetration
    Quantity("to_vi.energy", "|u_eps-u_h|_a", r"$\|u_\epsilon-u_h\|_a$", 1.0, True),
    Quantity("to_vi.max", "max|u_eps-u_h|", r"$\max|u_\epsilon-u_h|$", 1.0, True),
    Quantity("to_vi.pressure_l2", "|p_eps-p_h|_0", r"$\|p_\epsilon-p_h\|_0$", 1.0, True),
    Quantity("penetration", "penetration", "penetration", 1.0, True),
)
IN_H = (  # (5.6)-(5.9); of the pressure in L2, (5.7) claims no more than that it is bounded
    Quantity("errors.h1", "|u-u_h|_1", r"$\|u-u_h\|_1$", 1.0, True),
    Quantity("errors.l2", "|u-u_h|_0", r"$\|u-u_h\|_0$", 2.0, False),
    Quantity("errors.max", "max|u-u_h|", r"$\max|u-u_h|$", 2.0, False),
    Quantity("errors.pressure_l2", "|p-p_h|_0", r"$\|p-p_h\|_0$", 0.0, True),
    Quantity("errors.pressure_dual", "|p-p_h|_1*", r"$\|p-p_h\|_1^*$", 1.0, True),
)


def lookup(row: Mapping[str, Any], key: str) -> Any:
    """Value at a dotted key, or None."""
    if key in row:
        return row[key]
    value: Any = row
    for step in key.split("."):
        value = value.get(step) if isinstance(value, Mapping) else None
    return value


def parameter(varied: Sequence[str]) -> str:
    """The parameter of the orders: eps if it varies, h if meshes vary, otherwise ''."""
    if "eps" in varied or "solve.eps" in varied:
        return "eps"
    return "h" if {"cells", "refine", "mesh.cells", "mesh.refine"} & set(varied) else ""


def quantities(varied: Sequence[str], row: Mapping[str, Any]) -> list[Quantity]:
    """The quantities that this study measures."""
    candidates = IN_EPS if parameter(varied) == "eps" else IN_H
    return [quantity for quantity in candidates if lookup(row, quantity.key) is not None]


def order(key: str, row: Mapping[str, Any], before: Mapping[str, Any] | None, by: str) -> float | None:
    """Observed order between two rows, log(e1/e0) / log(x1/x0), that differ in the parameter only."""
    if before is None or not by:
        return None
    x1, x0, e1, e0 = (lookup(r, k) for k in (by, key) for r in (row, before))
    if not all(isinstance(v, float) and v > 0 for v in (x1, x0, e1, e0)) or x1 == x0:
        return None
    return math.log(e1 / e0) / math.log(x1 / x0)
