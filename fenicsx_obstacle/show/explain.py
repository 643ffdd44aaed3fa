"""`explain`: the equation that is assembled, its signs, the solver, what is not included, and the cost of a tolerance.

The words are in `templates/explain.txt`, those of a forecast here.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from fenicsx_obstacle.algebra.coarse import SMALLEST
from fenicsx_obstacle.algebra.methods import METHODS, NONLINEAR_WORDS
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA
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
from fenicsx_obstacle.effects.effect import Effect, OnPart, known, of_model_problem
from fenicsx_obstacle.mesh.memory import BYTES_PER_VERTEX, OTHERS
from fenicsx_obstacle.mesh.meshing import GEOMETRY
from fenicsx_obstacle.mesh.shapes import SHAPES
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.meshes import shape_of
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.scenes.tables import OF_BODIES, BoundaryTable, part_place
from fenicsx_obstacle.show.tables import duration
from fenicsx_obstacle.show.template import filled
from fenicsx_obstacle.text import counted, plain, title_of

if TYPE_CHECKING:
    from fenicsx_obstacle.answers.adapt import Adaptation
    from fenicsx_obstacle.studies.forecast import Forecast

BUSY = 1.2  # elapsed over processor time of a machine that does something else
BOUND, ESTIMATE = ("bound", 2), ("error", 3)  # what falls, and the factor within which forecasts are, measured


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
    text = filled(
        "explain.txt", scene=scene, integrals=integrals(scene), terms=_terms(scene),
        without=dict.fromkeys(effect.key for effect in scene.effects if not _has_form(effect)), moving=_moving(scene),
        equation=_equation(scene), sum_of=_sum, loads=lambda number: _loads(scene, number), components=_components,
        where=_where, point=_point, part_place=part_place, free=_free(scene),
        elastic=scene.model.elastic.key.replace("_", " "),
        mesh=_mesh(scene), size=_size(scene), method_words=_method(scene), linear_solver=_linear_solver(scene),
        pressed=any(getattr(effect, "force", None) for effect in scene.effects),
        orders=_orders(scene), counts_nodes=not scene.model.radial and any(map(_counts_nodes, scene.report.values())),
        not_included=_not_included(scene),
    )  # fmt: skip
    parts = []
    for part in re.split("^== ", text, flags=re.MULTILINE)[1:]:
        name, *lines = re.split("\n- ", part.rstrip("\n"))
        parts.append((name, [re.sub("\n *", " ", line) for line in lines]))
    return parts


def integrals(scene: Scene) -> int:
    """Number of assembled integrals: those of the effects, and the penalty."""
    return sum(map(_has_form, scene.effects)) + scene.penalised


def _has_form(effect: Effect) -> bool:
    """Whether it has a part of the residual that is a form."""
    return type(effect).terms is not Effect.terms


def _equation(scene: Scene) -> str:
    inside = [effect for effect in scene.effects if effect.equation and not isinstance(effect, OnPart)]
    left = [effect.equation for effect in inside if not effect.term.startswith("-")]
    right = [effect.equation for effect in inside if effect.term.startswith("-")]
    contact = ["p"] if scene.sides and not scene.model.thin and not scene.model.vector_valued else []
    return f"{_sum(left)} = {_sum(right + contact) or '0'}"


def _sum(terms: Sequence[str]) -> str:
    """Terms with their signs, which each of them may begin with."""
    signed = (f" - {term[1:].lstrip()}" if term.startswith("-") else f" + {term}" for term in terms)
    found = "".join(signed)
    return f"-{found[3:]}" if found.startswith(" - ") else found[3:]


def _terms(scene: Scene) -> str:
    """a(u, v) - f(v), the elastic effect first."""
    ordered = sorted(scene.effects, key=lambda effect: effect is not scene.model.elastic)
    return " ".join(effect.term for effect in ordered if effect.term)


def _moving(scene: Scene) -> bool:
    """Whether there are derivatives in time."""
    return scene.time is not None and scene.time.order > EQUILIBRIA


def _counts_nodes(formula: Formula) -> bool:
    """Whether a formula integrates the contact set."""
    integrals = [node for node in ast.walk(formula.tree)
                 if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "integral"]  # fmt: skip
    return any(isinstance(part, ast.Name) and part.id == "contact" for node in integrals for part in ast.walk(node))


def _point(given: Any) -> str:
    return f"[{', '.join(map(plain, given))}]" if isinstance(given, tuple) else plain(given)


def _loads(scene: Scene, number: int) -> list[str]:
    """What acts on a part of the boundary."""
    return [effect.equation for effect in scene.effects if isinstance(effect, OnPart) and effect.part == number]


def _components(part: BoundaryTable) -> list[str]:
    """The components of a displacement that are given on a part of the boundary."""
    values = part.value if isinstance(part.value, tuple) else ()
    return [f"u_{axis} = {plain(one)}" for axis, one in zip("xyz", values, strict=False) if one != "free"]


def _where(part: BoundaryTable) -> str:
    names = (part.on,) if isinstance(part.on, str) else part.on or ()
    return f"where {part.where}" if part.where else f"on {', '.join(names) or 'the whole boundary'}"


def _free(scene: Scene) -> str:
    """The sides on which nothing acts and u is not given, as far as they have names; "" where there are none."""
    parts = scene.model.boundary
    if any(part.on is None and part.where is None for part in parts):
        return ""
    if scene.tables.mesh.shape is None or any(part.where is not None for part in parts):
        return "what is not listed"
    listed = {name for part in parts for name in part.on or ()}
    return ", ".join(side for side in shape_of(scene).sides if side not in listed)


def _mesh(scene: Scene) -> str:
    table = scene.tables.mesh
    if scene.mesh is not None:
        return "given as a DOLFINx mesh; its geometry is the polygon of its cells"
    refined = f", refined {'once' if table.refine == 1 else f'{table.refine} times'}" if table.refine else ""
    if table.file is not None:
        cad = Path(table.file).suffix.lower() in GEOMETRY
        how = "meshed by Gmsh; when refined, new vertices lie on its curves and surfaces" if cad else "its polygon"
        return f"{table.file}{refined}; the geometry is {'that of the file, ' if cad else ''}{how}"
    assert table.shape is not None
    axes = [key for key in SHAPES[table.shape].keys if key in ("x", "y", "z")]
    corners = ", ".join(f"{axis} = [{', '.join(map(plain, getattr(table, axis)))}]" for axis in axes)
    where = corners or f"radius {plain(table.radius)}, boundary vertices stay on the circle when refined"
    return f"{table.shape}, {where}, {counted(table.cells, 'cell')} along x{refined}"


def _size(scene: Scene) -> str:
    """About how many unknowns there are, and the memory of a solve; nothing of meshes that are yet to be read."""
    if scene.tables.mesh.shape is None:
        return ""
    shape, degree = shape_of(scene), scene.pair.degree
    dim = len(shape.cells)
    unknowns = shape.vertices(degree * 2.0**scene.tables.mesh.refine)
    more = 1.0 if all(map(of_model_problem, scene.effects)) else OTHERS
    megabytes = max(unknowns * more * BYTES_PER_VERTEX[dim] / 1e6, 1.0)
    return f"about {float(f'{unknowns:.4g}'):.0f} unknowns, {megabytes:.3g} MB in addition to the libraries"


def _method(scene: Scene) -> str:
    """The method, with what the effects change of it."""
    method, words = scene.options.method, METHODS[scene.options.method]
    if scene.model.vector_valued:
        return words
    if method == "vi" and not scene.pair.nodal:
        return AUGMENTED
    if not all(effect.convex for effect in scene.effects):
        return words.replace("on the energy", "on the norm of the residual, because there is no energy,")
    if all(effect.affine for effect in scene.effects):
        return words
    if method == "vi":
        return f"{words}; if it fails, from the solution of the penalty"
    return words.replace(*NONLINEAR_WORDS)


def _linear_solver(scene: Scene) -> str:
    """The linear solver of a step, and from which levels steps start."""
    effects, pair, options = scene.effects, scene.pair, scene.options
    if nested(effects, pair, options):
        others = f"; {ALGEBRAIC}; {LINEAR_SOLVER} on meshes of less than {SMALLEST} unknowns that have none"
        return NESTED + others if scene.sides else NESTED
    symmetric = all(effect.symmetric for effect in effects)
    solver = (LINEAR_SOLVER if symmetric else GENERAL_SOLVER) if pair.nodal else DIRECT_SOLVER
    if _moving(scene):
        return f"{solver}, on the finest level only, from the last time step"
    by_levels = stepwise(effects, pair, options)
    return f"{solver}, {'each level starts from the next coarser one' if by_levels else 'on the finest level only'}"


def _orders(scene: Scene) -> str:
    """The orders that the solution is known to have."""
    if scene.tables.exact is None:
        return ""
    rates = scene.tables.exact.rates
    known = {name: getattr(rates, name) for name in rates.__struct_fields__}
    return ", ".join(f"{name} {rate:g}" for name, rate in known.items() if rate is not None)


def _not_included(scene: Scene) -> str:
    named = {effect.key for effect in scene.effects}
    keys = (*sorted(known() - {"elasticity"}), *sorted(known("boundary") - set(OF_BODIES)))
    absent = [key for key in keys if key not in named]
    absent += [f"{side} obstacle" for side in ("lower", "upper") if side not in scene.sides]
    return "; ".join(absent) or "nothing"


def forecast_text(run: Adaptation) -> str:
    """Lines for `explain --tol` of a refinement before its first mesh (collective): a few seconds of calibration.

    Raises:
        InputError: As `forecast`.
        NotConverged: As `forecast`.
    """
    from fenicsx_obstacle.studies.forecast import forecast  # which loads finite elements

    asked = f"{run.tolerance:g}" if run.goal is None else f"{run.tolerance:g} --of {run.goal}"
    option = "--tol" if run.relative else "--tol-absolute"
    text = f"{asked}: {forecast_in_words(forecast(run), *(BOUND if run.goal is None else ESTIMATE))}"
    return fill(text, 110, initial_indent=f"  {option:13} ", subsequent_indent=" " * 16, break_on_hyphens=False)


def forecast_in_words(found: Forecast, error: str, factor: int) -> str:
    """What a forecast expects, and how certain it is.

    Args:
        found: The forecast.
        error: What has a tolerance.
        factor: Within which the forecast is.
    """
    if found.stopped:
        return f"cannot be reached: {found.stopped}"
    parts = [f"about {found.dofs:.3g} unknowns on mesh {found.meshes}", f"{duration(found.seconds)} of processor time",
             f"{found.memory_mb:.0f} MB"]  # fmt: skip
    expected = "expect " + ", ".join(parts)
    if found.stopped is not None:
        return f"{expected} (measured: the calibration has reached the tolerance)"
    sure = found.agrees and found.busy <= BUSY
    certain = f"{'' if sure else 'unknowns and memory '}within a factor of {factor}"
    lines = [f"{expected} (from {duration(found.calibration)} of calibration; the {error} is taken as proportional to "
             f"unknowns^-{found.order:.2f}; {certain})."]  # fmt: skip
    if not found.agrees:
        lines.append(f"The time is uncertain: measured times per unknown differ by a factor of {found.spread:.1f}.")
    if found.busy > BUSY:
        lines.append(f"The machine is busy: elapsed time is {found.busy:.1f} times processor time now, and both may be "
                     "longer than without other programs.")  # fmt: skip
    if not found.fits:
        lines.append("This is more memory than is free.")
    return " ".join(lines)
