"""Scenes: shapes, elements, methods, effects, data, bounds, time and bodies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cases import ALL, DEMOS, ONE, Values, add, digest

from fenicsx_obstacle import Scene, solve

SQUARE = {"shape": "rectangle", "cells": 8}
STRING = {"shape": "interval", "cells": 24}
BOX = {"shape": "box", "cells": 4}
QUADS = {**SQUARE, "cell": "quadrilateral"}
HEXES = {**BOX, "cell": "hexahedron"}
DISK = {"shape": "disk", "cells": 8}
L_SHAPE = {"shape": "l-shape", "cells": 8}
FIXED = [{"value": 0}]
BOTH = {"lower": "-0.05 - 0.03*x", "upper": "0.04 + 0.02*x"}
WAVE = "40*sin(2*pi*x)"
REPORT = {"force": "integral(p)", "area": "integral(contact)", "volume": "integral(u)", "steep": "max(slope)"}


def scene(name: str, *, ranks: tuple[int, ...] = ALL, how: dict[str, Any] | None = None, **given: Any) -> None:
    """A case that solves a scene; `how` are arguments of `solve`, the others those of `Scene`."""
    data = {"mesh": SQUARE, "tension": 1, "load": -4, "lower": "-0.08 - 0.05*x + 0.03*y", **given}
    data = {key: value for key, value in data.items() if value is not None}

    def run(folder: Path) -> Values:
        return digest(solve(Scene(**data), **(how or {})))

    add(name, run, ranks)


def file(name: str, path: str, changes: dict[str, Any], *, ranks: tuple[int, ...] = ALL, **how: Any) -> None:
    """A case that solves a scene of demos/ or of the catalogue with other values."""

    def run(folder: Path) -> Values:
        place = DEMOS / path if path.endswith(".toml") else path
        if isinstance(place, Path):
            return digest(solve(Scene.read(place, changes), **how))
        return digest(solve(place, **changes, **how))

    add(name, run, ranks)


METHODS = ("penalty", "successive", "vi")


def meshes() -> None:
    for diagonal in ("right", "left", "crossed", "union-jack"):
        scene(f"shape/rectangle-{diagonal}", mesh={**SQUARE, "diagonal": diagonal}, report=REPORT)
    scene("shape/rectangle-perturbed", mesh={**SQUARE, "perturb": 0.2})
    scene("shape/rectangle-long", mesh={**SQUARE, "x": [-1, 2], "y": [0, 0.5], "cells": 18})
    scene("shape/rectangle-refined", mesh={**SQUARE, "cells": 4, "refine": 2})
    scene("shape/rectangle-prime", mesh={**SQUARE, "cells": 7})
    scene("shape/rectangle-large", mesh={**SQUARE, "cells": 48})
    scene("shape/quadrilaterals", mesh=QUADS, report=REPORT)
    scene("shape/quadrilaterals-perturbed", mesh={**QUADS, "perturb": 0.2})
    scene("shape/interval", mesh=STRING, lower="-0.08 - 0.05*x", report=REPORT)
    scene("shape/interval-prime", mesh={**STRING, "cells": 31, "x": [-1, 1]}, lower=-0.2)
    scene("shape/disk", mesh=DISK, lower=-0.2, report=REPORT)
    scene("shape/disk-refined", mesh={**DISK, "cells": 4, "refine": 2, "radius": 2}, lower="-0.3 - x^2/9")
    scene("shape/l-shape", mesh=L_SHAPE, report=REPORT)
    scene("shape/l-shape-refined", mesh={**L_SHAPE, "cells": 4, "refine": 1})
    scene("shape/box", mesh=BOX, load=-10, lower="-0.08 - 0.05*x + 0.03*y*z", report=REPORT)
    scene("shape/box-refined", mesh={**BOX, "cells": 2, "refine": 1}, load=-10, lower=-0.1)
    scene("shape/hexahedra", mesh=HEXES, load=-10, lower="-0.08 - 0.05*x + 0.03*y*z", report=REPORT)
    for name, demo in (("geo", "i_section"), ("geo-surface", "dam")):
        file(f"shape/{name}", f"{demo}.toml", {}, ranks=ALL)


PAIRS = {
    "P1-interval": (STRING, "P1"), "P1-triangle": (SQUARE, "P1"), "P1-tetrahedron": (BOX, "P1"),
    "P2-triangle": (SQUARE, "P2"), "Q1-quadrilateral": (QUADS, "Q1"), "Q1-hexahedron": (HEXES, "Q1"),
    "Q2-interval": (STRING, "Q2"), "Q2-quadrilateral": (QUADS, "Q2"), "Q2-hexahedron": (HEXES, "Q2"),
    "voronoi-triangle": (SQUARE, "P1-voronoi"), "voronoi-tetrahedron": (BOX, "P1-voronoi"),
    "gauss-quadrilateral": (QUADS, "Q1-gauss"),
}  # fmt: skip


def elements() -> None:
    for name, (mesh, pair) in PAIRS.items():
        solid = mesh["shape"] == "box"
        for method in METHODS:
            how = {"element": pair, "method": method}
            scene(f"pair/{name}-{method}", mesh=mesh, how=how, load=-10 if solid else -4, report=REPORT,
                  lower="-0.08 - 0.02*x")  # fmt: skip
            scene(f"pair/{name}-{method}-both", mesh=mesh, how=how, load=WAVE, **BOTH, ranks=ONE)
        scene(f"pair/{name}-upper", mesh=mesh, how={"element": pair, "eps": 1e-6}, load=9, lower=None, upper=0.06)


def parameters() -> None:
    for eps in (1e-2, 1e-5, 1e-8, 1e-11, "h^2/50", "h^3"):
        scene(f"eps/{eps}", how={"eps": eps}, ranks=ALL if eps == 1e-8 else ONE)
        scene(f"eps/{eps}-both", how={"eps": eps}, load=WAVE, **BOTH, ranks=ONE)
    for method in METHODS:
        scene(f"start/cold-{method}", how={"start": "cold", "method": method}, mesh={**SQUARE, "cells": 24})
        scene(f"start/nested-{method}", how={"start": "nested", "method": method}, mesh={**SQUARE, "cells": 24})
    scene("start/refine", how={"refine": 1, "cells": 12})
    scene("method/no-obstacle", lower=None)
    scene("method/no-contact", lower=-9)
    scene("method/full-contact", lower=0, load=-9)
    scene("method/floating", boundary=[], load=-1, lower="x^2 + y^2/2")
    scene("method/floating-vi", boundary=[], load=-1, lower="x^2 + y^2/2", how={"method": "vi"})
    scene("method/narrow", load=WAVE, lower=-1e-3, upper=1e-3)
    scene("method/tiny-units", tension=1e-9, load=-4e-9, lower=-0.08)
    scene("method/large-units", tension=1e11, load=-4e9, lower=-0.0008)
    for name in ("ball", "biactive", "biactive_power", "cone", "disk_flat", "disk_mu_jump", "halfplane", "nsv",
                 "ring_wedge", "smooth_square", "torsion_disk", "two_obstacle_square"):  # fmt: skip
        file(f"catalogue/{name}", name, {"cells": 16})
        file(f"catalogue/{name}-vi", name, {"cells": 16}, method="vi", ranks=ONE)
    for name in ("string_mu_jump", "string_parabola", "string_torsion", "string_two_obstacles", "string_wedge"):
        file(f"catalogue/{name}", name, {})
        file(f"catalogue/{name}-vi", name, {"cells": 40}, method="vi", ranks=ONE)


def effects() -> None:
    spring = [{"on": "left", "value": 0}, {"on": "right", "spring": 3}, {"on": "top", "flux": "0.2*x"}]
    thin = [{"on": "left", "value": 0}, {"on": "right", "upper": "0.35*(1 - y)"}]
    matrix = [["2 + x", 0.5], [0.5, 1]]
    scene("effect/tension-formula", tension="1 + x*y")
    scene("effect/tension-jump", tension="where(x < 0.5, 1, 20)")
    scene("effect/tension-strong-jump", tension="where(x < 0.5, 1, 1e6)", load=-9)
    scene("effect/tension-matrix", tension=matrix)
    scene("effect/tension-matrix-vi", tension=matrix, how={"method": "vi"})
    scene("effect/tension-matrix-p2", tension=[[2, 0.5], [0.5, 1]], how={"element": "P2"})
    scene("effect/load-formula", load="-9*x^2")
    scene("effect/large-slope", tension=None, large_slope=1, load=-1.5)
    scene("effect/large-slope-vi", tension=None, large_slope=1, load=-1.5, how={"method": "vi"})
    scene("effect/large-slope-q1", tension=None, large_slope=1, load=-1.5, mesh=QUADS)
    for exponent in (1.5, 3):
        law = {"exponent": exponent, "coefficient": 1, "regularisation": 1e-4}
        scene(f"effect/power-law-{exponent}", tension=None, power_law=law, load=-2)
        scene(f"effect/power-law-{exponent}-string", tension=None, power_law=law, load=-2, mesh=STRING, lower=-0.1)
    scene("effect/foundation", foundation=20, load=-9)
    scene("effect/foundation-large", foundation="1e5*x", load=-9)
    scene("effect/foundation-p2", foundation=20, load=-9, how={"element": "P2"})
    soft = {"lower": -0.03, "stiffness": 50}
    scene("effect/soft-obstacle", soft_obstacle=soft)
    scene("effect/soft-obstacle-both", soft_obstacle={**soft, "upper": "0.02"}, load=WAVE, lower=-0.06, upper=0.05)
    scene("effect/drift", drift=["7 + 5*y", "-5*x"], load=-9)
    scene("effect/drift-vi", drift=["7 + 5*y", "-5*x"], load=-9, how={"method": "vi"})
    scene("effect/drift-upwind", drift=[50, 10], load=-20, lower=-0.05)
    scene("effect/drift-string", drift=[100], load=-20, lower=-0.05, mesh=STRING)
    scene("effect/drift-foundation", drift=[3, "x"], foundation=5)
    scene("effect/point-load", point_load=[{"at": [0.5, 0.5], "force": -1}, {"at": [0.31, 0.27], "force": 0.2}], load=0)
    scene("effect/point-load-string", point_load=[{"at": [0.4], "force": -2}], load=0, mesh=STRING, lower=-0.2)
    scene("effect/flux-spring", boundary=spring, report={"cords": "integral(3*u, 'right')",
          "wall": "integral(normal_flux, 'left')", "table": "integral(p)"})  # fmt: skip
    scene("effect/flux-spring-p2", boundary=spring, how={"element": "P2"})
    scene("effect/flux-spring-q2", boundary=spring, how={"element": "Q2"}, mesh=QUADS)
    scene("effect/spring-string", boundary=[{"on": "left", "spring": 3}, {"on": "right", "value": 0.1}], mesh=STRING,
          lower=-0.2)  # fmt: skip
    scene(
        "effect/spring-box", boundary=[{"on": "left", "spring": 3}, {"on": "front", "value": 0}], mesh=BOX, lower=-0.2
    )
    scene("effect/where", boundary=[{"where": "x < 1e-9", "value": 0}, {"where": "y > 0.999", "flux": 0.1}])
    scene("effect/boundary-formula", boundary=[{"value": "0.1*x*y"}])
    scene("effect/axial", axial_symmetry=True, boundary=[{"on": "right", "value": 0}], mesh=STRING, lower=-0.3)
    scene("effect/axial-plane", axial_symmetry=True, boundary=[{"on": "right", "value": 0}], lower=-0.2)
    scene("effect/axial-power-law", axial_symmetry=True, boundary=[{"on": "right", "value": 0}], mesh=STRING, load=3,
          tension=None, power_law={"exponent": 1.5}, lower=None, upper=0.3)  # fmt: skip
    scene("effect/thin", boundary=thin, load=1, lower=None, report={"through": "-integral(p, 'right')"})
    scene("effect/thin-vi", boundary=thin, load=1, lower=None, how={"method": "vi"})
    scene("effect/thin-q1", boundary=thin, load=1, lower=None, mesh=QUADS)
    scene("effect/thin-string", boundary=[{"on": "left", "value": 0}, {"on": "right", "lower": -0.3}], mesh=STRING,
          lower=None)  # fmt: skip
    scene(
        "effect/thin-box", boundary=[{"on": "left", "value": 0}, {"on": "right", "lower": -0.3}], mesh=BOX, lower=None
    )
    scene("effect/materials", boundary=[{"value": 0}], tension="where(hypot(x - 0.5, y - 0.5) < 0.3, 5, 1)")
    for demo, cells in (("awning", 16), ("cloth", 16), ("stamp", 16), ("tent", 16), ("wall", 16), ("pollutant", 16),
                        ("soap", 16), ("plate", 18), ("two_sided", 16), ("drum", 40), ("creep", 40), ("foam", 40),
                        ("torsion", 16), ("l_shape", 8), ("string", 40)):  # fmt: skip
        file(f"demo/{demo}", f"{demo}.toml", {"mesh.cells": cells})


def bounds() -> None:
    for name, mesh in (("string", STRING), ("square", SQUARE), ("box", BOX), ("disk", DISK), ("l", L_SHAPE)):
        scene(f"bound/{name}", mesh=mesh, how={"bound": True}, lower="-0.08 - 0.02*x^2")
        scene(f"bound/{name}-vi", mesh=mesh, how={"bound": True, "method": "vi"}, lower=-0.08, ranks=ONE)
    scene("bound/p2", how={"bound": True, "element": "P2"})
    scene("bound/p2-curved", how={"bound": True, "element": "P2"}, lower="-0.08 - 0.1*x^2*y", load="-4 - x")
    scene("bound/both", how={"bound": True}, load=WAVE, **BOTH)
    scene("bound/both-p2", how={"bound": True, "element": "P2"}, load=WAVE, **BOTH)
    scene("bound/kink", how={"bound": True}, lower="-0.04 - 0.3*abs(x - 0.43)")
    scene("bound/condition", how={"bound": True}, lower="where(x < 0.37, -0.05, -0.15)")
    scene("bound/no-obstacle", how={"bound": True}, lower=None)
    scene("bound/load-formula", how={"bound": True}, load="-4*exp(x)")
    scene("bound/tension-formula", how={"bound": True}, tension="1 + x^2")
    scene("bound/tension-matrix", how={"bound": True}, tension=[[2, 0.5], [0.5, 1]])
    scene("bound/foundation", how={"bound": True}, foundation=10)
    scene("bound/flux-spring", how={"bound": True}, boundary=[{"on": "left", "value": 0}, {"on": "right", "spring": 3},
          {"on": "top", "flux": "0.2*x"}])  # fmt: skip
    scene("bound/boundary-formula", how={"bound": True}, boundary=[{"value": "0.1*x^2 - 0.05*y"}])
    scene("bound/axial", how={"bound": True}, axial_symmetry=True, boundary=[{"on": "right", "value": 0}], mesh=STRING,
          lower=-0.3)  # fmt: skip
    scene("bound/thin", how={"bound": True}, lower=None, load=1,
          boundary=[{"on": "left", "value": 0}, {"on": "right", "upper": "0.35*(1 - y)"}])  # fmt: skip
    scene(
        "bound/point-load",
        how={"bound": True},
        point_load=[{"at": [0.4], "force": -2}],
        load=0,
        mesh=STRING,
        lower=-0.2,
    )
    scene("bound/large-slope", how={"bound": True}, tension=None, large_slope=1, load=-1.5)
    for name in ("ball", "disk_flat", "halfplane", "nsv", "two_obstacle_square", "string_parabola", "string_wedge"):
        file(f"bound/catalogue-{name}", name, {"cells": 16}, bound=True)
    scene("tol/square", how={"tol": 0.2})
    scene("tol/string", how={"tol": 0.05}, mesh=STRING, lower="-0.08 - 0.02*x^2")
    scene("tol/box", how={"tol": 0.6}, mesh={**BOX, "cells": 2}, load=-10, lower=-0.1)
    scene("tol/l-shape", how={"tol": 0.25}, mesh={**L_SHAPE, "cells": 4})
    scene("tol/p2", how={"tol": 0.05, "element": "P2"}, mesh={**SQUARE, "cells": 4})
    scene("tol/absolute", how={"tol_absolute": 0.08})
    scene("tol/budget", how={"tol": 0.001, "budget": "500 unknowns"})
    file("tol/ball", "ball", {"cells": 8}, tol=0.15)
    goal = {"force": "integral(p)", "middle": "at(u, 0.4, 0.4)", "mean": "integral(u)"}
    scene("goal/energy", how={"tol": 0.05, "goal": "energy"})
    scene("goal/force", how={"tol": 0.02, "goal": "force"}, report={"mean": "integral(u)"})
    scene("goal/mean", how={"tol": 0.01, "goal": "mean"}, report=goal)
    scene("goal/force-lower", how={"tol": 0.05, "goal": "force.lower"}, load=WAVE, **BOTH)
    scene("uncertainty/square", how={"uncertainty": True, "cells": 16}, report=goal)
    scene("uncertainty/string", how={"uncertainty": True, "cells": 32}, mesh=STRING, lower=-0.1)
    scene("uncertainty/refine", how={"uncertainty": True}, mesh={**SQUARE, "cells": 4, "refine": 2}, report=goal)
    scene("uncertainty/p2", how={"uncertainty": True, "element": "P2", "cells": 8}, report=goal)


def times() -> None:
    for demo, changes in {
        "put": {"mesh.cells": 60, "time.steps": 12}, "bounce": {"mesh.cells": 40, "time.steps": 60},
        "press": {"mesh.cells": 8, "mesh.refine": 0, "time.steps": 5},
    }.items():  # fmt: skip
        file(f"time/{demo}", f"{demo}.toml", changes)
        file(f"time/{demo}-vi", f"{demo}.toml", {**changes, "solve.method": "vi"}, ranks=ONE)
    file("time/put-euler", "put.toml", {"mesh.cells": 60, "time.steps": 12, "time.scheme": "euler"})
    file("time/put-tolerance", "put.toml", {"mesh.cells": 60, "time.steps": 12, "time.tolerance": 0.02})
    moving = {"end": 1, "steps": 4}
    scene("time/equilibria", time=moving, load="-4*t")
    scene("time/rate", time={**moving, "start": 0}, rate=1, load=-4)
    scene("time/rate-p2", time={**moving, "start": 0}, rate=1, load=-4, how={"element": "P2"})
    scene("time/rate-nonlinear", time={**moving, "start": 0}, rate=1, tension=None, large_slope=1, load=-1.5)
    scene("time/rate-drift", time={**moving, "start": 0, "scheme": "bdf2"}, rate=1, drift=[3, "x"], load=-4)
    scene(
        "time/inertia", time={"end": 1, "steps": 8, "start": 0, "velocity": "-sin(pi*x)*sin(pi*y)"}, inertia=1, load=0
    )
    scene("time/inertia-damped", time={"end": 1, "steps": 8, "start": 0}, inertia=1, rate=0.5, load=-4)
    scene("time/moving-obstacle", time=moving, lower="0.1*t - 0.1 - x", load=-4)
    scene("time/moving-boundary", time={**moving, "start": "0.1*x"}, rate=1, boundary=[{"value": "0.1*x + 0.05*t"}])


def bodies() -> None:
    steel: dict[str, Any] = {"young": 10, "poisson": 0.3}
    plane = {**steel, "plane": "strain"}
    block = {"shape": "rectangle", "x": [0, 2], "y": [-2, 0], "cells": 8}
    sides = [{"on": "left", "value": [0, "free"]}, {"on": "bottom", "value": ["free", 0]}]
    base: dict[str, Any] = {"tension": None, "load": None, "lower": None, "elasticity": plane, "mesh": block}

    def body(
        name: str, obstacle: dict[str, Any], *, on: str = "top", ranks: tuple[int, ...] = ALL, **given: Any
    ) -> None:
        boundary = [*given.pop("boundary", sides), {"on": on, "obstacle": obstacle}]
        scene(f"body/{name}", ranks=ranks, boundary=boundary, **{**base, **given})

    cylinder = {"cylinder": 4, "centre": [0, 3.98]}
    moved = {"cylinder": 4, "centre": [0, 4], "force": 0.1, "moves": [0, -1]}
    for method in ("penalty", "vi"):
        for element in ("P1", "P2"):
            body(f"cylinder-{element}-{method}", cylinder, how={"element": element, "method": method})
            body(f"force-{element}-{method}", moved, how={"element": element, "method": method})
    body("stress", cylinder, elasticity={**steel, "plane": "stress"})
    for element in ("Q1", "Q2"):
        body(f"cylinder-{element}", cylinder, mesh={**block, "cell": "quadrilateral"}, how={"element": element})
    body("box", {"box": [1, 1], "centre": [0, 0.48]})
    body("plane", {"plane": [0, -1], "at": [0, -0.02]})
    body("gap", {"gap": "x^2/8 - 0.02"})
    body("axial", {"sphere": 4, "centre": [0, 3.98]}, elasticity=steel, axial_symmetry=True)
    body("load", cylinder, load=[0, -0.1])
    body("spring", cylinder, boundary=[{"on": "left", "value": [0, "free"]}, {"on": "bottom", "spring": 20}])
    body("spring-list", cylinder, boundary=[{"on": "left", "value": [0, "free"]}, {"on": "bottom", "spring": [1, 20]}])
    body("traction", {"plane": [0, 1], "at": [0, -2]}, on="bottom",
         boundary=[sides[0], {"on": "top", "traction": [0, "-0.2*x"]}])  # fmt: skip
    body("pressure", {"plane": [0, 1], "at": [0, -2]}, on="bottom",
         boundary=[sides[0], {"on": "top", "pressure": "0.2*x"}])  # fmt: skip
    body("report", cylinder, report={"force": "force_y", "half": "half_width", "peak": "peak",
         "stress": "max(von_mises)", "area": "contact_area"})  # fmt: skip
    body("eps", cylinder, how={"eps": 1e-6})
    body("uneven", cylinder, elasticity={"young": "10 + x", "poisson": "0.3 - 0.05*y", "plane": "strain"})
    body("time", cylinder, load=[0, "-0.1*t"], time={"end": 1, "steps": 3})
    solid = {"shape": "box", "x": [0, 1], "y": [0, 1], "z": [-1, 0], "cells": 3}
    ball = {"sphere": 3, "centre": [0.5, 0.5, 2.98]}
    for cell, element in (("tetrahedron", "P1"), ("tetrahedron", "P2"), ("hexahedron", "Q1"), ("hexahedron", "Q2")):
        cells = 2 if element in ("P2", "Q2") else 3
        mesh = {**solid, "cell": cell, "cells": cells}
        boundary = [{"where": "z < -0.999", "value": [0, 0, 0]}, {"where": "z > -0.001", "obstacle": ball}]
        scene(f"body/solid-{element}", **{**base, "elasticity": steel, "mesh": mesh}, boundary=boundary,
              how={"element": element})  # fmt: skip
    file("body/lift-off", "lift_off.toml", {"mesh.cells": 20})
    for demo in ("hertz_cylinder", "hertz_sphere", "roller"):
        file(f"body/{demo}", f"{demo}.toml", {"solve.element": "P1"}, ranks=ONE)


for subject in (meshes, elements, parameters, effects, bounds, times, bodies):
    subject()
