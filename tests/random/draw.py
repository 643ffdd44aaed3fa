"""Random scenes with verdicts: `python -m tests.random.draw COUNTS SEED` prints JSON lines."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from fenicsx_obstacle.checkout import ROOT
from fenicsx_obstacle.errors import InputError, ObstacleError
from fenicsx_obstacle.origin import versions
from fenicsx_obstacle.studies.rows import RowStore
from fenicsx_obstacle.text import nearest
from tests.hard.row import FAILED, REJECTED, RIGHT, Row
from tests.processes import launch_module, records, tell

if TYPE_CHECKING:
    from tests.random.families.family import Family

AT_ONCE = 2
PATIENCE = 180.0  # seconds for one scene
SEED = 1  # the same scenes every time
STRIDE = 10000  # between the seeds of processes for two seeds of the user


def shares(count: int, *, truths: bool = False, family: str | None = None) -> dict[str, int]:
    """How many scenes of each family to draw: half of them admissible ones, the others in equal parts.

    Args:
        count: Of all.
        truths: Whether only families whose true error is known, in equal parts.
        family: The only one.

    Raises:
        InputError: Without Hypothesis or SymPy, or for an unknown family.
    """
    for module, name in (("hypothesis", "Hypothesis"), ("sympy", "SymPy")):
        if find_spec(module) is None:
            raise InputError(f"random scenes are drawn with {name}, which is not there: pip install {module}")
    from tests.random.families.all_families import TRUTHS
    from tests.random.random_scenes import FAMILIES

    if family is not None:
        known = TRUTHS if truths else FAMILIES
        if family not in known:
            raise InputError(f"hard --random: no family '{family}'" + nearest(family, known))
        return {family: count}
    if truths:
        return _alike(count, list(TRUTHS))
    first, *others = FAMILIES
    return {first: count - count // 2} | _alike(count // 2, others)


def _alike(count: int, names: Sequence[str]) -> dict[str, int]:
    return {name: count // len(names) + (k < count % len(names)) for k, name in enumerate(names)}


def try_all(
    counts: Mapping[str, int], seed: int, comm: MPI.Comm, done: Callable[[Row], None],
    begins: Callable[[Family], bool] | None = None,
) -> None:  # fmt: skip
    """Draw scenes and judge them (collective).

    Args:
        counts: How many of each family.
        seed: Of the drawing.
        comm: Communicator.
        done: Called with a row for each scene.
        begins: Called with each scene before it is solved, on rank 0; it is solved if this returns true.
    """
    if comm.rank != 0:
        while (scene := comm.bcast(None)) is not None:
            done(judged(scene, comm))
        return

    def one(scene: Family) -> None:
        if begins is None or begins(scene):
            done(judged(comm.bcast(scene), comm))

    # one rank draws: what Hypothesis draws depends on the modules that are loaded, and not all ranks load the same
    try:
        for name, count in counts.items():
            _draw(name, count, seed, one)
    finally:
        comm.bcast(None)


def _draw(name: str, count: int, seed: int, use: Callable[[Family], None]) -> None:
    """Draw so many different scenes of a family, and use each."""
    import hypothesis

    from tests.random.random_scenes import FAMILIES

    drawn: set[str] = set()

    @hypothesis.seed(seed)
    @hypothesis.settings(max_examples=count, deadline=None, database=None, phases=[hypothesis.Phase.generate],
                         suppress_health_check=list(hypothesis.HealthCheck))  # fmt: skip
    @hypothesis.given(FAMILIES[name])
    def one(scene: Family) -> None:
        hypothesis.assume(repr(scene) not in drawn)
        drawn.add(repr(scene))
        use(scene)

    if count > 0:
        one()


def judged(scene: Family, comm: MPI.Comm) -> Row:
    """One row: FAILED if anything has, rejected if nothing was answered, and what was said (collective)."""
    from tests.random.families.family import Judgement

    start, judgement = time.perf_counter(), Judgement(comm)
    try:
        scene.judge(judgement)
    except ObstacleError as error:
        judgement.check(False, str(error))
    verdict = FAILED if judgement.wrong else (RIGHT if judgement.answers else REJECTED)
    return {**described(scene), "verdict": verdict, "answers": judgement.answers, "rejected": judgement.rejected,
            "message": "; ".join(judgement.wrong), "crashed": judgement.crashed, "bounds": judgement.bounds,
            "seconds": time.perf_counter() - start}  # fmt: skip


def described(scene: Family) -> Row:
    """What a scene is, and how to show it to the program again."""
    return {"key": key_of(scene), "family": scene.name, "scene": asdict(scene), "text": scene.text()}


def key_of(scene: Family) -> str:
    """Of a scene and of what its row depends on: the versions, the package's code, and the suites' code."""
    parts = [repr(scene), versions(), code(ROOT)]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


@cache
def code(clone: Path) -> str:
    """A hash of the code of a clone that solves and judges."""
    found = hashlib.sha256()
    for folder in ("fenicsx_obstacle", "tests/hard", "tests/random"):
        for file in sorted(path for path in (clone / folder).rglob("*") if path.suffix in (".py", ".c", ".toml")):
            found.update(f"{file.relative_to(clone)} {hashlib.sha256(file.read_bytes()).hexdigest()}".encode())
    return found.hexdigest()


def run(
    counts: Mapping[str, int], environment: Mapping[str, str], seed: int = SEED, store: RowStore | None = None
) -> Iterator[Row]:
    """A row for each of so many scenes of each family, in processes (one rank).

    Args:
        counts: How many of each family.
        environment: Of the processes.
        seed: Of the drawing.
        store: Rows of an earlier run, which are not judged again unless they have failed; new rows are added.
    """
    parts = [{name: n // AT_ONCE + (k < n % AT_ONCE) for name, n in counts.items()} for k in range(AT_ONCE)]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for rows in pool.map(lambda k: list(_share(parts[k], STRIDE * seed + k, environment, store)), range(AT_ONCE)):
            yield from rows


def _share(
    counts: Mapping[str, int], seed: int, environment: Mapping[str, str], store: RowStore | None
) -> Iterator[Row]:
    """The rows of one process; should it be lost with a scene, or shaken by one, another goes on with others."""
    known = "" if store is None else json.dumps(store.keys())
    left = Counter(counts)
    while left.total() > 0:
        given = json.dumps({name: count for name, count in left.items() if count})
        command = launch_module(1, "tests.random.draw", given, str(seed))
        started: Any = None
        before = left.total()
        for record in records(command, environment, PATIENCE, known):
            if "known" in record:
                row = None if store is None else store.find(record["known"])
                assert row is not None
                left[row["family"]] -= 1
                yield row
                continue
            if "begins" in record:
                started = record["begins"]
                continue
            started = None
            left[record["family"]] -= 1
            record["seed"] = seed
            if store is not None and record["verdict"] != FAILED:
                record = store.add(record.pop("key"), record)
            yield record
            if record["crashed"]:  # libraries remember errors, and later scenes might suffer from them
                break
        if started is not None:
            left[started["family"]] -= 1
            yield {**started, "verdict": FAILED, "answers": 0, "rejected": 0, "seconds": PATIENCE, "seed": seed,
                   "bounds": [], "message": "took the process down, or did not end", "crashed": True}  # fmt: skip
        if left.total() == before:
            raise InputError("no random scene could be drawn")
        seed += AT_ONCE


def main() -> None:
    """Scenes and rows, a line each; keys of rows that are known come from standard input."""
    counts, seed = json.loads(sys.argv[1]), int(sys.argv[2])
    known = set(json.loads(sys.stdin.read() or "[]"))

    def begins(scene: Family) -> bool:
        if (key := key_of(scene)) in known:
            tell({"known": key})
            return False
        tell({"begins": described(scene)})
        return True

    try_all(counts, seed, MPI.COMM_WORLD, tell, begins)


if __name__ == "__main__":
    main()
