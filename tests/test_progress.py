"""Progress on a terminal, silence elsewhere, a log where it is asked for."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios

import pytest

from fenicsx_obstacle.launcher import mpirun
from tests.conftest import CLEAN, DEMOS, slow_except
from tests.helpers import run

pytestmark = pytest.mark.serial
STUDY = ["study", str(DEMOS / "string.toml"), "--cells", "8", "--vary", "eps=1e-1,1e-3", "--output"]


def on_terminal(*arguments, ranks=1):
    """Run with standard error on a terminal: what came out of stdout, and of the terminal."""
    try:
        ours, theirs = pty.openpty()
    except OSError:  # a bare chroot, a container without /dev/pts
        pytest.skip("this machine gives no terminals")
    fcntl.ioctl(
        theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0)
    )  # a terminal without width shows nothing
    command = [*(mpirun(ranks) if ranks > 1 else []), sys.executable, "-m", "fenicsx_obstacle", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, text=True, env=CLEAN)
    os.close(theirs)
    seen = b""
    while True:
        try:
            piece = os.read(ours, 4096)
        except OSError:  # the other end was closed
            break
        if not piece:
            break
        seen += piece
    os.close(ours)
    stdout, _ = process.communicate(timeout=120)
    assert process.returncode == 0, seen
    return stdout, seen.decode()


@pytest.mark.slow
def test_a_terminal_sees_what_is_solved(tmp_path):
    """The row's scene and values, and the step of the solver; the table stays on standard output."""
    stdout, seen = on_terminal(*STUDY, tmp_path / "out")
    assert "string: eps=0.1" in seen
    assert "1/2" in seen
    assert "step" in seen or "timing" in seen or "mesh" in seen
    assert "|u_eps-u_h|_a" in stdout
    assert "\r" not in stdout


@pytest.mark.slow
def test_quiet_is_quiet(tmp_path):
    stdout, seen = on_terminal(*STUDY, tmp_path / "out", "--quiet")
    assert stdout == ""
    assert seen == ""


@pytest.mark.slow
def test_no_bar_without_a_terminal(tmp_path):
    done = run(*STUDY, tmp_path / "out")
    assert done.returncode == 0
    assert done.stderr == ""


@pytest.mark.parametrize("ranks", slow_except([1, 2]))
def test_log_has_rank_and_time(ranks, tmp_path):
    done = run(*STUDY, tmp_path / "out", "--log", "info", "--quiet", ranks=ranks)
    assert done.returncode == 0
    line = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} rank (\d) INFO fenicsx_obstacle\S*: (.*)$", re.MULTILINE)
    found = line.findall(done.stderr)
    assert {rank for rank, _ in found} == {str(rank) for rank in range(ranks)}
    assert sum("eps=0.1" in text for _, text in found) == ranks
    assert any(text.startswith("step 0: ") for _, text in found)
