"""Meshes of CAD programs: without groups, with bodies that only seem to be connected, of curved domains."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.elements import Field
from tests.random.families.family import ANSWER, EITHER, Family, Judgement
from tests.random.families.strategies import place

TELLING = ("connect", "component", "duplicate", "coincid", "on top of", "separate", "fragment", "pieces", "bodies")


@dataclass(frozen=True)
class Cad(Family):
    """A membrane on a body from CAD, a load, u = 0 on the whole boundary.

    Attributes:
        kind: What is in the file.
        width: Of the first rectangle, or a radius.
        size: Of the cells.
        version: Of the file format of Gmsh.
        suffix: .msh or .geo.
        load: The same everywhere.
        lower: Obstacle, or None.
        options: Of `solve` where a certificate is asked for.
    """

    kind: str
    width: float
    size: float
    version: float
    suffix: str
    load: float
    lower: float | None
    options: dict[str, Any]

    name = "CAD"

    def judge(self, judgement: Judgement) -> None:
        comm, expected = judgement.comm, ANSWER if self.kind in ("no groups", "joined") else EITHER
        found: list[Answer] = []
        with tempfile.TemporaryDirectory(prefix="obstacle-") as own:
            folder = Path(comm.bcast(own))
            for groups in (True, False) if self.kind == "no groups" else (True,):
                file = on_root(comm, self.write, folder / f"{groups}{self.suffix}", groups)
                answer = judgement.solve(partial(self.on, file), expected, f"groups: {groups}", **self.options)
                found += [] if answer is None else [answer]
            comm.Barrier()
        if not found:
            return
        first, *others = found
        if self.kind == "apart":  # without shared nodes they are no membrane of their union
            told = any(word in text.lower() for text in (*judgement.said, first.summary()) for word in TELLING)
            judgement.check(told, "two bodies without shared nodes are solved as two membranes, and nothing is said")
        elif self.kind == "joined" and self.lower is None:  # the membrane on a shape of this package
            top, true = max(map(abs, Field(first.u).ends())), abs(self.load) * torsion(self.width + 0.7)
            right = abs(top - true) <= (0.02 + 4 * self.size**2) * true
            judgement.check(right, f"largest |u| {top:.5g}; true: {true:.5g}")
        elif self.kind not in KINDS[:3]:
            judgement.not_certified(first, "the domain is curved")
        for other in others:  # without physical groups it is the same membrane as with them
            pairs = zip(("energy", "force"), self._figures(first), self._figures(other), strict=True)
            for name, a, b in pairs:
                same = abs(a - b) <= 1e-6 * abs(a) + 1e-12
                judgement.check(same, f"{name} {a:.8g} with groups, {b:.8g} without them")

    def on(self, file: Path) -> Scene:
        return Scene(mesh={"file": str(file)}, tension=1, load=self.load, lower=self.lower)

    def _figures(self, answer: Answer) -> tuple[float, float]:
        """The energy and the contact force."""
        return answer.record["energy"], answer.record["contact"].get("lower", {"force": 0.0})["force"]

    def write(self, file: Path, groups: bool) -> Path:
        """Make the file (rank 0)."""
        if file.suffix == ".geo":
            file.write_text(GEO.format(h=self.size, r=self.width), encoding="utf-8")
            return file
        import gmsh

        gmsh.initialize([], False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            add, w = gmsh.model.occ, self.width
            if self.kind in ("apart", "joined"):
                bodies = [(2, add.addRectangle(0, 0, 0, w, 1)), (2, add.addRectangle(w, 0, 0, 0.7, 1))]
                if self.kind == "joined":
                    add.fragment(bodies[:1], bodies[1:])
            elif self.kind == "no groups":
                add.addRectangle(0, 0, 0, w, 1)
            elif self.kind == "disk":
                add.addDisk(0, 0, 0, w, w)
            elif self.kind == "ellipse":
                add.addDisk(0, 0, 0, 1.3 * w, w)
            else:
                add.cut([(2, add.addRectangle(-1, -1, 0, 2, 2))], [(2, add.addDisk(0, 0, 0, 0.6 * w, 0.6 * w))])
            add.synchronize()
            if groups:
                gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)])
                if self.kind not in ("apart", "joined"):
                    gmsh.model.addPhysicalGroup(1, [tag for _, tag in gmsh.model.getEntities(1)])
            gmsh.option.setNumber("Mesh.MeshSizeMin", self.size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", self.size)
            gmsh.model.mesh.generate(2)
            gmsh.option.setNumber("Mesh.MshFileVersion", self.version)
            gmsh.write(str(file))
        finally:
            gmsh.finalize()
        return file

    def text(self) -> str:
        file = f"Path('a{self.suffix}')"
        return (f"from pathlib import Path\nfrom {type(self).__module__} import Cad\n"
                f"one = {self!r}\nscene = one.on(one.write({file}, True))  # False: without groups\n")  # fmt: skip


def torsion(width: float) -> float:
    """Largest u of -laplace u = 1, u = 0 on the boundary of a rectangle of height 1, by a series."""
    n = 2 * np.arange(30) + 1
    t = np.exp(-n * np.pi * width / 2)
    return float(4 / np.pi**3 * np.sum((-1.0) ** (n // 2) / n**3 * (1 - 2 * t / (1 + t**2))))


GEO = """h = {h}; r = {r};
Point(1) = {{0, 0, 0, h}}; Point(2) = {{r, 0, 0, h}}; Point(3) = {{0, r, 0, h}};
Point(4) = {{-r, 0, 0, h}}; Point(5) = {{0, -r, 0, h}};
Circle(1) = {{2, 1, 3}}; Circle(2) = {{3, 1, 4}}; Circle(3) = {{4, 1, 5}}; Circle(4) = {{5, 1, 2}};
Curve Loop(1) = {{1, 2, 3, 4}}; Plane Surface(1) = {{1}};
"""
KINDS = ("no groups", "apart", "joined", "disk", "ellipse", "hole")


@st.composite
def cad(draw: st.DrawFn) -> Cad:
    """Coarse meshes."""
    kind = draw(st.sampled_from(KINDS))
    suffix = draw(st.sampled_from([".msh", ".geo"])) if kind == "disk" else ".msh"
    tolerance = draw(st.sampled_from([None, 0.2, 0.1]))
    options = {"bound": True} if tolerance is None else {"tol": tolerance, "budget": "2e3 unknowns"}
    if kind in KINDS[:3]:
        options = {}
    load = draw(st.sampled_from([-1.0, -20.0, 3.0]))
    lower = draw(st.sampled_from([None, -0.05])) if load < 0 else None
    return Cad(kind, draw(place(0.5, 1.5)), draw(st.sampled_from([0.1, 0.2, 0.4])),
               draw(st.sampled_from([2.2, 4.1])), suffix, load, lower, options)  # fmt: skip
