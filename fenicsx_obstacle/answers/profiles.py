"""The lines and curves of [profile.NAME]: their points, the solution along them, and formulas of comparison there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.cells import chains, corners, facet_corners, sides
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.points import values_of
from fenicsx_obstacle.problems.values import Profile
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.report import of_profile
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import counted, csv_of, nearest

FORMULA = "_formula"  # after the name of a column: that of the formula of comparison
_SAME = 1e-9  # of the extent of a curve: ends of facets so near are one point


def profiles_of(answer: Answer) -> dict[str, Profile]:
    """The solution that pictures show along all profiles of its scene, with formulas of comparison (collective).

    Raises:
        InputError: As `points_of`, or if a formula is not finite at a point.
    """
    scene, found = answer.scene, {}
    shown = answer.shown
    t = shown.record["time"]["t"] if "time" in shown.record else None
    for name, points in points_of(scene, answer.level).items():
        found[name] = replace(shown.on(points), formulas=formulas_at(scene, points, of_profile(scene, name), t))
    return found


def moments_of(answer: Answer, profile: Profile, given: Mapping[str, Formula]) -> list[tuple[float, Profile]]:
    """u, pressure, gap and formulas along the same points at each moment that was kept (collective); none without
    time.

    Args:
        answer: Solution of a scene.
        profile: It along a line, at the end.
        given: Formulas of comparison.

    Raises:
        InputError: As `formulas_at`.
    """
    if answer.time_history is None or answer.scene.model.vector_valued:  # of a body at the moment that is shown
        return []
    plain, points = answer.plain.level, in_space(profile.points)
    comm, map_ = plain.comm, plain.V.dofmap.index_map
    first, found = map_.local_range[0], []
    for frame in answer.time_history.frames:
        fields = comm.bcast({name: frame.fields[name] for name in ("u", "pressure", "gap") if name in frame.fields})
        values = dict[str, Any]()
        for name, nodal in fields.items():
            function = fem.Function(plain.V)
            function.x.array[: plain.owned] = nodal[first : first + plain.owned]
            function.x.scatter_forward()
            values[name] = values_of(function, points)
        gap = values.pop("gap", np.full(len(points), np.inf))
        formulas = formulas_at(answer.scene, profile.points, given, frame.t)
        found.append((frame.t, replace(profile, gap=gap, slope=None, flux=None, formulas=formulas, **values)))
    return found


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
            formulas_at(scene, points, of_profile(scene, name), t)


def formulas_at(
    scene: Scene, points: np.ndarray, given: Mapping[str, Formula], t: float | None
) -> dict[str, np.ndarray]:
    """The values of formulas of comparison.

    Args:
        scene: Whose definitions they may use.
        points: Shape (n, gdim).
        given: Formulas by the column over which they are drawn.
        t: The moment, of a scene with time.

    Raises:
        InputError: If a formula is not finite at a point.
    """
    x, values = in_space(points).T, {} if t is None else {"t": t}
    found = {key: scene.at_points(formula, x, values) for key, formula in given.items()}
    for key, one in found.items():
        if not np.isfinite(one).all():
            where = ", ".join(f"{x:.6g}" for x in points[np.argmin(np.isfinite(one))])
            raise InputError(f"{given[key].place} = {given[key].text}: is not finite at ({where})")
    return found


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
    x = segments.reshape(-1, 3)
    size = max(np.ptp(x, axis=0).max(), 1e-300)
    keys = np.round(x / (_SAME * size)).astype(np.int64)
    _, first, ends = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    edges = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0)  # each is a facet of two cells inside
    curves, counts = chains(edges, len(first)), np.bincount(edges.ravel())
    if len(curves) > 1 or counts.max() > 2:
        raise InputError(f"{place}: is not a single curve")
    curve = curves[0] if counts.min() == 1 else np.append(curves[0], curves[0][0])
    return np.asarray(x[first[curve]])


def as_columns(profile: Profile) -> dict[str, list[float]]:
    """Its columns by their names: the coordinates, s, the quantities that are known, and formulas of comparison."""
    axes = "xyz"[: profile.points.shape[1]]
    columns = {axis: profile.points[:, k] for k, axis in enumerate(axes)} | {"s": profile.s}
    named = {"u": profile.u, "p": profile.pressure, "gap": profile.gap, "slope": profile.slope, "flux": profile.flux,
             "von_mises": profile.von_mises}  # fmt: skip
    for name, values in named.items():
        if values is not None and values.ndim == 1:
            columns[name] = values
        elif values is not None:
            columns |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate(axes)}
    columns |= {name + FORMULA: values for name, values in profile.formulas.items()}
    return {name: values.tolist() for name, values in columns.items()}


def as_csv(parts: Sequence[tuple[Mapping[str, str], Mapping[str, Sequence[float]]]]) -> str:
    """A line for each point of each part.

    Args:
        parts: First what is the same at all points of a part, by the heads of its columns; then its columns.
    """
    return csv_of([
        {**same, **{name: f"{x:.12g}" for name, x in zip(columns, point, strict=True)}}
        for same, columns in parts for point in zip(*columns.values(), strict=True)
    ])  # fmt: skip
