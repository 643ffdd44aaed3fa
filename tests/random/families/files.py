"""Meshes of CAD programs: without groups, with bodies that only seem to be connected, of curved domains."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
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


@contextmanager
def gmsh_model() -> Iterator[Any]:
    """Gmsh with an empty model, on one rank."""
    import gmsh

    gmsh.initialize([], False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh
    finally:
        gmsh.finalize()


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
        comm = judgement.comm
        with tempfile.TemporaryDirectory(prefix="obstacle-") as own:
            folder = Path(comm.bcast(own))
            {"no groups": self._groups, "apart": self._apart, "joined": self._joined}.get(
                self.kind, self._curved)(judgement, folder)  # fmt: skip
            comm.Barrier()

    def on(self, file: Path) -> Scene:
        return Scene(mesh={"file": str(file)}, tension=1, load=self.load, lower=self.lower)

    def _groups(self, judgement: Judgement, folder: Path) -> None:
        """Without physical groups it is the same membrane as with them."""
        found: list[Answer] = []
        for groups in (True, False):
            file = on_root(judgement.comm, self.write, folder / f"{groups}.msh", groups)
            answer = judgement.solve(partial(self.on, file), ANSWER, f"groups: {groups}")
            found += [] if answer is None else [answer]
        if len(found) == 2:
            self._same(judgement, *found)

    def _apart(self, judgement: Judgement, folder: Path) -> None:
        """Two rectangles that share an edge without shared nodes are no membrane of their union."""
        file = on_root(judgement.comm, self.write, folder / "apart.msh", True)
        answer = judgement.solve(lambda: self.on(file), EITHER)
        if answer is None:
            return
        told = any(word in text.lower() for text in (*judgement.said, answer.summary()) for word in TELLING)
        judgement.check(told, "two bodies without shared nodes are solved as two membranes, and nothing is said")

    def _joined(self, judgement: Judgement, folder: Path) -> None:
        """The same made one: it must be solved, and is the membrane on a shape of this package."""
        file = on_root(judgement.comm, self.write, folder / "joined.msh", True)
        answer = judgement.solve(lambda: self.on(file), ANSWER)
        if answer is None:
            return
        low, high = Field(answer.u).ends()
        top, true = max(abs(low), abs(high)), abs(self.load) * torsion(self.width + 0.7)
        if self.lower is None:
            judgement.check(
                abs(top - true) <= (0.02 + 4 * self.size**2) * true, f"largest |u| {top:.5g}; true: {true:.5g}"
            )

    def _curved(self, judgement: Judgement, folder: Path) -> None:
        """A curved domain is no polygon."""
        file = on_root(judgement.comm, self.write, folder / f"curved{self.suffix}", True)
        answer = judgement.solve(lambda: self.on(file), EITHER, **self.options)
        if answer is not None:
            judgement.not_certified(answer, "the domain is curved")

    def _same(self, judgement: Judgement, first: Answer, second: Answer) -> None:
        for key in ("energy", "contact"):
            a, b = (answer.record[key] for answer in (first, second))
            if key == "contact":
                a, b = (side.get("lower", {"force": 0.0})["force"] for side in (a, b))
            judgement.check(abs(a - b) <= 1e-6 * abs(a) + 1e-12, f"{key} {a:.8g} with groups, {b:.8g} without them")

    def write(self, file: Path, groups: bool) -> Path:
        """Make the file (rank 0)."""
        if file.suffix == ".geo":
            file.write_text(GEO.format(h=self.size, r=self.width), encoding="utf-8")
            return file
        with gmsh_model() as gmsh:
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
        return file

    def text(self) -> str:
        words = {
            "no groups": f"Gmsh: rectangle {self.width} x 1, without physical groups",
            "apart": f"Gmsh: rectangles {self.width} x 1 and 0.7 x 1 side by side, not fragmented",
            "joined": f"Gmsh: rectangles {self.width} x 1 and 0.7 x 1 side by side, fragmented",
            "disk": f"Gmsh: OpenCASCADE disk of radius {self.width}, {self.suffix}",
            "ellipse": f"Gmsh: OpenCASCADE ellipse of half axes {1.3 * self.width} and {self.width}",
            "hole": f"Gmsh: square 2 x 2 with a hole of radius {0.6 * self.width}",
        }[self.kind]
        obstacle = "" if self.lower is None else f", lower={self.lower}"
        return (
            f"{words}, mesh size {self.size}, format {self.version}: Scene(mesh={{'file': ...}}, tension=1, "
            f"load={self.load}{obstacle}); solve(scene, {self.options})"
        )


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


def there() -> bool:
    """Whether Gmsh's Python module is."""
    return find_spec("gmsh") is not None
