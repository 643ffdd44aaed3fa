"""What a golden result is: a case with a name, and the numbers and words that it leaves."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from mpi4py import MPI

import fenicsx_obstacle

COMM = MPI.COMM_WORLD
DEMOS = Path(__file__).resolve().parents[2] / "demos"
CHECKOUT = Path(fenicsx_obstacle.__file__).resolve().parents[1]  # of the package that runs
Values = dict[str, Any]
# times, memory, versions and places differ from run to run; the last ones say nothing
VOLATILE = {"seconds", "memory_mb", "versions", "command", "ranks", "poisson_seconds", "poisson_units",
            "processor_seconds", "title", "converged", "round_off"}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A golden result.

    Attributes:
        name: Subject and variant, `subject/variant`.
        run: Makes the values in a folder of its own, the same on all ranks (collective).
        ranks: The numbers of ranks on which it runs.
    """

    name: str
    run: Callable[[Path], Mapping[str, Any]]
    ranks: tuple[int, ...]


CASES: dict[str, Case] = {}
ALL, ONE = (1, 2, 3), (1,)  # all: one rank and, by the name, two or three
EVERY = ("empty/",)  # subjects that run on one, two and three ranks


def add(name: str, run: Callable[[Path], Mapping[str, Any]], ranks: tuple[int, ...] = ALL) -> None:
    """Register a case."""
    assert name not in CASES, name
    if ranks == ALL and not name.startswith(EVERY):
        ranks = (1, 2 + crc32(name.encode()) % 2)
    CASES[name] = Case(name, run, ranks)


def case(name: str, ranks: tuple[int, ...] = ALL) -> Callable[[Callable[[Path], Values]], Callable[[Path], Values]]:
    """Register a function of a folder as a case."""

    def keep(run: Callable[[Path], Values]) -> Callable[[Path], Values]:
        add(name, run, ranks)
        return run

    return keep


def flat(record: Mapping[str, Any], prefix: str = "") -> Values:
    """A nested record with dotted names, without what differs from run to run; short lists of numbers stay lists.

    Of files only the names stay, not the checksums: some hold times and places.
    """
    values: Values = {}
    for key, value in record.items():
        if value is None or key.endswith("seconds") or not VOLATILE.isdisjoint(key.split(".")):
            continue
        name = f"{prefix}{key}"
        if key == "files" and isinstance(value, Mapping):
            values[name] = sorted(value)
        elif isinstance(value, Mapping):
            values |= flat(value, f"{name}.")
        elif isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
            for number, one in enumerate(value):
                values |= flat(one, f"{name}.{number}.")
        else:
            values[name] = plain(value)
    return values


def plain(value: Any) -> Any:
    """A value as JSON has it, floats with 11 digits."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.11g}") if math.isfinite(value) else str(value)
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def placeless(value: Any, folder: Path) -> Any:
    """A value in whose words FOLDER, DEMOS and CHECKOUT stand for places of this run."""
    if isinstance(value, list):
        return [placeless(one, folder) for one in value]
    if not isinstance(value, str):
        return value
    for place, name in ((folder, "FOLDER"), (DEMOS, "DEMOS"), (CHECKOUT, "CHECKOUT")):
        value = value.replace(str(place), name)
    return value


def norms(function: Any) -> list[float]:
    """Sum, Euclidean norm and a sum weighted by place, of the values of a Function on all ranks (collective)."""
    V = function.function_space
    size = V.dofmap.index_map.size_local
    values = function.x.array[: size * V.dofmap.index_map_bs].reshape(size, V.dofmap.index_map_bs).astype(float)
    x = V.tabulate_dof_coordinates()[:size]
    infinite = ~np.isfinite(values)
    values = np.where(infinite, 0.0, values)
    weights = np.cos(1 + x @ [3.0, 5.0, 7.0])[:, None] * (1 + np.arange(values.shape[1]))
    parts = [values.sum(), (values**2).sum(), (values * weights).sum(), infinite.sum()]
    total, squares, weighted, missing = COMM.allreduce(np.array(parts, dtype=float))
    return [total, math.sqrt(squares), weighted, *([missing] if missing else [])]


def digest(solution: Any) -> Values:
    """The values of a solution: its record, norms of its fields, and on one rank the Newton steps (collective)."""
    values = flat(solution.record)
    for name, function in solution.functions().items():
        values[f"field.{name}"] = plain(norms(function))
    if COMM.size == 1:
        values |= trace(solution.history)
    return values


def trace(history: Iterable[Any]) -> Values:
    """The Newton steps, which say where two solves begin to differ."""
    steps = list(history)
    names = [name for name in ("active", "changed", "krylov") if steps and hasattr(steps[0], name)]
    return {f"trace.{name}": [getattr(step, name) for step in steps] for name in names}
