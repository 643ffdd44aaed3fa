"""Views in space by pyvista, in a separate process, since VTK may crash without a display.

`python -m fenicsx_obstacle.show.render FOLDER` is that process; `rendered` starts it. Nothing else imports pyvista.
"""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.show.figures import INK

PATIENCE = 120.0  # seconds
PIXELS = 1500  # width of a picture
EYE = -58.0, 32.0  # azimuth and elevation, degrees
FREE, OBSTACLE, EDGE = "#97C0E4", "#8A8178", "#66788A"
CLEAR = 0.42  # opacity of u out of contact: a wall in front must not hide the contact behind it
UPPER = 0.4  # opacity of an upper obstacle
BESIDE = 1e-4  # of the widest side: distance of a cut from nodes, as cells are cut there into ones without area
ABOVE_BODY = 3e-3  # the same: distance towards the eye of the pressure from the body that it presses
GIVEN = "given.pickle"  # arrays and views, in the folder of a process
_MPI = ("OMPI_", "PMIX_", "PRTE_", "PMI_")
_WORKER = [sys.executable, "-P", "-m", "fenicsx_obstacle.show.render"]


@dataclass(frozen=True)
class View:
    """The contents of a view in space.

    Attributes:
        kind: `graph` of u over a plane mesh, `surface` in space, `solid`, cut open, or `body`, pressed on some facets.
        shown: The field in colours; where it is the pressure, only in contact.
        colours: Name of a colormap.
        limits: Values at its ends.
        lower: Lower corner of the box, in the units of the data.
        upper: Upper corner.
        scale: From data to the picture, for each axis.
        eye: Azimuth and elevation of the eye, degrees.
    """

    kind: str
    shown: str
    colours: str
    limits: tuple[float, float]
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    eye: tuple[float, float] = EYE

    @property
    def half(self) -> float:
        """Half the side of the picture, a square: the box fits into it from everywhere."""
        return float(np.linalg.norm((self.upper - self.lower) * self.scale)) / 2

    @property
    def centre(self) -> np.ndarray:
        """Centre of the box, in the units of the data."""
        return (self.lower + self.upper) / 2


def axes_of_view(eye: tuple[float, float]) -> np.ndarray:
    """Unit vectors to the right, up and towards an eye, as rows."""
    a, e = np.radians(eye)
    right, up = [-np.sin(a), np.cos(a), 0.0], [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    return np.array([right, up, np.cross(right, up)])


def rendered(arrays: Mapping[str, np.ndarray], views: Sequence[View]) -> tuple[list[np.ndarray], str]:
    """Pictures of some views by pyvista (one rank).

    Args:
        arrays: Points, cells, nodal fields and, of bodies, `facets`: the triangles that show the pressure.
        views: What to draw.

    Returns:
        The pictures with their alpha channels, or none; and who drew them, or why not.
    """
    if find_spec("pyvista") is None:
        return [], "pyvista is not installed"
    from matplotlib.image import imread

    with tempfile.TemporaryDirectory(prefix="obstacle-") as name:
        folder = Path(name)
        (folder / GIVEN).write_bytes(pickle.dumps((dict(arrays), list(views))))
        pictures = [folder / f"{number}.png" for number in range(len(views))]
        # VTK must not take itself for a rank of our MPI
        env = {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}
        # VTK of Debian draws on a display only
        display = [] if os.getenv("DISPLAY") or not shutil.which("xvfb-run") else ["xvfb-run", "--auto-servernum"]
        worker = [*display, *_WORKER, name]
        try:
            done = subprocess.run(worker, env=env, timeout=PATIENCE, capture_output=True, check=False)
        except subprocess.TimeoutExpired:
            return [], f"pyvista took more than {PATIENCE:.0f} s"
        except OSError as error:
            return [], f"pyvista could not be started: {error.strerror}"
        if done.returncode < 0:
            return [], f"pyvista crashed ({signal.Signals(-done.returncode).name})"
        if done.returncode > 0 or not all(picture.exists() for picture in pictures):
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            return [], f"pyvista failed ({''.join(last) or f'exit status {done.returncode}'})"
        return [imread(picture) for picture in pictures], "pyvista"


def draw(folder: Path) -> None:
    """Draw what `rendered` has written; runs in the process of its own."""
    import pyvista

    arrays, views = pickle.loads((folder / GIVEN).read_bytes())
    for number, view in enumerate(views):
        plotter = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS))
        plotter.enable_depth_peeling()
        _add(plotter, _grid(arrays, view), view)
        camera, (_, up, eye) = plotter.camera, axes_of_view(view.eye)
        camera.parallel_projection = True
        camera.focal_point = view.centre * view.scale
        camera.position, camera.up = camera.focal_point + 5 * eye, up
        camera.parallel_scale = view.half
        camera.clipping_range = (0.1, 10)
        plotter.enable_anti_aliasing("ssaa")
        plotter.screenshot(folder / f"{number}.png", transparent_background=True)


