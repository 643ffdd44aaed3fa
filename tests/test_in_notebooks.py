"""What a notebook shows: the picture of an answer, and a slider where ipywidgets is there."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.show import render
from fenicsx_obstacle.show.widget import slider
from tests.conftest import COMM, membrane

INTERVAL = {"shape": "interval", "cells": 8}


@pytest.fixture(autouse=True)
def without_pyvista(monkeypatch):
    """Who draws is not what is tested here."""
    monkeypatch.setattr(render, "find_spec", lambda name: None)


@pytest.fixture
def notebook(monkeypatch):
    """What a slider takes of ipywidgets: `interactive` keeps the function, which the browser calls."""
    made = SimpleNamespace(
        SelectionSlider=lambda **given: SimpleNamespace(**given),
        interactive=lambda draw, options, **given: SimpleNamespace(draw=draw, **options, **given),
    )
    monkeypatch.setitem(sys.modules, "ipywidgets", made)


def test_a_picture_shows_itself(disk, folder):
    """Jupyter looks for `_repr_png_`; rank 0 draws, the others have words."""
    answer = solve(disk, cells=4)
    for picture in (answer.plot(), answer.plot(folder / "disk.png")):
        data = picture._repr_png_()
        assert "drawn by matplotlib" in repr(picture)
        assert data.startswith(b"\x89PNG") if COMM.rank == 0 else data is None


@pytest.mark.usefixtures("notebook")
def test_a_slider_over_eps(disk):
    """Each eps is solved anew on the same mesh: a softer obstacle gives way more."""
    answer = solve(disk, cells=8, eps=1e-3)
    made = slider(answer)
    values = list(made.eps.options.values())
    assert made.auto_display
    assert made.eps.value == answer.record["eps"]
    assert np.allclose(np.diff(np.log10(values)), -1)
    assert "drawn by" in repr(made.draw(values[0]))


@pytest.mark.slow
@pytest.mark.usefixtures("notebook")
def test_a_slider_over_moments():
    """One place for each moment that was kept."""
    scene = Scene(mesh=INTERVAL, tension=1, load="-t", lower=-0.05, time={"end": 1, "steps": 4})
    answer = solve(scene)
    if COMM.size > 1:  # it is for one rank
        return
    made = slider(answer)
    assert len(made.moment.options) == len(answer.time_history.frames)
    assert [repr(made.draw(k)) for k in (0, made.moment.value)] == ["t = 0", "t = 1"]
    assert made.draw(1)._repr_png_() != made.draw(2)._repr_png_()


def test_what_has_no_slider(disk, monkeypatch):
    """Neither eps nor moments to choose from, or no ipywidgets: told in words."""
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(InputError, match="pip install ipywidgets"):
        slider(solve(disk, cells=4))
    monkeypatch.setitem(sys.modules, "ipywidgets", SimpleNamespace())
    with pytest.raises(InputError, match="there is no eps"):
        slider(solve(membrane(load=-1, lower=-0.01), method="vi"))
