"""How often the stated uncertainties hold: stated and true errors, on scenes with exact solutions.

    .venv/bin/python benchmarks/uncertainties.py
    .venv/bin/python benchmarks/uncertainties.py ball cone --cells 32..128 --each

Each scene is solved with `uncertainty=True` on several meshes, by several elements and methods. The true values are
integrals of the exact solution over a fine grid, its values at a point, its largest value, and contact area and force
from `exact_contact`. Where they are not known a quantity is not judged. `--each` prints every quantity.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
from ladder import show
from mpi4py import MPI

from fenicsx_obstacle import Scene
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.answers.uncertainty import with_uncertainties
from fenicsx_obstacle.cli_options import values_of
from fenicsx_obstacle.effects.domain.load import Load
from fenicsx_obstacle.estimation.exact_contact import exact_contact
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.scenes import catalogue, meshes

FINE = {1: 200_000, 2: 1500}  # cells of the grid for the true values, along each axis
POINT = (0.38, 0.21)  # of the size of the domain, from its first corner: on no symmetry
STEP = 1e-6  # of central differences
TRUTH = 2e-7  # relative accuracy of the true contact area and force of `exact_contact`
TIMES = 3.0  # the stated uncertainty within which a true error should lie
NO_AREA = ("biactive", "biactive_power", "ring_wedge", "string_wedge")  # contact without pressure, or of measure 0


def main() -> None:
    """Print the table (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="names of the catalogue; all by default")
    parser.add_argument("--cells", default="32..256", help="a list or range, as for --vary")
    parser.add_argument("--each", action="store_true")
    options = parser.parse_args()
    rows = []
    for name in options.scenes or catalogue.names():
        scene = with_report(catalogue.read(name))
        true = truths(scene)
        for change in ({}, {"solve.method": "vi"}, {"solve.eps": "h^2"}, {"solve.element": "P2"}):
            for cells in values_of(options.cells, "cells"):
                found = scene.change({"mesh.cells": cells, **change})
                rows += [(name, *(change.values() or ["-"]), cells, *row) for row in compared(found, true)]
                if options.each:
                    for row in rows[-len(true) :]:
                        show(str(row))
    show(f"{'quantity':10} {'cases':>6} {'held':>6} {'stated/true':>12} {'not settled':>12} {'unbounded':>10}")
    for quantity in [*dict.fromkeys(row[-4] for row in rows), "all"]:
        show(line(quantity, [row for row in rows if quantity in (row[-4], "all")]))


def with_report(scene: Scene) -> Scene:
    """The scene with quantities whose true values are found."""
    x = ", ".join(str(value) for value in point(scene))
    report = {"volume": "integral(u)", "square": "integral(u^2)", "point": f"at(u, {x})", "top": "sup(u)"}
    return scene.change({"report": {**report, "bottom": "inf(u)", "peak": "sup(abs(p))"}})


def extent(scene: Scene) -> np.ndarray:
    """Both ends of the domain along each axis."""
    with closing(SolverContext(scene.change({"mesh.cells": 4}))) as context:
        x = context.problem.level.mesh.geometry.x[:, : context.problem.level.mesh.geometry.dim]
        return np.array([x.min(axis=0), x.max(axis=0)]).T


def point(scene: Scene) -> list[float]:
    """Where u is evaluated."""
    return [float(low + share * (high - low)) for (low, high), share in zip(extent(scene), POINT, strict=False)]


