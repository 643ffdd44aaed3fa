"""Odd but legal input, full disks, signals: an answer or one clear message, a documented status, nothing left."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fenicsx_obstacle import InputError, NotConverged, Scene, solve
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.safe_writing import write_text
from fenicsx_obstacle.scenes.catalogue import changed
from fenicsx_obstacle.show.report import report_answer
from tests.cli.faults.kill import _session
from tests.conftest import CLEAN, COMM, DEMOS, membrane, slow_except
from tests.helpers import LAUNCHER

HELD = {"mesh": {"shape": "rectangle", "cells": 4}, "tension": 1, "boundary": []}


@pytest.mark.parametrize("level", slow_except([1.0, 0.0, -300.0], 0.0))
@pytest.mark.parametrize("element", ["P1", "P2", "Q1"])
def test_a_membrane_that_lies_on_a_flat_obstacle(level, element):
    """Held by its obstacle alone u is constant: its range is 0, and the summary says what penetration is against it."""
    mesh = {**HELD["mesh"], "cell": "quadrilateral" if element == "Q1" else "triangle"}
    answer = solve(Scene(**{**HELD, "mesh": mesh}, load=1, upper=level).change({"solve.element": element}))
    assert answer.record["contact"]["upper"]["force"] == pytest.approx(1)
    assert "penetration is more than the range of u" in answer.summary() and answer.record["u_range"] < 1e-12


TITLES = {
    "3000 characters without a space": "w" * 3000,
    "a dollar": "a $ b",
    "an open formula": r"$\frac{1}{",
    "signs that no font has": "\U0001f9ff中文",
    "from right to left": "\u202eאבג",
    "markup": "<b>bold</b><script>alert(1)</script>",
    "lines": "one\ntwo\n\n\tthree",
    "control characters": "\x1b[31mred\x07",
    "nothing but spaces": "   ",
}


@pytest.mark.slow
@pytest.mark.usefixtures("matplotlib_draws")
@pytest.mark.parametrize("name", slow_except(TITLES, *list(TITLES)[:2]))
def test_titles_are_drawn_and_printed_in_one_line(name, folder):
    """Any title and name of u: a picture, a page without its markup, a first line without control characters."""
    title = TITLES[name]
    scene = Scene(mesh={"shape": "interval", "cells": 4}, tension=1, load=-1, lower=-0.05, title=title, u=title)
    answer = solve(scene)
    answer.save(folder)
    report_answer(answer, folder, picture=True)
    assert (folder / "answer.png").stat().st_size > 10000
    assert "<script" not in (folder / "report.html").read_text(encoding="utf-8")
    first = answer.summary().splitlines()[0]
    assert 0 < len(first) <= 160
    assert first.isprintable()


@pytest.mark.slow
@pytest.mark.usefixtures("matplotlib_draws")
def test_values_that_cannot_be_drawn(folder):
    """Heights near the largest number are saved, and their picture is refused in one sentence."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 2}, tension=1, load=-1, boundary=[{"value": 1e300}])
    with pytest.raises(InputError, match="not drawn"):
        solve(scene).plot(folder / "huge.png")
    far = Scene(mesh={"shape": "interval", "cells": 2}, tension=1, load=-1, lower=-1e300)
    assert "drawn by" in solve(far).plot(folder / "far.png").said
    answer = solve(membrane(), bound=True, cells=4)  # the bound is 0
    answer.save(folder)
    assert "contribute half of the bound" in report_answer(answer, folder, picture=True)[1]


@pytest.mark.parametrize(("method", "element"), [("vi", "P1"), ("successive", "P1"), ("penalty", "P1"),
                                                 ("vi", "Q1-gauss")])  # fmt: skip
def test_errors_name_the_method_that_was_asked_for(method, element):
    """Whatever a method begins with or is made of, its failure is its own."""
    scene, none = membrane(load=-9, lower=-0.05), {"snes_max_it": 0}
    with defaults("penalty_", none), defaults("vi_", none), pytest.raises(NotConverged, match=f"{method} did") as error:
        solve(scene, method=method, element=element, cells=4, start="cold")
    assert error.value.solver == method
    assert f"--method {method}" not in str(error.value)


MOVING = {"mesh": {"shape": "interval", "cells": 8}, "tension": 1, "load": -1, "upper": "0.5 - t"}


def test_data_that_contradict_later_say_when(folder):
    """An obstacle that meets a boundary value at t = 0.75: the message has the time, and there is no folder."""
    place = folder / "out"
    with pytest.raises(InputError, match=r"lies above the upper obstacle.*at t = 0\.75$"):
        solve(Scene(**MOVING, time={"end": 1, "steps": 4}), keep=place)
    with pytest.raises(InputError, match=r"at tau, s = 0\.6$"):
        solve(Scene(**MOVING, rate=1, time={"end": 1, "steps": 5, "start": 0, "name": "tau,\ns"}), keep=place)
    COMM.barrier()
    assert not place.exists()


def test_the_first_moment_is_named():
    """A sequence of equilibria whose first one is not found says t = 0."""
    with defaults("penalty_", {"snes_max_it": 0}), pytest.raises(NotConverged, match=r"at t = 0"):
        solve(Scene(**{**MOVING, "load": 20, "upper": 0.1}, time={"end": 1, "steps": 4}), start="cold")


INCOMPLETE = '[mesh]\nshape = "rectangle"\ncells = 4\n[effects]\nload = "2*q"\n'


