"""Base class of families of random scenes, and the judgement of a result."""

from __future__ import annotations

import logging
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solve import solve
from fenicsx_obstacle.errors import InputError, ObstacleError
from fenicsx_obstacle.mesh.shapes import SHAPES
from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field

ANSWER, REJECTION, EITHER, INPUT_ERROR = "an answer", "a rejection", "either", "a rejection of the input"
LONGEST = 2000  # characters of a formula
ROUND_OFF = 1e-12  # of the energy norm: no error can be computed more accurately
Result = TypeVar("Result")


class Judgement:
    """Verdict on one drawn scene.

    Attributes:
        comm: Communicator.
        wrong: What is against the truth, in words.
        answers: How many solutions were returned.
        rejected: How many times data were rejected, or no solution was found.
        bounds: Each bound that was compared with a true error: words, total, error, norm, whether it is claimed.
        said: Warnings of the last attempt.
        crashed: Whether an error was raised that is none of this package's.
    """

    def __init__(self, comm: MPI.Comm):
        self.comm = comm
        self.wrong: list[str] = []
        self.answers = self.rejected = 0
        self.bounds: list[dict[str, Any]] = []
        self.said: list[str] = []
        self.crashed = False

    def check(self, holds: bool, words: str) -> None:
        """Note a failure unless something holds (the same on every rank)."""
        if not holds:
            self.wrong.append(words)

    def attempt(self, action: Callable[[], Result], expected: str, what: str = "solve") -> Result | None:
        """Call the program (collective).

        Args:
            action: The call.
            expected: ANSWER, REJECTION (of any kind), INPUT_ERROR, or EITHER.
            what: The call in words.

        Returns:
            What it returned; None where it was rejected.
        """
        try:
            with _listening() as self.said:
                found = action()
        except ObstacleError as error:
            self.rejected += 1
            name = type(error).__name__
            self.check(expected != ANSWER, f"{what}: must be answered, not rejected: {name}: {error}")
            if expected == INPUT_ERROR:
                self.check(isinstance(error, InputError), f"{what}: must be an InputError, not {name}: {error}")
            return None
        except Exception as error:
            if self.comm.size > 1:  # the other ranks may wait for this one
                raise
            self.crashed = True
            self.check(False, f"{what}: {type(error).__name__}: {error}")
            return None
        self.answers += 1
        self.check(expected in (ANSWER, EITHER), f"{what}: must be rejected, not answered")
        return found

    def solve(
        self, scene: Callable[[], Scene], expected: str = ANSWER, what: str = "", **options: Any
    ) -> Answer | None:
        """Make a scene and solve it (collective)."""
        words = what or ", ".join(["solve", *(f"{key}={value!r}" for key, value in options.items())])
        return self.attempt(lambda: solve(scene(), comm=self.comm, **options), expected, words)

    def near(self, answer: Answer, least: float, most: float, margin: float) -> None:
        """u must go from one value to the other, up to a margin (collective)."""
        low, high = Field(answer.u).ends()
        self.check(max(abs(low - least), abs(high - most)) <= margin,
                   f"u from {low:.8g} to {high:.8g}; true: from {least:.8g} to {most:.8g}")  # fmt: skip

    def certificate(self, answer: Answer, error: float, norm: float, accuracy: float = 1e-9) -> None:
        """A bound that is said to hold must hold.

        Args:
            answer: Solved with a bound or a tolerance.
            error: True energy error, or less.
            norm: Energy norm of the true solution.
            accuracy: Of `error`, relative.
        """
        assert answer.bound is not None
        limit = answer.bound.total * (1 + accuracy) + ROUND_OFF * norm
        words = f"'{answer.bound.words}': bound {answer.bound.total:.6g}, true error {error:.6g}"
        claimed = claims(answer)
        self.bounds.append({"words": answer.bound.words, "total": answer.bound.total, "error": error, "norm": norm,
                            "claimed": claimed, "below": error > limit})  # fmt: skip
        self.check(not claimed or error <= limit, f"false certificate: {words}, norm {norm:.4g}")

    def not_certified(self, answer: Answer, why: str) -> None:
        """The word 'certified' must not stand alone."""
        assert answer.bound is not None
        self.check(not bare(answer), f"the word 'certified' stands alone although {why}")


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Warnings, also those that are logged."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    try:
        with warnings.catch_warnings(record=True, action="always") as caught:
            yield said
    finally:
        logging.getLogger().removeHandler(handler)
        said += [str(warning.message) for warning in caught]


def bare(answer: Answer) -> bool:
    """Whether the word 'certified' stands alone, or the record says that the bound is guaranteed."""
    return answer.bound is not None and (answer.bound.words == "certified" or answer.bound.guaranteed)


def claims(answer: Answer) -> bool:
    """Whether the bound is said to hold on the mesh as it is."""
    return bare(answer) or (answer.bound is not None and answer.bound.words.startswith("certified on the polygon"))


@dataclass(frozen=True)
class Family(ABC):
    """A drawn scene, its truth and its judge; the class is the family."""

    name: ClassVar[str]

    @abstractmethod
    def judge(self, judgement: Judgement) -> None:
        """Call the program and compare (collective)."""

    def scene(self) -> Scene:
        """The scene (collective), if there is one."""
        raise NotImplementedError

    def text(self) -> str:
        """TOML, or Python where the mesh is no shape, that shows the scene to the program again."""
        if vars(self).get("mesh", {}).get("shape", "box") in SHAPES:
            return f"# {self.asked()}\n{self.scene().toml()}"
        return f"from {type(self).__module__} import {type(self).__name__}\n{self!r}.scene()  # {self.asked()}"

    def asked(self) -> str:
        """What is asked for."""
        return f"solve(scene, {vars(self).get('options', {})})"


@dataclass(frozen=True)
class ClosedForm(Family):
    """A scene whose u is a formula, given on the whole boundary unless `boundary` says otherwise.

    Attributes:
        mesh: The table [mesh], or what `built` takes.
        options: Of `solve`.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]

    accuracy: ClassVar[float] = 1e-9  # of the true error, relative
    longest_flux: ClassVar[int] = LONGEST

    @abstractmethod
    def built(self, comm: MPI.Comm) -> Any:
        """The table [mesh] as it is, or the mesh that it stands for (collective)."""

    @abstractmethod
    def data(self) -> dict[str, Any]:
        """What a scene has in addition to mesh and boundary."""

    @abstractmethod
    def value(self) -> str:
        """u as the scene has it."""

    @abstractmethod
    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, from below, with the energy of the foundation but not of springs; the norm of u (collective)."""

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary."""
        return [{"value": self.value()}]

    def more(self, judgement: Judgement, answer: Answer) -> None:
        """Check what else is known of an answer (collective)."""

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        return Scene(mesh=self.built(comm), boundary=self.boundary(), **self.data())

    def judge(self, judgement: Judgement) -> None:
        answer = judgement.solve(lambda: self.scene(judgement.comm), **self.options)
        if answer is None:
            return
        if {"bound", "tol"} & set(self.options):
            judgement.certificate(answer, *self.error(Field(answer.u)), self.accuracy)
        self.more(judgement, answer)

    @property
    def short(self) -> bool:
        """Whether all its formulas are short enough for a scene."""
        return all(len(str(text)) < LONGEST for text in (self.value(), *self.data().values())) and all(
            len(part.get("flux", "")) < self.longest_flux for part in self.boundary()
        )
