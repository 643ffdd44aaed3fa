"""Measured heights as a datum of a problem: `Table("rough.csv", scale=1e-6)`, in TOML {file = "rough.csv"}."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import sha256
from math import cos, isfinite, radians, sin
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.data.measured.grid import Grid, OnGrid
from fenicsx_obstacle.data.measured.read import Heights, numbers, of_arrays, read
from fenicsx_obstacle.data.measured.triangulated import Triangulated
from fenicsx_obstacle.effects.field import Enclosed, Field, Names
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.text import counted, in_toml

KEYS = ("file", "x", "y", "range", "scale", "rotate", "shift", "smooth")
_NOTHING = {"scale": 1.0, "rotate": 0.0, "smooth": 0.0}  # what changes no table
_SAME = 1e-4  # of the mean distance of the lines of a grid: distances that differ less are equal
_FEWEST = 1e-7  # of the extent: lines of a grid that are nearer are one
_LISTED = 3  # places in a message


@dataclass(frozen=True, eq=False)
class Table:
    """Measured data from a file or from arrays.

    A file contains columns x, y, z or x, z (.csv, .txt; .npy), arrays x, y, z (.npz), values z with their extents
    (.npy, .csv, and images, .png), or facets in space (.stl), of which the highest at a point counts. Points of a
    regular grid are recognised, others are triangulated. Between the points z is linear or bilinear.

    Attributes:
        file: Its name, or None.
        x: Without coordinates in the file, the first and the last x; with `z`, the coordinates of its columns.
        y: The same of y.
        z: Values as an array, shape (len(y), len(x)), or (n,) with x and y of that shape.
        range: The values z of black and white in an image.
        scale: Factor of all coordinates, or one for each.
        rotate: Angle about the z-axis in degrees, after scaling.
        shift: Added to x, y and z last; for data along one axis to x and z.
        smooth: Standard deviation of a Gaussian filter in the unit of scaled x and y; for grids.
    """

    file: str | Path | None = None
    x: Any = None
    y: Any = None
    z: Any = None
    range: Any = None
    scale: Any = 1.0
    rotate: float = 0.0
    shift: Any = None
    smooth: float = 0.0
    folder: Path = field(default=Path(), kw_only=True, repr=False)

    @property
    def path(self) -> Path | None:
        """Its file, from where the process runs."""
        return None if self.file is None else self.folder / self.file

    def on(self, source: str) -> MeasuredField:
        """The datum for a place in a scene (every rank reads the file).

        Raises:
            InputError: Naming the place, the file and the line or point.
        """
        return MeasuredField(self, source)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays x, y, z that were given."""
        given = {key: getattr(self, key) for key in ("x", "y", "z")}
        return {key: numbers(value) for key, value in given.items() if value is not None}

    @property
    def in_toml(self) -> dict[str, Any]:
        """The keys that are not default values, as in a scene; without the arrays."""
        given = {key: getattr(self, key) for key in KEYS if self.z is None or key not in ("x", "y")}
        given["file"] = None if self.path is None else str(self.path)
        return {key: value for key, value in given.items() if value is not None and value != _NOTHING.get(key)}

    def __str__(self) -> str:
        return in_toml(self.in_toml | ({} if self.file is None else {"file": str(self.file)}))


