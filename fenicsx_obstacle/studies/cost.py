"""Cost of accuracy: each method on a sequence of meshes, with errors, time and memory.

A row is on the disk as soon as it is finished; after any end of the run, the next one continues from there.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.algebra.penalty_parameter import penalty_parameter
from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.io.folder import ANSWER, content_of
from fenicsx_obstacle.mesh.memory import fits
from fenicsx_obstacle.mesh.meshing import read_once
from fenicsx_obstacle.parallel import forget_peak_memory, on_root, peak_memory_mb, total
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.catalogue import changed
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.studies.choices import FACTOR, FIRST, Choice, choices, uniform_meshes
from fenicsx_obstacle.studies.reference_solution import ExactReference, Reference, Truth, make_reference, sizes_of
from fenicsx_obstacle.studies.rows import RowStore, row_key

_log = logging.getLogger(__name__)
Row = dict[str, Any]
OnRow = Callable[[Row], None]
DEFAULT_BUDGET = "10s, 1.2e6 unknowns"
GROWTH = 3.0  # of an adaptive mesh over the one before
MAP_MESHES, MAP_EPS = 4, 20  # of the map over h and eps: meshes, and powers of ten
REFERENCE = "reference"  # a folder
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

    def __init__(self, scene: Scene, options: Mapping[str, Any], budget: str | None, folder: Path):
        """Nothing is computed yet.

        Args:
            scene: What to solve.
            options: Changes of the scene, as in `solve`.
            budget: Of one row; by default `DEFAULT_BUDGET`.
            folder: Where a reference solution is kept.

        Raises:
            InputError: If an option does not fit.
        """
        self.full = changed(scene, options)
        self.full.only_scalar("the cost of accuracy")
        self.comm = self.full.mesh.comm if self.full.mesh is not None else MPI.COMM_WORLD
        # the errors of a known solution take time that does not belong to the solver
        self.scene = self.full.change({"exact": None, "report": {}})
        self.budget, self.folder = Budget.of(budget or DEFAULT_BUDGET), folder
        self.choices, self.ends = choices(self.full), dict[str, str]()
        self._warm: set[tuple[Any, ...]] = set()
        self._fixed: float | None = None
        self._dim: int | None = None  # of the meshes
        self._before = 0.0  # MB, before the present mesh

    @read_once()
    def run(self, on_row: OnRow, store: RowStore) -> list[Row]:
        """All rows (collective).

        Args:
            on_row: Called with each row.
            store: Where they are kept.
        """
        self._store = store
        rows = [self._find_truth()]
        for row in self._rows():
            rows.append(row)
            on_row(row)
        return rows

    def _rows(self) -> Iterator[Row]:
        """The rows of all choices, and of the map (collective)."""
        uniform = [choice for choice in self.choices if not choice.adaptive]
        for group in dict.fromkeys(choice.group for choice in uniform):
            yield from self._uniform([choice for choice in uniform if choice.group == group])
        for choice in self.choices:
            if choice.adaptive:
                yield from self._adaptive(choice)
        yield from self._map()

    def _find_truth(self) -> Row:
        """The first row: the reference solution (collective)."""
        key = on_root(self.comm, row_key, self.full, f"cost truth {self.budget}", self.comm.size)
        row = self._store.find(key)
        if self.full.tables.exact is not None:
            self.truth = ExactReference(self.full, self.comm)
        else:
            if row is not None:
                try:
                    if self._content_of_reference() != row.get("reference"):
                        raise InputError("the reference solution of another run")
                    self.truth = Reference(Answer.read(self.folder / REFERENCE, self.comm), row)
                except InputError:  # or files were removed
                    row = None
            if row is None:
                _log.info("the reference solution, on the finest mesh")
                limits = min(self.budget.seconds, 60.0), min(self.budget.unknowns, 3e5)
                self.truth = make_reference(self.scene, *limits, self.comm)
                self.truth.answer.save(self.folder / REFERENCE)
        if row is None:
            row = {"choice": "", **self.truth.record}
            if self.full.tables.exact is None:
                row["reference"] = self._content_of_reference()
            row = self._store.add(key, row)
        return row

    def _content_of_reference(self) -> str:
        """A hash of the reference solution that is kept (collective)."""
        return on_root(self.comm, content_of, self.folder / REFERENCE / ANSWER)

    def _uniform(self, members: Sequence[Choice]) -> Iterator[Row]:
        """Rows of choices that share their meshes (collective)."""
        found: dict[str, list[Row]] = {choice.name: [] for choice in members}
        for size in uniform_meshes(self.scene):
            going = [choice for choice in members if choice.name not in self.ends]
            if not going:
                return
            mesh: SolverContext | None = None
            try:
                for choice in going:
                    scene = self._scene_of(choice, size)
                    key = self._key(scene, choice.name)
                    row = self._store.find(key)
                    if row is None:
                        row = {"choice": choice.name, "adaptive": False, "element": scene.pair.name}
                        try:
                            mesh = mesh or self._mesh(scene)
                            row |= self._solved(mesh, scene)
                        except (NotConverged, InputError) as error:
                            dofs = {} if mesh is None else {"dofs": mesh.problem.level.dofs}
                            row |= {**dofs, "reason": without_name(error, self.full)}
                        row = self._store.add(key, row)
                    found[choice.name].append(row)
                    yield row
                    self._end(choice, found[choice.name], scene)
            finally:
                if mesh is not None:
                    mesh.close()
                    self.truth.forget()

    def _mesh(self, scene: Scene) -> SolverContext:
        """A mesh on which forms are compiled already (collective).

        Raises:
            InputError: If the scene has none.
        """
        key = scene.pair.name, scene.options.start
        if key not in self._warm:
            self._warm.add(key)
            for method in ("penalty", "vi"):
                with closing(SolverContext(scene, self.comm)) as context, suppress(NotConverged, InputError):
                    context.answer(replace(scene.options, method=method, eps="auto"))
        self._before = forget_peak_memory(self.comm)
        mesh = SolverContext(scene, self.comm)
        _ = mesh.distance, mesh.poisson
        return mesh

    def _solved(self, mesh: SolverContext, scene: Scene) -> Row:
        """The values of a row (collective).

        Raises:
            InputError, NotConverged: If there are none.
        """
        forget_peak_memory(self.comm)
        answer = mesh.answer(scene.options)
        row = self._figures(mesh, answer)
        spent = {"poisson_seconds": mesh.poisson, "seconds": mesh.mesh_seconds + row["solve"]}
        return {**row, **spent, "parts": parts(mesh, answer)}

    def _figures(self, work: SolverContext, answer: Answer) -> Row:
        """Values that every row has (collective)."""
        memory, record = peak_memory_mb(self.comm) - self._before - self.truth.occupied, answer.record
        seconds, occupied = record["seconds"], forget_peak_memory(self.comm)
        errors = self.truth.errors(work, answer)
        self.truth.occupied += max(forget_peak_memory(self.comm) - occupied, 0.0)
        return {
            "dofs": record["dofs"], "cells": record["cells"], "cells_total": record["cells_total"], "h": record["h"],
            "eps": record["eps"], "newton": record["newton_iterations"], "krylov": record["krylov_iterations"],
            "solve": seconds["solve"], "mesh": seconds["mesh"], "memory_mb": memory,
            "errors": errors, "sizes": sizes_of(work.distance, answer),
            "floor": floor_of(work, answer),
        }  # fmt: skip

    def _adaptive(self, choice: Choice) -> Iterator[Row]:
        """Rows of one choice on meshes that are refined where the error is (collective)."""
        scene, found = choice.on(next(uniform_meshes(self.scene))), list[Row]()
        base, computed = {"choice": choice.name, "adaptive": True, "element": scene.pair.name}, None
        while choice.name not in self.ends:
            key = self._key(scene, f"{choice.name} {len(found)}")
            row = self._store.find(key)
            if row is None:
                computed = computed or self._refined(scene, len(found))
                row = next(computed, None)
                if row is None:
                    self.ends[choice.name] = too_many(self.budget)
                    return
                row = self._store.add(key, {**base, **row})
                self.truth.forget()
            found.append(row)
            yield row
            self._end(choice, found, scene)
        if computed is not None:
            computed.close()

    def _refined(self, scene: Scene, first: int) -> Generator[Row, None, None]:
        """The values of a row on each mesh, of this number on, or in the end why there is none (collective)."""
        try:
            with closing(Adaptation(scene, self.comm).meshes()) as meshes:  # compiles what is not compiled yet
                for _ in islice(meshes, 2):
                    pass
            self._before, memory = forget_peak_memory(self.comm), 0.0
            refinement = Adaptation(scene, self.comm)
            with closing(refinement.meshes(unknowns=self.budget.unknowns)) as meshes:
                for number, (work, answer) in enumerate(meshes):
                    if refinement.full:
                        return
                    memory = max(memory, peak_memory_mb(self.comm) - self._before)
                    if number < first:
                        continue
                    assert answer.bound is not None
                    figures = self._figures(work, answer)
                    spent = {"seconds": refinement.path[-1]["seconds"], "poisson_seconds": None, "memory_mb": memory}
                    yield {**figures, "bound": answer.bound.record, "parts": {}, **spent}
                    forget_peak_memory(self.comm)  # of what measured the errors
        except (NotConverged, InputError) as error:
            yield {"reason": without_name(error, self.full)}

    def _map(self) -> Iterator[Row]:
        """Rows over h and eps, from 1/mu L^2 down past the floor of round-off (collective)."""
        penalised = [choice for choice in self.choices if choice.solve.get("eps") == "h^2"]
        if not penalised:
            return
        for size in islice(uniform_meshes(self.scene), MAP_MESHES):
            scene = penalised[0].on(size)
            keys = [self._key(scene, f"map {k}") for k in range(MAP_EPS)]
            stored = [self._store.find(key) for key in keys]
            mesh = None
            if not all(stored):
                try:
                    mesh = self._mesh(scene)
                except InputError:
                    return
            with closing(mesh) if mesh is not None else nullcontext():
                if mesh is not None and mesh.problem.level.dofs > self.budget.unknowns:
                    return
                for k, (key, row) in enumerate(zip(keys, stored, strict=True)):
                    if row is None:
                        assert mesh is not None
                        row = self._store.add(key, place(mesh, scene, self.truth, k))
                    yield row
            self.truth.forget()

    def _end(self, choice: Choice, rows: Sequence[Row], scene: Scene) -> None:
        """Note why there is no further row, if there is none (collective)."""
        budget, last = self.budget, rows[-1]
        if last.get("reason"):
            self.ends[choice.name] = str(last["reason"])
            return
        if self._dim is None:
            self._dim = meshes.build(scene, self.comm, 0).mesh.topology.dim
        dim, halved = self._dim, scene.tables.mesh.shape is None
        growth = GROWTH if choice.adaptive else float((2 if halved else FACTOR[dim]) ** dim)
        times = [row["seconds"] for row in rows]
        if choice.adaptive:  # seconds are those of all meshes so far
            next_ = times[-1] + growth * (times[-1] - (times[-2] if len(times) > 1 else 0.0))
        else:
            next_ = times[-1] * max([growth, *(b / a for a, b in list(pairwise(times))[-1:])])
        why = ""
        if next_ > budget.seconds:
            why = f"the next mesh would take about {next_:.2g} s; the budget is {budget.seconds:g} s"
        elif growth * last["dofs"] > budget.unknowns and not choice.adaptive:
            why = too_many(budget)
        elif growth * last["memory_mb"] > budget.megabytes:
            why = f"the next mesh would take more than the budget of {budget.megabytes:g} MB"
        elif not fits(growth * last["dofs"], dim, self.comm):
            why = "the next mesh would not fit into the memory of this machine"
        if why:
            self.ends[choice.name] = why

    def _scene_of(self, choice: Choice, size: Scene) -> Scene:
        """The scene of a choice on a mesh; a fixed eps is h^2/mu on the first mesh (collective)."""
        if choice.solve.get("eps") != FIRST:
            return choice.on(size)
        if self._fixed is None:
            first = next(uniform_meshes(self.scene))
            with closing(SolverContext(first, self.comm)) as context:
                self._fixed = penalty_parameter(context.problem, first.options_with(eps="h^2"))
        return replace(choice, solve={**choice.solve, "eps": self._fixed}).on(size)

    def _key(self, scene: Scene, kind: str) -> str:
        exact = self.full.tables.exact
        truth = "reference" if exact is None else repr(exact)
        return on_root(self.comm, row_key, scene, f"cost {kind} {truth}", self.comm.size)


def parts(context: SolverContext, answer: Answer) -> dict[str, dict[str, float]]:
    """The part of eps: distance to the solution of the inequality on the same mesh (collective)."""
    if answer.record["method"] == "vi":
        context.inequality = answer
    if answer.record["eps"] is not None:
        with suppress(NotConverged):
            return {"eps": context.distance.of_u(answer.u.x.array - context.inequality.u.x.array)}
    return {}


def floor_of(context: SolverContext, answer: Answer) -> float:
    """An estimate of the relative error of u by unbalanced forces and round-off (collective).

    Systems are solved until unbalanced forces are 1e-10 of the acting ones. Values of u are rounded, which causes
    forces of machine epsilon times the stiffness of each node and u there, with random signs.
    """
    problem, comm = context.problem, answer.level.comm
    step = answer.history[-1]
    if step.forces <= 0:
        return EPSILON
    rounded = 0.0
    if problem.affine and problem.level.pair.nodal:
        u = answer.u.x.array[: problem.level.owned]
        rounded = EPSILON * math.sqrt(total(comm, (problem.matrices.diagonal * u * ~problem.fixed) ** 2))
    return min(step.unbalanced / step.forces, TOLERANCE) + rounded / step.forces


def too_many(budget: Budget) -> str:
    """The message that a mesh exceeds a budget."""
    return f"the next mesh would have more than the {budget.unknowns:g} unknowns of the budget"


def place(context: SolverContext, scene: Scene, truth: Truth, k: int) -> dict[str, Any]:
    """One place of the map over h and eps: k powers of ten below 1/mu L^2 (collective)."""
    problem = context.problem
    h = problem.level.h
    unit = penalty_parameter(problem, scene.options) / h**2  # 1/mu
    eps = unit * problem.data.extent**2 * 10.0**-k
    row: dict[str, Any] = {"choice": "map", "h": h, "eps": eps, "paper": unit * h**2, "auto": unit * h**2 / 100,
                "floor": smallest_eps(problem)}  # fmt: skip
    try:
        answer = context.answer(replace(scene.options, eps=eps))
    except (NotConverged, InputError) as error:
        return {**row, "reason": without_name(error, scene)}
    row |= {"errors": truth.errors(context, answer), "sizes": sizes_of(context.distance, answer)}
    return {**row, "line": answer.record.get("round_off", {}).get("line")}


def without_name(error: Exception, scene: Scene) -> str:
    """A message without the name of the scene, which all rows share."""
    return str(error).removeprefix(f"{scene.source}: ")
