"""`explain`: the equation that is assembled, its signs, the solver, and what is not included."""

from __future__ import annotations

import ast
from pathlib import Path
from textwrap import fill
from typing import Any

from fenicsx_obstacle.algebra.coarse import SMALLEST
from fenicsx_obstacle.algebra.methods import METHODS, NONLINEAR_WORDS
from fenicsx_obstacle.discrete.hierarchy import (
    ALGEBRAIC,
    AUGMENTED,
    DIRECT_SOLVER,
    GENERAL_SOLVER,
    LINEAR_SOLVER,
    NESTED,
    nested,
    stepwise,
)
from fenicsx_obstacle.discrete.memory import BYTES_PER_VERTEX, OTHERS
from fenicsx_obstacle.discrete.meshing import GEOMETRY
from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA
from fenicsx_obstacle.effects.effect import Effect, known
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.meshes import shape_of
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.tables import OF_BODIES, BoundaryTable, part_place
from fenicsx_obstacle.show.steps import steps_of
from fenicsx_obstacle.text import counted, plain, title_of


def explain(scene: Scene) -> str:
    """The text, in lines of at most 110 characters; needs no mesh."""
    lines = [title_of(scene.tables.title, scene.name)]
    for name, texts in explained(scene):
        for number, text in enumerate(texts):
            first = f"  {name if number == 0 else '':14}"
            lines.append(fill(text, 110, initial_indent=first, subsequent_indent=" " * 18, break_on_hyphens=False))
    return "\n".join(lines)


def explained(scene: Scene) -> list[tuple[str, list[str]]]:
    """Its parts: name and lines of each."""
    if scene.model.vector_valued:
        return _explained_body(scene)
    return [
        ("equation", _equation(scene)),
        ("data", [_datum(effect) for effect in scene.effects]),
        ("effects", _integrals(scene)),
        ("with", [f"{name} = {formula.text}" for name, formula in scene.define.items()]),
        ("obstacle", _obstacles(scene)),
        ("boundary", _boundary(scene)),
        ("discrete", _discrete(scene)),
        ("mesh", [_mesh(scene), *_size(scene)]),
        ("time", steps_of(scene)),
        ("solver", _solver(scene)),
        ("exact", _exact(scene)),
        ("report", _report(scene)),
        ("profile", _profiles(scene)),
        ("not included", [_not_included(scene)]),
    ]


def _explained_body(scene: Scene) -> list[tuple[str, list[str]]]:
    """The same of a scene with an elastic body."""
    return [
        ("equation", _equation(scene)),
        ("data", [_datum(effect) for effect in scene.effects if effect.key != "obstacle"]),
        ("effects", _integrals(scene)),
        ("with", [f"{name} = {formula.text}" for name, formula in scene.define.items()]),
        ("obstacle", _body_obstacles(scene)),
        ("boundary", _body_boundary(scene)),
        ("discrete", _body_discrete(scene)),
        ("mesh", [_mesh(scene)]),
        ("time", _body_steps(scene)),
        ("solver", _body_solver(scene)),
        ("report", _report(scene)),
        ("profile", _profiles(scene)),
        ("not included", ["friction; large displacements; contact of two elastic bodies; inertia"]),
    ]


def _report(scene: Scene) -> list[str]:
    """The formulas of [report], and how those count that integrate the contact set."""
    lines = [f"{name} = {formula.text}" for name, formula in scene.report.items()]
    if any(_counts_nodes(formula) for formula in scene.report.values()):
        of_bodies = ", in [report] contact_area" if scene.model.vector_valued else ""
        lines.append("integral(contact) counts nodes: each node in contact has its whole area, also at the edge of the "
                     f"contact; contact.area of the result{of_bodies} is more accurate")  # fmt: skip
    return lines


def _counts_nodes(formula: Formula) -> bool:
    """Whether a formula integrates the contact set."""
    integrals = [node for node in ast.walk(formula.tree)
                 if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "integral"]  # fmt: skip
    return any(isinstance(part, ast.Name) and part.id == "contact" for node in integrals for part in ast.walk(node))


