"""The pictures of the pages. `./obstacle docs` draws all but three, which are kept in docs/gallery:

    ./obstacle hard
    ./obstacle cost ball
    .venv/bin/python benchmarks/pictures.py ball digit hard

Verdicts, times and counts are read from files that other commands have written: `cost` (digit), `benchmarks/ladder.py`
(steps) and `hard` (hard).
"""

from __future__ import annotations

import argparse
import io
import json
import re
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from mosaic import mosaic
from PIL import Image

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show.figures import BLUE, COLOURS, INK, MARKERS, VERMILION, figure
from fenicsx_obstacle.show.free_boundary import Patch, free_boundary, patch_of
from fenicsx_obstacle.show.maps import OUT_OF_CONTACT, draw_domain, draw_lines, triangles
from fenicsx_obstacle.show.newton import animate_newton
from fenicsx_obstacle.show.tables import duration
from fenicsx_obstacle.studies.price import cheapest, relative, solved

ROOT = Path(__file__).parent.parent
GALLERY, DEMOS = ROOT / "docs" / "gallery", ROOT / "demos"
PLASTIC = "#E69F00"
DIGITS = (1, 1.5, 2, 2.5, 3)
CELLS, EPS = (8, 11, 16, 23, 32, 45, 64, 91, 128), np.logspace(0, -7, 15)  # of the map
WIDTH, LARGEST = 1500, 300_000  # pixels, bytes


def main() -> None:
    """Draw those that are named."""
    drawn = {
        "ball": ball, "tarpaulin": tarpaulin, "newton": newton, "digit": digit, "steps": steps, "map": over,
        "known": known, "hard": hard,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*drawn, []], metavar="NAME", default=[])
    parser.add_argument("--cost", type=Path, default=Path("out/ball/cost/rows.jsonl"))
    parser.add_argument("--ladder", type=Path, default=Path("out/ladder.jsonl"))
    parser.add_argument("--hard", type=Path, default=Path("out/hard/hard.jsonl"))
    parser.add_argument("--folder", type=Path, default=GALLERY)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.names or drawn:
        print(drawn[name](options))


def ball(options: Any) -> str:
    """The usual picture of an answer."""
    picture = solve(Scene.read(DEMOS / "ball.toml"), cells=128).plot()
    return kept(options, "ball", picture.page)


def tarpaulin(options: Any) -> str:
    """The first scene of docs/start.md."""
    text = (ROOT / "docs" / "start.md").read_text()
    scene = next(block for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL) if "tarpaulin" in block)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mine.toml"
        file.write_text(scene)
        return kept(options, "tarpaulin", solve(Scene.read(file)).plot().page)


def newton(options: Any) -> str:
    """Animation of the active sets of (3.4)* and of Newton's method with nested iteration."""
    answer = solve(Scene.read(DEMOS / "ball.toml"), cells=128, eps=1e-6)
    return animate_newton(answer, options.folder / "newton.gif")


def steps(options: Any) -> str:
    """Newton and CG steps over the number of cells, from a cold start and with nested iteration."""
    rows = lines_of(options.ladder)
    ways = {
        "vi-amg-cold": ("SNES VI and BoomerAMG, cold start", VERMILION),
        "vi": ("SNES VI, nested iteration", "#E69F00"),
        "eps=1e-12": ("penalty, eps = 1e-12", "#56B4E9"),
        "eps=h^2": ("penalty, eps = h$^2$", BLUE),
    }
    titles = {"newton_iterations": "Newton steps", "krylov_iterations": "linear (CG) steps in all of them"}
    page, panels = figure(10.0, 4.4, columns=2)
    for axes, (key, title) in zip(panels, titles.items(), strict=True):
        for number, (way, (label, colour)) in enumerate(ways.items()):
            part = {row["cells"]: row[key] for row in rows if row["way"] == way}
            cells = sorted(part)
            look = {"color": colour, "marker": MARKERS[number], "markersize": 9 - 1.5 * number, "label": label}
            axes.plot(cells, [part[n] for n in cells], linewidth=2, **look)
            if number in (0, len(ways) - 1):
                axes.annotate(f"{part[cells[-1]]}", (cells[-1], part[cells[-1]]), textcoords="offset points",
                              xytext=(-4, 7), ha="right", color=colour, fontsize=11, weight="bold")  # fmt: skip
        axes.set_xscale("log", base=2)
        axes.set(xlabel="N, cells a side", title=f"{title}, on the finest mesh")
        axes.set_xticks(cells, [str(n) for n in cells])
        axes.set_ylim(bottom=0, top=1.12 * max(row[key] for row in rows))
        axes.minorticks_off()
        axes.grid(True, color="0.9")
    panels[0].legend(fontsize=9, loc="upper left")
    page.suptitle("Membrane over a ball: steps from a cold start and with nested iteration", fontsize=12)
    return kept(options, "steps", page)


