"""What a notebook shows: the picture of an answer."""

import pytest

from fenicsx_obstacle import solve
from fenicsx_obstacle.show import render
from tests.conftest import COMM


@pytest.fixture(autouse=True)
def without_pyvista(monkeypatch):
    """Who draws is not what is tested here."""
    monkeypatch.setattr(render, "find_spec", lambda name: None)


def test_a_picture_shows_itself(disk, folder):
    """Jupyter looks for `_repr_png_`; rank 0 draws, the others have words."""
    answer = solve(disk, cells=4)
    for picture in (answer.plot(), answer.plot(folder / "disk.png")):
        data = picture._repr_png_()
        assert "drawn by matplotlib" in repr(picture)
        assert data.startswith(b"\x89PNG") if COMM.rank == 0 else data is None