def _profiles(scene: Scene) -> list[str]:
    lines = []
    for name, table in scene.tables.profile.items():
        where = f"along {table.on}" if table.on else f"from {_point(table.from_)} to {_point(table.to)}"
        over = [f"{key} over {plain(formula)}" for key, formula in table.compare.items()]
        lines.append(f"{name}: {', '.join([where, *over])}")
    return lines


def _point(given: Any) -> str:
    return f"[{', '.join(map(plain, given))}]" if isinstance(given, tuple) else plain(given)


def _body_obstacles(scene: Scene) -> list[str]:
    lines = [f"{effect.text} {_where(scene.tables.boundary[getattr(effect, 'part', 0)])}" for effect in scene.effects
             if effect.key == "obstacle"]  # fmt: skip
    return [*lines, "u . n <= gap, p >= 0 where they touch, p = 0 elsewhere; n: along, the normal of a half-space, or "
                    "the normal of the body"]  # fmt: skip


def _body_boundary(scene: Scene) -> list[str]:
    lines = []
    for number, part in enumerate(scene.tables.boundary):
        acting = " ".join(e.equation for e in scene.effects if getattr(e, "part", None) == number)
        values = part.value if isinstance(part.value, tuple) else ()
        given = [f"u_{axis} = {plain(one)}" for axis, one in zip("xyz", values, strict=False) if one != "free"]
        lines += [f"{', '.join(given)} {_where(part)}"] if given else []
        lines += [f"sigma(u) n = {acting} {_where(part)}"] if acting else []
    return [*lines, "free: sigma(u) n = 0 on what is not listed"]


def _body_discrete(scene: Scene) -> list[str]:
    space = f"V_h, continuous {scene.pair.space}, one for each component"
    lines = [f"a(u, v) + (1/eps) I((u . n - gap)^+, v . n) = f(v) for all v in {space}   (3.4)"]
    if not scene.penalised:
        lines = ["a(u, v - u) >= f(v - u) for all v in V_h with v . n <= gap at the nodes, u too   (3.19)"]
    ordered = sorted(scene.effects, key=lambda effect: not effect.elastic)
    lines.append("a(u, v) - f(v) = " + " ".join(effect.term for effect in ordered if effect.term))
    lines.append("I: nodal rule of the facets where obstacles are   (3.5), (3.6)")
    if scene.penalised:
        auto = scene.options.eps == "auto"
        value = "auto: a thousandth of the median of D_i/A_ii, about 1e-3 h/E" if auto else scene.options.formula.text
        lines += ["p = (u . n - gap)^+ / eps at the nodes   (3.7), (3.8)", f"eps = {value}  [length^3/force]"]
    return lines


def _body_steps(scene: Scene) -> list[str]:
    if scene.time is None:
        return []
    time = scene.time
    how = f"quasi-static: equilibria at t = 0 and {counted(time.steps, 'moment')} more, to t = {time.end:g}"
    saved = "saved: output quantities of all times in history.csv" + ", fields in frames.xdmf" * (time.frames > 0)
    return [f"{how}, each from the last one; without inertia", saved]


def _body_solver(scene: Scene) -> list[str]:
    lines = [_why(scene), METHODS[scene.options.method], _steps(scene),
             "each step: conjugate gradients with smoothed aggregation (GAMG) and rigid body motions"]  # fmt: skip
    if any(effect.key == "obstacle" and "force" in effect.text for effect in scene.effects):
        lines.append("an obstacle with a force is moved until it presses with it: a solve for each of its places, from "
                     "the last solution")  # fmt: skip
    return [*lines, "displacements are small: slopes above 0.2, or displacements above 0.2 of the body, are rejected"]