def digit(options: Any) -> str:
    """Error against time, and the time of the fastest method for each digit."""
    rows = lines_of(options.cost)
    page, (left, right) = figure(11.0, 4.6, columns=2, width_ratios=(1.25, 1))
    names = ("P1 VI cold", "P1 eps = h", "P1 auto", "P2 auto", "P1 adaptive", "P2 adaptive")
    tints = ("0.55", COLOURS[1], COLOURS[0], "#56B4E9", COLOURS[2], "#E69F00")
    for name, tint, marker in zip(names, tints, "os^Dv*", strict=True):
        part = [row for row in solved(rows) if row["choice"] == name]
        left.loglog([row["seconds"] for row in part], [relative(row, "energy") for row in part], label=name,
                    color=tint, marker=marker, linewidth=1.8, markersize=6)  # fmt: skip
    left.set(xlabel="seconds, mesh and estimates included", ylabel="relative error, energy norm")
    left.grid(True, color="0.9")
    left.legend(fontsize=9, loc="lower left")
    for k in DIGITS:
        way = next(iter(cheapest(rows, "energy", 10.0**-k)), None)
        if way is not None and way[0].measured(10.0**-k):
            right.bar(k, way[1], width=0.36, color=BLUE)
            right.annotate(f"{duration(way[1])}\n{way[0].name}", (k, way[1]), textcoords="offset points",
                           xytext=(0, 3), ha="center", fontsize=8.5)  # fmt: skip
    right.set(xlabel="digits of accuracy, energy norm", ylabel="seconds of the fastest method")
    right.set_xticks(DIGITS, [f"{k:g}" for k in DIGITS])
    right.margins(y=0.15)
    page.suptitle("Membrane over a ball: cost of accuracy", fontsize=12)
    return kept(options, "digit", page)


def over(options: Any) -> str:
    """The error over h and eps, with the paper's rule and the default."""
    from matplotlib.colors import LogNorm

    found = {norm: np.empty((len(EPS), len(CELLS))) for norm in ("energy", "l2")}
    sides = []
    for column, cells in enumerate(CELLS):
        scene = Scene.read(DEMOS / "ball.toml").change({"mesh.cells": cells})
        with closing(SolverContext(scene)) as context:
            sides.append(context.problem.level.h)
            for line, eps in enumerate(EPS):
                errors = context.answer(scene.options_with(eps=float(eps))).record["errors"]
                for norm, values in found.items():
                    values[line, column] = errors[norm]
    h = np.array(sides)
    page, panels = figure(11.0, 4.8, columns=2)
    for axes, (norm, title) in zip(panels, {"energy": "energy norm", "l2": "L2 norm"}.items(), strict=True):
        values = found[norm]
        levels = np.geomspace(values.min() * 0.999, values.max() * 1.001, 22)
        drawn = axes.contourf(h, EPS, values, levels=levels, norm=LogNorm(), cmap="viridis_r")
        axes.contour(h, EPS, values, levels=levels, colors="white", linewidths=0.4)
        axes.plot(h, h**2, "-", color="black", linewidth=2, label="the paper's eps = h$^2$")
        axes.plot(h, h**2 / 100, "--", color="black", linewidth=2, label="auto")
        axes.legend(loc="lower right", fontsize=10, framealpha=1)
        axes.set(xscale="log", yscale="log", xlabel="h", ylabel="eps", title=f"error, {title}", ylim=(EPS[-1], EPS[0]))
        axes.set_xticks(h[::2], [f"1/{1 / one:.0f}" for one in h[::2]])
        axes.minorticks_off()
        ticks = 10.0 ** np.arange(np.ceil(np.log10(values.min())), np.floor(np.log10(values.max())) + 1)
        page.colorbar(drawn, ax=axes, ticks=ticks).ax.set_yticklabels([f"{tick:g}" for tick in ticks])
    page.suptitle("Membrane over a ball: error of mesh and penalty", fontsize=12)
    return kept(options, "map", page)


def known(options: Any) -> str:
    """Three applications with known values."""
    page, panels = figure(13.5, 4.7, columns=3)
    for axes, draw in zip(panels, (bearing, torsion, put), strict=True):
        draw(axes)
        axes.set_box_aspect(1)
    return kept(options, "known", page)


