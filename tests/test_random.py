"""Random scenes: every invariant of the theory holds for every answer, whatever shape, mesh, data and eps."""

import pytest
from conftest import COMM

from fenicsx_obstacle.studies.hard.draw import SEED, try_all
from fenicsx_obstacle.studies.hard.row import FAILED

COUNT = {1: 50, 2: 20}  # on three ranks 10


@pytest.mark.slow
def test_random_scenes():
    """A short form of `./obstacle hard --random 500`, with scenes of its own."""
    rows = []
    try_all(COUNT.get(COMM.size, 10), SEED + 100, COMM, rows.append)
    assert len(rows) >= 10
    assert not [f"{row['message']}\n{row['scene']}" for row in rows if row["verdict"] == FAILED]
    assert sum(row["answers"] for row in rows) > 2 * len(rows)
    scenes = COMM.allgather([row["scene"] for row in rows])
    assert all(other == scenes[0] for other in scenes)
