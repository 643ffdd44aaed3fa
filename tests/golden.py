"""Reference results of the catalogue, the demos and the hard scenes, for changes that must not change numbers.

`.venv/bin/python tests/golden.py write` solves every scene and stores its values in tests/golden/RANKS.json;
`check` solves them again and prints each value that differs by more than 1e-9. Under `mpirun -n 2` it is RANKS = 2.
Names of scenes after the command restrict it to them.
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
from fenicsx_obstacle.scenes.hard import cases

COMM = MPI.COMM_WORLD
HERE = Path(__file__).parent
TOLERANCE = 1e-9
# run times, versions and memory differ from run to run; round_off and algebraic are rounding errors themselves
VOLATILE = {"seconds", "poisson_seconds", "poisson_units", "memory_mb", "versions", "command", "round_off", "algebraic"}


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
    """All numbers and words of a result by name, and integrals of its fields (collective)."""
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
    found = dict(_flat(dict(answer.record)))
    for name, function in answer.functions().items():
        own = function.function_space.dofmap.index_map.size_local
        values = function.x.array[:own]
        x = function.function_space.tabulate_dof_coordinates()[:own]
        found[f"{name}: sum of squares"] = total(COMM, np.where(np.isfinite(values), values, 0.0) ** 2)
        found[f"{name}: first moment"] = total(COMM, np.where(np.isfinite(values), values, 0.0) * (1 + x.sum(axis=1)))
    return found


def _flat(record: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in record.items():
        if key in VOLATILE:
            continue
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, (int, float, str, bool)) or value is None:
            yield prefix + key, value


def differences(old: dict[str, Any], new: dict[str, Any]) -> Iterator[str]:
    """A line for each value that is missing, new, or differs."""
    for key in sorted({*old, *new}):
        if key not in old or key not in new:
            yield f"{key}: {'new' if key in new else 'missing'}"
        elif not _same(old[key], new[key]):
            yield f"{key}: {old[key]!r} before, {new[key]!r} now"


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, float) and isinstance(b, (int, float)):
        return math.isclose(a, b, rel_tol=TOLERANCE) or (math.isnan(a) and math.isnan(b))
    return bool(a == b)


def main() -> None:
    """Write or check (collective)."""
    command, *chosen = sys.argv[1:]
    file = HERE / "golden" / f"{COMM.size}.json"
    stored = json.loads(file.read_text()) if file.exists() else {}
    found, wrong = {}, 0
    for key, scene, arguments in scenes():
        if chosen and not any(part in chosen for part in key.split("/")):
            continue
        found[key] = COMM.bcast(values_of(scene, arguments))
        if command == "check" and COMM.rank == 0:
            for line in differences(stored.get(key, {}), found[key]):
                wrong += 1
                print(f"{key}: {line}", flush=True)
    if COMM.rank == 0:
        if command == "write":
            file.parent.mkdir(exist_ok=True)
            rows = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in {**stored, **found}.items())
            file.write_text("{\n" + ",\n".join(rows) + "\n}\n")
        print(f"{len(found)} results, {wrong} differences" if command == "check" else f"{len(found)} results written")
    sys.exit(COMM.bcast(wrong) > 0)


if __name__ == "__main__":
    main()
