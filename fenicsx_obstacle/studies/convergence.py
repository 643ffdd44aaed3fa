"""Studies: one row per value of a varied key, against the exact solution and the variational inequality."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.accuracy.norms import Distance
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.compute import Workbench, changed
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.scenes.scene import Scene

Row = dict[str, Any]


def study(
    scene: Scene,
    vary: Mapping[str, Sequence[Any]],
    *,
    on_row: Callable[[Row, Answer], None] | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    **options: Any,
) -> list[Row]:
    """Solve a scene for all combinations of values (collective).

    Rows hold what answer.json holds; `to_vi`, the distance to the SNES VI solution of the same mesh, where eps
    varies (Theorems 3.1-3.3); and, with an exact solution, the dual norm of the pressure error where meshes vary
    ((5.6)-(5.9)).

    Args:
        scene: What to solve.
        vary: Values of each key: cells, refine, eps, method, or a dotted key of the scene such as "define.ecc".
        on_row: Called with each row as it is computed, and its answer.
        comm: Communicator.
        **options: Fixed values, as in `solve`.

    Returns:
        The rows: `pandas.DataFrame(rows)`.

    Raises:
        InputError: For bad data.
        NotConverged: With PETSc's reason; `on_row` has seen what was computed before.
    """
    rows: list[Row] = []
    scene = changed(scene, options)
    bench: _Bench | None = None
    for values in product(*vary.values()):
        combination = dict(zip(vary, values, strict=True))
        now = changed(scene, combination)
        if bench is None or not bench.serves(now):
            bench = _Bench(now, comm)
        answer = bench.answer(now)
        row = {"vary": combination, **answer.record, **bench.extras(answer, by_eps="eps" in vary)}
        rows.append(row)
        if on_row is not None:
            on_row(row, answer)
    return rows


class _Bench:
    """A workbench with its reference solution."""

    def __init__(self, scene: Scene, comm: MPI.Comm):
        self.scene, self.work = scene, Workbench(scene, comm)
        self._reference: Answer | None = None
        self._distance: Distance | None = None

    def serves(self, scene: Scene) -> bool:
        """Whether the scene differs in its [solve] table only."""
        solve = {"solve.eps": "h", "solve.method": "vi"}
        return scene.change(solve).tables == self.scene.change(solve).tables

    def answer(self, scene: Scene) -> Answer:
        return self.work.answer(scene, yardstick=True)

    def extras(self, answer: Answer, *, by_eps: bool) -> Row:
        """What a study measures beyond a single answer (collective)."""
        extras: Row = {}
        if by_eps and answer.record["eps"] is not None:
            extras["to_vi"] = self._to_reference(answer)
        if not by_eps and self.work.exact is not None:
            dual = self.work.exact.dual.error(answer.pressure, answer.record["eps"])
            extras["errors"] = {**answer.record["errors"], "pressure_dual": dual}
        return extras

    def _to_reference(self, answer: Answer) -> dict[str, float]:
        if self._reference is None:
            self._reference = self.work.answer(self.scene.change({"solve.method": "vi"}))
            self._distance = Distance(self.work.problem)
        assert self._distance is not None
        reference, comm = self._reference, answer.level.comm
        u, p = answer.u.x.array - reference.u.x.array, answer.pressure.x.array - reference.pressure.x.array
        return {
            "energy": self._distance.energy(u), "l2": self._distance.l2(u), "max": largest(comm, np.abs(u)),
            "pressure_l2": self._distance.l2(p), "pressure_max": largest(comm, np.abs(reference.pressure.x.array)),
        }  # fmt: skip
