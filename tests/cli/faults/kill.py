"""kill -9, SIGTERM and Ctrl-C at random moments of a study, on one rank and on several."""

from __future__ import annotations

import csv
import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.processes import end, launch

STUDY = ("-m", "fenicsx_obstacle", "study", "disk_flat", "--vary", "cells=4,6,8,10,12,14,16,18", "--method", "vi")
ROWS = 8
TIMES = ("seconds", "poisson", "memory", "run", "command", "krylov")  # what may differ between two runs
PATIENCE = 120.0  # seconds for what lasts a few
KEPT = "interrupted; finished rows are kept, and the same command continues from them"


@dataclass(frozen=True)
class Fault:
    """What was broken, and what came of it.

    Attributes:
        name: What was broken.
        wrong: What should not have happened; empty if nothing.
        seconds: Time it took.
    """

    name: str
    wrong: str
    seconds: float


def kills(
    root: Path, environment: Mapping[str, str], rounds: Mapping[int, int],
    ways: Sequence[str] = ("all", "SIGTERM", "one rank"),
) -> Iterator[Fault]:  # fmt: skip
    """Studies that are ended at random moments, and go on.

    Args:
        root: An empty folder.
        environment: Of the processes.
        rounds: How often to end them whole and by one rank, for each number of ranks.
        ways: In which they are ended: all processes, the launcher, on several ranks one of them.
    """
    for ranks, count in rounds.items():
        whole, start = root / f"whole-{ranks}", time.perf_counter()
        wrong = _finish(whole, ranks, environment)
        length = time.perf_counter() - start
        yield Fault(f"a study on {ranks}, undisturbed", wrong, length)
        if wrong:
            continue
        moments = random.Random(ranks)
        for how in (way for way in ways if ranks > 1 or way != "one rank"):
            folder, seen = root / f"{how}-{ranks}", 0
            for number in range(count if how == "all" else max(count // 2, 1)):
                start = time.perf_counter()
                moment = moments.uniform(0.15, 0.9) * length
                wrong, seen = _kill(folder, ranks, how, moment, seen, environment, moments)
                name = f"a study on {ranks}: {how} killed after {moment:.1f} s (no. {number + 1})"
                yield Fault(name, wrong, time.perf_counter() - start)
            start = time.perf_counter()
            wrong = _finish(folder, ranks, environment) or _compare(folder, whole)
            yield Fault(f"a study on {ranks}, {how} killed: goes on to the same table", wrong,
                        time.perf_counter() - start)  # fmt: skip


def interrupts(root: Path, environment: Mapping[str, str], rounds: int) -> Iterator[Fault]:
    """Ctrl-C on one rank: one line; on two all ranks end, and the study goes on afterwards."""
    moments = random.Random(7)
    for ranks in (1, 2):
        for number in range(rounds):
            start, folder = time.perf_counter(), root / f"interrupted-{ranks}"
            process = _start(folder, ranks, environment)
            rows = _wait_for_rows(folder, 1 + number, process)
            # rows of the round before may be enough to wait for: in its first 0.05 s the interpreter itself answers
            time.sleep(moments.uniform(0.2, 0.5))
            os.killpg(process.pid, signal.SIGINT)  # as the terminal does
            said, wrong = _said(process), ""
            if said is None:
                wrong = "did not end"
            elif process.returncode == 0:
                wrong = "" if rows >= ROWS else "ended as if nothing had been"
            elif ranks == 1 and (said != KEPT or process.returncode != 130):
                wrong = f"status {process.returncode}: {said[-200:]}"
            elif "Traceback" in said or len(said.splitlines()) > 1:
                wrong = f"more than one line: {said[-200:]}"
            left = _left(process.pid)
            end(process)
            wrong = wrong or (f"left processes {left}" if left else "") or _rows(folder)[1]
            yield Fault(f"Ctrl-C on {ranks} (no. {number + 1})", wrong, time.perf_counter() - start)


def _start(folder: Path, ranks: int, environment: Mapping[str, str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*launch(ranks, *STUDY), "--output", str(folder)], env=environment, text=True, errors="replace",
        start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        preexec_fn=_obey_interrupts,
    )  # fmt: skip


def _obey_interrupts() -> None:
    """What runs in the background of a shell ignores them, and passes that on."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _finish(folder: Path, ranks: int, environment: Mapping[str, str]) -> str:
    """Let a study run to its end; what is wrong."""
    process = _start(folder, ranks, environment)
    if (said := _said(process)) is None:
        end(process)
        return "did not end"
    return "" if process.returncode == 0 else f"status {process.returncode}: {said[-200:]}"


def _said(process: subprocess.Popen[str]) -> str | None:
    """What a process says of its errors until its end; None if it does not end."""
    try:
        return process.communicate(timeout=PATIENCE)[1].strip()
    except subprocess.TimeoutExpired:
        return None


def _kill(
    folder: Path, ranks: int, how: str, moment: float, seen: int, environment: Mapping[str, str], choose: random.Random
) -> tuple[str, int]:
    """Kill a study after a while; what is wrong, and how many rows are there."""
    process = _start(folder, ranks, environment)
    time.sleep(moment)
    if how == "all":
        end(process)
    elif how == "SIGTERM":
        os.killpg(process.pid, signal.SIGTERM)
    else:
        words = {pid: _words(pid) for pid in _session(process.pid)}
        pythons = [pid for pid, found in words.items() if "fenicsx_obstacle" in found and "-n" not in found]
        if pythons:
            os.kill(choose.choice(pythons), signal.SIGKILL)
    wrong = "the others did not end" if _said(process) is None else ""
    left = _left(process.pid)
    end(process)
    count, torn = _rows(folder)
    lost = f"{seen} rows before, {count} after" if count < seen else ""
    return wrong or (f"left processes {left}" if left else "") or torn or lost, count


def _session(leader: int) -> list[int]:
    """Processes of the session that a process leads."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:  # gone meanwhile
            continue
        if int(session) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def _left(leader: int) -> list[int]:
    """Those that are there a while after its end."""
    for _ in range(150):
        left = [pid for pid in _session(leader) if pid != leader]
        if not left:
            return []
        time.sleep(0.1)
    return left


def _words(pid: int) -> list[str]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return []


def _wait_for_rows(folder: Path, count: int, process: subprocess.Popen[str]) -> int:
    start = time.perf_counter()
    while process.poll() is None and time.perf_counter() - start < PATIENCE:
        if _rows(folder)[0] >= count:
            break
        time.sleep(0.02)
    return _rows(folder)[0]


def _rows(folder: Path) -> tuple[int, str]:
    """How many whole rows there are; what is wrong with them. Half a line at the end is cut by the next run."""
    path = folder / "rows.jsonl"
    text = path.read_bytes() if path.exists() else b""
    whole = text[: text.rfind(b"\n") + 1].splitlines()
    try:
        keys = [json.loads(line)["key"] for line in whole]
    except ValueError:
        return len(whole), "a line that is no row"
    return len(keys), "" if len(keys) == len(set(keys)) else "a row twice"


def _compare(one: Path, other: Path) -> str:
    if _table(one) != _table(other):
        return "another table"
    return "" if (one / "last" / "answer.json").exists() else "no last answer"


def _table(folder: Path) -> list[dict[str, str]]:
    """The final table without times, numbers to 9 digits."""
    with (folder / "rows.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [{key: _rounded(value) for key, value in row.items() if not key.startswith(TIMES)} for row in rows]


def _rounded(text: str) -> str:
    try:
        return f"{float(text):.8e}"
    except ValueError:
        return text
