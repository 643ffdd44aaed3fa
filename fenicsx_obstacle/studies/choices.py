"""The methods that `cost` compares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from fenicsx_obstacle.scenes.meshes import shape_of
from fenicsx_obstacle.scenes.scene import Scene

FIRST = "eps of the first mesh"  # stands for the number that h^2 is there
FIRST_CELLS = {1: 16, 2: 16, 3: 8}
FACTOR = {1: 4, 2: 2, 3: 2}  # cells per side from one mesh to the next
MESHES = 20  # more than any budget allows


@dataclass(frozen=True)
class Choice:
    """A method with its eps and mesh.

    Attributes:
        name: In tables.
        words: What it is, for somebody who has not read the paper.
        element: Pair of spaces and rule.
        solve: Options of the solves.
        adaptive: Whether meshes are refined where the error is, instead of everywhere.
    """

    name: str
    words: str
    element: str
    solve: Mapping[str, Any] = field(default_factory=dict)
    adaptive: bool = False

    @property
    def group(self) -> tuple[str, str]:
        """Choices of one group are solved on the same meshes with the same preparations: element and start."""
        return self.element, self.solve.get("start", "nested")

    def on(self, scene: Scene) -> Scene:
        """The scene, solved this way."""
        scene = scene.change({"solve.element": self.element})
        return scene.with_options(scene.options_with(**self.solve))


def choices(scene: Scene) -> list[Choice]:
    """All methods; one that is not possible for a scene raises an error when it is tried.

    The element is the scene's own; P2 is added.
    """
    own, nested, penalty = scene.pair.name, "started from the solution on the next coarser mesh", {"method": "penalty"}
    if own == "P2":
        own = "P1"
    bounded = "the same on meshes refined where a bound of the error says that it is"
    found = [
        Choice(f"{own} VI", f"no penalty: the variational inequality by PETSc's SNES VI, {nested}",
               own, {"method": "vi"}),
        Choice(f"{own} VI cold", "the same solver started without contact",
               own, {"method": "vi", "start": "cold"}),
        Choice(f"{own} eps fixed", "penalty with one value of eps for all meshes, as many codes do",
               own, {"eps": FIRST, **penalty}),
        Choice(f"{own} eps = h", "penalty with eps proportional to the side h of a cell",
               own, {"eps": "h", **penalty}),
        Choice(f"{own} eps = h^2", "penalty with Kikuchi's eps = h^2, which keeps the order of convergence",
               own, {"eps": "h^2", **penalty}),
        Choice(f"{own} auto", f"this program's default: penalty with eps = h^2/100, {nested}",
               own, {"eps": "auto", **penalty}),
        Choice(f"{own} adaptive", bounded, own, {"eps": "auto", **penalty}, adaptive=True),
        Choice("P2 VI", "quadratic elements, the inequality itself", "P2", {"method": "vi"}),
        Choice("P2 eps = h^2", "quadratic elements with Kikuchi's eps = h^2", "P2", {"eps": "h^2", **penalty}),
        Choice("P2 auto", "quadratic elements, eps = h^2/100", "P2", {"eps": "auto", **penalty}),
        Choice("P2 adaptive", bounded, "P2", {"eps": "auto", **penalty}, adaptive=True),
    ]  # fmt: skip
    return [choice for choice in found if scene.sides or choice.solve.get("eps") == "auto"]


def uniform_meshes(scene: Scene) -> Iterator[Scene]:
    """The scene on uniform meshes, each finer than the one before."""
    table = scene.tables.mesh
    for k in range(MESHES):
        if table.shape is None:
            yield scene.change({"mesh.refine": table.refine + k})
        else:
            dim = len(shape_of(scene).cells)
            yield scene.change({"mesh.refine": 0, "mesh.cells": FIRST_CELLS[dim] * FACTOR[dim] ** k})
