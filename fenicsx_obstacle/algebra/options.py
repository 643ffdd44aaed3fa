"""Options of a solve: method, eps and start. Needs no scene and no mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import plain

MethodName = Literal["penalty", "successive", "vi"]
StartName = Literal["nested", "cold"]


@dataclass(frozen=True)
class EpsFormula:
    """eps as a formula in the mesh size h.

    Attributes:
        text: The formula, for messages and files: two with the same text are equal.
        value: Its value for h.
        scaled: Whether it depends on h; it is then yet to be divided by the largest tension.
    """

    text: str
    value: Callable[[float], float] = field(compare=False, repr=False)
    scaled: bool = True


# its error is a few per cent of that of the mesh; the cost does not depend on eps
AUTO = EpsFormula("h^2/100", lambda h: float(np.power(h, 2.0) / 100))  # digit for digit what a scene makes of the text


@dataclass(frozen=True)
class SolverOptions:
    """Options of a solve; `dataclasses.replace(options, eps=1e-6)` changes one.

    The element is not among them: it belongs to the mesh, on which it makes the discrete problem.

    Attributes:
        method: penalty, successive or vi.
        eps: Penalty parameter: a number in units of u/p, a formula in h, or "auto" (`penalty_parameter`).
        start: nested, from the coarsest level of the mesh on, or cold.
        source: Where they come from, for messages.

    Raises:
        InputError: If a value is not one of these.
    """

    method: str = "penalty"
    eps: float | str | EpsFormula = "auto"
    start: str = "nested"
    source: str = field(default="SolverOptions:", compare=False, repr=False)

    def __post_init__(self) -> None:
        for key, known in (("method", get_args(MethodName)), ("start", get_args(StartName))):
            if getattr(self, key) not in known:
                wanted = f"expected {', '.join(known[:-1])} or {known[-1]}"
                raise InputError(f"{self.source} {key} = {getattr(self, key)!r}: {wanted}")
        if self.eps == "auto":
            return
        if not isinstance(self.eps, EpsFormula):
            try:
                if isinstance(self.eps, bool | str):
                    raise TypeError
                object.__setattr__(self, "eps", float(self.eps))
            except (TypeError, ValueError):
                wanted = "expected a number, an EpsFormula or 'auto'"
                raise InputError(f"{self.source} eps = {self.eps!r}: {wanted}") from None
        eps = self.formula.value(1.0)
        if not math.isfinite(eps):
            raise InputError(f"{self.source} eps = {self.formula.text}: is {eps}")
        if eps <= 0:
            raise InputError(f"{self.source} eps = {self.formula.text}: must be positive and finite")

    @property
    def formula(self) -> EpsFormula:
        """eps as a formula, whatever it was given as."""
        if isinstance(self.eps, EpsFormula):
            return self.eps
        if isinstance(self.eps, str):
            return AUTO
        eps = self.eps
        return EpsFormula(plain(eps), lambda h: eps, scaled=False)
