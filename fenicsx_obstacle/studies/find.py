"""The value of a key for which a quantity reaches a target: a bracketing root finder, one solve for each value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.meshing import read_once
from fenicsx_obstacle.problems.summary import lookup
from fenicsx_obstacle.scenes.catalogue import SCENE, changed
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.studies.convergence import OnRow, Row, Study
from fenicsx_obstacle.studies.orders import last_part
from fenicsx_obstacle.studies.rows import RowStore, flat
from fenicsx_obstacle.text import nearest

WITHIN = 1e-4  # of the interval: accuracy of the value that is found
SMALLEST = 1e-12  # of the interval: what can be asked for
STEEP = 10.0  # times `within`: relative change over the last interval below which a quantity is continuous
HALVINGS = 10  # of the last interval, where the change is larger


@checked(
    scene=SCENE, vary='one key and an interval such as {"define.gap": (0, 0.2)}', target='a text such as "force = 30"'
)
def find(
    scene: Scene | str | Path, vary: Mapping[str, Sequence[float]], target: str, *, within: float = WITHIN,
    comm: MPI.Comm = MPI.COMM_WORLD, **options: Any,
) -> list[Row]:  # fmt: skip
    """Find the value of a key for which a quantity reaches a target (collective).

    Both ends of the interval are solved first; the quantity must be below the target at one and above it at the other.
    Brent's method chooses the other values.

    Args:
        scene: A Scene, its file, or its name in the catalogue.
        vary: One key and the interval to search: {"define.gap": (0, 0.2)}.
        target: A quantity and its value, "force = 30": energy, area, penetration, force (force.lower or force.upper
            where there are two obstacles), or a name of [report].
        within: Accuracy of the value, relative to the interval; the error of the mesh is not included.
        comm: Communicator.
        **options: Fixed values, as in `solve`.

    Returns:
        One row for each solve, as `study` returns them; the last is the one that was found, `rows[-1]["vary.KEY"]`.

    Raises:
        InputError: If the data are invalid, or the target is not between the values at both ends.
        NotConverged: With PETSc's reason.
    """
    return [flat(row) for row in Find(changed(scene), vary, target, options, comm, within=within).run()]


class Find(Study):
    """A study whose rows are chosen one after the other: both ends of an interval, then where a target is expected.

    Attributes:
        key: The key that varies.
        ends: Of the interval.
        within: Accuracy of the value, as a share of the interval.
        quantity: What has a target, as it was named.
        target: Its value there.
        last: The scene of the value that was found; before, of the upper end.
        rows: All rows by the value of the key, but the one that was found last.
        found: The value of the key that was found; before, the upper end.
    """

    def __init__(
        self, scene: Scene, vary: Mapping[str, Sequence[float]], target: str, options: Mapping[str, Any],
        comm: MPI.Comm = MPI.COMM_WORLD, *, within: float = WITHIN,
    ):  # fmt: skip
        """Check what can be checked before the first solve.

        Args:
            scene: What to solve.
            vary: One key with two numbers.
            target: NAME = VALUE.
            options: Fixed values.
            comm: Communicator; not used if the scene has a DOLFINx mesh.
            within: Share of the interval.

        Raises:
            InputError: If one of them is wrong.
        """
        if len(vary) != 1:
            raise InputError('find: one key varies, as in {"define.gap": (0, 0.2)}')
        self.key, ends = next(iter(vary.items()))
        numbers = isinstance(ends, Sequence) and all(isinstance(x, int | float) and math.isfinite(x) for x in ends)
        if not numbers or len(ends) != 2 or ends[0] == ends[1]:
            raise InputError(f"find: {self.key} = {ends!r}: expected two numbers, the ends of the interval to search")
        if not SMALLEST <= within < 1:
            raise InputError(f"find: within = {within:g}: expected a share of the interval, {SMALLEST:g} to 1")
        self.ends = float(min(ends)), float(max(ends))
        self.within = within
        super().__init__(scene, {self.key: list(self.ends)}, options, comm)
        self.quantity, self._place, self.target = _target(target, self.last)
        if _target(target, self.points[0][1])[2] != self.target:
            raise InputError(f"{scene.source}: target '{target}': its value depends on {self.key}; take a quantity of "
                             "[report] that is the difference, and the target 0")  # fmt: skip
        self.rows: dict[float, Row] = {}
        self.found = self.ends[1]

    @read_once()
    def run(self, on_row: OnRow | None = None, store: RowStore | None = None) -> list[Row]:
        """All rows in the order of their solves, but the one that was found last (collective).

        Args:
            on_row: Called with each row, and its answer where it was computed now.
            store: Where finished rows are kept, or None.

        Raises:
            InputError: If the target is not between the values at both ends, whose rows are kept.
        """
        from scipy.optimize import brentq  # only where a target is looked for

        self.store = store

        def difference(x: float) -> float:
            x = self.comm.bcast(float(x))  # one value on all ranks
            if x not in self.rows:
                self.rows[x], answer = self.row({self.key: x}, changed(self.base, {self.key: x}))
                if on_row is not None:
                    on_row(self.rows[x], answer)
            return self._value(x, self.rows[x]) - self.target

        values = [difference(x) + self.target for x in self.ends]
        self._check_bracket(values)
        width = self.ends[1] - self.ends[0]
        root = brentq(difference, *self.ends, xtol=self.within * width, rtol=4 * 2.0**-52)
        steep = STEEP * self.within * (max(values) - min(values))
        self.found = self._continuous(self.comm.bcast(float(root)), difference, steep)
        self.last = changed(self.base, {self.key: self.found})
        row = self.rows.pop(self.found)
        rows = [*self.rows.values(), row]
        self.write_table(rows)
        return rows

    def reached(self, row: Row) -> float:
        """The quantity in a row."""
        return self._value(row["vary"][self.key], row)

    def _value(self, x: float, row: Row) -> float:
        """The quantity in a row.

        Raises:
            InputError: If it has none.
        """
        value = lookup(row, self._place)
        if not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{self.last.source}: {self.quantity} is not finite at {self.key} = {x:.6g}")
        return float(value)

    def _check_bracket(self, values: Sequence[float]) -> None:
        if (values[0] - self.target) * (values[1] - self.target) <= 0:
            return
        at = " and ".join(f"{value:.6g} at {self.key} = {x:g}" for x, value in zip(self.ends, values, strict=True))
        beyond = "below" if max(values) < self.target else "above"
        raise InputError(
            f"{self.last.source}: {self.quantity} = {self.target:g} is not reached between the ends: it is {at}, both "
            f"{beyond} the target; choose another interval"
        )

    def _continuous(self, found: float, difference: Callable[[float], float], steep: float) -> float:
        """The value found, or one beside it that is closer to the target (collective).

        Args:
            found: By the root finder, which leaves a value on the other side of the target at a distance of `within`.
            difference: From the target.
            steep: Change of the quantity between both from which on the interval is halved.

        Raises:
            InputError: If the change remains where the interval becomes small: the quantity jumps.
        """
        if difference(found) == 0:
            return found
        beyond = [x for x in self.rows if difference(x) * difference(found) < 0]
        pair = [found, min(beyond, key=lambda x: abs(x - found))]
        change = first = abs(difference(pair[0]) - difference(pair[1]))
        for _ in range(HALVINGS):
            if change <= steep:
                break
            middle = (pair[0] + pair[1]) / 2
            pair[0 if difference(middle) * difference(pair[0]) > 0 else 1] = middle
            change = abs(difference(pair[0]) - difference(pair[1]))
        else:
            if change > first / 2:
                at = " and ".join(f"{difference(x) + self.target:.6g} at {x:.9g}" for x in sorted(pair))
                raise InputError(
                    f"{self.last.source}: {self.quantity} jumps over {self.target:g} at {self.key} = {pair[0]:.6g}: it "
                    f"is {at}; no value of {last_part(self.key)} reaches the target on this mesh"
                )
        return min(pair, key=lambda x: abs(difference(x)))


def _target(text: str, scene: Scene) -> tuple[str, str, float]:
    """The quantity as it was named, where it stands in a row, and its value."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not name or not value:
        raise InputError(f"{scene.source}: target '{text}': expected NAME = VALUE, such as force = 30")
    known = scene.quantities
    if name not in known:
        raise InputError(f"{scene.source}: target '{text}': no quantity '{name}'" + nearest(name, known))
    return name, known[name], scene.number(value, f"target '{text}'")