def truths(scene: Scene) -> dict[str, float]:
    """The true values, by the name in the record."""
    exact, ends = scene.exact, extent(scene)
    assert exact is not None
    at = lambda field, x: field.at(x, {"eps": 0.0})  # noqa: E731
    sums, tops, peaks = dict.fromkeys(("volume", "square", "energy"), 0.0), [], [0.0]
    tension = scene.model.elastic.value
    for x, weight in grid(ends):
        u, energy = at(exact.u, x), np.zeros(x.shape[1])
        for axis in range(len(ends)):
            step = np.zeros((3, 1))
            step[axis] = STEP
            energy += ((at(exact.u, x + step) - at(exact.u, x - step)) / (2 * STEP)) ** 2 / 2
        energy *= at(tension, x)
        for effect in scene.model.effects:
            if isinstance(effect, Load):
                energy -= at(effect.value, x) * u
        for name, values in (("volume", u), ("square", u**2), ("energy", energy)):
            sums[name] += float(np.sum(np.broadcast_to(values, u.shape) * weight))
        tops.append((u.max(), u.min()))
        if exact.pressure is not None:
            peaks.append(float(np.abs(at(exact.pressure, x)).max()))
    corner = np.zeros((3, 2 ** len(ends)))
    for axis, (low, high) in enumerate(ends):
        corner[axis] = [low if number >> axis & 1 else high for number in range(corner.shape[1])]
    tops.append((at(exact.u, corner).max(), at(exact.u, corner).min()))
    place = np.zeros((3, 1))
    place[: len(ends), 0] = point(scene)
    known = {"energy": sums["energy"], "report.volume": sums["volume"], "report.square": sums["square"],
             "report.point": float(at(exact.u, place)[0]), "report.top": max(top for top, _ in tops),
             "report.bottom": min(bottom for _, bottom in tops)}  # fmt: skip
    bounded = exact.pressure is not None and scene.name != "cone"
    known["report.peak"] = max(peaks) if bounded else np.inf
    contact = exact_contact(scene.model, exact, meshes.build(scene, MPI.COMM_WORLD, 0))
    if scene.name not in NO_AREA:
        known["contact.area"] = contact["area"]
    one_side = (scene.model.lower is None) != (scene.model.upper is None)
    if one_side and "force" in contact and scene.name != "cone":
        known[f"contact.{'lower' if scene.model.upper is None else 'upper'}.force"] = contact["force"]
    return known


def grid(ends: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points of quadrature over a fine grid and their weights, part by part."""
    points, weights = rule(1, 5)
    places = points[:, 1]
    axes, sizes = [], []
    for low, high in ends:
        edges = np.linspace(low, high, FINE[len(ends)] + 1)
        axes.append((edges[:-1, None] + np.diff(edges)[:, None] * places).ravel())
        sizes.append((np.diff(edges)[:, None] * weights).ravel())
    if len(ends) == 1:
        yield np.vstack([axes[0], np.zeros((2, len(axes[0])))]), sizes[0]
        return
    for part in np.array_split(np.arange(len(axes[1])), 30):
        x, y = np.meshgrid(axes[0], axes[1][part])
        yield np.vstack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.outer(sizes[1][part], sizes[0]).ravel()


def compared(scene: Scene, true: Mapping[str, float]) -> list[tuple[str, float, float | None, str]]:
    """Quantity, true error, stated error and verdict."""
    with closing(SolverContext(scene)) as context:
        record = with_uncertainties(context.answer(errors=False), context.problem.data).record
    found, rows = record["uncertainty"], []
    if "energy" not in found:
        raise SystemExit(f"{scene.name}: {found['reason']}")
    for key, truth in true.items():
        one: Any = found
        for part in key.split("."):
            one = one[part]
        unknown = TRUTH * abs(truth) if key.startswith("contact") else 0.0
        error = max(abs(one["values"][-1] - truth) - unknown, 0.0)
        rows.append((key.rpartition(".")[2], error, one["error"], one["verdict"]))
    return rows


def line(quantity: str, rows: list[Any]) -> str:
    """A line of the table; errors of round-off count as held."""
    stated = [(error, said) for *_, error, said, _ in rows if said is not None]
    held = [error <= TIMES * said or error <= 1e-9 for error, said in stated]
    ratios = [said / error for error, said in stated if 0 < error < np.inf]
    shares = [sum(row[-1] == verdict for row in rows) / len(rows) for verdict in ("not settled", "unbounded")]
    median = np.median(ratios or [np.nan])
    return f"{quantity:10} {len(rows):6} {np.mean(held):6.1%} {median:12.2f} {shares[0]:12.1%} {shares[1]:10.1%}"


if __name__ == "__main__":
    main()
