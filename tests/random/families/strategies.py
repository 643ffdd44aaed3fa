"""Strategies that several families share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hypothesis import strategies as st

DIAGONALS = ("right", "left", "crossed", "union-jack")


def power(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of any magnitude between 10^low and 10^high, with three digits."""
    return st.floats(low, high).map(lambda x: float(f"{10**x:.3g}"))


def place(low: float = 0.0, high: float = 1.0) -> st.SearchStrategy[float]:
    """Numbers with three digits, seldom on a line of a mesh."""
    return st.integers(1, 999).map(lambda k: round(low + (high - low) * k / 1000, 6))


def grids(
    low: int = 4, high: int = 16, perturb: Sequence[float] = (0.0, 0.0, 0.2), **ends: Sequence[float]
) -> st.SearchStrategy[dict[str, Any]]:
    """The table [mesh] of a rectangle of triangles, by default the unit square."""
    return st.fixed_dictionaries({
        "shape": st.just("rectangle"), "cells": st.integers(low, high), "diagonal": st.sampled_from(DIAGONALS),
        "perturb": st.sampled_from(perturb), **{axis: st.just(list(places)) for axis, places in ends.items()},
    })  # fmt: skip


def bounds(*, seldom: bool = False, elements: Sequence[str] = ("P1", "P2")) -> st.SearchStrategy[dict[str, Any]]:
    """What is asked for: a bound, or a tolerance (`seldom`: it takes more time)."""
    budget = "500 unknowns" if seldom else "2e3 unknowns"
    asked = [{"bound": True}] * (12 if seldom else 2) + [{"tol": tol, "budget": budget} for tol in (0.3, 0.1, 0.05)]
    return st.builds(lambda element, one: {**one, "element": element}, st.sampled_from(elements),
                     st.sampled_from(asked))  # fmt: skip


def bounds_by_all_ways(*elements: str) -> st.SearchStrategy[dict[str, Any]]:
    """The same for scenes with contact: by each method, with several eps."""
    ways = st.sampled_from([{}, {}, {"method": "vi"}, {"eps": 1e-10}, {"eps": "h"}, {"eps": "h^2"}])
    return st.builds(lambda asked, way: asked | way, bounds(seldom=True, elements=elements), ways)