def test_options_give_what_a_scene_lacks(folder):
    """Tables, keys, names of [define] and parts of the boundary that a file does not have; it is checked then."""
    file = folder / "scene.toml"
    on_root(COMM, write_text, file, INCOMPLETE)
    given = {"effects.tension": 1, "define.q": 3}
    scene = changed(str(file), {**given, "boundary.0.value": 0.1, "boundary.1.flux": 2, "boundary.1.on": "left"})
    assert scene.tables.boundary[0].value == 0.1
    assert scene.tables.boundary[1].flux == 2
    assert changed(str(file), {**given, "obstacle.lower": -1, "cells": 2, "report.f": "integral(u)"}).sides == ["lower"]
    other = Scene.read(DEMOS / "disk.toml").change({"boundary.0.value": 0.0})
    assert other.tables.boundary[0].value == 0.0
    assert other.change({"mesh.x.1": 2}).tables.mesh.x == ("-sqrt(0.5)", 2)


def launched(ranks, *arguments, **options):
    ranked = [] if ranks == 1 else ["--ranks", str(ranks)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": CLEAN, "timeout": 60, **options}
    return subprocess.run([LAUNCHER, *ranked, *map(str, arguments)], text=True, check=False, **options)


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("ranks", [1, 2])
def test_status_4_reaches_the_shell(ranks, tmp_path):
    """On any number of ranks, with one line on standard error and the answer in its folder."""
    words = ["--tol", "0.01", "--budget", "400 unknowns", "--quiet", "--output", tmp_path]
    done = launched(ranks, "solve", "ball", *words)
    assert done.returncode == 4, done.stderr
    assert done.stderr.startswith("Error: the relative tolerance 0.01 is not reached: the budget of unknowns")
    assert done.stderr.count("\n") == 1
    assert json.loads((tmp_path / "answer.json").read_text())["adaptive"]["reached"] is False


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["explain", "nowhere"], "nowhere"), (["solve", "ball", "--no-such-option"], "no-such-option"),
     (["solve", "ball", "--cells", "4", "--", "x"], "after -- come PETSc's options")],
)  # fmt: skip
def test_rejected_input_has_the_last_word_on_two_ranks(arguments, words, tmp_path):
    """mpirun adds nothing to the message, status 2 reaches the shell, and no temporary file is left."""
    done = launched(2, *arguments, cwd=tmp_path, env={**CLEAN, "TMPDIR": str(tmp_path)})
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("Error: ") == 1
    assert words in done.stderr.splitlines()[-1]
    assert not [path for path in tmp_path.iterdir() if path.is_file()]


SOLVE = ["solve", "ball", "--cells", "4", "--output", "result"]


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    ("ranks", "arguments", "how"),
    [(1, ["--help"], "full"), (1, ["scenes"], "closed pipe"), (1, SOLVE, "closed pipe"), (1, SOLVE, "none"),
     *((ranks, [*SOLVE, *more], "full") for ranks in (1, 2) for more in ([], ["--json", "-"]))],
)  # fmt: skip
def test_output_that_cannot_be_written(ranks, arguments, how, tmp_path):
    """A full device and a closed pipe are told at the end, in one line and by status 1; a stream that is closed is
    nobody's loss. Files are complete."""
    reading, writing = os.pipe()
    os.close(reading)
    outlet = {"full": "/dev/full", "closed pipe": f"&{writing}", "none": "&-"}[how]
    start = [sys.executable, "-m", "fenicsx_obstacle"] if ranks == 1 else [LAUNCHER, "--ranks", str(ranks)]
    command = ["bash", "-c", f'exec "$@" >{outlet}', "bash", *start, *arguments]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, env=CLEAN, cwd=tmp_path, pass_fds=[writing],
                          timeout=60, check=False)  # fmt: skip
    os.close(writing)
    assert done.returncode == (how != "none"), done.stderr
    assert done.stderr.count("\n") == (how != "none"), done.stderr
    assert how == "none" or done.stderr.startswith("Error: standard output: ")
    for name in ("answer.json", "fields.h5", "report.html", "free_boundary.csv") if "solve" in arguments else ():
        assert (tmp_path / "result" / name).exists()


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_end_all_processes(ranks, number, tmp_path):
    """SIGTERM and SIGHUP to the launcher alone, Ctrl-C: 128 + number, one line, rows are kept, no process is left."""
    study = ["study", "disk_flat", "--vary", "cells=4,6,400", "--method", "vi", "--output", str(tmp_path)]
    # under nohup, and in the background, signals are ignored
    process = subprocess.Popen([LAUNCHER, "--ranks", str(ranks), *study], stdout=subprocess.DEVNULL, env=CLEAN,
                               stderr=subprocess.PIPE, text=True, start_new_session=True,
                               preexec_fn=lambda: signal.signal(number, signal.SIG_DFL))  # fmt: skip
    rows = tmp_path / "rows.jsonl"
    deadline = time.monotonic() + 60
    while (not rows.exists() or rows.read_text().count("\n") < 2) and time.monotonic() < deadline:
        time.sleep(0.05)
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)  # the first as the terminal does
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 128 + number, said
    how = "interrupted" if number == signal.SIGINT else "terminated"
    assert said.strip() == f"{how}; finished rows are kept, and the same command continues from them"
    assert len([json.loads(row) for row in rows.read_text().splitlines()]) >= 2
    while _session(process.pid) and time.monotonic() < deadline:  # helpers of mpirun end a moment later
        time.sleep(0.05)
    assert not _session(process.pid)
