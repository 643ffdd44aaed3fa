"""The errors of the package, each with its exit status on the command line."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from typing import Any

from fenicsx_obstacle.text import counted, printable

LOST_OUTPUT = 1
"""Exit status where standard output could not be written: the disk is full, or the reader has closed its pipe."""
WRONG = 3
"""Exit status where a check of an answer found it wrong."""
NOT_REACHED = 4
"""Exit status where an answer is saved, but a budget did not allow its tolerance."""


REMEDIES = {
    "penalty": "; try a larger eps, or the method vi",
    "successive": "; try a larger eps, or the method penalty",
}


class ObstacleError(Exception):
    """Base of all errors of this package."""

    exit_status = 1

    def __str__(self) -> str:
        return printable(super().__str__())


class InputError(ObstacleError):
    """The user's scene, file or option is wrong. The message names the place and the remedy."""

    exit_status = 2


class PenetrationWarning(UserWarning):
    """A given eps is so large that u penetrates an obstacle by a visible share of its range."""


class NotConverged(ObstacleError):
    """A solver did not reach its tolerance; nothing is returned.

    Attributes:
        solver: The requested method; `penalty` where there is no obstacle.
        reason: PETSc's reason, in words.
        iterations: Newton steps taken.
    """

    exit_status = 3

    def __init__(self, solver: str, reason: str, iterations: int, eps: float | None, h: float):
        super().__init__(solver, reason, iterations, eps, h)  # all that pickle takes to another rank
        self.solver, self.reason, self.iterations, self.eps, self.h = solver, reason, iterations, eps, h

    def __str__(self) -> str:
        where = f"h = {self.h:.3g}" if self.eps is None else f"eps = {self.eps:.3g}, h = {self.h:.3g}"
        remedy = "" if self.eps is None else REMEDIES.get(self.solver, "")
        steps = counted(self.iterations, "step")
        return f"{self.solver} did not converge in {steps} ({where}): {self.reason}{remedy}"

    def changed(self, **values: Any) -> NotConverged:
        """The same error with another `solver`, `reason` or `eps`."""
        return NotConverged(**{**vars(self), **values})


def interrupted(number: int, arguments: Sequence[str]) -> str:
    """What a command that a signal has ended says.

    Args:
        number: The signal.
        arguments: Of the command.
    """
    word = "interrupted" if number == signal.SIGINT else "terminated"
    has_rows = list(arguments[:1]) in (["study"], ["cost"], ["find"])
    return word + ("; finished rows are kept, and the same command continues from them" if has_rows else "")
