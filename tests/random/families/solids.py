"""Closed forms on tetrahedra: contact in a half space, a ball and a cylinder, at points, lines and planes, or none.

A surface, where phi = 0, divides space. u is the obstacle where phi < 0, and the obstacle plus w elsewhere, and w is 0
there together with its gradient. In contact the load is lower by any pressure. Where the tension jumps at the surface,
u = w/tension on both sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random
from typing import Any

import basix
import numpy as np
import sympy
from hypothesis import strategies as st
from mpi4py import MPI
from sympy import Expr

from tests.random.families.elements import Field
from tests.random.families.family import ClosedForm
from tests.random.families.integrals import gauss
from tests.random.families.solid_meshes import inscribed_ball, solid, solids

AXES = sympy.symbols("x y z", real=True)
OBSTACLES = ("0", "0", "x/2 - y/3 + z/4", "x**2 - y*z", "x**3*z - y**2", "sin(2*x)*exp(y)*cos(z)",
             "exp(-x**2 - y**2 - z**2)", "1/(4 + x + y*z)")  # fmt: skip
TENSIONS = ("1", "1", "1", "4 + x*y - z", "exp(x - z)", "1.5 + sin(2*x + y)*cos(z)")
FACTORS = ("1 + x", "exp(y - z)", "2 + x*z")  # of w where only the tension jumps
KINDS = ("half", "ball", "tube", "flat ball", "flat tube", "sheet", "line", "point", "free", "layers", "inclusion")
IN_CONTACT = ("half", "ball", "tube", "flat ball", "flat tube")
JUMPS = ("layers", "inclusion")
MOST = 30000  # pieces of cells that the surface crosses
DEGREE = 9  # of the quadrature


@dataclass(frozen=True)
class Solid(ClosedForm):
    """A scene in space whose u is known.

    Attributes:
        kind: In `KINDS`.
        normal: Of the plane, or the axis of the cylinder; of length 1.
        middle: A point of the plane or axis, or the centre.
        radius: Of the ball or cylinder.
        obstacle: A formula; of u itself if there is no contact.
        size: Of w.
        stiff: Formula of the tension.
        scale: Of the tension.
        inside: The tension where phi < 0 is so many times as large.
        pressed: Contact pressure, times size and scale.
        upper: Whether all is upside down.
        foundation: Times scale.
        end: 'flux' or 'spring' instead of u on the right side of a box; 'layered' if u depends on x alone, and is given
            on two sides; else ''.
        spring: Its stiffness, times scale.
    """

    kind: str
    normal: tuple[float, float, float]
    middle: tuple[float, float, float]
    radius: float
    obstacle: str
    size: float
    stiff: str
    scale: float
    inside: float
    pressed: float
    upper: bool
    foundation: float
    end: str
    spring: float

    name = "tetrahedra"

    def built(self, comm: MPI.Comm) -> Any:
        return solid(self.mesh, comm)

    def _squares(self) -> tuple[Expr, Expr]:
        """The distance along the normal, and the squared distance from the middle."""
        off = [axis - c for axis, c in zip(AXES, self.middle, strict=True)]
        return sum(n * d for n, d in zip(self.normal, off, strict=True)), sum(d**2 for d in off)

    def _phi(self) -> Expr:
        """Negative in contact, or inside."""
        along, squared = self._squares()
        if self.kind in ("half", "layers"):
            return along
        return (squared - along**2 if self.kind in ("tube", "flat tube") else squared) - self.radius**2

    def _distance(self, points: np.ndarray) -> np.ndarray:
        """From the surface, with a sign."""
        off = points - np.array(self.middle)
        along = off @ np.array(self.normal)
        if self.kind in ("half", "layers"):
            return along
        squared = (off**2).sum(axis=-1) - (along**2 if self.kind in ("tube", "flat tube") else 0.0)
        return np.sqrt(np.maximum(squared, 0.0)) - self.radius

    def _sides(self) -> tuple[Expr, Expr]:
        """u where phi < 0, and elsewhere; the obstacle below."""
        along, squared = self._squares()
        a, across, psi = self.radius, squared - along**2, _formula(self.obstacle)
        if self.kind in JUMPS:
            base = self.size * self._phi() * _formula(self.obstacle)
            return base / self.inside, base
        w: dict[str, Expr] = {
            "half": along**2 / 2,
            "ball": squared / 6 + a**3 / (3 * sympy.sqrt(squared)) - a**2 / 2,
            "tube": across / 4 - a**2 / 4 - a**2 / 4 * (sympy.log(across) - math.log(a**2)),
            "flat ball": (squared - a**2) ** 2, "flat tube": (across - a**2) ** 2,
            "sheet": along**2, "line": across, "point": squared, "free": sympy.Integer(0),
        }  # fmt: skip
        outside = psi + self.size * w[self.kind]
        return (psi if self.kind in IN_CONTACT else outside), outside

    def _either(self, inside: Expr, outside: Expr) -> str:
        """A formula with both sides of the surface; it is finite where that of the outside is not used."""
        if inside == outside:
            return f"({outside})"
        if self.kind in ("ball", "tube"):
            along, squared = self._squares()
            far = squared if self.kind == "ball" else squared - along**2
            outside = outside.xreplace({far: sympy.Max(far, self.radius**2 / 2)})
        return f"where({self._phi()} < 0, {inside}, {outside})".replace("Max", "max")

    @property
    def _sign(self) -> int:
        return -1 if self.upper else 1

    def _tensions(self) -> tuple[Expr, Expr]:
        outside = self.scale * _formula(self.stiff)
        return self.inside * outside, outside

    def value(self) -> str:
        return self._either(*(self._sign * u for u in self._sides()))

    def data(self) -> dict[str, Any]:
        k, psi, loads = self.scale * self.foundation, _formula(self.obstacle), []
        for u, tension in zip(self._sides(), self._tensions(), strict=True):
            if self.kind in ("ball", "tube") and u != psi:  # w has the Laplacian 1
                second = self.size + sum(sympy.diff(psi, axis, 2) for axis in AXES)
            else:
                second = sum(sympy.diff(u, axis, 2) for axis in AXES)
            across = sum(sympy.diff(tension, axis) * sympy.diff(u, axis) for axis in AXES)
            loads.append(k * u - tension * second - across)
        if self.kind in IN_CONTACT:
            loads[0] -= self.pressed * self.size * self.scale
        far = self.kind in ("free", *JUMPS)
        obstacle = "-1e3" if far else str(psi)
        side = {"upper": f"-({obstacle})"} if self.upper else {"lower": obstacle}
        data = {"load": self._either(*(self._sign * load for load in loads)), **side}
        data["tension"] = self._either(*self._tensions())
        return data | ({"foundation": repr(k)} if k > 0 else {})

    def boundary(self) -> list[dict[str, Any]]:
        (whole,) = super().boundary()
        if not self.end:
            return [whole]
        if self.end == "layered":
            return [{"on": ["left", "right"], **whole}]
        sides = ["left", "bottom", "top", "back", "front"]
        parts = zip(self._sides(), self._tensions(), strict=True)
        flux = self._either(*(self._sign * tension * sympy.diff(u, AXES[0]) for u, tension in parts))
        if self.end == "flux":
            return [{"on": sides, **whole}, {"on": "right", "flux": flux}]
        k = self.spring * self.scale
        return [{"on": sides, **whole}, {"on": "right", "flux": f"{flux} + {k!r}*({self.value()})", "spring": repr(k)}]

    def error(self, field: Field) -> tuple[float, float]:
        """Cells that the surface crosses are divided again and again; the last pieces that it crosses are omitted."""
        cells, corners = np.arange(len(field.vertices)), field.vertices
        found = np.zeros(2)
        integrands = []
        for u, mu in zip(self._sides(), self._tensions(), strict=True):
            values = (u, *(sympy.diff(u, axis) for axis in AXES), mu)
            integrands.append([sympy.lambdify(AXES, value, "numpy", cse=True) for value in values])
        while len(cells):
            middle = corners.mean(axis=1)
            size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
            distance = self._distance(middle)
            crossed = np.abs(distance) <= size if self.kind in (*IN_CONTACT, *JUMPS) else np.zeros(len(cells), bool)
            for below, functions in zip((True, False), integrands, strict=True):
                here = ~crossed & ((distance < 0) == below)
                found += self._integrals(field, cells[here], corners[here], functions)
            if 8 * np.count_nonzero(crossed) > MOST:
                break
            cells, corners = np.repeat(cells[crossed], 8), _eighths(corners[crossed])
        error, norm = np.sqrt(field.comm.allreduce(found))
        return float(error), float(norm)

    def _integrals(self, field: Field, cells: np.ndarray, corners: np.ndarray, functions: list[Any]) -> np.ndarray:
        """The squares of error and norm on tetrahedra on one side of the surface."""
        points, weights = gauss(basix.CellType.tetrahedron, DEGREE)
        volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        at = np.einsum("qk,nkd->nqd", points, corners)
        value, *slope, tension = (np.broadcast_to(one(*np.moveaxis(at, 2, 0)), at.shape[:2]) for one in functions)
        true = self._sign * np.stack(slope, axis=2)
        middle, k = corners.mean(axis=1)[:, None], self.scale * self.foundation
        gradient = field.gradient(cells, middle)
        off = field.at(cells, middle) + ((at - middle) * gradient).sum(axis=2) - self._sign * value
        density = tension * ((gradient - true) ** 2).sum(axis=2) + k * off**2
        return np.array([volumes @ (one @ weights) for one in (density, tension * (true**2).sum(axis=2))])


def _formula(text: str) -> Expr:
    return sympy.sympify(text, dict(zip("xyz", AXES, strict=True)))


def _eighths(corners: np.ndarray) -> np.ndarray:
    """Tetrahedra, each in eight by the midpoints of its edges; shape (n, 4, 3)."""
    p = {(i, j): (corners[:, i] + corners[:, j]) / 2 for i in range(4) for j in range(i, 4)}
    parts = [[(0, 0), (0, 1), (0, 2), (0, 3)], [(1, 1), (0, 1), (1, 2), (1, 3)], [(2, 2), (0, 2), (1, 2), (2, 3)],
             [(3, 3), (0, 3), (1, 3), (2, 3)], [(0, 1), (2, 3), (0, 2), (0, 3)], [(0, 1), (2, 3), (0, 3), (1, 3)],
             [(0, 1), (2, 3), (1, 3), (1, 2)], [(0, 1), (2, 3), (1, 2), (0, 2)]]  # fmt: skip
    return np.stack([np.stack([p[key] for key in part], axis=1) for part in parts], axis=1).reshape(-1, 4, 3)


def drawn(rng: Random) -> Solid:
    """Of all kinds of contact, meshes and eps."""
    mesh, kind, turn, height = solids(rng), rng.choice(KINDS), rng.uniform(0, 2 * math.pi), rng.uniform(-1, 1)
    level = math.sqrt(1 - height**2)
    normal = (round(level * math.cos(turn), 15), round(level * math.sin(turn), 15), round(height, 15))
    centre, room = inscribed_ball(mesh)
    a, b, c = (round(x + rng.uniform(-0.3, 0.3) * room, 6) for x in centre)
    radius = round(room * (rng.uniform(0.2, 0.45) if rng.random() < 0.7 else rng.uniform(0.2, 1.2)), 6)
    options: dict[str, Any] = {"bound": True, "eps": rng.choice(["h", "h^2", "auto", "1e-10"])}
    if mesh["shape"] == "box" and rng.random() < 0.1:
        mesh["cells"] = min(mesh["cells"], 4)
        options = {"tol": rng.choice([0.5, 0.3]), "budget": "2e3 unknowns"}
    elif rng.random() < 0.2:
        options = {"bound": True, "method": "vi"}
    obstacle = rng.choice(FACTORS if kind in JUMPS else OBSTACLES[2:] if kind == "free" else OBSTACLES)
    stiff, inside = rng.choice(TENSIONS if kind not in ("ball", "tube") else TENSIONS[:1]), 1.0
    if kind in JUMPS or (kind in IN_CONTACT and obstacle == "0"):
        inside = rng.choice([2.0, 10.0, 0.1, 100.0] if kind in JUMPS else [1.0, 1.0, 10.0, 0.1, 100.0])
    end = rng.choice(["", "", "flux", "spring"]) if mesh["shape"] == "box" else ""
    if mesh["shape"] == "box" and kind in ("half", "layers") and rng.random() < 0.7:
        end, normal, obstacle = "layered", (1.0, 0.0, 0.0), "1 + x" if kind == "layers" else rng.choice(["0", "x/2"])
        inside = inside if obstacle != "x/2" else 1.0
    size, scale, pressed = (float(f"{10 ** rng.uniform(*ends):.3g}") for ends in ((-1, 1), (-3, 3), (-2, 1)))
    return Solid(
        mesh, options, kind, normal, (a, b, c), radius, obstacle, size, stiff, scale, inside, pressed,
        rng.random() < 0.5, rng.choice([0.0, 0.0, 0.0, 1.0, 300.0]), end, rng.choice([0.5, 30.0]),
    )  # fmt: skip


def tetrahedra() -> st.SearchStrategy[Solid]:
    """From one number each, so that no two scenes are alike."""
    return st.integers(0, 2**32 - 1).map(Random).map(drawn)