def _datum(effect: Effect) -> str:
    unit = f"  [{effect.unit}]" if effect.unit else ""
    part = getattr(effect, "part", None)
    of_part = "" if part is None else f" of {part_place(part)}"
    return f"{effect.key}{of_part} = {effect.text}{unit}"


def _equation(scene: Scene) -> list[str]:
    inside = [effect for effect in scene.effects if effect.table == "effects"]
    left = [effect.equation for effect in inside if effect.left]
    right = [effect.equation for effect in inside if not effect.left and effect.equation]
    contact = ["p"] if scene.sides and not scene.model.thin and not scene.model.vector_valued else []
    return [f"{' + '.join(left).replace('+ -', '- ')} = {' + '.join(right + contact) or '0'}"]


def integrals(scene: Scene) -> int:
    """Number of assembled integrals: those of the effects, and the penalty."""
    return sum(effect.integrals for effect in scene.effects) + scene.penalised


def _integrals(scene: Scene) -> list[str]:
    """Each effect with its term, and how many integrals that makes."""
    contact = ", the penalty included" if scene.penalised else ""
    without = [effect.key for effect in scene.effects if not effect.integrals]
    no_form = f"; {', '.join(without)} without one" if without else ""
    terms = [f"{effect.key}: {effect.term.removeprefix('+ ')}" for effect in scene.effects if effect.term]
    return [*terms, f"{counted(integrals(scene), 'integral')}{contact}{no_form}; nothing else is assembled"]


def _obstacles(scene: Scene) -> list[str]:
    signs = {"lower": ("u >= lower", ">="), "upper": ("u <= upper", "<=")}
    lines = []
    for side in scene.sides:
        relation, sign = signs[side]
        found = [(getattr(scene.tables.obstacle, side), "")]
        found += [(getattr(part, side), f" {_where(part)}") for part in scene.tables.boundary]
        lines += [f"{relation} = {plain(value)}{where}" for value, where in found if value is not None]
        lines.append(f"p {sign} 0 where u touches {side}, p = 0 elsewhere; the force on it is reported >= 0")
    return lines or ["none: p = 0"]


def _boundary(scene: Scene) -> list[str]:
    tables, lines = scene.tables, []
    listed: set[str] = set()
    everywhere = False
    for number, part in enumerate(tables.boundary):
        names = (part.on,) if isinstance(part.on, str) else part.on or ()
        listed |= set(names)
        everywhere |= part.on is None and part.where is None
        place = _where(part)
        if part.value is not None:
            lines.append(f"u = {plain(part.value)} {place}")
        acting = [effect for effect in scene.effects if getattr(effect, "part", None) == number]
        touches = part.lower is not None or part.upper is not None
        if acting or touches:
            right = " ".join([effect.equation for effect in acting] + ["+ p"] * touches).removeprefix("+ ")
            lines.append(f"tension du/dn = {right} {place}; along a curve inside, its jump")
    if not everywhere:
        sides = _named_sides(scene)
        free = [side for side in sides if side not in listed] if not any(p.where for p in tables.boundary) else []
        place = ", ".join(free) if free else "what is not listed"
        if free or not sides or any(p.where for p in tables.boundary):
            lines.append(f"free: tension du/dn = 0 on {place}")
    return lines


def _where(part: BoundaryTable) -> str:
    names = (part.on,) if isinstance(part.on, str) else part.on or ()
    return f"where {part.where}" if part.where else f"on {', '.join(names) or 'the whole boundary'}"


def _named_sides(scene: Scene) -> tuple[str, ...]:
    names = ("left", "right", "bottom", "top", "back", "front")
    sides = {
        "interval": names[:2],
        "rectangle": names[:4],
        "box": names,
        "disk": ("circle",),
        "l-shape": ("outer", "notch"),
    }
    return sides.get(scene.tables.mesh.shape or "", ())