def _grid(arrays: Mapping[str, np.ndarray], view: View) -> Any:
    import pyvista

    cells = arrays["cells"]
    kind = pyvista.CellType.TRIANGLE if cells.shape[1] == 3 else pyvista.CellType.TETRA
    of_kind = {kind: cells} | ({pyvista.CellType.TRIANGLE: arrays["facets"]} if "facets" in arrays else {})
    grid = pyvista.UnstructuredGrid(of_kind, arrays["points"] * view.scale)
    for name in arrays.keys() - {"points", "cells", "facets"}:
        grid[name] = arrays[name]
    return grid


def _add(plotter: Any, grid: Any, view: View) -> None:
    """Add the obstacles, u cut along the free boundary, its edges, and the free boundary."""
    levels = {side: f"level {side}" for side in ("lower", "upper") if f"level {side}" in grid.point_data}
    shell = body = grid
    if view.kind == "graph":
        shell = body = grid.warp_by_scalar("seen", factor=view.scale[2])
        for side, level in levels.items():
            _add_obstacle(plotter, grid, view, side, level)
    elif view.kind in ("solid", "body"):
        cells = grid.extract_cells(grid.celltypes == grid.celltypes[0])
        shell, body = _within(cells.extract_surface(), view), _within(cells, view).extract_surface()
    scale = {"scalars": view.shown, "cmap": view.colours, "clim": view.limits, "show_scalar_bar": False}
    smooth, apart = view.kind not in ("solid", "body"), body
    for level in levels.values():
        _paint(plotter, apart.clip_scalar(scalars=level, value=0.0), smooth_shading=smooth, **scale)
        apart = apart.clip_scalar(scalars=level, value=0.0, invert=False)
    pressed = view.shown == "pressure" and (levels or view.kind in ("graph", "body"))
    opacity = CLEAR if view.kind == "graph" else 1.0
    _paint(plotter, apart, smooth_shading=smooth, **({"color": FREE, "opacity": opacity} if pressed else scale))
    if pressed and view.kind == "body":
        facets = _within(grid.extract_cells(grid.celltypes != grid.celltypes[0]), view)
        facets.points += ABOVE_BODY * axes_of_view(view.eye)[2]
        _paint(plotter, facets, **scale)
    outside = shell.extract_surface()
    if view.kind == "body":  # whose tetrahedra may be inverted: angles between their faces would not be those outside
        outside = outside.compute_normals()
    edges = outside.extract_feature_edges(
        boundary_edges=True, feature_edges=view.kind == "body", manifold_edges=False, non_manifold_edges=False
    )
    _draw_lines(plotter, edges, 0.0015, color=EDGE)
    if pressed and not levels and view.kind == "graph":  # obstacles on the boundary: a wide line where there is contact
        held = edges.threshold(0.5, scalars="contact", all_scalars=True)
        _draw_lines(plotter, held.extract_geometry(), 0.01, **scale)
    for level in levels.values():
        line = body.extract_surface().contour(isosurfaces=[0.0], scalars=level)
        _draw_lines(plotter, line, 0.0035, color=INK)


def _within(mesh: Any, view: View) -> Any:
    """A mesh, cut where the box of a view ends within it."""
    for axis, unit in enumerate(np.eye(3)):
        for corner, sign in ((view.lower, -1), (view.upper, 1)):
            place = sign * corner[axis] * view.scale[axis]
            if mesh.n_cells and np.max(sign * mesh.points[:, axis]) > place + BESIDE:
                mesh = mesh.clip(normal=sign * unit, origin=sign * (place - BESIDE) * unit)
    return mesh


def _add_obstacle(plotter: Any, grid: Any, view: View, side: str, level: str) -> None:
    """An obstacle within the box, without the part that u covers in contact."""
    surface, lower = grid.warp_by_scalar(side, factor=view.scale[2]), side == "lower"
    for scalars, value, below in ((side, view.lower[2], False), (side, view.upper[2], True), (level, 0.0, False)):
        if surface.n_cells == 0:  # far away
            return
        surface = surface.clip_scalar(scalars=scalars, value=value, invert=below)
        if not surface.n_cells:  # nothing of it is within the box; VTK drops the data then
            return
    # a little behind u: where both are equal the eye would see one through the other in patches
    offset = 4e-3 * (view.upper[2] - view.lower[2]) * view.scale[2]
    surface.points[:, 2] += -offset if lower else offset
    _paint(plotter, surface, color=OBSTACLE, opacity=1.0 if lower else UPPER, smooth_shading=True)


def _draw_lines(plotter: Any, lines: Any, radius: float, **look: Any) -> None:
    if lines.n_points:
        plotter.add_mesh(lines.strip().tube(radius=radius), lighting=False, **look)


def _paint(plotter: Any, mesh: Any, **look: Any) -> None:
    if mesh.n_cells:
        plotter.add_mesh(mesh.extract_surface(), ambient=0.78, diffuse=0.3, specular=0.05, specular_power=20, **look)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