class MeasuredField(Field):
    """A table as a datum.

    Attributes:
        table: It.
        surface: Its heights, before they are rotated and shifted.
        along_x: Whether it has values along one axis.
    """

    def __init__(self, table: Table, source: str):
        self.table, self.source = table, source
        self.text = str(table) if table.file is not None else "heights in arrays"
        self._name = f"{source}: {'arrays' if table.path is None else table.path}"
        heights = self._heights()
        self.along_x = heights.columns is not None and heights.columns.shape[1] == 2
        scale = table.scale
        factors = self._list("scale", scale) if np.iterable(scale) else [self._number("scale", scale)] * 3
        self._scale = np.array([factors[0], 1.0, factors[2]] if self.along_x else factors)
        if np.any(self._scale[:2] <= 0) or self._scale[2] == 0:
            raise InputError(f"{self._name}: scale = {scale!r}: factors of x and y must be positive, that of z not 0")
        turn = radians(self._number("rotate", table.rotate))
        self._turn = np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]])  # of points, backwards
        if self.along_x and turn:
            raise InputError(f"{self._name}: rotate is for columns x, y, z")
        self._shift = np.array([0.0, 0.0, 0.0] if table.shift is None else self._list("shift", table.shift))
        self.surface = self._made(heights)

    @property
    def in_full(self) -> str:
        heights = vars(self._heights()).values()
        digest = sha256(b"".join(one.tobytes() for one in heights if isinstance(one, np.ndarray)))
        return f"{self.text} with heights {digest.hexdigest()[:8]}"

    # reading

    def _made(self, heights: Heights) -> Grid | Triangulated:
        if heights.matrix is not None:
            return self._grid(*self._of_matrix(heights))
        self._check_extents()
        assert heights.columns is not None
        columns = heights.columns
        self._check_finite(columns, lambda k: f"({', '.join(f'{x:.4g}' for x in columns[k, :-1])})")
        scaled = heights.columns * self._scale[[0, 2] if self.along_x else [0, 1, 2]]
        if heights.triangles is not None:
            return self._triangulated(scaled[:, :2], scaled[:, 2], heights.triangles)
        if self.along_x:
            order = np.argsort(scaled[:, 0], kind="stable")
            if len(scaled) < 2 or np.any(np.diff(scaled[order, 0]) <= 0):
                raise InputError(f"{self._name}: needs two points or more, each x once")
            return self._grid(scaled[order, 0], None, scaled[order, 1])
        return self._of_points(scaled)

    def _heights(self) -> Heights:
        table = self.table
        if (table.file is None) == (table.z is None):
            raise InputError(f"{self.source}: measured data need either a file or an array z")
        if table.path is None:
            return of_arrays(table.x, table.y, table.z, self._name)
        try:
            return read(table.path)
        except InputError as error:
            raise InputError(f"{self.source}: {error}") from None

    def _check_extents(self) -> None:
        """Reject keys that do not belong to data with coordinates."""
        for key in ("x", "y", "range"):
            if self.table.file is not None and getattr(self.table, key) is not None:
                raise InputError(f"{self._name}: {key} has no meaning for data that have coordinates")

    def _of_matrix(self, heights: Heights) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Axes and heights, shape (len(x), len(y)), scaled."""
        z, axes = heights.matrix, []
        assert z is not None
        for key, own, count in (("x", heights.x, z.shape[1]), ("y", heights.y, z.shape[0])):
            given = own if own is not None else getattr(self.table, key)
            if given is None:
                what = "an image" if heights.image else f"heights alone, {z.shape[0]} x {z.shape[1]}"
                raise InputError(f"{self._name}: {what}: give extents, x = [first, last] and y = [first, last]")
            axis = np.asarray(given if own is not None else self._list(key, given, 2), dtype=np.float64)
            if len(axis) == 2 != count:
                axis = np.linspace(axis[0], axis[1], count)
            if axis.shape != (count,) or count < 2:
                raise InputError(f"{self._name}: {count} values along {key}, but {len(axis)} coordinates")
            if not np.isfinite(axis).all() or not np.all(np.diff(axis) > 0):
                raise InputError(f"{self._name}: {key} must ascend")
            axes.append(axis)
        if heights.image:
            if self.table.range is None:
                raise InputError(f"{self._name}: an image: give range = [height of black, height of white]")
            low, high = self._list("range", self.table.range, 2)
            z = low + (high - low) * z
        elif self.table.range is not None:
            raise InputError(f"{self._name}: range is for images")
        columns = z.shape[1]
        self._check_finite(z.reshape(-1, 1), lambda k: f"row {k // columns + 1}, column {k % columns + 1}")
        return axes[0] * self._scale[0], axes[1] * self._scale[1], z.T * self._scale[2]

    def _check_finite(self, rows: np.ndarray, place: Callable[[int], str]) -> None:
        """Reject rows with a number that is not finite, naming the places of the first ones."""
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
        if len(bad):
            places = "; ".join(map(place, bad[:_LISTED])) + (" and more" if len(bad) > _LISTED else "")
            raise InputError(
                f"{self._name}: {len(bad)} of {counted(len(rows), 'value')} are not finite numbers: at {places}; "
                "replace them, or remove these points: the others are then triangulated"
            )

    def _of_points(self, points: np.ndarray) -> Grid | Triangulated:
        """A grid if the points are one, else triangles between them."""
        x, y = (_lines(points[:, axis]) for axis in (0, 1))
        if len(x) * len(y) == len(points) and min(len(x), len(y)) > 1:
            i, j = (_number_of_line(axis, points[:, k]) for k, axis in enumerate((x, y)))
            z = np.full((len(x), len(y)), np.nan)
            z[i, j] = points[:, 2]
            if np.isfinite(z).all():
                return self._grid(x, y, z)
        distinct, times = np.unique(points[:, :2], axis=0, return_counts=True)
        if len(distinct) < len(points):
            place = ", ".join(f"{x:.4g}" for x in distinct[np.argmax(times > 1)])
            raise InputError(f"{self._name}: two heights or more at ({place})")
        from scipy.spatial import Delaunay, QhullError

        try:
            centre, size = points[:, :2].mean(axis=0), np.ptp(points[:, :2], axis=0).max()
            triangles = Delaunay((points[:, :2] - centre) / (size or 1.0)).simplices
        except (QhullError, ValueError):
            raise InputError(f"{self._name}: {counted(len(points), 'point')} that span no area") from None
        return self._triangulated(points[:, :2], points[:, 2], triangles)

    def _grid(self, x: np.ndarray, y: np.ndarray | None, z: np.ndarray) -> Grid | Triangulated:
        width = self._number("smooth", self.table.smooth)
        if width < 0:
            raise InputError(f"{self._name}: smooth = {width:g}: must not be negative")
        if width:
            axes = [x] if y is None else [x, y]
            steps = [np.diff(axis) for axis in axes]
            if any(
                np.ptp(step) > _SAME * step.mean() + 1e-9 * np.ptp(axis) for step, axis in zip(steps, axes, strict=True)
            ):
                raise InputError(f"{self._name}: smooth is for grids with equal distances")
            from scipy.ndimage import gaussian_filter

            z = gaussian_filter(z, [width / step.mean() for step in steps], mode="nearest")
        return Grid(x, y, z + self._shift[2])

    def _triangulated(self, points: np.ndarray, z: np.ndarray, triangles: np.ndarray) -> Grid | Triangulated:
        if self.table.smooth:
            raise InputError(f"{self._name}: smooth is for heights on a grid")
        try:
            return Triangulated(points, z + self._shift[2], triangles)
        except ValueError:
            count = counted(len(triangles), "facet")
            raise InputError(f"{self._name}: {count}, all of them vertical: they are no heights over x and y") from None

    # numbers

    def _number(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not isfinite(value):
            raise InputError(f"{self._name}: {key} = {value!r}: expected a finite number")
        return float(value)

    def _list(self, key: str, value: Any, count: int = 0) -> list[float]:
        """Numbers of a list; of x, y and z, or x and z along one axis, where no count is given: then three."""
        wanted = count or (2 if self.along_x else 3)
        if not isinstance(value, list | tuple | np.ndarray) or len(value) != wanted:
            names = f"{wanted} numbers" if count else "[x, z]" if self.along_x else "[x, y, z]"
            raise InputError(f"{self._name}: {key} = {value!r}: expected {names}")
        found = [self._number(key, one) for one in value]
        return found if wanted == count or not self.along_x else [found[0], 0.0, found[1]]

    # the datum

    @property
    def continuous(self) -> bool:  # type: ignore[override]
        return isinstance(self.surface, Grid)

    @property
    def pointwise(self) -> bool:
        return True

    @property
    def spacing(self) -> float:
        """Distance of neighbouring data."""
        return self.surface.spacing

    @property
    def facets(self) -> np.ndarray | None:
        """Corners of the facets of an STL surface, shape (m, 3, 3), scaled, rotated and shifted; None of a table."""
        heights = self._heights()
        if heights.triangles is None:
            return None
        assert heights.columns is not None
        points = heights.columns * self._scale
        points[:, :2] = points[:, :2] @ self._turn
        found: np.ndarray = (points + self._shift)[heights.triangles]
        return found if self._scale[2] > 0 else found[:, ::-1]

    def _inward(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) in the coordinates of the surface."""
        there = points - self._shift[:2]
        return there @ self._turn.T if self.table.rotate else there

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return self.surface.at(self._inward(x[:2].T))

    def over(self, corners: np.ndarray, names: Names, cells: np.ndarray) -> Enclosed | None:
        if not isinstance(self.surface, Grid) or corners.shape[2] != 2:
            return None
        return OnGrid(self.surface, self._inward(corners))

    def because(self, point: np.ndarray, names: Names) -> str:
        axes = "x" if self.along_x else "xy"
        ends = zip(axes, self.surface.low + self._shift[:2], self.surface.high + self._shift[:2], strict=False)
        turned = ", turned," if self.table.rotate else ""
        return f"; the data{turned} reach over " + ", ".join(f"{a} = {low:.6g} .. {high:.6g}" for a, low, high in ends)


def _lines(x: np.ndarray) -> np.ndarray:
    """The lines of a grid that coordinates are on."""
    found = np.sort(x)
    near = _FEWEST * (found[-1] - found[0])
    starts = np.flatnonzero(np.concatenate([[True], np.diff(found) > near]))
    return found[starts]


def _number_of_line(lines: np.ndarray, x: np.ndarray) -> np.ndarray:
    middles = (lines[1:] + lines[:-1]) / 2
    return np.searchsorted(middles, x)
