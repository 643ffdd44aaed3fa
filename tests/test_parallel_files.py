"""Results are written and read by all ranks; rank 0 gathers no more than what lies near the free boundary."""

import errno
import pickle
import sys

import h5py
import numpy as np
import pytest

from fenicsx_obstacle import Answer, InputError, Scene, solve
from fenicsx_obstacle.io import folder as folder_module
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.parallel import gathered, on_root
from fenicsx_obstacle.show.boundary import free_boundary, patch_of
from fenicsx_obstacle.show.free_boundary import near_free_boundary, write_free_boundary
from tests.conftest import COMM, DEMOS


@pytest.mark.parametrize("name, changes", [
    ("ball", {"mesh.cells": 96}),
    ("ball", {"mesh.cells": 24, "solve.element": "P2"}),
    ("two_sided", {}),
    ("string", {}),
])  # fmt: skip
def test_the_free_boundary_needs_only_the_cells_near_it(name, changes):
    """The same pieces with the same coordinates, to the last digit, as from the whole mesh on rank 0."""
    answer = solve(Scene.read(DEMOS / f"{name}.toml").change(changes))
    near, whole = near_free_boundary(answer.fields), gather(answer.fields)
    if COMM.rank != 0:
        assert near is None
        return
    assert near is not None and (changes.get("mesh.cells") != 96 or len(near.cells) < 0.4 * len(whole["cells"]))
    ours, theirs = free_boundary(near), free_boundary(patch_of(whole))
    assert len(ours) == len(theirs) > 0
    for a, b in zip(ours, theirs, strict=True):
        assert np.array_equal(a.points[a.cells], b.points[b.cells])


@pytest.mark.slow
def test_rank_0_holds_nothing_of_the_size_of_the_mesh(folder, monkeypatch):
    """Bytes gathered on rank 0 to save, report and read: as h falls they grow like the free boundary, not like the
    mesh, of which they are a small part."""
    sent = []

    def counted(comm, values):
        found = gathered(comm, values)
        sent.append(0 if found is None else found.nbytes)
        return found

    def told(comm, action, *arguments):
        found = on_root(comm, action, *arguments)
        sent.append(len(pickle.dumps(found)))
        return found

    for module in [one for name, one in sys.modules.items() if name.startswith("fenicsx_obstacle.")]:
        for name, replacement in (("gathered", counted), ("on_root", told)):
            if module.__name__ != "fenicsx_obstacle.parallel" and hasattr(module, name):
                monkeypatch.setattr(module, name, replacement)
    bytes_sent = []
    for cells in (64, 128):
        answer = solve("ball", cells=cells)
        sent.clear()
        answer.save(folder / str(cells))
        write_free_boundary(answer.fields, folder / str(cells) / "free_boundary.csv")
        read = Answer.read(folder / str(cells))
        assert read.level.dofs == answer.level.dofs
        bytes_sent.append(COMM.bcast(sum(sent)))
    assert 0 < bytes_sent[1] < 2.5 * bytes_sent[0]
    assert bytes_sent[1] < 0.2 * (folder / "128" / "fields.h5").stat().st_size


def test_the_file_of_all_ranks_is_plain_hdf5(folder, ball):
    """Every array stands in it as rank 0 would have gathered it, without gaps or compression."""
    answer = solve(ball, cells=16)
    answer.save(folder)
    arrays = gather(answer.fields)
    with h5py.File(folder / "fields.h5") as file:
        assert set(file) >= {"points", "cells", "gdim", "u", "pressure", "contact", "lower", "gap", "error"}
        for name, values in arrays.items():
            assert file[name].dtype == values.dtype and np.array_equal(file[name][()], values), name


def test_a_rank_that_cannot_write_is_told_on_all(folder, ball, monkeypatch):
    """As if the disk of the last rank were full: an earlier result stays whole."""
    answer = solve(ball, cells=8)
    answer.save(folder)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}

    def full(*_):
        if COMM.rank == COMM.size - 1:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder_module, "fill", full)
    with pytest.raises(InputError, match="cannot be written: No space left on device; the old content stays"):
        answer.save(folder)
    COMM.barrier()
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
