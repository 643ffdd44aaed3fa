"""One or two obstacles close to a solution in closed form, beside those that it has: u stays as it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st
from mpi4py import MPI

from tests.random.families.elements import Field
from tests.random.families.family import ClosedForm
from tests.random.families.strategies import place, power

# distances from u, which oscillate inside cells, or jump; most are 0 somewhere
GAPS = ("1", "1 + cos({k}*x)", "abs(sin({k}*(x + 0.3*y)))", "max(0, sin({k}*x))", "({k}*(x - {a}))^2",
        "abs(x + y - {a})", "where(x < {a}, 1, 1e3)", "min(1, abs({k}*(y - {a})))",
        "(1 + cos({k}*x))*(1 + sin({k}*y))")  # fmt: skip
APART = 1e-3  # of the distance: so far an obstacle stays from u where another one may hold it


@dataclass(frozen=True)
class Close(ClosedForm):
    """A scene of another family with the obstacles that it lacks.

    Attributes:
        base: That scene.
        gaps: Distances of a lower and of an upper obstacle from u, at least 0.
        size: Of these.
    """

    base: ClosedForm
    gaps: tuple[str, str]
    size: float

    name = "close obstacles"
    longest_flux = 4000

    def built(self, comm: MPI.Comm) -> Any:
        return self.base.built(comm)

    def data(self) -> dict[str, Any]:
        found = self.base.data()
        apart = APART if {"lower", "upper"} & set(found) else 0
        for side, sign, gap in zip(("lower", "upper"), "-+", self.gaps, strict=True):
            found.setdefault(side, f"({self.value()}) {sign} {self.size!r}*({apart!r} + {gap})")
        return found

    def value(self) -> str:
        return self.base.value()

    def error(self, field: Field) -> tuple[float, float]:
        return self.base.error(field)

    def boundary(self) -> list[dict[str, Any]]:
        return self.base.boundary()


@st.composite
def close(draw: st.DrawFn, bases: st.SearchStrategy[ClosedForm]) -> Close:
    """Distances from 1e-7 to 1."""
    base = draw(bases)
    k, a = draw(st.sampled_from(["3", "20", "97", "500"])), draw(place(-0.3, 0.9))
    lower, upper = (draw(st.sampled_from(GAPS)).format(k=k, a=a) for _ in range(2))
    return Close(base.mesh, base.options, base, (lower, upper), draw(power(-7, 0)))
