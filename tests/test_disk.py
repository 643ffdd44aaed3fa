"""Disks that are full, devices, and processes that are killed: a short form of `./obstacle hard --faults`."""

import os
import resource
import shutil
from functools import partial
from pathlib import Path

import pytest

from fenicsx_obstacle import InputError
from fenicsx_obstacle.parallel import write_text
from tests.cli.faults.disk import ALONE, COMMANDS, FULL, _refused, _run
from tests.cli.faults.kill import interrupts
from tests.conftest import CLEAN

pytestmark = pytest.mark.serial


@pytest.mark.slow
def test_files_that_may_not_grow(tmp_path):
    """A solve over an earlier answer: one message, and nothing has changed."""
    command = COMMANDS["solve"]
    assert _run(1, [*command[:2], "--cells", "8"], tmp_path / "before", CLEAN).returncode == 0
    for size in (100, 4000):
        folder = tmp_path / str(size)
        shutil.copytree(tmp_path / "before", folder)
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
        assert _refused("solve", 1, command, folder, {**CLEAN, **ALONE}, FULL, limit).wrong == ""


def test_devices_are_written_as_they_are(tmp_path):
    """--json /dev/null must not put a file in its place; a full one is named."""
    link = tmp_path / "null"
    os.mkfifo(link)
    reader = os.open(link, os.O_RDONLY | os.O_NONBLOCK)
    write_text(link, "figures")
    assert os.read(reader, 100) == b"figures"
    os.close(reader)
    assert link.is_fifo()
    with pytest.raises(InputError, match="/dev/full: cannot be written: No space left on device"):
        write_text(Path("/dev/full"), "figures")
    assert not Path("/dev/full").is_file()


def test_a_file_that_cannot_be_written_leaves_the_earlier_one(tmp_path):
    """Neither half a file nor a scratch file beside it."""
    (tmp_path / "a").write_text("before")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with pytest.raises(InputError, match="File too large"):
            write_text(tmp_path / "a", "after" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.slow
def test_interrupts(tmp_path):
    """Ctrl-C on one rank and on two: one line at most, and no process is left."""
    assert [fault.wrong for fault in interrupts(tmp_path, CLEAN, 1)] == ["", ""]