def _discrete(scene: Scene) -> list[str]:
    sides = scene.sides
    terms = ["a(u, v)"]
    penalised = scene.options.method != "vi"
    rule = "(L/eps) I" if scene.model.thin else "(1/eps) I"
    if penalised and "upper" in sides:
        terms.append(f"+ {rule}((u - upper)^+, v)")
    if penalised and "lower" in sides:
        terms.append(f"- {rule}((lower - u)^+, v)")
    space = f"V_h, continuous {scene.pair.space}"
    lines = [f"{' '.join(terms)} = f(v) for all v in {space}, v = 0 where u is given" + "   (3.4)" * bool(sides)]
    if not penalised and sides:
        lines = ["a(u, v - u) >= f(v - u) for all v in V_h between the obstacles, u too   (3.19)"]
    lines += [effect.note for effect in scene.effects if effect.note]
    ordered = sorted(scene.effects, key=lambda effect: not effect.elastic)  # its term has no sign
    lines.append("a(u, v) - f(v) = " + " ".join(effect.term for effect in ordered if effect.term))
    if sides:
        of_facets = "nodal rule of the facets where obstacles are; L: longest side of the box around the mesh"
        lines.append(f"I: {of_facets if scene.model.thin else scene.pair.words}   (3.5), (3.6)")
        times = "L " if scene.model.thin else ""
        signs = {"upper": f"-{times}(u - upper)^+ / eps", "lower": f"{times}(lower - u)^+ / eps"}
        pressure = " + ".join(signs[side] for side in sides) if penalised else "(a(u, phi_i) - f(phi_i)) / I(phi_i, 1)"
        if not penalised and not scene.pair.nodal:
            pressure = "the multiplier"
        lines.append(f"p = {pressure} at the points of I" + "   (3.7), (3.8)" * penalised)
    if penalised and sides:
        chosen = "auto: " if scene.options.eps == "auto" else ""
        lines.append(f"eps = {chosen}{scene.options.formula.text}" + _eps_rule(scene))
    return lines


def _eps_rule(scene: Scene) -> str:
    elastic = next(effect.key for effect in scene.effects if effect.elastic)
    return f", divided by the largest {elastic.replace('_', ' ')}" if scene.options.formula.scaled else ""


def _mesh(scene: Scene) -> str:
    table = scene.tables.mesh
    if scene.mesh is not None:
        return "given as a DOLFINx mesh; its geometry is the polygon of its cells"
    refined = f", refined {'once' if table.refine == 1 else f'{table.refine} times'}" if table.refine else ""
    if table.file is not None:
        cad = Path(table.file).suffix.lower() in GEOMETRY
        how = "meshed by Gmsh; when refined, new vertices lie on its curves and surfaces" if cad else "its polygon"
        return f"{table.file}{refined}; the geometry is {'that of the file, ' if cad else ''}{how}"
    axes = {"interval": "x", "rectangle": "xy", "box": "xyz", "l-shape": "xy"}.get(table.shape or "", "")
    corners = ", ".join(f"{axis} = [{', '.join(map(plain, getattr(table, axis)))}]" for axis in axes)
    where = corners or f"radius {plain(table.radius)}, boundary vertices stay on the circle when refined"
    return f"{table.shape}, {where}, {counted(table.cells, 'cell')} along x{refined}"


def _size(scene: Scene) -> list[str]:
    """About how many unknowns there are, and the memory of a solve; nothing of meshes that are yet to be read."""
    if scene.tables.mesh.shape is None:
        return []
    shape, degree = shape_of(scene), scene.pair.degree
    dim = len(shape.cells)
    unknowns = shape.vertices(degree * 2.0**scene.tables.mesh.refine)
    more = 1.0 if all(effect.in_model_problem for effect in scene.effects) else OTHERS
    megabytes = max(unknowns * more * BYTES_PER_VERTEX[dim] / 1e6, 1.0)
    return [f"about {unknowns:.4g} unknowns, {megabytes:.3g} MB in addition to the libraries"]


