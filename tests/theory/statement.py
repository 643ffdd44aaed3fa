"""Statements of the paper: a function that measures, rows of a table, and one picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import nearest

RATE_MARGIN = 0.15  # between rates that count as the same
CLOSE = 0.05  # between constants that count as the same, relative
_MODULES: tuple[str, ...] = (  # in the order of the paper
    "signs", "monotone", "limits", "iteration", "digits", "algebra", "in_eps", "stability", "in_h", "totals",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One row: a claim and what is observed.

    Attributes:
        statement: Where the paper says it: "Thm 3.3, (5.5)".
        quantity: What is measured, on what.
        claimed: The paper's claim, in a few words or as a number.
        expected: What the theory, sharpened or corrected where it has to be, gives; None where it gives no number.
        observed: What is measured here.
        verdict: holds, not sharp, sharp, misprint, needs hypothesis, or FAILS.
    """

    statement: str
    quantity: str
    claimed: str
    expected: float | None
    observed: float
    verdict: str

    @property
    def record(self) -> dict[str, Any]:
        """The row as JSON takes it."""
        return dict(vars(self))


@dataclass(frozen=True)
class Curve:
    """A line of a picture.

    Attributes:
        label: Its name.
        x: Abscissae.
        y: Ordinates.
        slope: Order to draw at its last point, None for none.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    slope: float | None = None


@dataclass(frozen=True)
class Panel:
    """One of the axes of a picture.

    Attributes:
        title: Above it.
        x: Label of the abscissa.
        y: Label of the ordinate.
        curves: What is drawn.
        scales: Of the two axes: "log" or "linear".
    """

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    scales: tuple[str, str] = ("log", "log")


@dataclass(frozen=True)
class Found:
    """What measuring a statement gave; the same on every rank."""

    findings: Sequence[Finding]
    panels: Sequence[Panel] = field(default=())


@dataclass(frozen=True)
class Statement:
    """A statement of the paper.

    Attributes:
        number: As the paper numbers it: "3.3", "(3.27)".
        title: One line.
        also: Further numbers that find it.
        measure: Measures it, on a communicator (collective).
    """

    number: str
    title: str
    also: tuple[str, ...]
    measure: Callable[[MPI.Comm], Found]


_register: dict[str, Statement] = {}


def statement(number: str, title: str, *also: str) -> Callable[[Callable[[MPI.Comm], Found]], Any]:
    """Decorator: the function measures the statement of this number."""

    def note(measure: Callable[[MPI.Comm], Found]) -> Callable[[MPI.Comm], Found]:
        assert number not in _register, number
        _register[number] = Statement(number, title, also, measure)
        return measure

    return note


def statements() -> list[Statement]:
    """All statements, in the order of their modules."""
    for name in _MODULES:
        import_module(f"tests.theory.{name}")
    return list(_register.values())


def find(number: str) -> Statement:
    """The statement of a number.

    Raises:
        InputError: If there is none, naming those that are near.
    """
    wanted, known = number.strip("()"), {}
    for one in statements():
        for name in (one.number, *one.also):
            known[name.strip("()")] = one
    if wanted not in known:
        raise InputError(f"theory {number}: no such statement" + nearest(wanted, known))
    return known[wanted]


def rate(where: str, quantity: str, claimed: float, expected: float, x: Sequence[float], y: Sequence[float]) -> Finding:
    """A claimed and an observed order, the slope of log y over log x by least squares.

    Args:
        where: Where the paper says it.
        quantity: What is measured, on what.
        claimed: The paper's order.
        expected: The order that the sharpest known argument gives.
        x: eps or h.
        y: Errors.
    """
    seen = slope(x, y)
    if abs(seen - expected) > RATE_MARGIN:
        verdict = "FAILS"
    else:
        verdict = "sharp" if abs(expected - claimed) <= RATE_MARGIN / 2 else "not sharp"
        verdict = verdict if expected >= claimed - RATE_MARGIN / 2 else "needs hypothesis"
    return Finding(where, quantity, f"order {claimed:.3g}", expected, seen, verdict)


def constant(where: str, quantity: str, claimed: str, expected: float, observed: float, good: str = "holds") -> Finding:
    """A claimed and a measured constant; `good` is the verdict where they agree."""
    agree = math.isclose(observed, expected, rel_tol=CLOSE, abs_tol=1e-12)
    return Finding(where, quantity, claimed, expected, observed, good if agree else "FAILS")


def check(where: str, quantity: str, claimed: str, observed: float, holds: bool, good: str = "holds") -> Finding:
    """A claim that is no number: an inequality, a sign, a count; `good` is the verdict where it `holds`."""
    return Finding(where, quantity, claimed, None, observed, good if holds else "FAILS")


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of log y over log x by least squares."""
    return float(np.polyfit(np.log(np.asarray(x)), np.log(np.asarray(y)), 1)[0])
