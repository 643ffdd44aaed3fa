"""Numbers in sentences."""

from __future__ import annotations

from typing import Any


def counted(number: int, noun: str) -> str:
    """A number with its noun: 1 step, 2 steps."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def plain(value: Any) -> str:
    """A number or formula as one writes it: 0 and not 0.0."""
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def short(value: Any) -> str:
    """A number or formula in few characters."""
    return f"{value:g}" if isinstance(value, float) else str(value)
