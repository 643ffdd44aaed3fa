"""Studies: one row per combination of values, against the exact solution and the variational inequality."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.io.validation import check_record
from fenicsx_obstacle.mesh.meshing import read_once
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes.catalogue import SCENE, changed
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.studies.orders import parameter
from fenicsx_obstacle.studies.rows import RowStore, flat, row_key
from fenicsx_obstacle.studies.solves import Solves

_log = logging.getLogger(__name__)
Row = dict[str, Any]
OnRow = Callable[[Row, Answer | None], None]


@checked(scene=SCENE, vary='values by keys such as {"cells": [16, 32]}')
def study(
    scene: Scene | str | Path,
    vary: Mapping[str, Sequence[Any]],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    uncertainty: bool = False,
    **options: Any,
) -> list[Row]:
    """Solve a scene for all combinations of values (collective).

    Rows have the values of answer.json. If eps varies they also have `to_vi.*`, the distance to the SNES VI solution
    on the same mesh (Theorems 3.1-3.3); if meshes vary and the exact solution is known, the dual norm of the pressure
    error ((5.6)-(5.9)).

    Args:
        scene: A Scene, its file, or its name in the catalogue.
        vary: Values of each key: cells, refine, eps, method, or a dotted key of the scene such as "define.ecc".
        comm: Communicator.
        uncertainty: Estimate the error of each quantity in each row, as in `solve`.
        **options: Fixed values, as in `solve`.

    Returns:
        Rows with dotted keys: `pandas.DataFrame(rows)`.

    Raises:
        InputError: If the data are invalid.
        NotConverged: With PETSc's reason.
    """
    if not vary:
        raise InputError('study: vary = {}: name a key and its values, as in {"cells": [16, 32]}; one solve is solve()')
    return [flat(row) for row in Study(changed(scene), vary, options, comm, uncertainty=uncertainty).run()]


class Study:
    """A study that may be interrupted: rows in a store are not computed again.

    Attributes:
        base: The scene without these values.
        vary: Values of each key that varies.
        by: What orders are taken in: eps, h or nothing.
        penalised: Whether any row has an eps.
        last: The scene of the last row.
        points: The values of each row, and its scene.
        store: Where finished rows are kept, or None.
    """

    def __init__(
        self,
        scene: Scene,
        vary: Mapping[str, Sequence[Any]],
        options: Mapping[str, Any],
        comm: MPI.Comm = MPI.COMM_WORLD,
        *,
        uncertainty: bool = False,
    ):
        """Check all scenes of the study before the first is solved.

        Args:
            scene: What to solve.
            vary: Values of each key.
            options: Fixed values.
            comm: Communicator; not used if the scene has a DOLFINx mesh.
            uncertainty: Whether each row has the uncertainty of its output quantities.

        Raises:
            InputError: If a value does not fit its key.
        """
        self._uncertainty = uncertainty
        for key, values in vary.items():
            if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
                raise InputError(f"{scene.source}: {key} = {values!r} cannot vary: expected a list of values")
        self.vary, self.by = vary, parameter(list(vary))
        self.comm = scene.mesh.comm if scene.mesh is not None else comm
        self._solves = Solves(self.comm)
        self.store: RowStore | None = None
        self.base = changed(scene, options)
        combinations = [dict(zip(vary, values, strict=True)) for values in product(*vary.values())]
        self.points = [(combination, changed(self.base, combination)) for combination in combinations]
        self.last = self.points[-1][1]
        penalised = [point.penalised for _, point in self.points]
        if self.by == "eps" and not all(penalised):
            raise InputError(f"{scene.source}: eps cannot vary: it means nothing to method vi, or without an obstacle")
        self.penalised = any(penalised)

    @read_once()
    def run(self, on_row: OnRow | None = None, store: RowStore | None = None) -> list[Row]:
        """All rows, in order (collective).

        Args:
            on_row: Called with each row, and its answer where it was computed now.
            store: Where finished rows are kept, or None.
        """
        self.store = store
        rows: list[Row] = []
        for number, (combination, scene) in enumerate(self.points, start=1):
            values = ", ".join(f"{key}={value}" for key, value in combination.items())
            _log.info(values, extra={"row": number, "rows": len(self.points)})
            row, answer = self.row(combination, scene)
            rows.append(row)
            self.write_table(rows)
            if on_row is not None:
                on_row(row, answer)
        return rows

    def solve(self, combination: Mapping[str, Any], scene: Scene) -> Answer:
        """The answer of a scene with these values of the keys (collective)."""
        return self._solves.answer(combination, scene, uncertainty=self._uncertainty)

    def row(self, combination: Mapping[str, Any], scene: Scene) -> tuple[Row, Answer | None]:
        """A row, which is kept, and its answer where it is computed now (collective)."""
        key = self._key(scene)
        if self.store is not None and (stored := self.store.find(key)) is not None:
            try:
                check_record(stored)
            except ValueError as error:
                raise InputError(f"{self.store.path}: a row is damaged: {error}; use --fresh or --output") from None
            return {**stored, "vary": dict(combination)}, None  # other keys may have led to the same scene
        answer = self.solve(combination, scene)
        if self._key(scene) != key:
            raise InputError(f"{scene.source}: one of its files has changed while it was solved: run the study again")
        row = {"vary": dict(combination), **answer.record, **self._extras(answer)}
        return row if self.store is None else self.store.add(key, row), answer

    def write_table(self, rows: list[Row]) -> None:
        """Write rows.csv, where rows are kept (collective)."""
        if self.store is not None:
            self.store.write_table(rows)

    def _key(self, scene: Scene) -> str:
        kind = self.by + " uncertainty" * self._uncertainty
        return "" if self.store is None else on_root(self.comm, row_key, scene, kind, self.comm.size)

    def _extras(self, answer: Answer) -> Row:
        """Quantities that a study measures in addition to those of a single answer (collective)."""
        work = self._solves.work
        assert work is not None
        by, eps, extras = self.by, answer.record["eps"], Row()
        if answer.scene.tables.profile:
            from fenicsx_obstacle.answers.profiles import as_columns, profiles_of  # only where a scene names one

            extras["profiles"] = {name: as_columns(profile) for name, profile in profiles_of(answer).items()}
        if by == "eps" and eps is not None and not answer.scene.model.vector_valued:
            extras["to_vi"] = self._solves.to_reference(answer)
        at_rest = self.last.time is None
        if by == "h" and work.exact is not None and at_rest and not answer.scene.model.thin:
            dual = work.exact.dual.error(answer.pressure, eps)
            extras["errors"] = {**answer.record["errors"], "pressure_dual": dual}
        return extras