def bearing(axes: Any) -> None:
    """The unrolled film: its pressure, and the edge where it cavitates."""
    answer = solve(Scene.read(DEMOS / "bearing.toml"), refine=1)
    patch = patch_of(gather(answer.fields))
    film = unrolled(patch)
    levels = np.linspace(film.fields["u"].min(), film.fields["u"].max(), 15)
    shape = triangles(film.points, film.cells)
    drawn = axes.tricontourf(shape, film.fields["u"], levels=levels, cmap="viridis")
    axes.tricontourf(shape, film.fields["level lower"], levels=[-np.inf, 0], colors=["0.85"])
    draw_lines(axes, [unrolled(line) for line in free_boundary(patch)])
    axes.annotate("cavitation", (282, 0), ha="center", va="center", fontsize=10)
    axes.set(xlim=(0, 360), ylim=(-1, 1), xlabel="angle from the groove, degrees", ylabel="z / R")
    axes.set_xticks(range(0, 361, 90))
    bar = axes.figure.colorbar(drawn, ax=axes, label="film pressure, dimensionless", shrink=0.75)
    bar.set_ticks(np.arange(0, 3.1, 0.5))
    axes.set_title(f"Journal bearing\nSommerfeld number {answer.report['sommerfeld']:.4f}\n"
                   "Raimondi and Boyd 1958: 0.121", fontsize=11)  # fmt: skip


def unrolled(patch: Patch) -> Patch:
    """A part of a cylinder about z over its angle in degrees; cells across the seam lie beyond 360."""
    angle = np.degrees(np.arctan2(patch.points[:, 1], patch.points[:, 0])) % 360
    flat = np.column_stack([angle, patch.points[:, 2], np.zeros(len(angle))])
    across = np.ptp(angle[patch.cells], axis=1, keepdims=True) > 180
    cells = np.where(across & (angle[patch.cells] < 180), patch.cells + len(angle), patch.cells)
    fields = {name: np.concatenate([values, values]) for name, values in patch.fields.items()}
    return Patch(np.concatenate([flat, flat + np.array([360, 0, 0])]), cells, fields)


def torsion(axes: Any) -> None:
    """Where the bar has yielded, and lines of shear stress."""
    answer = solve(Scene.read(DEMOS / "torsion.toml"))
    patch = patch_of(gather(answer.fields))
    patch.points[:] *= 1000  # mm
    from matplotlib.patches import Patch as Swatch

    draw_domain(axes, patch)
    shape = triangles(patch.points, patch.cells)
    axes.tricontourf(shape, patch.fields["level upper"], levels=[-np.inf, 0], colors=[PLASTIC], zorder=1)
    axes.tricontour(shape, patch.fields["u"], levels=12, colors="0.35", linewidths=0.7, zorder=2)
    draw_lines(axes, free_boundary(patch))
    size = patch.points.max()
    axes.set(aspect="equal", xlim=(0, size), ylim=(0, size), xlabel="x, mm", ylabel="y, mm")
    swatches = {"plastic": PLASTIC, "elastic": OUT_OF_CONTACT}
    handles = [Swatch(facecolor=colour, edgecolor="0.4", label=label) for label, colour in swatches.items()]
    axes.legend(handles=handles, loc="center", fontsize=9, framealpha=1)
    axes.set_title(f"Twisted steel bar, 20 mm\ntorque {answer.report['torque']:.1f} N m\nfinite volumes: 467.1 N m",
                   fontsize=11)  # fmt: skip


def put(axes: Any) -> None:
    """The value of the option a year before it expires."""
    answer = solve(Scene.read(DEMOS / "put.toml"))
    arrays = gather(answer.fields)
    order = np.argsort(arrays["points"][:, 0])
    price, value, payoff = (
        values[order] for values in (100 * np.exp(arrays["points"][:, 0]), arrays["u"], arrays["lower"])
    )
    edge, found = answer.report["exercise"], answer.report["price"]
    assert edge is not None
    axes.fill_between(price, payoff, 0, color="0.88", hatch="////", edgecolor="0.7", linewidth=0, label="payoff")
    axes.plot(price, value, color=BLUE, linewidth=2, label="value, a year before expiry")
    axes.axvline(edge, color=INK, linestyle="--", linewidth=1, label=f"exercised below {edge:.1f}")
    axes.plot([100], [found], "o", color=VERMILION, label=f"at the strike: {found:.4f}")
    axes.set(xlim=(60, 140), ylim=(0, 40), xlabel="price of the share", ylabel="value of the option")
    axes.legend(fontsize=8.5)
    axes.set_title(f"American put\nprice {found:.4f}\nbinomial tree, 4000 steps: 6.0902", fontsize=11)


def hard(options: Any) -> str:
    """All hard scenes in the plane with their verdicts."""
    return kept(options, "hard", mosaic(lines_of(options.hard)))


def lines_of(file: Path) -> Sequence[dict[str, Any]]:
    """Records of a file of JSON lines."""
    return [json.loads(line) for line in file.read_text().splitlines()]


def kept(options: Any, name: str, page: Any) -> str:
    """Write a figure, with fewer colours where it would be large."""
    data, path = io.BytesIO(), options.folder / f"{name}.png"
    page.savefig(data, format="png", dpi=WIDTH / page.get_figwidth())
    picture = Image.open(data).convert("RGB")
    picture.save(path, optimize=True)
    if path.stat().st_size > LARGEST:
        picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    return f"{path}: {path.stat().st_size / 1000:.0f} kB"


if __name__ == "__main__":
    main()
