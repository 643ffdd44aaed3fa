"""The command line as users meet it: in processes of its own, on 1, 2 and 3 ranks."""

import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from fenicsx_obstacle import InputError, releases
from fenicsx_obstacle.cli_options import typed, values_of
from fenicsx_obstacle.launcher import mpirun
from tests.conftest import CLEAN, DEMOS, slow_except
from tests.helpers import inside, run, run_python

pytestmark = pytest.mark.serial


@pytest.mark.slow
def test_saved_on_three_ranks_plotted_on_one(tmp_path):
    done = run("solve", DEMOS / "disk.toml", "--cells", 16, "--output", tmp_path / "disk", ranks=3)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("saved in") == 1
    assert not (tmp_path / "disk" / "answer.png").exists()  # a picture takes longer than the solve: on demand
    assert inside("plot", tmp_path / "disk").returncode == 0
    assert (tmp_path / "disk" / "answer.png").exists()
    assert "<img" in (tmp_path / "disk" / "report.html").read_text()
    assert inside("plot", tmp_path / "disk", "--output", tmp_path / "p.pdf").returncode == 0
    assert (tmp_path / "p.pdf").read_bytes().startswith(b"%PDF")
    refused = inside("plot", tmp_path / "disk", "--output", tmp_path / "p.doc")
    assert refused.returncode == 2
    assert "pictures are written as .png, .pdf, .svg" in refused.stderr
    again = run("solve", DEMOS / "disk.toml", "--cells", 16, "--output", tmp_path / "disk", "--plot", ranks=2)
    assert "drawn by" in again.stdout
    assert "--plot" in json.loads((tmp_path / "disk" / "answer.json").read_text())["command"]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", slow_except([1, 2], 2))
def test_unconverged_exits_3_and_keeps_what_was_computed(ranks, tmp_path):
    limit = ["--start", "cold", "--", "-penalty_snes_max_it", "8", "-penalty_snes_linesearch_type", "basic"]
    study = ["study", DEMOS / "disk.toml", "--vary", "eps=1e-1..1e-6", "--output", tmp_path / "out"]
    done = run(*study, *limit, ranks=ranks)
    assert done.returncode == 3, done.stderr
    assert "limit of steps was reached (DIVERGED_MAX_IT)" in done.stderr and "Traceback" not in done.stderr
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == 3


def test_a_failing_rank_ends_all():
    """An exception on one rank aborts the others instead of leaving them in a collective call."""
    code = (
        "from mpi4py import MPI; from fenicsx_obstacle.parallel import abort_on_uncaught_errors as hook\n"
        "hook(MPI.COMM_WORLD)\n"
        "if MPI.COMM_WORLD.rank == 1: raise RuntimeError('on one rank')\n"
        "MPI.COMM_WORLD.barrier()"
    )
    start = time.monotonic()
    done = run_python(code, ranks=2, timeout=60)
    assert done.returncode != 0
    assert "on one rank" in done.stderr
    assert time.monotonic() - start < 30


@pytest.mark.slow
def test_a_failing_test_on_one_rank_fails_on_all(tmp_path):
    """The test-suite itself: no hang, and rank 0 reports what rank 1 met."""
    (tmp_path / "conftest.py").write_text((DEMOS.parent / "tests" / "conftest.py").read_text())
    code = "from mpi4py import MPI\n\ndef test_it():\n    assert MPI.COMM_WORLD.rank == 0, 'only here'\n"
    (tmp_path / "test_one.py").write_text(code)
    command = [*mpirun(2), sys.executable, "-m", "pytest", "-q", "test_one.py"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=CLEAN, timeout=60, check=False)
    assert done.returncode != 0
    assert "only here" in done.stdout


@pytest.mark.slow
def test_json_on_standard_output_is_nothing_else(tmp_path):
    done = run("solve", DEMOS / "string.toml", "--json", "-", "--output", tmp_path / "out", ranks=2)
    assert json.loads(done.stdout)["scene"] == "string"


@pytest.mark.slow
def test_nothing_compiles_twice(tmp_path):
    """An eps-ladder compiles each form once, on all ranks; a warm start compiles none. A source without its library,
    left by kill -9, is removed and compiled again."""
    env, cache = {**CLEAN, "XDG_CACHE_HOME": str(tmp_path / "cache")}, tmp_path / "cache"
    study = ["study", DEMOS / "string.toml", "--cells", "8", "--output", tmp_path / "out", "--vary"]
    counts = []
    for values, ranks in (("eps=1e-1", 1), ("eps=1e-1..1e-4", 2), ("eps=1e-1..1e-5", 1)):
        if counts and ranks == 1:
            victim = max(cache.rglob("libffcx_forms_*.c"))
            for file in victim.parent.glob(victim.stem + "*"):
                file.unlink()
            victim.write_text("int unfinished")
        done = run(*study, values, ranks=ranks, env=env)
        assert done.returncode == 0, done.stderr
        counts.append(len(list(cache.rglob("*.c.cached"))))
    assert counts[0] > 0
    assert counts == [counts[0]] * 3


def test_a_source_that_another_process_removes(tmp_path, monkeypatch):
    """Several processes remove unfinished sources of one cache at once."""
    source = tmp_path / "fenics" / "libffcx_forms_0.c"
    source.parent.mkdir()
    source.write_text("int unfinished")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(Path, "exists", lambda _: bool(source.unlink(missing_ok=True)))
    releases._remove_stale_sources(0.0)
    assert not list(source.parent.iterdir())


