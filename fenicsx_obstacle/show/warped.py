"""Pictures in space by pyvista, in a process of its own: VTK may crash where there is no display, and nothing else may.

`python -m fenicsx_obstacle.show.warped VIEW.npz PICTURE.png` is that process; `rendered` starts it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.show.relief import View, axes_of_view

PATIENCE = 120.0  # seconds
_MPI = ("OMPI_", "PMIX_", "PRTE_", "PMI_")
_WORKER = [sys.executable, "-m", "fenicsx_obstacle.show.warped"]


def rendered(view: View, extent: tuple[float, float, float, float], pixels: int) -> tuple[np.ndarray | None, str]:
    """The picture of a view by pyvista (one rank).

    Args:
        view: What to draw.
        extent: Left, right, bottom, top of the picture, in the projection of the view.
        pixels: Its width.

    Returns:
        The picture with its alpha channel, or None; and who drew it, or why not.
    """
    if find_spec("pyvista") is None:
        return None, "pyvista is not installed"
    from matplotlib.image import imread

    with tempfile.TemporaryDirectory(prefix="obstacle-") as folder:
        data, picture = Path(folder) / "view.npz", Path(folder) / "view.png"
        _write(view, extent, pixels, data)
        # VTK must not take itself for a rank of our MPI
        env = {key: value for key, value in os.environ.items() if not key.startswith(_MPI)}
        try:
            done = subprocess.run(
                [*_WORKER, str(data), str(picture)], env=env, timeout=PATIENCE, capture_output=True, check=False
            )
        except subprocess.TimeoutExpired:
            return None, f"pyvista took more than {PATIENCE:.0f} s"
        except OSError as error:
            return None, f"pyvista could not be started: {error.strerror}"
        if done.returncode < 0:
            return None, f"pyvista crashed ({signal.Signals(-done.returncode).name})"
        if done.returncode > 0 or not picture.exists():
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            return None, f"pyvista failed ({''.join(last) or f'exit status {done.returncode}'})"
        return imread(picture), "pyvista"


def _write(view: View, extent: tuple[float, ...], pixels: int, path: Path) -> None:
    arrays: dict[str, Any] = {"extent": np.array(extent), "pixels": np.array(pixels)}
    for number, surface in enumerate(view.surfaces):
        arrays |= {f"{name}{number}": np.asarray(value) for name, value in vars(surface).items()}
    for number, lines in enumerate(view.lines):
        arrays |= {f"line_{name}{number}": np.asarray(value) for name, value in vars(lines).items()}
    np.savez(path, **arrays)


def draw(data: Path, picture: Path) -> None:
    """Draw what `rendered` has written; runs in the process of its own."""
    import pyvista

    arrays = np.load(data)
    left, right, bottom, top = arrays["extent"]
    width = int(arrays["pixels"])
    plotter = pyvista.Plotter(off_screen=True, window_size=(width, round(width * (top - bottom) / (right - left))))
    number = 0
    while f"points{number}" in arrays:
        surface = {name: arrays[f"{name}{number}"] for name in ("points", "triangles", "colours", "opacity")}
        faces = np.insert(surface["triangles"], 0, 3, axis=1).ravel()
        mesh = pyvista.PolyData(surface["points"], faces)
        mesh["colours"] = (255 * surface["colours"]).astype(np.uint8)
        plotter.add_mesh(
            mesh, scalars="colours", rgb=True, opacity=float(surface["opacity"]), smooth_shading=True,
            ambient=0.5, diffuse=0.55, specular=0.08, specular_power=20,
        )  # fmt: skip
        number += 1
    number = 0
    while f"line_ends{number}" in arrays:
        ends, colour, radius = (arrays[f"line_{name}{number}"] for name in ("ends", "colour", "radius"))
        if len(ends):
            segments = np.insert(np.arange(2 * len(ends)).reshape(-1, 2), 0, 2, axis=1).ravel()
            line = pyvista.PolyData(ends.reshape(-1, 3), lines=segments).clean(tolerance=1e-9).strip()
            plotter.add_mesh(line.tube(radius=float(radius)), color=str(colour), lighting=False)
        number += 1
    _look(plotter, (left, right, bottom, top))
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(picture, transparent_background=True)


def _look(plotter: object, extent: tuple[float, float, float, float]) -> None:
    """The camera of `axes_of_view`, so that what matplotlib draws around the picture fits it."""
    left, right, bottom, top = extent
    across, up, out = axes_of_view()
    centre = across * (left + right) / 2 + up * (bottom + top) / 2
    camera = plotter.camera  # type: ignore[attr-defined]
    camera.parallel_projection = True
    camera.focal_point, camera.position, camera.up = centre, centre + 5 * out, up
    camera.parallel_scale = (top - bottom) / 2
    camera.clipping_range = (0.1, 10)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
