"""Guaranteed errors of output quantities that are linear in u.

Let Q(v) be a sum of int (q v + s) over the domain or materials, q and s polynomials. Where the error bound B of u_h is
certified,

    |Q(u) - Q(u_h)| <= ||Q||_* B + |Q_0(w)|,   ||Q||_* = sup Q_0(v)/||v|| = ||z||,   Q_0(v) = int q v,

v = 0 where u is given, and z solves the linear problem a(z, v) = int q v of the same tension, foundation and springs.
w continues what boundary values are between the nodes (`estimation/boundary_data.py`): u - u_h - w is 0 where u is
given, and B bounds its norm. |Q_0(w)| is at most the sum of |T| max|q| max|w| over the cells T. The error bound B_z of
z_h on the same mesh gives ||z||^2 = Q_0(z) <= Q_0(z_h) + B_z ||z||, hence ||z|| <= B_z/2 + (B_z^2/4 + Q_0(z_h))^(1/2).
The values Q(u_h) and Q_0(z_h) are exact, because so is the quadrature of [report] for such integrands.
"""

from __future__ import annotations

import ast
import re
from contextlib import closing
from dataclasses import replace
from math import sqrt
from typing import Any

import msgspec

from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError, NotConverged
from fenicsx_obstacle.estimation.quadrature import DEGREE
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import of_outputs

BILINEAR = ("tension", "foundation")  # effects that are part of a


def with_guaranteed_outputs(answer: Answer, context: SolverContext) -> Answer:
    """The answer with `record["bound"]["outputs"]`: value and error of each linear quantity, and whether the error is
    guaranteed or, with sampled data, estimated (collective).

    Empty where the bound is an indicator, or no quantity is such an integral; not there without [report].

    Args:
        answer: With a bound.
        context: Made it.
    """
    bound, scene, found = answer.bound, context.scene, dict[str, dict[str, float | str]]()
    assert bound is not None
    if not scene.report:
        return answer
    if bound.certified and not context.problem.model.radial:
        for name, formula in scene.report.items():
            raw = _dual(scene, name, formula, context.problem.level)
            error = None if raw is None else _error(scene, raw, name, context, bound.total)
            if error is not None:
                value = answer.record["report"][name]
                found[name] = {"value": value, "error": error, "words": of_outputs(bound.words)}
    return replace(answer, record={**answer.record, "bound": {**answer.record["bound"], "outputs": found}})


def _error(scene: Scene, raw: dict[str, Any], name: str, context: SolverContext, energy_error: float) -> float | None:
    """An upper bound of |Q(u) - Q(u_h)|, (E17); None where there is no certified one (collective).

    Args:
        scene: Of u.
        raw: Tables of the scene whose solution is z.
        name: Of Q_0 in its [report].
        context: Of u.
        energy_error: B.
    """
    level, rim = context.problem.level, context.estimator.element.dirichlet.deviation
    try:
        with closing(SolverContext(scene.with_tables(raw), level.comm, level)) as linear:
            answer = linear.answer(bound=True, errors=False)
            element = linear.estimator.element
    except (InputError, NotConverged):
        return None
    bound, value = answer.bound, answer.record["report"][name]
    assert bound is not None
    if not bound.certified or value is None:
        return None
    norm = bound.total / 2 + sqrt(bound.total**2 / 4 + max(value, 0.0))
    weights = element.equilibration.load.largest
    return norm * energy_error + total(level.comm, element.simplices.area * weights * rim)


