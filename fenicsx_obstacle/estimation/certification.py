"""Certification of an error bound: certified, certified for sampled data or for the polygon, or an indicator."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.edges import cut_parts
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import first_given, total


class Obstacle(Protocol):
    """One obstacle between the nodes: `ObstacleExcess` of P1, `LatticeObstacle` of P2."""

    sampled: bool
    unbounded: np.ndarray


@dataclass(frozen=True, eq=False)
class CellDatum:
    """What is known of a datum.

    Attributes:
        name: Of it.
        pieces: It, on cells or facets; None of a number.
        wrong: What it may be where its bounds are not finite, in words.
        cells: The cell of each of these; None: they are the owned cells.
        least: A number that must be below all its values.
    """

    name: str
    pieces: Pieces | None
    wrong: str
    cells: np.ndarray | None = None
    least: float = -np.inf


class Hypotheses:
    """The hypotheses of the bound for the data on one mesh, checked without sampling."""

    def __init__(self, simplices: Simplices, known: Iterable[CellDatum], dirichlet: BoundaryData):
        """Look at the parts of the boundary (collective).

        Args:
            simplices: The owned cells.
            known: The data in cells and facets, the same ones on all ranks.
            dirichlet: Boundary values.
        """
        self._simplices, self._rim = simplices, dirichlet
        comm = simplices.data.level.comm
        self._reasons = cut_parts(simplices)
        self._sampled = []
        for datum in known:
            pieces = datum.pieces
            if pieces is None:
                continue
            bad = ~pieces.finite | (pieces.lower <= datum.least)
            cells = np.zeros(len(simplices.area), dtype=bool)
            cells[np.flatnonzero(bad) if datum.cells is None else datum.cells[bad]] = True
            if place := self._near(cells):
                self._reasons.append(f"the {datum.wrong} near {place}")
            if total(comm, int(pieces.sampled)) > 0:
                self._sampled.append(datum.name)
        if place := self._first(dirichlet.unbounded):
            self._reasons.append(f"the boundary value may be infinite or undefined near {place}")

    def words(self, reasons: Iterable[str], obstacles: Iterable[Obstacle]) -> str:
        """How far a bound is guaranteed, as `in_words` has it (collective).

        Args:
            reasons: Further ones for which it is an indicator.
            obstacles: With the bound's state in mind.
        """
        level, found, obstacles = self._simplices.data.level, [*reasons, *self._reasons], list(obstacles)
        for side in obstacles:
            if place := self._near(side.unbounded):
                found.append(f"the obstacle may be infinite or undefined near {place}")
        sampled = list(self._sampled)
        sampled += ["obstacle"] if any(side.sampled for side in obstacles) else []
        sampled += ["boundary value"] if self._rim.sampled else []
        return in_words(found, sampled, polygon=not level.polygonal)

    def _near(self, cells: np.ndarray) -> str:
        """The first of some cells, in words; empty if there is none (collective)."""
        middle = self._simplices.middle
        return self._first(np.pad(middle[np.argmax(cells)], (0, 3 - middle.shape[1])) if cells.any() else None)

    def _first(self, point: np.ndarray | None) -> str:
        """The first point that a rank has, in words (collective)."""
        data = self._simplices.data
        found = first_given(data.level.comm, point)
        return "" if found is None else data.place(found)


def in_words(reasons: Sequence[str], sampled: Sequence[str], *, polygon: bool) -> str:
    """'certified' if all hypotheses hold, or with that for which it is; or 'an indicator', and why.

    Args:
        reasons: Why it is an indicator only; empty if it is more.
        sampled: Data that are known at samples only, by name.
        polygon: Whether the domain may differ from the polygon of the mesh.
    """
    if reasons:
        return "an indicator: " + "; ".join(reasons)
    *most, last = sampled or ("",)
    of_samples = f" for the sampled {', '.join(most)}{' and ' if most else ''}{last}" if last else ""
    return f"certified{' on the polygon of the mesh' if polygon else ''}{of_samples}"
