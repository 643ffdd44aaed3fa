"""(2.8)-(2.13): which penalty operators are monotone. The one by the duality map of H1 is not; the one in L2 is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from scipy import sparse

from fenicsx_obstacle.check.reference import active_sets
from tests.theory.signs import even
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, statement

PAIRS, WAVES = 4, 6  # random pairs of functions, and sines of which each is made
LINE = even(200)
X = LINE.nodes[1:-1]
HAT = 0.05 * np.maximum(1 - np.abs(X - 0.5) / 0.1, 0.0)  # of height 0.05, from 0.4 to 0.6
RAMP = np.minimum(np.minimum(X, 1 - X) / 0.2, 1.0)  # up to 1 within 0.2 of each end
H1, LUMPED = LINE.H, np.diag(LINE.D)  # of ((u, v)) + ((u', v')), and of I(u, v)
Pair = tuple[np.ndarray, np.ndarray]


@statement("2.10", "Which penalty operators are monotone",
           "2.8", "2.9", "2.11", "2.12", "2.13")  # fmt: skip
def penalties(comm: MPI.Comm) -> Found:
    """beta(u) - beta(v) on u - v for three penalty operators, with g = 0, P1 on (0, 1)."""
    u, v = HAT, 10 * HAT - RAMP
    random = np.random.default_rng(1981)
    waves = np.sin(np.pi * np.outer(np.arange(1, WAVES + 1), X)) / np.arange(1, WAVES + 1)[:, None]
    pairs = [(one, other) for one, other in random.standard_normal((PAIRS, 2, WAVES)) @ waves]
    panels = [
        _panel("J((u - g)^+) is not monotone on this pair", {"u": u, "v = 10 u - ramp": v}),
        _panel("what is beyond K", {"u^+": u, "u - P_K u": _beyond(u)}),
    ]
    return Found([*_duality(u, v), *_projection(u, pairs), *_nodal([(u, v), *pairs])], panels)


def _positive(u: np.ndarray) -> np.ndarray:
    return np.maximum(u, 0.0)


def _beyond(u: np.ndarray) -> np.ndarray:
    """u - P_K u, K = {v <= 0}, P_K u the nearest of K in H1: a variational inequality."""
    start, low, high = (np.full(len(u), value) for value in (0.0, -np.inf, 0.0))
    nearest = active_sets(sparse.csc_matrix(H1), H1 @ u, LINE.D, low, high, start, None)
    assert nearest is not None
    return u - nearest


def _panel(title: str, functions: dict[str, np.ndarray]) -> Panel:
    """Drawn at every tenth node: those where the slopes change are among them."""
    curves = [Curve(name, list(LINE.nodes[::10]), list(np.pad(values, 1)[::10])) for name, values in functions.items()]
    return Panel(title, "x", "height, g = 0", curves, ("linear", "linear"))


def _duality(u: np.ndarray, v: np.ndarray) -> list[Finding]:
    """J((u - g)^+) of (2.10), J the duality map: <J w, z> is the product of w and z in H1."""
    value = float((_positive(u) - _positive(v)) @ H1 @ (u - v))
    # v < 0, so that it is (u, u - v) = (u, ramp) - 9 (u, u), and the ramp is 1 where u is not 0
    by_hand = 0.05 * 0.1 - 9 * (0.05**2 / 0.1 * 2 + 0.05**2 * 0.2 / 3)
    highest = float((-H1 @ _positive(u)).max())
    return [
        constant("(2.10)", "<J u^+ - J v^+, u - v>, a hat u and v = 10 u - ramp", "monotone: >= 0", by_hand, value,
                 "needs hypothesis"),
        check("(2.13)", "largest nodal value of -J u^+, a hat u", "<= 0, p_eps in N", highest, highest > 0.1,
              "needs hypothesis"),
    ]  # fmt: skip


def _projection(u: np.ndarray, pairs: list[Pair]) -> list[Finding]:
    """J(I - P_K) of (2.8): monotone, and Lipschitz with constant 1; and how far P_K is from the smaller of u and g."""
    apart = _beyond(u) - _positive(u)
    size = float(np.sqrt(apart @ H1 @ apart / (u @ H1 @ u)))
    least = min(_ratio(H1, pair, _beyond) for pair in pairs)
    return [
        check("(2.10)", "|(u - P_K u) - u^+| / |u| in H1, a hat u", "the same operator", size, size > 0.1,
              "needs hypothesis"),
        check("(2.8)", f"least <beta u - beta v, u - v> / |beta u - beta v|^2, {PAIRS} pairs", "monotone: >= 0", least,
              least >= 1 - 1e-6),
    ]  # fmt: skip


def _nodal(pairs: list[Pair]) -> list[Finding]:
    """I((u - g)^+, .) of (3.2)-(3.4), the penalty that this package has."""
    least = min(_ratio(LUMPED, pair, _positive) for pair in pairs)
    changes = [(_positive(u) - _positive(v), u - v) for u, v in pairs]
    most = max(float(np.sqrt(change @ LUMPED @ change / (apart @ LUMPED @ apart))) for change, apart in changes)
    return [
        check("(3.2), (3.3)", "least I(u^+ - v^+, u - v) / I(u^+ - v^+, u^+ - v^+)", "monotone: >= 0", least,
              least >= 1 - 1e-12),
        check("(3.2), (3.3)", "largest |u^+ - v^+| / |u - v| in the norm of I", "Lipschitz", most, most <= 1),
    ]  # fmt: skip


def _ratio(product: np.ndarray, pair: Pair, part: Callable[[np.ndarray], np.ndarray]) -> float:
    """(part(u) - part(v), u - v) over the square of part(u) - part(v)."""
    u, v = pair
    change = part(u) - part(v)
    return float(change @ product @ (u - v) / (change @ product @ change))
