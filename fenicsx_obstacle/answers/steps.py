"""The accepted time steps: difference formulas, estimates of the local error, and files from which any number of ranks
can continue."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from fenicsx_obstacle.answers.time_history import TimeHistory, from_arrays, to_arrays
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.data.time_discretization import INERTIA, NO_STEP, RATE, TimeDiscretization
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.hdf5 import arrays
from fenicsx_obstacle.io.paraview import to_hdf5
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import places
from fenicsx_obstacle.parallel import agree, gathered, largest, on_root
from fenicsx_obstacle.safe_writing import replaced

NAME = "checkpoint.h5"
NEAR = 1e-6  # of h: how far a node may be from where it was
DEPTH = {"euler": 1, "bdf2": 2}  # of how many earlier moments a scheme makes u_t
SLOWER, FASTER = 0.2, 2.0  # how much a step may be shorter or longer than the one before
WORTH = 1.3  # times the length: a longer step pays for the matrix that it changes
SAFETY = 0.85
SAME = 1e-9  # of a step: round-off of t


class Steps:
    """The accepted time steps, and the difference formulas of the next one.

    Attributes:
        times: The last moments, the newest first.
        u_values: u there, ghosts included.
        velocity: u_t at the newest, with inertia.
        impulse: a(u, .) - f at the newest, at owned nodes, with inertia.
        eps: Penalty parameter of all steps, with the penalty method.
    """

    def __init__(self, moments: TimeDiscretization, u: np.ndarray, velocity: np.ndarray | None = None):
        self.order, self.depth = moments.order, DEPTH.get(moments.scheme, 1)
        self.times, self.u_values, self.velocity = [0.0], [u], velocity
        self.impulse: np.ndarray | None = None
        self.eps: float | None = None

    def prepare(self, problem: Problem, t: float) -> None:
        """Set the difference formulas of the step to t; `Problem.move` then updates the data."""
        assert problem.data.moment is not None
        assert problem.model.time is not None
        moment, dt, usual = problem.data.moment, t - self.times[0], problem.model.time.step
        dt = usual if abs(dt - usual) < SAME * usual else dt  # the numbers of the matrix stay, to the last digit
        moment.t = t
        if self.order == RATE:
            used = self._used()
            weights = difference([t, *self.times[:used]])
            moment.first = weights[0]
            problem.data.motion.past.x.array[:] = -sum(
                w * u for w, u in zip(weights[1:], self.u_values[:used], strict=True)
            )
        elif self.order == INERTIA:
            # twice rho (v1 - v0)/dt + (A u0 + A u1)/2 = f + p with v1 = 2 (u1 - u0)/dt - v0
            moment.first, moment.second = 2 / dt, 4 / dt**2
            assert self.velocity is not None and self.impulse is not None
            motion, u = problem.data.motion, self.u_values[0]
            motion.past.x.array[:] = 2 / dt * u
            motion.past_twice.x.array[:] = 4 / dt**2 * (u + dt * self.velocity)
            problem.law.impulse = -self.impulse

    def accept(self, t: float, u: np.ndarray) -> None:
        """Accept u as the solution at a new time."""
        if self.velocity is not None:
            self.velocity = 2 / (t - self.times[0]) * (u - self.u_values[0]) - self.velocity
        self.times = [t, *self.times][: self.depth + 1]
        self.u_values = [u, *self.u_values][: self.depth + 1]

    def error(self, problem: Problem, t: float, u: np.ndarray) -> float:
        """An estimate of the local error of the step to t, from its distance to an extrapolation (Milne's device).

        A difference of the depth k is wrong by D = u^(k+1)/(k+1)! (t - t_1) ... (t - t_k), which moves u by D/c; the
        extrapolation from k + 1 moments is off by that times (t - t_(k+1)) (Milne's device; collective).
        """
        used = self._used()
        known = min(used + 1, len(self.times))
        weights = extrapolation(t, self.times[:known])
        foreseen = sum(w * u_values for w, u_values in zip(weights, self.u_values[:known], strict=True))
        c = difference([t, *self.times[:used]])[0]
        off = np.abs(u - foreseen)
        off[problem.data.fixed[0]] = 0.0  # data
        return largest(problem.level.comm, off) / (1 + c * (t - self.times[known - 1]))

    def next_length(self, dt: float, error: float, tolerance: float) -> float:
        """Length of the next step, or of the same once more where its error was too large."""
        factor = SAFETY * (tolerance / max(error, 1e-300)) ** (1 / (self._used() + 1))
        factor = min(max(factor, SLOWER), FASTER)
        return dt * (factor if factor < 1 or factor > WORTH else 1.0)

    def _used(self) -> int:
        """Number of earlier time steps in the next difference formula; the first steps use fewer."""
        return min(self.depth, len(self.times))


def difference(times: Sequence[float]) -> list[float]:
    """Weights of values at these times whose sum is the derivative at the first one of the polynomial through them."""
    first, *others = times
    weights = []
    for j, t in enumerate(others, start=1):
        rest = [s for k, s in enumerate(times) if k not in (0, j)]
        weights.append(float(np.prod([first - s for s in rest]) / ((t - first) * np.prod([t - s for s in rest]))))
    return [-sum(weights), *weights]


def extrapolation(t: float, times: Sequence[float]) -> list[float]:
    """Weights of values at these times whose sum is the value at t of the polynomial through them."""
    return [float(np.prod([(t - s) / (one - s) for s in times if s != one])) for one in times]


def write_checkpoint(
    folder: Path, model: Model, level: Level, steps: Steps, time_history: TimeHistory, mesh: Mapping[str, np.ndarray]
) -> None:
    """Write the state into a folder, in one step, with the words of the data (collective).

    Args:
        folder: For the state.
        model: Of the scene.
        level: The mesh.
        steps: The accepted steps.
        time_history: What was recorded of them.
        mesh: `points` and `cells` in the order of the frames, on rank 0.

    Raises:
        InputError: If it cannot be written.
    """
    own, comm = level.owned, level.comm
    nodes = places(level)[:own]
    fields = {"points": nodes[:, :3], "around": nodes[:, 3:]}
    fields |= {f"u{k}": u[:own] for k, u in enumerate(steps.u_values)}
    if steps.velocity is not None:
        fields["velocity"] = steps.velocity[:own]
    found = {name: gathered(comm, values) for name, values in fields.items()}

    def save() -> None:
        arrays = {name: values for name, values in found.items() if values is not None}
        arrays |= {
            "times": np.array(steps.times),
            "rows": np.array(json.dumps([dict(row) for row in time_history.rows]).encode()),
        }
        arrays["data"] = np.array(json.dumps(_in_words(model)).encode())
        arrays |= {"eps": np.array(steps.eps)} if steps.eps is not None else {}
        arrays |= {f"frames/{name}": values for name, values in to_arrays(time_history.frames).items()}
        arrays |= {f"mesh/{name}": mesh[name] for name in ("points", "cells")}
        content = to_hdf5(arrays)
        try:
            with replaced(folder / NAME) as scratch:
                scratch.write_bytes(content)
        except OSError as error:
            raise InputError(f"{folder / NAME}: cannot be written: {error.strerror}") from None

    on_root(comm, save)


def _in_words(model: Model) -> dict[str, str]:
    """What is said of the data, by their place in the scene: formulas with their definitions, numbers, the parts of
    the boundary, and the contents of files."""
    words = {f"{part.name} on": "the boundary" if part.on is None else ", ".join(part.on) for part in model.boundary}
    for effect in model.effects:
        numbers = {key: one for key, one in vars(effect).items() if isinstance(one, int | float | str)}
        words[f"[effects] {effect.key} {numbers.get('part', '')}".strip()] = f"given {numbers or ''}".strip()
    words |= {field.source: field.in_full for field in model.data if field.pointwise or field.uniform}
    return {place.removeprefix(f"{model.source}: "): text for place, text in words.items()}


def read_checkpoint(
    folder: Path, model: Model, level: Level, mesh: Mapping[str, np.ndarray]
) -> tuple[Steps, TimeHistory]:
    """The state that a folder holds (collective).

    Args:
        folder: Of a saved or of an interrupted solve.
        model: Of the scene that goes on.
        level: The same mesh, however it is distributed.
        mesh: `points` and `cells` in the order that frames have now, on rank 0.

    Raises:
        InputError: If there is none, or it is of another mesh or of other data.
    """
    place, comm, moments = folder / NAME, level.comm, model.time
    assert moments is not None
    stored, time_history, stored_mesh = on_root(comm, _load, place)
    nodes = places(level)[:, : 3 + stored["around"].shape[1]]
    distance, found = cKDTree(np.hstack([stored["points"], stored["around"]])).query(nodes)
    elsewhere = bool(np.any(distance > NEAR * level.h)) or len(stored["points"]) != level.dofs
    with agree(comm):
        if elsewhere:
            raise InputError(f"{place}: belongs to another mesh: [mesh] must not change")
    data = _in_words(model)
    before = json.loads(stored["data"].item()) if "data" in stored else data  # earlier versions did not keep them
    changed = [key for key in sorted({**before, **data}) if before.get(key) != data.get(key)]
    with agree(comm):
        if changed:
            was, now = (words.get(changed[0], "not there") for words in (before, data))
            raise InputError(
                f"{place}: belongs to other data: {changed[0]} was {was}, now {now}; only [time] steps and end, "
                "[solve] and [report] may change"
            )
    velocity = stored["velocity"][found] if "velocity" in stored else None
    if (velocity is None) == (moments.order == INERTIA):
        raise InputError(f"{place}: is of a scene {'without' if velocity is None else 'with'} inertia")
    past = [stored[f"u{k}"][found] for k in range(len(stored["times"]))]
    steps = Steps(moments, past[0], velocity)
    steps.times = [float(t) for t in stored["times"][: steps.depth + 1]]
    steps.u_values = past[: steps.depth + 1]
    steps.eps = float(stored["eps"]) if "eps" in stored else None
    time_history = time_history.renumbered(stored_mesh, mesh)
    if steps.times[0] >= moments.end * (1 - NO_STEP):
        raise InputError(f"{place}: stands at {moments.name} = {steps.times[0]:g} already; set a later [time] end")
    return steps, time_history


def _load(place: Path) -> tuple[dict[str, np.ndarray], TimeHistory, dict[str, np.ndarray]]:
    """The state, what was recorded of the steps, and the mesh in the order of its frames (one rank)."""
    try:
        content = io.BytesIO(place.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{place}: no state to continue from: {getattr(error, 'strerror', error)}") from None
    try:
        found = arrays(content)
        frames, mesh = (
            {name.removeprefix(group): found.pop(name) for name in [*found] if name.startswith(group)}
            for group in ("frames/", "mesh/")
        )
        rows, times = json.loads(found.pop("rows").item()), found["times"]
        count, past = len(found["points"]), [f"u{k}" for k in range(len(times))]
        if not past or times.dtype.kind != "f" or times.shape != (len(past),):
            raise ValueError("it holds no state")
        if not mesh:  # of version 0.2
            mesh, found["around"] = {"points": found["points"]}, np.empty((count, 0))
        for name in ("points", "around", "velocity", *past):
            if name != "velocity" or name in found:
                shape, kind = found[name].shape, found[name].dtype.kind
                if kind != "f" or shape[:1] != (count,) or (name == "points" and shape != (count, 3)):
                    raise ValueError(f"'{name}' has shape {shape}")
        if "eps" in found and not (found["eps"].dtype.kind == "f" and found["eps"].shape == () and found["eps"] > 0):
            raise ValueError("its eps is none")
        whole = isinstance(rows, list) and all(isinstance(row, dict) and {"step", "t"} <= set(row) for row in rows)
        if not rows or not whole:
            raise ValueError("its rows are none")
        cells, nodes = mesh.get("cells", np.empty((0, 1), int)), len(mesh["points"])
        if cells.dtype.kind not in "iu" or cells.ndim != 2 or np.any((cells < 0) | (cells >= nodes)):
            raise ValueError("a cell has no point")
        return found, TimeHistory(tuple(rows), tuple(from_arrays(frames, nodes))), mesh
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{place}: is damaged: {error}") from None
