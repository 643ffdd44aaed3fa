"""What an error bound rests on: certified, for sampled data or the polygon of the mesh only, or an indicator."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fenicsx_obstacle.estimation.edges import cut_parts
from fenicsx_obstacle.estimation.exactness import Known
from fenicsx_obstacle.estimation.rim import Rim
from fenicsx_obstacle.estimation.triangles import Triangles
from fenicsx_obstacle.parallel import total

UNTRUSTED = 10.0  # times the bound: if the load could add so much between its samples they say nothing


class Obstacle(Protocol):
    """One obstacle between the nodes: `peaks.Peaks` of P1, `element_p2.LatticeObstacle` of P2."""

    sampled: bool
    unbounded: np.ndarray
    surprise: float


@dataclass(frozen=True)
class Standing:
    """What a bound rests on.

    Attributes:
        reasons: Why it is an indicator only; empty if it is more.
        sampled: Data that are known at samples only, by name.
        polygon: Whether the domain may differ from the polygon of the mesh.
        detail: What the samples of the obstacle have shown.
    """

    reasons: tuple[str, ...]
    sampled: tuple[str, ...]
    polygon: bool
    detail: str = ""

    @property
    def guaranteed(self) -> bool:
        """Whether all hypotheses hold."""
        return not (self.reasons or self.sampled or self.polygon)

    @property
    def words(self) -> str:
        """'certified', and for what; or 'an indicator', and why."""
        *most, last = self.sampled or ("",)
        sampled = f" for the sampled {', '.join(most)}{' and ' if most else ''}{last}" if last else ""
        if self.reasons:
            return "an indicator: " + "; ".join(self.reasons)
        detail = f": {self.detail}" if self.detail else ""
        return f"certified{' on the polygon of the mesh' if self.polygon else ''}{sampled}{detail}"


class Hypotheses:
    """What is known of the data on one mesh, without sampling."""

    def __init__(self, triangles: Triangles, tension: Known, load: Known, unseen: np.ndarray, rim: Rim):
        """Look at the parts of the boundary (collective).

        Args:
            triangles: The owned cells.
            tension: In the cells.
            load: Likewise.
            unseen: What the load's variation could add to the bound in each cell where it is sampled.
            rim: Boundary values.
        """
        self._triangles, self._rim, self._unseen = triangles, rim, unseen
        comm = triangles.data.level.comm
        self._reasons = cut_parts(triangles)
        self._middles = np.zeros((len(triangles.area), 3))
        self._middles[:, :2] = triangles.x.mean(axis=1)
        found = (
            ("tension may be 0, negative, infinite or undefined", self._near(~tension.finite | (tension.lower <= 0))),
            ("load may be infinite or undefined", self._near(~load.finite)),
            ("boundary value may be infinite or undefined", self._first(rim.unbounded)),
        )
        self._reasons += [f"the {what} near {place}" for what, place in found if place]
        exact = {"tension": tension, "load": load}
        self._sampled = [name for name, known in exact.items() if total(comm, np.count_nonzero(~known.exact)) > 0]
        self._load_is_finite = not found[1][1]

    def standing(self, reasons: Iterable[str], obstacles: Iterable[Obstacle], bound: float) -> Standing:
        """What a bound rests on (collective).

        Args:
            reasons: Further ones for which it is an indicator.
            obstacles: With the bound's state in mind.
            bound: Its total.
        """
        level, found, obstacles = self._triangles.data.level, [*reasons, *self._reasons], list(obstacles)
        for side in obstacles:
            if place := self._near(side.unbounded):
                found.append(f"the obstacle may be infinite or undefined near {place}")
        if self._load_is_finite and np.sqrt(total(level.comm, self._unseen**2)) > UNTRUSTED * bound:
            worst = self._unseen >= 0.5 * max(level.comm.allgather(float(self._unseen.max(initial=0.0))))
            found.append(f"between its samples the load may be much larger than they show, near {self._near(worst)}")
        sampled = list(self._sampled)
        sampled += ["obstacle"] if any(side.sampled for side in obstacles) else []
        sampled += ["boundary value"] if self._rim.sampled else []
        surprise = max((side.surprise for side in obstacles), default=0.0)
        detail = f"its peaks within cells differ by {surprise:.2g} from sample to sample" if surprise > 0 else ""
        return Standing(tuple(found), tuple(sampled), level.polygonal is not True, detail)

    def _near(self, cells: np.ndarray) -> str:
        """The first of some cells, in words; empty if there is none (collective)."""
        return self._first(self._middles[np.argmax(cells)] if cells.any() else None)

    def _first(self, point: np.ndarray | None) -> str:
        """The first point that a rank has, in words (collective)."""
        data = self._triangles.data
        found = next((one for one in data.level.comm.allgather(point) if one is not None), None)
        return "" if found is None else data.place(found)
