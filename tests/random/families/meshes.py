"""Meshes that families share: all shapes of triangles, moved vertices, and meshes of the caller's own."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from hypothesis import strategies as st
from mpi4py import MPI

from fenicsx_obstacle import releases
from tests.random.families.strategies import grids

OWN = "own"
RECTANGLES = (
    {"x": [0.0, 1.0], "y": [0.0, 1.0]}, {"x": [-1.0, 1.0], "y": [-1.0, 1.0]}, {"x": [-0.5, 0.5], "y": [-0.377, 0.623]},
    {"x": [-1.0, 0.3], "y": [-0.4, 0.6]},
)  # fmt: skip


def shifts(places: np.ndarray) -> np.ndarray:
    """Two numbers between -1 and 1 that look random, for each place of a grid (n, 2); the same on every rank."""
    mixed = np.sin(np.rint(places) @ np.array([[12.9898, 39.346], [78.233, 11.135]])) * 43758.5453
    return np.asarray(2 * (mixed - np.floor(mixed)) - 1)


def skewed(
    comm: MPI.Comm, cells: int, side: float, slope: float, stretch: float, scatter: float, *, middle: bool = False,
    lined: bool = False,
) -> dmesh.Mesh:  # fmt: skip
    """A grid on a parallelogram that is stretched along x: obtuse and flat triangles (collective).

    Args:
        comm: Communicator.
        cells: Along each side.
        side: Length of the square that is moved.
        slope: Of its sides.
        stretch: Along x.
        scatter: How far inner vertices are moved before, in parts of a cell.
        middle: Whether its middle is at the origin.
        lined: Whether the line of vertices in the middle stays straight; `cells` is even.
    """
    mesh = dmesh.create_rectangle(comm, [np.zeros(2), np.array([side, side])], [cells, cells],
                                  ghost_mode=releases.FACET_GHOSTS)  # fmt: skip
    x, h = mesh.geometry.x, side / cells
    inside = np.all((x[:, :2] > h / 2) & (x[:, :2] < side - h / 2), axis=1)
    if lined:
        inside &= np.abs(x[:, 0] - side / 2) > h / 4
    x[:, :2] += scatter * h * shifts(x[:, :2] / h) * inside[:, None]
    x[:, :2] -= side / 2 if middle else 0.0
    x[:, 0] = stretch * (x[:, 0] + slope * x[:, 1])
    return mesh


def made(table: dict[str, Any], comm: MPI.Comm) -> Any:
    """A table [mesh] as it is, or the mesh that a table of `meshes` stands for (collective)."""
    if table["shape"] != OWN:
        return table
    return skewed(comm, table["cells"], 2.0, table["slope"], table["stretch"], table["scatter"], middle=True)


@st.composite
def meshes(draw: st.DrawFn, low: int = 4, high: int = 14) -> dict[str, Any]:
    """Domains inside of |x|, |y| <= 1; an 'own' one is no table but made by `made`."""
    shape = draw(st.sampled_from(["rectangle", "rectangle", "rectangle", "l-shape", "disk", OWN]))
    if shape == "rectangle":
        return draw(grids(low, high, (0.0, 0.0, 0.2, 0.3), **draw(st.sampled_from(RECTANGLES))))
    mesh: dict[str, Any] = {"shape": shape, "cells": draw(st.integers(low, high))}
    if shape == "l-shape":
        mesh |= RECTANGLES[1]
    if shape == OWN:
        slope = draw(st.integers(-20, 20)) / 10
        stretch = draw(st.sampled_from([1.0, 1.0, 0.2, 0.03])) / (1 + abs(slope))
        mesh |= {"slope": slope, "stretch": stretch, "scatter": draw(st.sampled_from([0.0, 0.2, 0.3]))}
    return mesh