@pytest.mark.parametrize(
    ("text", "key", "values"),
    [("16..128", "cells", [16, 32, 64, 128]), ("1e-1..1e-4", "eps", [1e-1, 1e-2, 1e-3, 1e-4]),
     ("h,h^2,1e-8", "eps", ["h", "h^2", 1e-8]), ("1..100:3", "define.f", [1, 10, 100]),
     ("1e-4..1e-2", "eps", [1e-4, 1e-3, 1e-2]), ("penalty,vi", "method", ["penalty", "vi"]),
     ("min(x,max(-1,y)),-3", "obstacle.lower", ["min(x,max(-1,y))", -3]), ("[1,0],[2,0]", "k", [[1, 0], [2, 0]])],
)  # fmt: skip
def test_lists_of_values(text, key, values):
    assert values_of(text, key) == values
    with pytest.raises(InputError, match="ends of a range are positive numbers"):
        values_of(f"1..1{'0' * 309}", key)  # a whole number beyond all floating-point numbers


@pytest.mark.slow
def test_60_lines_become_3():
    """The blocks of the page, the second one after the first, run as they stand and print the same force."""
    page = (DEMOS / "your_60_lines_become_3.md").read_text()
    by_hand, own, scene = (block.partition("```")[0] for block in page.split("```python\n")[1:])
    printed = []
    for code in (by_hand + own, scene):
        done = run_python(code)
        assert done.returncode == 0, done.stderr
        printed += done.stdout.splitlines()
    assert printed == ["force on the ball 4.2724"] * 3


@pytest.mark.slow
def test_compare_and_free_boundary(tmp_path):
    """Two saved results on different meshes; the free boundary of the ball is the circle r = 0.698 to within h."""
    for cells in (32, 64):
        solved = inside("solve", "ball", "--cells", cells, "--method", "vi", "--output", tmp_path / str(cells))
        assert solved.returncode == 0
    done = run("compare", tmp_path / "32", tmp_path / "64", "--json", tmp_path / "c.json", ranks=2)
    assert done.returncode == 0, done.stderr
    assert "Jaccard" in done.stdout
    assert json.loads((tmp_path / "c.json").read_text())["u"]["l2"] < 0.01
    line = np.loadtxt(tmp_path / "64" / "free_boundary.csv", delimiter=",", skiprows=1)
    assert np.abs(np.hypot(line[:, 0], line[:, 1]) - 0.697965148223374).max() < 2 * 4 / 64


@pytest.mark.slow
def test_files_of_others_stay(tmp_path):
    """A result never removes what it did not write."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years")
    assert inside("solve", DEMOS / "string.toml", "--output", tmp_path / "out").returncode == 0
    assert (tmp_path / "out" / "thesis.tex").read_text() == "years"
    assert not [name for name in os.listdir(tmp_path / "out") if name.startswith(".")]


STUDY = ["study", str(DEMOS / "string.toml"), "--cells", "8", "--vary", "eps=1e-1,1e-3", "--output"]


def on_terminal(*arguments):
    """Run with standard error on a terminal: what came out of stdout, and of the terminal."""
    try:
        ours, theirs = pty.openpty()
    except OSError:  # a bare chroot, a container without /dev/pts
        pytest.skip("this machine gives no terminals")
    # a terminal without width shows nothing
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    command = [sys.executable, "-m", "fenicsx_obstacle", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, text=True, env=CLEAN)
    os.close(theirs)
    seen = b""
    with suppress(OSError):  # the other end was closed
        while piece := os.read(ours, 4096):
            seen += piece
    os.close(ours)
    stdout, _ = process.communicate(timeout=120)
    assert process.returncode == 0, seen
    return stdout, seen.decode()


@pytest.mark.slow
def test_a_terminal_sees_what_is_solved(tmp_path):
    """The row's scene and values, and the step of the solver; the table stays on standard output; --quiet is quiet, and
    without a terminal there is no bar."""
    stdout, seen = on_terminal(*STUDY, tmp_path / "out")
    assert "string: eps=0.1" in seen and "1/2" in seen
    assert "step" in seen or "timing" in seen or "mesh" in seen
    assert "|u_eps-u_h|_a" in stdout and "\r" not in stdout
    assert on_terminal(*STUDY, tmp_path / "out", "--quiet") == ("", "")
    done = run(*STUDY, tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("ranks", slow_except([1, 2]))
def test_log_has_rank_and_time(ranks, tmp_path):
    done = run(*STUDY, tmp_path / "out", "--log", "info", "--quiet", ranks=ranks)
    assert done.returncode == 0
    line = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} rank (\d) INFO fenicsx_obstacle\S*: (.*)$", re.MULTILINE)
    found = line.findall(done.stderr)
    assert {rank for rank, _ in found} == {str(rank) for rank in range(ranks)}
    assert sum("eps=0.1" in text for _, text in found) == ranks
    assert any(text.startswith("step 0: ") for _, text in found)


def test_short_names_in_settings():
    """--set cells=5 is --cells 5, where the option is not given."""
    for text in ("-20#x", "-10\neffects.load=3", "1, 2"):
        assert typed({"set_": [f"define.q={text}"]}) == {"define.q": text}
    assert typed({"cells": None, "eps": "h", "set_": ["cells=5", "define.q=1e3"]}) == {
        "cells": 5, "eps": "h", "define.q": 1e3
    }  # fmt: skip
