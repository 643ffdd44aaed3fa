"""Boundary values with jumps or kinks, and parts of the boundary that end inside a facet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hypothesis import strategies as st

from fenicsx_obstacle.scenes.scene import Scene
from tests.random.families.family import ANSWER, EITHER, INPUT_ERROR, Family, Judgement
from tests.random.families.strategies import bounds, grids, place

JUMPS = ("where({s} < {c}, 0, {a})", "{a}*({s} >= {c})", "{a}*sign({s} - {c})", "{a}*floor({s} - {c})",
        "where({s} > {c}, {a}*{s}, {a}*({s} + 0.1))", "{a}*(({s} + 1 - {c}) % 1)")  # fmt: skip
KINKS = ("where({s} < {c}, {a}*{s}, {a}*{c})", "{a}*abs({s} - {c})", "{a}*min({s}, {c})", "{a}*max({s} - {c}, 0)",
        "where({s} < {c}, 0, {a}*({s} - {c})^2)")  # fmt: skip
FREE_ENDS = ("x == 0 and y < {c}", "y == 1 and x > {c}", "x == 0 and y < {c} or y == 0",
             "x == 1 and abs(y - 0.5) < {d}")  # fmt: skip


@dataclass(frozen=True)
class DirichletData(Family):
    """Values on the boundary of a square that jump or bend at a place, or two tables that give a corner two values.

    Attributes:
        mesh: The table [mesh].
        options: Of `solve`.
        effects: Besides a tension of 1.
        boundary: As in [[boundary]].
        expected: What comes of `options`; without them there is an answer.
        flaw: Why no bound is certified; empty where one may be.
    """

    mesh: dict[str, Any]
    options: dict[str, Any]
    effects: dict[str, Any]
    boundary: tuple[dict[str, Any], ...]
    expected: str
    flaw: str

    name = "boundary values"

    def scene(self) -> Scene:
        return Scene(mesh=self.mesh, tension=1, boundary=self.boundary, **self.effects)

    def judge(self, judgement: Judgement) -> None:
        judgement.solve(self.scene, ANSWER, element=self.options["element"])
        answer = judgement.solve(self.scene, self.expected, **self.options)
        if answer is not None and self.flaw:
            judgement.not_certified(answer, self.flaw)


@st.composite
def jumps(draw: st.DrawFn) -> DirichletData:
    """Jumps inside edges and at corners, and values that bend only."""
    kind = draw(st.sampled_from(["jump", "jump", "kink", "corner"]))
    size = draw(st.sampled_from([1.0, -2.0, 1e-4, 1e5]))
    if kind == "corner":
        boundary = [{"on": "left", "value": 0}, {"on": draw(st.sampled_from(["bottom", "top"])), "value": size}]
    else:
        spelling = draw(st.sampled_from(JUMPS if kind == "jump" else KINKS))
        s = draw(st.sampled_from(["x", "y", "(0.6*x + 0.8*y)"]))
        value = spelling.format(s=s, c=repr(draw(place(0.1, 0.9))), a=repr(size))
        boundary = [{"value": value}]
        if s != "(0.6*x + 0.8*y)" and draw(st.booleans()):
            boundary = [{"on": "bottom" if s == "x" else "left", "value": value}]
    # no u of finite energy takes values that jump
    expected = {"corner": EITHER, "kink": ANSWER, "jump": INPUT_ERROR}[kind]
    return DirichletData(draw(grids()), draw(bounds()), {}, tuple(boundary), expected,
                         "" if kind == "kink" else "the boundary values jump")  # fmt: skip


@dataclass(frozen=True)
class Ends(DirichletData):
    """A part of the boundary where u is given ends inside a facet, so that another part is held on each mesh."""

    name = "ends of boundary parts"


@st.composite
def ends(draw: st.DrawFn) -> Ends:
    """Ends that no facet of the first mesh and of those refined from it has."""
    mesh = draw(grids())
    cells = mesh["cells"]
    facet, share = draw(st.integers(1, cells - 2)), draw(place(0.03, 0.97))
    share += 0.0004 * (8 * share == int(8 * share))  # halves of facets never end there
    c = (facet + share) / cells
    # symmetric about the middle, each end in a facet of its own
    d = (1 + share) / cells if cells % 2 == 0 else (1.5 + 0.9 * share) / cells
    options = draw(bounds())
    text = draw(st.sampled_from(FREE_ENDS)).format(c=repr(c), d=repr(d))
    boundary: list[dict[str, Any]] = [{"where": text, "value": 0}]
    if draw(st.booleans()):
        boundary.append({"on": "right" if "x == 0" in text else "left", "value": 0})
    return Ends(mesh, options, {"load": -1.0}, tuple(boundary), EITHER, "a part of the boundary ends inside a facet")
