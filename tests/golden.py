"""Reference results of the catalogue, the demos and the hard scenes, for changes that must not change numbers.

`.venv/bin/python tests/golden.py check` solves every scene and prints each value that differs from tests/golden/1.json,
`mpirun -n 2 .venv/bin/python tests/golden.py check` from 2.json; `write` replaces the file. Names of scenes after the
command restrict it to them. A set takes about two minutes. Set OMP_NUM_THREADS=1 and SCOTCH_PTHREAD_NUMBER=1, as
`./obstacle` does: with threads the same mesh is partitioned in another way each time.

On the number of ranks of the reference all values are compared to 1e-9, relative. Values of round-off (the balance of
forces, errors where the discrete solution is exact) need to agree to 1e-12 of what they are the round-off of: the
field, the forces of the report. Moments of fields are integrals with cancellation: to 1e-9 of the field's norm.
Iteration counts of the scene press are not compared: which of its symmetric nodes touches first in a step is decided
by the last digit, and two runs on 2 ranks differ by 1 or 2 of 45 Newton steps.

On other numbers of ranks, such as 3, the reference is that of 1 rank, and 1e-9 is 1e-6: dofs are numbered and sums are
taken in another order, solvers stop at unbalanced forces of 1e-10 of the acting ones, and stiffness and 1/eps amplify
that. Iteration counts depend on the partition and are not compared, nor are contact sets of the biactive scenes, whose
contact without pressure is decided by round-off.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import ObstacleError, Scene, solve
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.catalogue import names
from fenicsx_obstacle.scenes.catalogue import scene as catalogued
from fenicsx_obstacle.verification.hard.cases import cases

COMM = MPI.COMM_WORLD
HERE = Path(__file__).parent
SAME_RANKS, OTHER_RANKS = 1e-9, 1e-6
ROUND_OFF = 1e-12
ZERO = 1e-50  # fields of this size are 0
DIGITS = 12  # that are stored
# run times, versions and memory differ from run to run; round_off and algebraic are rounding errors themselves
VOLATILE = {"seconds", "poisson_seconds", "poisson_units", "memory_mb", "versions", "command", "round_off", "algebraic"}
KNOWN = {"scene", "title", "method", "converged", "reason", "ranks", "bound.words"}  # the key of a result says them
PARTITIONED = ("newton_", "krylov_")


def scenes() -> Iterator[tuple[str, Scene, dict[str, Any]]]:
    """A key, a scene and the arguments of `solve` for each result."""
    for name in names():
        scene = catalogued(name)
        for method in ("penalty", "vi"):
            yield f"catalogue/{name}/{method}", scene, {"method": method, "bound": method == "penalty"}
    for file in sorted(HERE.parent.glob("demos/*.toml")):
        if not file.is_symlink():
            yield f"demos/{file.stem}", Scene.read(file), {}
    for case in cases():
        if not case.refuse:
            for method in ("penalty", "vi"):
                yield f"hard/{case.name}/{method}", case.on(0), {"method": method}


def values_of(scene: Scene, arguments: dict[str, Any]) -> dict[str, Any]:
    """All numbers and words of a result by name; norm and first moment of its fields (collective)."""
    if arguments.get("bound"):
        try:
            answer = solve(scene, **arguments)
        except ObstacleError:  # no bound for this scene
            answer = solve(scene, **{**arguments, "bound": False})
    else:
        try:
            answer = solve(scene, **arguments)
        except ObstacleError as error:
            return {"error": str(error)}
    found = {key: value for key, value in _flat(dict(answer.record)) if key not in KNOWN}
    for name, function in answer.functions().items():
        own = function.function_space.dofmap.index_map.size_local
        values = np.where(np.isfinite(function.x.array[:own]), function.x.array[:own], 0.0)
        weights = 1 + function.function_space.tabulate_dof_coordinates()[:own].sum(axis=1)
        found[f"{name}.norm"] = math.sqrt(total(COMM, values**2))
        found[f"{name}.moment"] = total(COMM, values * weights) / math.sqrt(total(COMM, weights**2))
    return {key: _rounded(value) for key, value in found.items()}


def _flat(record: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in record.items():
        if key in VOLATILE:
            continue
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, (int, float, str, bool)) or value is None:
            yield prefix + key, value


def _rounded(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def differences(name: str, old: dict[str, Any], new: dict[str, Any], same_ranks: bool) -> Iterator[str]:
    """A line for each value that is missing, new, or differs."""
    for key in sorted({*old, *new}):
        if name.split("/")[1] == "press" and key.startswith(PARTITIONED):
            continue
        if not same_ranks and (key.startswith(PARTITIONED) or ("biactive" in name and key.startswith("contact."))):
            continue
        if key not in old or key not in new:
            yield f"{key}: {'new' if key in new else 'missing'}"
        elif not _same(key, old, new, SAME_RANKS if same_ranks else OTHER_RANKS):
            yield f"{key}: {old[key]!r} before, {new[key]!r} now"


def _same(key: str, old: dict[str, Any], new: dict[str, Any], tolerance: float) -> bool:
    a, b = old[key], new[key]
    if not isinstance(a, float) or not isinstance(b, (int, float)):
        return bool(a == b)
    group, _, what = key.partition(".")
    scale = ROUND_OFF * _size(group, old)
    if what == "moment":
        scale = max(scale, tolerance * abs(old[f"{group}.norm"]))
    return math.isclose(a, b, rel_tol=tolerance, abs_tol=max(scale, ZERO)) or (math.isnan(a) and math.isnan(b))


def _size(group: str, old: dict[str, Any]) -> float:
    """Size of what a value of this group may be the round-off of."""
    groups = {"errors": ("u",), "error": ("u",), "report": ("report", "contact")}.get(group, (group,))
    values = (value for key, value in old.items() if key.partition(".")[0] in groups)
    return max((abs(value) for value in values if isinstance(value, float) and math.isfinite(value)), default=0.0)


def main() -> None:
    """Write or check (collective)."""
    command, *chosen = sys.argv[1:]
    folder = HERE / "golden"
    file = folder / f"{COMM.size}.json"
    same_ranks = command == "write" or file.exists()
    file = file if same_ranks else folder / "1.json"
    stored = json.loads(file.read_text()) if file.exists() else {}
    found, wrong = {}, 0
    for key, scene, arguments in scenes():
        if chosen and not any(part in chosen for part in key.split("/")):
            continue
        found[key] = COMM.bcast(values_of(scene, arguments))
        if command == "check" and COMM.rank == 0:
            for line in differences(key, stored.get(key, {}), found[key], same_ranks):
                wrong += 1
                print(f"{key}: {line}", flush=True)
    if COMM.rank == 0:
        if command == "write":
            folder.mkdir(exist_ok=True)
            rows = (f"{json.dumps(key)}:{json.dumps(value, separators=(',', ':'))}"
                    for key, value in {**stored, **found}.items())  # fmt: skip
            file.write_text("{\n" + ",\n".join(rows) + "\n}\n")
        print(f"{len(found)} results, {wrong} differences" if command == "check" else f"{len(found)} results written")
    sys.exit(COMM.bcast(wrong) > 0)


if __name__ == "__main__":
    main()
