"""Strategies that several families share."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st


def power(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of any magnitude between 10^low and 10^high, with three digits."""
    return st.floats(low, high).map(lambda x: float(f"{10**x:.3g}"))


def place(low: float = 0.0, high: float = 1.0) -> st.SearchStrategy[float]:
    """Numbers with three digits, seldom on a line of a mesh."""
    return st.integers(1, 999).map(lambda k: round(low + (high - low) * k / 1000, 6))


@st.composite
def grids(draw: st.DrawFn, low: int = 4, high: int = 16) -> dict[str, Any]:
    """The table [mesh] of a unit square of triangles."""
    mesh: dict[str, Any] = {"shape": "rectangle", "cells": draw(st.integers(low, high))}
    mesh["diagonal"] = draw(st.sampled_from(["right", "left", "crossed", "union-jack"]))
    mesh["perturb"] = draw(st.sampled_from([0.0, 0.0, 0.2]))
    return mesh


@st.composite
def bounds(draw: st.DrawFn, unknowns: str = "2e3", *, seldom: bool = False) -> dict[str, Any]:
    """What is asked for: a bound, or a tolerance (`seldom`: it takes more time); on P1 or P2."""
    element = draw(st.sampled_from(["P1", "P2"]))
    tolerance = draw(st.sampled_from([None] * (12 if seldom else 2) + [0.3, 0.1, 0.05]))
    asked = {"bound": True} if tolerance is None else {"tol": tolerance, "budget": f"{unknowns} unknowns"}
    return {"element": element, **asked}
