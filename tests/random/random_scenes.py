"""Random scenes, drawn by Hypothesis: shapes, meshes, elements, coefficients over 12 decades, obstacles, loads, eps.

They are admissible by construction: boundary values are cut off at the obstacles, the upper obstacle is the lower one
and a gap. Whatever the program does not answer, or answers against the theory, is a failure. Scenes whose solution is
known, or that have none, are in `families`; half of all scenes that are drawn are of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st
from mpi4py import MPI

from fenicsx_obstacle.scenes.scene import Scene
from tests.hard.judge import judge
from tests.hard.row import FAILED, RIGHT
from tests.random.families.all_families import KNOWN
from tests.random.families.family import Family, Judgement
from tests.random.families.meshes import skewed
from tests.random.families.strategies import DIAGONALS, power

SMOOTH = ("1", "1 + x/L", "sin(3*x/L + 1)", "cos(7*x/L)*cos(5*y/L)", "(x^2 - y^2)/L^2", "exp(-9*(x^2 + y^2)/L^2)")
KINKED = ("where(x < L/3, 1, -1)", "abs(x/L - 0.4)", "max(0, 1 - 4*hypot(x, y)/L)", "sign(sin(20*x/L)*sin(20*y/L + 1))",
          "floor(4*x/L)/4", "min(x/L, y/L + 0.3)")  # fmt: skip
POSITIVE = ("1", "1 + 0.9*sin(9*x/L)", "where(x < L/3, 1, 1e6)", "where(x < L/3, 1, 1e-6)", "(1.1 + cos(x/L))^3",
            "exp(6*sin(x/L))")  # fmt: skip


@dataclass(frozen=True)
class Drawn(Family):
    """An admissible random scene, judged by the invariants of the theory.

    Attributes:
        data: What `Scene` takes, the mesh apart.
        mesh: The table [mesh].
        element: Name of the pair.
        skew: Slope of the sides of a mesh of the caller's own, and how much it is stretched; None for a shape.
        scatter: How far its inner vertices are moved, in parts of a cell.
        ratios: eps over h^2/tension, falling.
    """

    data: dict[str, Any]
    mesh: dict[str, Any]
    element: str
    skew: tuple[float, float] | None
    scatter: float
    ratios: tuple[float, ...]

    name = "admissible"

    def scene(self, comm: MPI.Comm = MPI.COMM_WORLD) -> Scene:
        """The scene (collective)."""
        if self.skew is None:
            return Scene(mesh=self.mesh, **self.data).change({"solve.element": self.element})
        mesh = skewed(comm, self.mesh["cells"], self.data["define"]["L"], *self.skew, self.scatter)
        return Scene(mesh=mesh, **self.data).change({"mesh.refine": self.mesh["refine"]})

    def epsilons(self) -> list[str]:
        """Formulas in h: they are divided by the tension."""
        return [f"{ratio!r}*h^2" for ratio in self.ratios]

    def judge(self, judgement: Judgement) -> None:
        for row in judge(self.scene(judgement.comm), judgement.comm, self.epsilons()):
            failed = row["verdict"] == FAILED
            judgement.check(not failed, f"{row['method']} {row['asked']}: {row['message']}")
            judgement.answers += row["verdict"] == RIGHT
            judgement.rejected += not failed and row["verdict"] != RIGHT

    def asked(self) -> str:
        return f"SNES VI, penalty and (3.4)* with eps = {', '.join(self.epsilons())}"


@st.composite
def drawn(draw: st.DrawFn) -> Drawn:
    """An admissible random scene."""
    L, height, tension = draw(power(-3, 3)), draw(power(-6, 6)), draw(power(-6, 6))
    shape = draw(st.sampled_from(["interval", "rectangle", "rectangle", "rectangle", "disk", "l-shape", "box", "own"]))
    mesh: dict[str, Any] = {"shape": shape}
    skew, scatter, element = None, 0.0, "P1"
    if shape == "own":
        mesh |= {"cells": draw(st.integers(3, 14)), "refine": draw(st.integers(0, 1))}
        skew = draw(st.integers(-40, 40)) / 10, draw(power(-3, 3))
        scatter = draw(st.sampled_from([0.0, 0.2, 0.3]))
    else:
        cells = {"interval": 200, "box": 5}.get(shape, 24)
        mesh["cells"] = draw(st.integers(2, cells))
    if shape in ("interval", "rectangle", "l-shape", "box"):
        mesh["x"] = [0.0, L]
    if shape in ("rectangle", "l-shape", "box"):
        mesh["y"] = [0.0, L * draw(st.sampled_from([1.0, 0.5, 2.0]))]
    if shape == "box":
        mesh["z"] = [0.0, L]
    if shape == "disk":
        mesh["radius"] = L
    if shape == "rectangle":
        element = draw(st.sampled_from(["P1", "P1", "P1", "P1-voronoi", "Q1", "Q2", "P2"]))
        if element[0] == "P":
            mesh["diagonal"] = draw(st.sampled_from(DIAGONALS))
        if element != "P1-voronoi":
            mesh["perturb"] = draw(st.sampled_from([0.0, 0.0, 0.1, 0.2]))
    field = st.sampled_from(SMOOTH + KINKED)
    stiff, pull = draw(st.sampled_from(POSITIVE)), draw(power(-3, 3)) * draw(st.sampled_from([-1.0, 0.0, 1.0]))
    sides = draw(st.sampled_from(["lower", "upper", "both", "both", "none"]))
    base = f"H*({draw(st.floats(-1, 1)):.3f} + {draw(power(-3, 1)):.3g}*({draw(field)}))"
    gap = f"H*{draw(power(-8, 1)):.3g}*(1 + abs({draw(field)}))"
    define = {"L": L, "H": height, "mu": tension, "base": base, "gap": gap}
    obstacles = {"lower": {"lower": "base"}, "upper": {"upper": "base"}, "none": {},
                 "both": {"lower": "base", "upper": "base + gap"}}[sides]  # fmt: skip
    value = f"H*{draw(st.floats(-1, 1)):.3f}*({draw(field)})"
    for side, cut in (("lower", "max"), ("upper", "min")):
        if side in obstacles:
            value = f"{cut}({value}, {obstacles[side]})"
    data = {
        "define": define, "tension": f"mu*({stiff})", "load": f"mu*H/L^2*{pull!r}*({draw(field)})", **obstacles,
        "boundary": [{"value": value}],
    }  # fmt: skip
    ratios = sorted({draw(power(-8, 2)), draw(power(-2, 3))}, reverse=True)
    return Drawn(data, mesh, element, skew, scatter, tuple(ratios))


FAMILIES: dict[str, st.SearchStrategy[Any]] = {Drawn.name: drawn(), **KNOWN}
