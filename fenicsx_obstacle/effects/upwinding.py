"""Upwinding: test functions by which drift across coarse cells does not make u oscillate (SUPG)."""

from __future__ import annotations

from typing import Any

import ufl


def upwinded(v: Any, b: Any, tension: Any, h: Any) -> Any:
    """Test functions v + tau b . grad v with tau = max(0, |b| h/2 - tension)/|b|^2; v where b = 0.

    Args:
        v: Test function.
        b: Drift.
        tension: A number or a matrix.
        h: Side of each cell.
    """
    squared = ufl.inner(b, b)
    along = ufl.inner(tension * b, b) / squared if tension.ufl_shape else tension
    excess = ufl.max_value(ufl.sqrt(squared) * h / 2 - along, 0.0)
    return v + ufl.conditional(ufl.gt(squared, 0.0), excess / squared, 0.0) * ufl.inner(b, ufl.grad(v))
