"""Lines and curves of [profile.NAME] on a mesh: their points, and formulas of comparison there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.discrete.cells import corners, facet_corners, sides
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.discrete.points import values_of
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.scenes.report import compare_place
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import counted, nearest

_SAME = 1e-9  # of the extent of a curve: ends of facets so near are one point


def points_of(scene: Scene, level: Level) -> dict[str, np.ndarray]:
    """The points of each profile of a scene, shape (n, gdim), the same on every rank (collective).

    Raises:
        InputError: If a point is outside the mesh, or a name is of no curve.
    """
    found, gdim = {}, level.mesh.geometry.dim
    for name, table in scene.tables.profile.items():
        place = f"{scene.source}: [profile.{name}]"
        if table.on is not None:
            found[name] = _on_curve(level, table.on, table.n, place)
            continue
        ends = []
        for key, given in (("from", table.from_), ("to", table.to)):
            assert given is not None  # as the tables were checked
            numbers = given if isinstance(given, tuple) else (given,)
            if len(numbers) != gdim:
                raise InputError(f"{place} {key}: needs {counted(gdim, 'coordinate')}, not {len(numbers)}")
            ends.append([scene.number(one, f"[profile.{name}] {key}") for one in numbers])
        if ends[0] == ends[1]:
            raise InputError(f"{place}: from and to are the same point")
        found[name] = np.linspace(np.array(ends[0]), np.array(ends[1]), table.n)
        outside = np.isnan(values_of(fem.Function(level.Q), in_space(found[name])))
        if outside.any():
            x = ", ".join(f"{x:.6g}" for x in found[name][np.argmax(outside)])
            raise InputError(f"{place}: the point ({x}) is outside the mesh")
    return found


def check_profiles(scene: Scene, level: Level) -> None:
    """Reject profiles before anything is solved (collective).

    Raises:
        InputError: As `points_of`, or if a formula of comparison is not finite at a point.
    """
    for name, points in points_of(scene, level).items():
        for t in (None,) if scene.time is None else (0.0, scene.time.end):
            _formulas(scene, points, scene.tables.profile[name].compare, compare_place(name), t)


def compared(
    scene: Scene, profile: Profile, given: Mapping[str, float | str], place: str, t: float | None = None
) -> Profile:
    """A profile with the values of formulas of comparison.

    Args:
        scene: Whose definitions they may use.
        profile: The solution along a line.
        given: Formulas by the column over which they are drawn.
        place: Where they stand, for messages.
        t: The moment, of a scene with time.

    Raises:
        InputError: If a formula is not finite at a point.
    """
    return replace(profile, formulas=_formulas(scene, profile.points, given, place, t))


def _formulas(
    scene: Scene, points: np.ndarray, given: Mapping[str, float | str], place: str, t: float | None
) -> dict[str, np.ndarray]:
    x, values = in_space(points).T, {} if t is None else {"t": t}
    formulas = {key: scene.at_points(scene.formula(one, f"{place} {key}"), x, values) for key, one in given.items()}
    for key, one in formulas.items():
        if not np.isfinite(one).all():
            where = ", ".join(f"{x:.6g}" for x in points[np.argmin(np.isfinite(one))])
            raise InputError(f"{scene.source}: {place} {key} = {given[key]}: is not finite at ({where})")
    return formulas


def in_space(points: np.ndarray) -> np.ndarray:
    """Points with three coordinates, shape (n, 3)."""
    x = np.zeros((len(points), 3))
    x[:, : points.shape[1]] = points
    return x


def _on_curve(level: Level, name: str, n: int, place: str) -> np.ndarray:
    """Points at equal distances along a named curve of a plane mesh (collective)."""
    mesh = level.mesh
    if mesh.topology.dim != 2:
        raise InputError(f"{place} on: is for curves of plane meshes")
    if name not in level.facets:
        raise InputError(f"{place} on: no curve named '{name}'" + nearest(name, level.facets))
    cells, numbers, _ = sides(mesh, level.facets[name])
    x = corners(mesh)[cells[:, None], np.array(facet_corners(mesh))[numbers]]
    gathered = np.concatenate(mesh.comm.allgather(x))
    if not len(gathered):
        raise InputError(f"{place} on = '{name}': no facet of the mesh lies on it")
    path = _chained(gathered, f"{place} on = '{name}'")
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, s[-1], n)
    return np.column_stack([np.interp(at, s, path[:, k]) for k in range(mesh.geometry.dim)])


def _chained(segments: np.ndarray, place: str) -> np.ndarray:
    """Segments (n, 2, 3) one after the other, as their points (n + 1, 3); a closed curve ends where it begins."""
    size = max(np.ptp(segments.reshape(-1, 3), axis=0).max(), 1e-300)
    keys = [tuple(key) for key in np.round(segments.reshape(-1, 3) / (_SAME * size)).astype(np.int64).tolist()]
    at = dict(zip(keys, segments.reshape(-1, 3), strict=True))
    beside: dict[Any, set[Any]] = {key: set() for key in at}
    for a, b in zip(keys[::2], keys[1::2], strict=True):
        beside[a].add(b)
        beside[b].add(a)
    ends = sorted(key for key, others in beside.items() if len(others) == 1)
    if len(ends) not in (0, 2) or any(len(others) > 2 for others in beside.values()):
        raise InputError(f"{place}: is not a single curve")
    path = [ends[0] if ends else min(beside)]
    seen = {path[0]}
    while further := sorted(beside[path[-1]] - seen):
        path.append(further[0])
        seen.add(further[0])
    if len(seen) < len(beside):
        raise InputError(f"{place}: is not a single curve")
    return np.array([at[key] for key in (path if ends else [*path, path[0]])])
