"""Closed forms on a foundation, with fluxes and springs on sides of a rectangle: u is that of another family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from hypothesis import assume
from hypothesis import strategies as st
from mpi4py import MPI

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.closed import ClosedForm, Curve, Piecewise, everywhere, line_at, x, y
from tests.random.families.elements import Field
from tests.random.families.meshes import made
from tests.random.families.touching import touching
from tests.random.families.varying import varying

SIDES = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
HALF = line_at(0.0, 0.113)
# of foundations and springs, times a factor
SHAPES = {
    "even": everywhere(1), "smooth": everywhere(sympy.exp(x - y)), "linear": everywhere(3 + x + y),
    "half": Piecewise([(((HALF, True),), sympy.Integer(1)), ((), sympy.Integer(0))]),
    "two": Piecewise([(((HALF, False),), 2 + x), ((), sympy.Integer(1))]),
}  # fmt: skip


@dataclass(frozen=True)
class Supported(ClosedForm):
    """-div(tension grad u) + k u = load + p with the u of another scene; flux and spring replace u on sides.

    Attributes:
        base: The other scene.
        shape: Of the foundation, in `SHAPES`.
        size: It times this.
        sides: Where u is not given.
        spring: Shape of the springs there.
        stiff: They times this.
    """

    base: ClosedForm
    shape: str
    size: float
    sides: tuple[str, ...]
    spring: str
    stiff: float

    name = "supported"

    def u(self) -> list[Piecewise]:
        return self.base.u()

    def tension(self) -> Piecewise:
        return self.base.tension()

    def poles(self) -> list[tuple[float, float]]:
        return self.base.poles()

    def data(self) -> dict[str, Any]:
        data = self.base.data()
        if self.size > 0:
            foundation = f"{self.size!r}*{SHAPES[self.shape].text(self.spelling)}"
            data |= {"load": f"({data.get('load', 0)}) + {foundation}*({self.value()})", "foundation": foundation}
        return data

    def boundary(self) -> list[dict[str, Any]]:
        """The parts of the boundary."""
        given = [side for side in SIDES if side not in self.sides]
        parts: list[dict[str, Any]] = [{"on": given, "value": self.value()}] if given else []
        for side in self.sides:
            outward = [
                f"({number})*{self.tension().text(self.spelling)}*"
                f"{part.map(lambda value, s=s: sympy.diff(value, s)).text(self.spelling)}"
                for part in self.u() for number, s in zip(SIDES[side], (x, y), strict=True) if number
            ]  # fmt: skip
            flux = " + ".join(outward)
            if self.stiff > 0:
                spring = f"{self.stiff!r}*{SHAPES[self.spring].text(self.spelling)}"
                parts.append({"on": side, "flux": f"{flux} + {spring}*({self.value()})", "spring": spring})
            else:
                parts.append({"on": side, "flux": flux})
        return parts

    @property
    def short(self) -> bool:
        """Whether all its formulas are short enough for a scene."""
        return super().short and all(len(part.get("flux", "")) < 4000 for part in self.boundary())

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        return Scene(mesh=made(self.mesh, comm), boundary=self.boundary(), **self.data())

    def error(self, field: Field) -> tuple[float, float]:
        """Of a field, from below, with the energy of the foundation but not of springs; the norm of u (collective)."""
        error, norm = super().error(field)
        nodes = self.nodes(field)
        px, py = nodes.points.T
        true = sum((part.at(px, py) for part in self.u()), np.zeros(len(px)))
        off = field.at(nodes.cells, nodes.points[:, None])[:, 0] - true
        k = self.size * SHAPES[self.shape].at(px, py)
        return float(np.hypot(error, np.sqrt(field.comm.allreduce(float(nodes.weights @ (k * off**2)))))), norm

    def curves(self) -> list[Curve]:
        """See `ClosedForm.curves`."""
        return [*super().curves(), HALF]


@st.composite
def supported(draw: st.DrawFn) -> Supported:
    """u is smooth, or touches an obstacle."""
    base = draw(st.one_of(varying(), touching()).filter(lambda one: one.mesh["shape"] == "rectangle"))
    foundation = draw(st.sampled_from([0.0, 0.0, 0.3, 7.0, 300.0, 1e5]))
    sides = draw(st.lists(st.sampled_from(sorted(SIDES)), min_size=0 if foundation else 1, max_size=3, unique=True))
    found = Supported(
        base.mesh,
        {**base.options, "element": "P1"},
        base.spelling,
        base,
        draw(st.sampled_from(sorted(SHAPES))),
        foundation,
        tuple(sides),
        draw(st.sampled_from(sorted(SHAPES))),
        draw(st.sampled_from([0.0, 0.0, 0.5, 20.0, 1e4])),
    )
    assume(found.short)
    return found
