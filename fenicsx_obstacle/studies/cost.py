"""Cost of accuracy: each method on a sequence of meshes, with errors, time and memory.

A row is on the disk as soon as it is finished; after any end of the run, the next one continues from there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.penalty_parameter import penalty_parameter
from fenicsx_obstacle.answers.adapt import Refinement
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.changes import changed
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.meshing import read_once
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.estimation.norms import Distance
from fenicsx_obstacle.io.folder import content_of
from fenicsx_obstacle.parallel import forget_peak_memory, on_root, peak_memory_mb
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.studies.choices import FACTOR, FIRST, Choice, choices, uniform_meshes
from fenicsx_obstacle.studies.cost_mesh import CostMesh, ending, floor_of, place, too_many, without_name
from fenicsx_obstacle.studies.reference_solution import ExactReference, Truth, make_reference, read_reference, sizes_of
from fenicsx_obstacle.studies.rows import RowStore, row_key

_log = logging.getLogger(__name__)
Row = dict[str, Any]
OnRow = Callable[[Row], None]
DEFAULT_BUDGET = "10s, 1.2e6 unknowns"
GROWTH = 3.0  # of an adaptive mesh over the one before
MAP_MESHES, MAP_EPS = 4, 20  # of the map over h and eps: meshes, and powers of ten
REFERENCE = "reference.h5"
EPSILON = float(np.finfo(float).eps)


class CostStudy:
    """The rows of `cost` for one scene.

    Attributes:
        scene: What is solved.
        choices: The methods that are compared.
        ends: Why the rows of a choice end where they do, by its name.
        truth: What errors are measured against; there is none before `run`.
    """

    truth: Truth

    def __init__(self, scene: Scene, options: Mapping[str, Any], budget: str | None, folder: Path, comm: MPI.Comm):
        """Nothing is computed yet.

        Args:
            scene: What to solve.
            options: Changes of the scene, as in `solve`.
            budget: Of one row; by default `DEFAULT_BUDGET`.
            folder: Where a reference solution is kept.
            comm: Communicator; not used if the scene has a DOLFINx mesh.

        Raises:
            InputError: If an option does not fit.
        """
        self.full = changed(scene, options)
        self.full.only_scalar("the cost of accuracy")
        self.comm = self.full.mesh.comm if self.full.mesh is not None else comm
        # the errors of a known solution take time that does not belong to the solver
        self.scene = self.full.change({"exact": None, "report": {}})
        self.budget, self.folder = Budget.of(budget or DEFAULT_BUDGET), folder
        self.choices, self.ends = choices(self.full), dict[str, str]()
        self._store: RowStore | None = None
        self._warm: set[tuple[Any, ...]] = set()
        self._fixed: float | None = None

    @read_once()
    def run(self, on_row: OnRow, store: RowStore | None) -> list[Row]:
        """All rows (collective).

        Args:
            on_row: Called with each row.
            store: Where they are kept, or None.
        """
        self._store = store
        rows = [self._find_truth()]
        groups = list(dict.fromkeys(choice.group for choice in self.choices if not choice.adaptive))
        for group in groups:
            members = [choice for choice in self.choices if choice.group == group and not choice.adaptive]
            for row in self._uniform(members):
                rows.append(row)
                on_row(row)
        for choice in self.choices:
            for row in self._adaptive(choice) if choice.adaptive else ():
                rows.append(row)
                on_row(row)
        for row in self._map():
            rows.append(row)
            on_row(row)
        return rows

    def _find_truth(self) -> Row:
        """The first row: the reference solution (collective)."""
        coarse = next(uniform_meshes(self.scene))
        key = on_root(self.comm, row_key, self.full, f"cost truth {self.budget}", self.comm.size)
        row = self._find(key)
        if self.full.tables.exact is not None:
            self.truth = ExactReference(self.full, self.comm)
        else:
            if row is not None:
                try:
                    if on_root(self.comm, content_of, self.folder / REFERENCE) != row.get("reference"):
                        raise InputError("the reference solution of another run")
                    self.truth = read_reference(self.folder / REFERENCE, row, self.comm)
                except InputError:  # or the file was removed
                    row = None
            if row is None:
                _log.info("the reference solution, on the finest mesh")
                limits = min(self.budget.seconds, 60.0), min(self.budget.unknowns, 3e5)
                found = make_reference(coarse, uniform_meshes, *limits, self.comm)
                found.cloud.save(self.folder / REFERENCE, self.comm)
                self.truth = found
        if row is None:
            row = {"choice": "", **self.truth.record}
            if self.full.tables.exact is None:
                row["reference"] = on_root(self.comm, content_of, self.folder / REFERENCE)
            row = self._keep(key, row)
        return row

    def _uniform(self, members: Sequence[Choice]) -> Iterator[Row]:
        """Rows of choices that share their meshes (collective)."""
        found: dict[str, list[Row]] = {choice.name: [] for choice in members}
        for size in uniform_meshes(self.scene):
            going = [choice for choice in members if choice.name not in self.ends]
            if not going:
                return
            context: CostMesh | str | None = None
            try:
                for choice in going:
                    scene = self._scene_of(choice, size)
                    key = self._key(scene, choice.name)
                    row = self._find(key)
                    if row is None:
                        context = context or self._bench(scene)
                        row = self._keep(key, self._row_of(choice, context, scene))
                    if choice.solve.get("eps") == "h^2" and self._fixed is None:
                        self._fixed = row.get("eps")
                    found[choice.name].append(row)
                    yield row
                    self._end(choice, found[choice.name], scene)
            finally:
                if isinstance(context, CostMesh):
                    context.close()
                    self.truth.forget()

    def _bench(self, scene: Scene) -> CostMesh | str:
        """A solver context whose forms are compiled already, or why there is none (collective)."""
        try:
            key = scene.pair.name, scene.options.start
            if key not in self._warm:
                self._warm.add(key)
                for method in ("penalty", "vi"):
                    with closing(SolverContext(scene, self.comm)) as context, suppress(NotConverged, InputError):
                        context.answer(replace(context.options, method=method, eps="auto"))
            return CostMesh(scene, self.comm)
        except InputError as error:
            return without_name(error, self.full)

    def _row_of(self, choice: Choice, context: CostMesh | str, scene: Scene) -> Row:
        """A row, or why there is none (collective)."""
        row: Row = {"choice": choice.name, "adaptive": False, "element": scene.pair.name}
        if isinstance(context, str):
            return {**row, "reason": context}
        try:
            forget_peak_memory(self.comm)
            answer = context.work.answer(scene.options)
        except (NotConverged, InputError) as error:
            return {**row, "dofs": context.work.problem.level.dofs, "reason": without_name(error, self.full)}
        row |= self._figures(context.work, answer, context.before, context.distance)
        row |= {"poisson_seconds": context.poisson, "seconds": context.work.mesh_seconds + row["solve"]}
        row["parts"] = context.parts(answer)
        return row

    def _figures(self, work: SolverContext, answer: Answer, before: float, distance: Distance) -> Row:
        """Values that every row has (collective)."""
        memory, record = peak_memory_mb(self.comm) - before - self.truth.occupied, answer.record
        seconds, occupied = record["seconds"], forget_peak_memory(self.comm)
        errors = self.truth.errors(work, answer)
        self.truth.occupied += max(forget_peak_memory(self.comm) - occupied, 0.0)
        return {
            "dofs": record["dofs"], "cells": record["cells"], "cells_total": record["cells_total"], "h": record["h"],
            "eps": record["eps"], "newton": record["newton_iterations"], "krylov": record["krylov_iterations"],
            "solve": seconds["solve"], "mesh": seconds["mesh"], "memory_mb": memory,
            "errors": errors, "sizes": sizes_of(distance, answer),
            "floor": floor_of(work, answer),
        }  # fmt: skip

    def _adaptive(self, choice: Choice) -> Iterator[Row]:
        """Rows of one choice on meshes that are refined where the error is (collective)."""
        scene, found = choice.on(next(uniform_meshes(self.scene))), list[Row]()
        self._end(choice, found, scene)
        while choice.name not in self.ends:  # what is on the disk
            key = self._key(scene, f"{choice.name} {len(found)}")
            row = self._find(key)
            if row is None:
                break
            found.append(row)
            yield row
            self._end(choice, found, scene)
        if choice.name in self.ends:
            return
        base: Row = {"choice": choice.name, "adaptive": True, "element": scene.pair.name}
        try:
            with closing(Refinement(scene, self.comm).meshes()) as meshes:  # compiles what is not compiled yet
                for _ in islice(meshes, 2):
                    pass
            before, memory = forget_peak_memory(self.comm), 0.0
            refinement = Refinement(scene, self.comm)
            with closing(refinement.meshes(unknowns=self.budget.unknowns)) as meshes:
                for number, (work, answer) in enumerate(meshes):
                    if refinement.full:
                        self.ends[choice.name] = too_many(self.budget)
                        break
                    memory = max(memory, peak_memory_mb(self.comm) - before)
                    if number < len(found):
                        continue
                    bound = answer.bound
                    assert bound is not None
                    figures = self._figures(work, answer, before, Distance(work.problem))
                    row = {**base, **figures, "bound": bound.record, "parts": {}}
                    row |= {"seconds": refinement.path[-1]["seconds"], "poisson_seconds": None, "memory_mb": memory}
                    key = self._key(scene, f"{choice.name} {number}")
                    found.append(self._keep(key, row))
                    self.truth.forget()
                    yield found[-1]
                    self._end(choice, found, scene)
                    if choice.name in self.ends:
                        break
                    forget_peak_memory(self.comm)  # of what measured the errors
        except (NotConverged, InputError) as error:
            key = self._key(scene, f"{choice.name} {len(found)}")
            found.append(self._keep(key, {**base, "reason": without_name(error, self.full)}))
            self._end(choice, found, scene)
            yield found[-1]

    def _map(self) -> Iterator[Row]:
        """Rows over h and eps, from 1/mu L^2 down past the floor of round-off (collective)."""
        penalised = [choice for choice in self.choices if choice.solve.get("eps") == "h^2"]
        if not penalised:
            return
        for size in islice(uniform_meshes(self.scene), MAP_MESHES):
            scene = penalised[0].on(size)
            keys = [self._key(scene, f"map {k}") for k in range(MAP_EPS)]
            stored = [self._find(key) for key in keys]
            context = None if all(stored) else self._bench(scene)
            if isinstance(context, str):
                return
            if context is not None and context.work.problem.level.dofs > self.budget.unknowns:
                context.close()
                return
            for k, (key, row) in enumerate(zip(keys, stored, strict=True)):
                if row is None:
                    assert context is not None
                    row = self._keep(key, place(context, scene, self.truth, k))
                yield row
            if context is not None:
                context.close()
                self.truth.forget()

    def _end(self, choice: Choice, rows: Sequence[Row], scene: Scene) -> None:
        """Note why there is no further row, if there is none (collective)."""
        dim = {"interval": 1, "box": 3}.get(scene.tables.mesh.shape or "", 2)
        growth = GROWTH if choice.adaptive else float(FACTOR[dim] ** dim)
        why = ending(rows, growth, dim, self.budget, self.comm, adaptive=choice.adaptive)
        if why:
            self.ends[choice.name] = why

    def _scene_of(self, choice: Choice, size: Scene) -> Scene:
        if choice.solve.get("eps") == FIRST:
            choice = replace(choice, solve={**choice.solve, "eps": self._first_eps()})
        return choice.on(size)

    def _first_eps(self) -> float:
        """h^2/mu on the first mesh (collective)."""
        if self._fixed is None:
            first = next(uniform_meshes(self.scene))
            with closing(SolverContext(first, self.comm)) as context:
                self._fixed = penalty_parameter(context.problem, first.options_with(eps="h^2"))
        return self._fixed

    def _key(self, scene: Scene, kind: str) -> str:
        exact = self.full.tables.exact
        truth = "reference" if exact is None else repr(exact)
        return on_root(self.comm, row_key, scene, f"cost {kind} {truth}", self.comm.size)

    def _find(self, key: str) -> Row | None:
        """The row of a key, if it was finished (collective)."""
        return None if self._store is None else self._store.find(key)

    def _keep(self, key: str, row: Row) -> Row:
        """The row on the disk, the same on all ranks (collective)."""
        return row if self._store is None else self._store.add(key, row)