def _dual(scene: Scene, name: str, formula: Formula, level: Level) -> dict[str, Any] | None:
    """Tables of the scene whose solution is z; None if the quantity is not linear, or not integrated exactly."""
    integrals = _integrals(scene, formula.tree, "1") or []
    everywhere, loads, quantity, linear = "0", dict.fromkeys(level.groups, "0"), "0", False
    for part, factor, integrand in integrals:
        degrees = _degrees(scene, integrand)
        if degrees is None or degrees[0] > 1 or degrees[1] + scene.pair.degree - 1 > DEGREE:
            return None
        at_one, at_zero = (re.sub(r"\bu\b", u, ast.unparse(integrand)) for u in ("1.0", "0.0"))
        weight = f"({at_one}) - ({at_zero})"
        term, where = f" + {factor}*({weight})", "" if part is None else f", {part!r}"
        quantity += f" + {factor}*integral(u*({weight}){where})"
        if part is None:
            everywhere += term
        elif part in loads:
            loads[part] += term
        else:  # a curve or a part of the boundary
            return None
        linear = linear or degrees[0] == 1
    if not linear:
        return None
    raw = msgspec.to_builtins(scene.tables)
    raw |= {"obstacle": {}, "exact": None, "report": {name: quantity}, "profile": {}}
    raw["effects"] = {key: value for key, value in raw["effects"].items() if key in BILINEAR}
    raw["effects"]["load"] = everywhere
    if any(part is not None for part, _, _ in integrals):
        raw["effects"]["load"] = {key: f"{load} + {everywhere}" for key, load in loads.items()}
    raw["boundary"] = [found for table in raw.get("boundary", []) if (found := _homogeneous(table)) is not None]
    return raw


def _integrals(scene: Scene, node: ast.expr, factor: str) -> list[tuple[str | None, str, ast.expr]] | None:
    """Part of the mesh, factor and integrand of each integral in a sum of such; None if it is another expression."""
    match node:
        case ast.Call(func=ast.Name(id="integral"), args=[integrand]):
            return [(None, factor, integrand)]
        case ast.Call(func=ast.Name(id="integral"), args=[integrand, ast.Constant(value=str(part))]):
            return [(part, factor, integrand)]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as operation, operand=operand):
            return _integrals(scene, operand, f"-{factor}" if isinstance(operation, ast.USub) else factor)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as operation, right=right):
            sign = "-" if isinstance(operation, ast.Sub) else ""
            found = [_integrals(scene, left, factor), _integrals(scene, right, sign + factor)]
            return None if found[0] is None or found[1] is None else found[0] + found[1]
        case ast.BinOp(left=left, op=ast.Mult(), right=right) if _is_number(scene, left):
            return _integrals(scene, right, f"{factor}*({ast.unparse(left)})")
        case ast.BinOp(left=left, op=ast.Mult(), right=right) if _is_number(scene, right):
            return _integrals(scene, left, f"{factor}*({ast.unparse(right)})")
        case ast.BinOp(left=left, op=ast.Div(), right=right) if _is_number(scene, right):
            return _integrals(scene, left, f"{factor}/({ast.unparse(right)})")
    return [] if _is_number(scene, node) else None


def _is_number(scene: Scene, node: ast.expr) -> bool:
    """Whether an expression has a value without the solution."""
    names = {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}
    return not any(isinstance(one, ast.Call) for one in ast.walk(node)) and all(
        name in scene.known_names and scene.is_constant(name) for name in names
    )


def _homogeneous(table: dict[str, Any]) -> dict[str, Any] | None:
    """A table of [[boundary]] without obstacles and fluxes, and with 0 where u is given; None if nothing is left."""
    kept: dict[str, Any] = {key: table[key] for key in ("on", "where", "spring") if key in table}
    if "value" in table:
        kept["value"] = 0.0
    return kept if {"value", "spring"} & set(kept) else None


def _degrees(scene: Scene, node: ast.expr) -> tuple[int, int] | None:
    """Degree of an expression in u, and in u and the coordinates together; None if it is no polynomial of them."""
    match node:
        case ast.Constant():
            return 0, 0
        case ast.Name(id="u"):
            return 1, 1
        case ast.Name(id="x" | "y" | "z"):
            return 0, 1
        case ast.Name(id=name) if name in scene.define:
            return _degrees(scene, scene.define[name].tree)
        case ast.Name(id=name) if name in scene.known_names and scene.is_constant(name):
            return 0, 0
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            return _degrees(scene, operand)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int(power))) if power >= 0:
            a = _degrees(scene, left)
            return None if a is None else (power * a[0], power * a[1])
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() as operation, right=right):
            a, b = _degrees(scene, left), _degrees(scene, right)
            if a is None or b is None or (isinstance(operation, ast.Div) and b[1] > 0):
                return None
            if isinstance(operation, ast.Mult):
                return a[0] + b[0], a[1] + b[1]
            return max(a[0], b[0]), max(a[1], b[1])
    return None