def _solver(scene: Scene) -> list[str]:
    if not scene.sides:
        steps = "one linear solve" if all(effect.affine for effect in scene.effects) else "Newton steps"
        levels = (
            NESTED if nested(scene.effects, scene.pair, scene.options) else f"{_linear_solver(scene)}, {_levels(scene)}"
        )
        return [_why(scene), f"PETSc SNES, {steps}: {levels}"]
    method, pair = scene.options.method, scene.pair
    prefix = "vi" if method == "vi" and pair.nodal else "penalty"
    return [
        _why(scene),
        AUGMENTED if method == "vi" and not pair.nodal else _method(scene),
        _steps(scene),
        "stops when the unbalanced forces, summed, are below 1e-10 of the acting ones, with the final active set",
        f"each step: {NESTED}; {ALGEBRAIC}; {LINEAR_SOLVER} on meshes of less than {SMALLEST} unknowns that have none"
        if nested(scene.effects, scene.pair, scene.options)
        else f"each step: {_linear_solver(scene)}, {_levels(scene)}",
        f"PETSc options after -- override: -{prefix}_ksp_type preonly -{prefix}_pc_type lu",
    ]


def _why(scene: Scene) -> str:
    """The properties of the equation that determine the solver."""
    bent = [effect.key for effect in scene.effects if not effect.affine]
    skew = [effect.key for effect in scene.effects if not effect.symmetric]
    linear = f"not linear in u, because of {', '.join(bent)}" if bent else "linear in u"
    symmetric = f"not symmetric, because of {', '.join(skew)}" if skew else "symmetric"
    return f"without contact the equation is {linear}, and its derivative {symmetric}; therefore:"


def _levels(scene: Scene) -> str:
    if scene.time is not None and scene.time.order > EQUILIBRIA:
        return "on the finest level only, from the last time step"
    by_levels = stepwise(scene.effects, scene.pair, scene.options)
    return "each level starts from the next coarser one" if by_levels else "on the finest level only"


def _method(scene: Scene) -> str:
    """The method, with what the effects change of it."""
    words = METHODS[scene.options.method]
    if not all(effect.convex for effect in scene.effects):
        return words.replace("on the energy", "on the norm of the residual, because there is no energy,")
    if all(effect.affine for effect in scene.effects):
        return words
    if scene.options.method == "vi":
        return f"{words}; if it fails, from the solution of the penalty"
    return words.replace(*NONLINEAR_WORDS)


def _steps(scene: Scene) -> str:
    """One linear solve, or steps."""
    if not all(effect.affine for effect in scene.effects):
        return "a linear solve in each Newton step, with newly assembled forms"
    return "one linear solve without contact, and one more each time that the contact set changes"


def _linear_solver(scene: Scene) -> str:
    if not scene.pair.nodal:
        return DIRECT_SOLVER
    return LINEAR_SOLVER if all(effect.symmetric for effect in scene.effects) else GENERAL_SOLVER


def _exact(scene: Scene) -> list[str]:
    exact = scene.tables.exact
    if exact is None:
        return []
    lines = [f"u = {plain(exact.u)}: errors are reported"]
    lines += [] if exact.pressure is None else [f"p = {plain(exact.pressure)}"]
    lines += [
        f"{name}: {text}" for name, text in (("free boundary", exact.free), ("regularity", exact.regularity)) if text
    ]
    rates = {name: getattr(exact.rates, name) for name in exact.rates.__struct_fields__}
    orders = ", ".join(f"{name} {rate:g}" for name, rate in rates.items() if rate is not None)
    return lines + [f"orders in h, by VI and for eps = h^2: {orders}"] * bool(orders)


def _not_included(scene: Scene) -> str:
    named = {effect.key for effect in scene.effects}
    keys = (*sorted(known() - {"elasticity"}), *sorted(known("boundary") - set(OF_BODIES)))
    absent = [key for key in keys if key not in named]
    absent += [f"{side} obstacle" for side in ("lower", "upper") if side not in scene.sides]
    return "; ".join(absent) or "nothing"
