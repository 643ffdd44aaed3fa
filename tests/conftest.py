"""Tests run on 1, 2 and 3 ranks: a test that fails on one rank fails on all, and none hangs."""

from __future__ import annotations

import gc
import json
import os
import sys
import time
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

from fenicsx_obstacle.launcher import environment

_kept = environment()
CLEAN = {
    name: value for name, value in _kept.items() if not name.startswith("PYTEST_")
}  # of processes that tests start
os.environ.update(_kept)  # before MPI starts, also where pytest is called directly
if "PYTEST_XDIST_WORKER" in os.environ:  # started by a process in which MPI runs
    for _name in os.environ.keys() - _kept.keys():
        del os.environ[_name]

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from dolfinx import mesh as dmesh  # noqa: E402
from mpi4py import MPI  # noqa: E402
from petsc4py import PETSc  # noqa: E402

from fenicsx_obstacle import Scene, releases  # noqa: E402
from fenicsx_obstacle.show import render  # noqa: E402

COMM = MPI.COMM_WORLD
HOOKS = COMM.Dup()  # the tests' own collective calls must not meet those of the hooks
PATIENCE = 30  # seconds
# linear steps more than on one rank: Gauss-Seidel is that of each rank's own unknowns, and which rank owns a shared
# vertex, and its number, differ from one call of `create_mesh` to the next
MORE_ON_SEVERAL_RANKS = 2 if COMM.size > 1 else 0
ON_SEVERAL_RANKS = pytest.mark.skipif(COMM.size == 1, reason="compares several ranks with one")
ALL_SERIAL = pytest.StashKey[bool]()
DEMOS = Path(__file__).parent.parent / "demos"
BENCHMARKS = DEMOS.parent / "benchmarks"


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "serial: runs on one rank only: it starts processes, has no mesh or needs all scenes"
    )
    config.addinivalue_line("markers", "slow: runs with './obstacle test --all' only")
    config.addinivalue_line("markers", "ranks: each of its cases runs on several ranks, in place of the first and last")
    config.addinivalue_line("markers", "variant: slow beside others of its subject; on one rank, and where it is named")


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    if COMM.rank != 0:  # one report is enough; failures elsewhere reach it through pytest_runtest_call
        reporter = session.config.pluginmanager.getplugin("terminalreporter")
        reporter._tw._file = open(os.devnull, "w")  # noqa: SIM115


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--few", action="store_true", help="Of a test with many cases the first.")
    parser.addoption(
        "--by-file", action="store_true",
        help="The tests of those files whose name belongs to this number of ranks, of many cases the first and last.",
    )  # fmt: skip


def ranks_of(file: Path) -> int:
    """2 or 3: on how many ranks the tests of a file run, beside one; a third of the files on 3, which costs most."""
    return 3 if crc32(file.name.encode()) % 3 == 0 else 2


def some_cases(items: list[pytest.Item], few: bool) -> set[pytest.Item]:
    """Of each test with many cases the first, and unless there shall be few the last; all if ranks are its subject."""
    cases: dict[tuple[Path, str], list[pytest.Item]] = {}
    for item in items:
        cases.setdefault((item.path, getattr(item, "originalname", item.name)), []).append(item)
    chosen: set[pytest.Item] = set()
    for some in cases.values():
        chosen.update(some if "ranks" in some[0].keywords else some[:1] if few else (some[0], some[-1]))
    return chosen


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files of another number of ranks are not even imported."""
    others = collection_path.name.startswith("test_") and ranks_of(collection_path) != COMM.size
    return True if config.getoption("--by-file") and others else None


@pytest.hookimpl(trylast=True)  # after the choice by markers
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    by_file, few = config.getoption("--by-file"), config.getoption("--few")
    if by_file or few:
        kept = some_cases([
            item for item in items
            if not (by_file and "variant" in item.keywords)
        ], few)  # fmt: skip
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = [item for item in items if item in kept]
    if COMM.size > 1:
        kept = [item for item in items if "serial" not in item.keywords]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        config.stash[ALL_SERIAL] = bool(items) and not kept
        items[:] = kept


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Tests that are all serial are no mistake on several ranks."""
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and session.config.stash.get(ALL_SERIAL, False):
        session.exitstatus = pytest.ExitCode.OK


def pytest_collection_finish() -> None:
    """What all tests have imported stays: the garbage collection after each test need not search it."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    trouble, result = None, None
    try:
        result = yield
    except BaseException as error:
        trouble = error
    message = None if trouble is None else "".join(traceback.format_exception(trouble))
    _wait_for_all(item, message)
    messages = HOOKS.allgather(message)
    gc.collect()
    PETSc.garbage_cleanup()
    if trouble is not None:
        raise trouble
    elsewhere = [f"on rank {rank}:\n{text}" for rank, text in enumerate(messages) if text is not None]
    if elsewhere:
        pytest.fail("\n".join(elsewhere), pytrace=False)
    return result


def _wait_for_all(item: pytest.Item, message: str | None) -> None:
    """A rank that failed waits a while for the others; should they be waiting for it, it ends them all."""
    arrived, start = HOOKS.Ibarrier(), time.monotonic()
    while not arrived.Test():
        time.sleep(0.001)
        if message is not None and time.monotonic() - start > PATIENCE:
            with item.config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
                text = f"{item.nodeid} failed on rank {COMM.rank} and left the others waiting:\n{message}"
                print(text, file=sys.__stderr__, flush=True)
            COMM.Abort(1)


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new folder, the same on all ranks."""
    return COMM.bcast(tmp_path_factory.mktemp("folder") if COMM.rank == 0 else None)


@pytest.fixture
def matplotlib_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Views in space are drawn by matplotlib: the process in which pyvista draws takes seconds to begin."""
    monkeypatch.setattr(render, "find_spec", lambda name: None)


@pytest.fixture
def ball() -> Scene:
    return Scene.read(DEMOS / "ball.toml")


@pytest.fixture
def disk() -> Scene:
    return Scene.read(DEMOS / "disk.toml")


def as_version_02(folder: Path) -> None:
    """Make a saved answer one of version 0.2, which does not state the contents of its files (one rank)."""
    file = folder / "answer.json"
    record = json.loads(file.read_text())
    del record["files"]
    file.write_text(json.dumps(record))


def slow_except(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """Cases for `parametrize`, all but the quick ones marked slow, and as variants of the quick ones."""
    cases = list(cases)
    assert all(one in cases for one in quick), (quick, cases)
    values = [case if type(case) is tuple else (case,) for case in cases]
    marks = [() if case in quick else (pytest.mark.slow, pytest.mark.variant) for case in cases]
    return [pytest.param(*value, marks=mark) for value, mark in zip(values, marks, strict=True)]


def membrane(**given: Any) -> Scene:
    """A membrane on the unit square with 16 cells a side, u = 0 on the boundary."""
    data: dict[str, Any] = {"mesh": {"shape": "rectangle", "cells": 16}, "tension": 1, **given}
    return Scene(**data)


def by_hand(points: np.ndarray, cells: np.ndarray, comm: MPI.Comm = COMM) -> dmesh.Mesh:
    """A mesh of triangles, all on the last rank."""
    last = comm.rank == comm.size - 1
    cells, points = (cells, points) if last else (cells[:0], points[:0])
    return releases.create_mesh(comm, cells, points, "triangle", stay=True)
