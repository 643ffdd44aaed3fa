"""What a tolerance for one quantity brings: true and estimated error, and unknowns beside those of --tol in energy.

    .venv/bin/python benchmarks/goals.py --tol 3e-2,1e-2,3e-3 --energy 3e-2 --json goals.jsonl

True values are closed forms, evaluated here by SciPy. Errors are relative to the computed value. `estimate/true` is the
estimated over the true error; `fine` counts the unknowns of the finer mesh that the estimate takes. Runs under
mpirun as it stands.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ladder import show
from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

from fenicsx_obstacle import ObstacleError, Scene, solve
from fenicsx_obstacle.cli_options import values_of
from fenicsx_obstacle.scenes import catalogue

A_DISK = 0.5777150035509267  # contact radius of `disk_flat`
A_BALL = 0.6979651482233736  # of `ball`
CORNER = "r^(2/3)*sin(2/3*where(theta < 0, theta + 2*pi, theta))"
# of the torsion of a square bar (Timoshenko and Goodier)
SERIES = sum(math.tanh(k * math.pi / 2) / k**5 for k in range(1, 2001, 2))
HEADS = (f"{'scene':>15} {'quantity':>10} {'tol':>6} {'meshes':>6} {'unknowns':>8} {'fine':>7} {'energy':>9} "
         f"{'true':>8} {'estimate':>8} {'est/true':>8}  words")  # fmt: skip
Case = tuple[Scene, str, Callable[[], float]]


def bearing() -> Scene:
    """A bearing of infinite length: one dimension, cavitation where u would be negative."""
    return Scene(
        mesh={"shape": "interval", "x": [0, "2*pi"], "cells": 16}, define={"ecc": 0.6}, tension="(1 + ecc*cos(x))^3",
        load="6*ecc*sin(x)", lower=0, boundary=[{"value": 0}],
        report={"Wr": "-integral(u*cos(x))", "Wt": "integral(u*sin(x))", "sommerfeld": "pi/sqrt(Wr^2 + Wt^2)"},
    )  # fmt: skip


def true_bearing() -> float:
    """(H^3 u')' = -6 ecc sin x, u = 0 at x = 0, u = u' = 0 where the film ends."""
    ecc = 0.6

    def slope(x: float, end: float) -> float:
        return 6 * ecc * (math.cos(x) - math.cos(end)) / (1 + ecc * math.cos(x)) ** 3

    end = brentq(lambda b: quad(slope, 0, b, args=(b,), epsabs=1e-12)[0], math.pi + 0.1, 2 * math.pi - 0.1, xtol=1e-13)
    # by parts, u = 0 at both ends
    wr = quad(lambda x: slope(x, end) * math.sin(x), 0, end, epsabs=1e-12)[0]
    wt = quad(lambda x: slope(x, end) * math.cos(x), 0, end, epsabs=1e-12)[0]
    return math.pi / math.hypot(wr, wt)


def put() -> Scene:
    """The first implicit step, a quarter of a year, of an American put, K = 100, in x = ln(S/K)."""
    return Scene(
        mesh={"shape": "interval", "x": [-2, 2], "cells": 128},
        define={"K": 100, "interest": 0.05, "sigma": 0.2, "dt": 0.25, "payoff": "max(K - K*exp(x), 0)"},
        tension="sigma^2/2", load="payoff/dt", lower="payoff", boundary=[{"value": "payoff"}],
        drift=["sigma^2/2 - interest"], foundation="interest + 1/dt", report={"price": "at(u, 0)"},
    )  # fmt: skip


def true_put() -> float:
    """Exponentials on both sides of x = 0, where u and u' are continuous, and where exercise begins."""
    K, interest, sigma, dt = 100.0, 0.05, 0.2, 0.25
    k = np.roots([-(sigma**2) / 2, sigma**2 / 2 - interest, interest + 1 / dt])
    flat = K / (1 + interest * dt)  # for x < 0: flat - K e^x + sum of a_i e^(k_i x)

    def beyond(b: float) -> np.ndarray:
        """a_1, a_2 with u and u' continuous at b."""
        return np.linalg.solve([np.exp(k * b), k * np.exp(k * b)], [K - flat, 0.0])

    def above(b: float) -> tuple[np.ndarray, float]:
        """The coefficients for x > 0, and u at x = 2."""
        a = beyond(b)
        c = np.linalg.solve([np.ones(2), k], [a.sum() + flat - K, (a * k).sum() - K])
        return c, float(c @ np.exp(2 * k))

    b = brentq(lambda b: above(b)[1], -1.0, -1e-3, xtol=1e-14)
    return float(above(b)[0].sum())


def cases() -> dict[str, Case]:
    """Scenes with a quantity and its true value, on coarse meshes."""
    disk = catalogue.scene("disk_flat").change({"mesh.cells": 8})
    flow = disk.change({"report": {"outflow": "integral(normal_flux, 'left')", "volume": "integral(u)",
                                   "strain": "integral(slope^2)"}})  # fmt: skip
    A = A_BALL**2 / math.sqrt(1 - A_BALL**2)
    round_bar = Scene(mesh={"shape": "disk", "cells": 8}, tension=1, load=5, upper="1 - r",
                      boundary=[{"value": 0}], report={"torque": "2*integral(u)"})  # fmt: skip
    square_bar = Scene(mesh={"shape": "rectangle", "cells": 4}, tension=1, load=2, upper=10,
                       report={"torque": "2*integral(u)"})  # fmt: skip
    corner = Scene(mesh={"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 8}, tension=1, lower=-1,
                   boundary=[{"value": CORNER}], report={"volume": "integral(u)"})  # fmt: skip
    string = Scene.read(Path(__file__).parents[1] / "demos" / "string.toml").change({"mesh.cells": 8})
    nsv = catalogue.scene("nsv").change({"mesh.cells": 8, "report": {"volume": "integral(u)"}})
    return {
        "disk_flat": (disk, "force", lambda: 4 * math.pi * A_DISK**2),
        "ball": (catalogue.scene("ball").change({"mesh.cells": 8}), "force", lambda: 2 * math.pi * A),
        "flow": (flow, "outflow", lambda: math.pi * A_DISK**2 - 2),
        "strain": (flow, "strain", true_strain),
        "round_bar": (round_bar, "torque", lambda: 2 * (2 * math.pi) * (
            quad(lambda r: r * (0.6 + 1.25 * (0.16 - r**2)), 0, 0.4)[0] + quad(lambda r: r * (1 - r), 0.4, 1)[0])),
        "square_bar": (square_bar, "torque", lambda: 2 * 2 * (1 / 12 - 16 / math.pi**5 * SERIES)),
        "square_bar J": (square_bar, "energy", lambda: -2 * (1 / 12 - 16 / math.pi**5 * SERIES)),
        "string J": (string, "energy", true_string),
        "bearing": (bearing(), "sommerfeld", true_bearing),
        "put": (put(), "price", true_put),
        "corner": (corner, "volume", true_corner),
        "nsv": (nsv, "volume", true_nsv),
    }  # fmt: skip


def true_strain() -> float:
    """int |grad u|^2 over the square |x|, |y| <= sqrt(1/2), u of `disk_flat`."""
    half, a = math.sqrt(0.5), A_DISK

    def inner(angle: float) -> float:
        end = half / math.cos(angle)
        return quad(lambda r: r * (-2 * r + 2 * a**2 / r) ** 2, a, end, epsabs=1e-13)[0]

    return 8 * quad(inner, 0, math.pi / 4, epsabs=1e-12)[0]


def true_nsv() -> float:
    """int (r^2 - a^2)^2 over the part r > a of [-1, 1]^2, a = 0.7."""

    def inner(angle: float) -> float:
        return quad(lambda r: r * (r**2 - 0.49) ** 2, 0.7, 1 / math.cos(angle), epsabs=1e-13)[0]

    return 8 * quad(inner, 0, math.pi / 4, epsabs=1e-12)[0]


def true_string() -> float:
    """A string under a ceiling: u = f a d - f d^2/2 for d < a, f = 8, c = 0.3."""
    f, c = 8.0, 0.3
    a = math.sqrt(2 * c / f)
    free = quad(lambda d: (f * (a - d)) ** 2 / 2 - f * (f * a * d - f * d**2 / 2), 0, a)[0]
    return 2 * free - f * c * (1 - 2 * a)


def true_corner() -> float:
    """int r^(2/3) sin(2 theta/3) over [-1, 1]^2 without the quarter theta > 3 pi/2."""

    def along(angle: float) -> float:
        end = 1 / max(abs(math.cos(angle)), abs(math.sin(angle)))
        return end ** (8 / 3) / (8 / 3) * math.sin(2 * angle / 3)

    kinks = [math.pi / 4, 3 * math.pi / 4, 5 * math.pi / 4]
    return quad(along, 0, 3 * math.pi / 2, points=kinks, epsabs=1e-13)[0]


def main() -> None:
    """Solve each scene to each tolerance (collective)."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(cases()))
    parser.add_argument("--tol", default="3e-2,1e-2,3e-3")
    parser.add_argument("--energy", default="", help="tolerances that are also reached in energy, for comparison")
    parser.add_argument("--budget", default="60s")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    show(HEADS)
    ratios = []
    for name in options.scenes.split(","):
        scene, quantity, truth = cases()[name]
        exact = truth()
        for tol in values_of(options.tol, "tol"):
            unknowns = "-"
            try:
                record = dict(solve(scene, tol=tol, goal=quantity, budget=options.budget).record)
                if options.energy and tol in values_of(options.energy, "energy"):
                    other = solve(scene, tol=tol, budget=options.budget)
                    unknowns = f"{'' if other.adaptive.reached else '> '}{other.dofs}"
            except ObstacleError as error:
                show(f"{name:>15} {quantity:>10} {tol:6g} {error}")
                continue
            goal, size = record["goal"], abs(record["goal"]["value"])
            true, path = abs(goal["value"] - exact), record["adaptive"]["path"]
            ratios.append((goal["error"] / true, true / size <= tol))
            errors = f"{true / size:8.2e} {goal['error'] / size:8.2e} {goal['error'] / true:8.2f}"
            end = "" if record["adaptive"]["reached"] else "; the tolerance is not reached"
            show(f"{name:>15} {quantity:>10} {tol:6g} {len(path):6} {record['dofs']:8} {goal['dofs']:7} {unknowns:>9} "
                 f"{errors}  {goal['words']}{end}")  # fmt: skip
            if options.json is not None and MPI.COMM_WORLD.rank == 0:
                with options.json.open("a") as file:
                    file.write(json.dumps({**record, "exact_goal": exact}) + "\n")
    near, below = (sum(chosen) for chosen in ([0.5 <= r <= 2 for r, _ in ratios], [ok for _, ok in ratios]))
    show(f"{len(ratios)} runs: {near} estimates within a factor 2, {below} errors below the tolerance")


if __name__ == "__main__":
    main()
