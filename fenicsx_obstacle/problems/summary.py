"""The main values of a solution in words, from its record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fenicsx_obstacle.text import counted, of_outputs, patches_in_words, vector_in_words, with_error

PRESSURE_ROUNDOFF_SHOWN = 1e-3  # relative round-off of a pressure from which on it is reported


def summary(record: Mapping[str, Any], title: str) -> str:
    """The main values of a solution in a few lines of text.

    Args:
        record: Of the solution.
        title: Of its problem.
    """
    r = record
    size = f"{counted(r['cells_total'], 'cell')}, {counted(r['dofs'], 'unknown')}, h = {r['h']:.4g}"
    eps = "" if r["eps"] is None else f", eps = {r['eps']:.3g}"
    figures = main_values(r)
    if "peclet" in r:
        figures.append(f"largest Peclet number of a cell {peclet_in_words(r)}")
    if r["free"] == 0:
        figures.append("u is given at every node: use more cells")
    lines = [
        title,
        f"  {r['method']}{eps}; {size}; {counted(r['ranks'], 'rank')}",
        *([f"  {time_in_words(r)}; at the end:"] if "time" in r else []),
        f"  {steps_in_words(r)}, {r['seconds']['solve']:.2f} s (and {r['seconds']['mesh']:.2f} s for the mesh), "
        f"{r['seconds']['total']:.2f} s in all, {r['memory_mb']:.0f} MB",
        "  " + "; ".join(figures),
        *(f"  contact {words}" for words in patches_in_words(r["contact"])),
        *(f"  {name}: {words}" for name, words in remarks_in_words(r)),
    ]
    if "reason" in r.get("uncertainty", {}):
        lines.append(f"  no uncertainty: {r['uncertainty']['reason']}")
    if "errors" in r:
        lines.append("  error: " + ", ".join(f"{key} {value:.4g}" for key, value in r["errors"].items()))
    if "bound" in r:
        b = r["bound"]
        relative = "" if b["relative"] is None else f", {b['relative']:.3g} of its norm"
        parts = ", ".join(f"{key} {b[key]:.3g}" for key in ("discretisation", "penalty", "algebraic", "data"))
        most = "at most" if b["words"].startswith("certified") else "about"
        times = _effectivity(r["bound"])
        lines.append(f"  energy error {most} {b['total']:.4g}{relative} ({parts}); {b['words']}{times}")
        if b.get("energy") is not None and b["words"].startswith("certified"):
            lines.append("  energy of the exact solution between {:.8g} and {:.8g}".format(*b["energy"]))
    if (goal := r.get("goal")) is not None:
        lines.append(f"  {goal['name']} = {with_error(goal['value'], goal['error'])} ({goal['words']})")
    lines += _enclosure(r) + [f"  {words}" for words in tolerance_in_words(r)]
    if r.get("report"):
        lines.append("  report: " + ", ".join(f"{name} = {words}" for name, words in report_in_words(r).items()))
    return "\n".join(lines)


def remarks_in_words(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What a user should know of a mesh and of a solution, in the order of a text: mesh, warning or round-off, and
    words."""
    mesh = [("mesh", remark) for remark in record.get("mesh_remarks", ())]
    jump = [record["boundary_jump"]] if "boundary_jump" in record else []
    return mesh + [("warning", remark) for remark in (*record.get("remarks", ()), *jump)] + _round_off(record)


def steps_in_words(record: Mapping[str, Any]) -> str:
    """Newton steps and linear ones; of all steps in time together."""
    of, all_steps = ("total", "in all ") if "time" in record else ("iterations", "")
    linear = "GMRES step" if "peclet" in record else "linear step"
    return f"{all_steps}{counted(record[f'newton_{of}'], 'Newton step')}, {counted(record[f'krylov_{of}'], linear)}"


def peclet_in_words(record: Mapping[str, Any]) -> str:
    """The largest Peclet number of a cell, and what follows."""
    how = "upwinded where it is above 1" if record["peclet"] > 1 else "so nowhere upwinded"
    return f"{record['peclet']:.3g}, {how}"


def time_in_words(record: Mapping[str, Any]) -> str:
    """The steps in time."""
    time = record["time"]
    scheme = {"equilibria": "equilibria", "euler": "implicit Euler", "bdf2": "BDF2",
              "midpoint": "midpoint rule"}[time["scheme"]]  # fmt: skip
    again = f", {counted(time['rejected'], 'step')} repeated" if time["rejected"] else ""
    return f"{counted(time['steps'], 'step')} to {time['name']} = {time['t']:g}, {scheme}{again}"


def _round_off(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """About the round-off of the pressure, if it is large."""
    found, words = record.get("round_off", {}), []
    if (found.get("left") or 0.0) > PRESSURE_ROUNDOFF_SHOWN:
        words.append(
            f"{found['left']:.1g} of the pressure, because u is large; subtract a constant from u and obstacle"
        )
    if (found.get("line") or 0.0) > PRESSURE_ROUNDOFF_SHOWN:
        words.append(
            "eps is very small: p was computed from the unknown u - obstacle; computed from the saved u and obstacle "
            f"it would have an error of {found['line']:.1g}"
        )
    return [("round-off", one) for one in words]


def _enclosure(record: Mapping[str, Any]) -> list[str]:
    """A line about the distance of u from the solution of the inequality on the same mesh."""
    enclosure = record.get("enclosure")
    if enclosure is None:
        return []
    side = "above" if "lower" in record["contact"] else "below"
    words = "" if enclosure["guaranteed"] else "; not guaranteed, the stiffness is no M-matrix"
    return [f"  the solution without penalty is {side} u by at most {enclosure['width']:.3g} at each node{words}"]


def _effectivity(b: Mapping[str, Any]) -> str:
    """Bound over true error, in words; if it is below 1, with the reason."""
    if b["effectivity"] is None:
        return ""
    times = f"; {b['effectivity']:.3g} times the true one"
    if b["effectivity"] >= 1 or not b["words"].startswith("certified"):
        return times
    if b["guaranteed"]:
        return times + ", so that [exact] is not the solution of this scene, or both are round-off"
    what = ["the curved boundary"] if "polygon" in b["words"] else []
    what += ["data between samples"] if "sampled" in b["words"] else []
    return f"{times}, which includes the error of {' and '.join(what)}; the bound does not"


def tolerance_in_words(record: Mapping[str, Any]) -> list[str]:
    """Whether the tolerance was reached; nothing where there is none."""
    adaptive = record.get("adaptive")
    if adaptive is None:
        return []
    kind = "relative" if adaptive["relative"] else "absolute"
    goal = f"{kind} tolerance {adaptive['tolerance']:g}"
    if adaptive.get("of"):
        goal += f" for {adaptive['of']}"
        if adaptive["reached"]:
            where = f"on mesh {len(adaptive['path'])}"
            but = ", but by an estimate that is not settled" if "not settled" in record["goal"]["words"] else ""
            return [f"the {goal} is reached{but}, {where}; eps and meshes were chosen for it"]
    elif adaptive["reached"]:
        kind, _, what = record["bound"]["words"].partition(":")[0].partition("certified")
        words = ", by an indicator only" if kind else f",{what}" if what else ""
        where = f"on mesh {len(adaptive['path'])}"
        return [f"the {goal} is reached{words}, {where}; eps and meshes were chosen for it"]
    return [f"THE {goal.upper()} IS NOT REACHED: {adaptive['stopped']}"]


def main_values(r: Mapping[str, Any]) -> list[str]:
    """Energy and contact, in words."""
    contact = r["contact"]
    sides = [side for side in ("lower", "upper") if side in contact]
    figures = ["no energy" if r["energy"] is None else f"energy {with_uncertainty(r, 'energy', '.10g')}"]
    if sides:
        figures.append(f"contact area {with_uncertainty(r, 'contact.area', '.6g')}")
        if "resultant" in contact:
            figures.append(f"contact force {vector_in_words(contact['resultant'])}")
        else:
            for side in sides:
                figures.append(f"force on {side} obstacle {with_uncertainty(r, f'contact.{side}.force', '.6g')}")
        figures.append(f"penetration {with_uncertainty(r, 'penetration', '.3g')}")
    known = {key: contact.get(key) for key in ("half_width", "peak", "approach")}  # of an elastic body
    return figures + [f"{key.replace('_', '-')} {value:.6g}" for key, value in known.items() if value is not None]


def report_in_words(record: Mapping[str, Any]) -> dict[str, str]:
    """The values of [report], by name; extremes with their places."""
    places, found, goal = record.get("report_places", {}), {}, record.get("goal", {})
    bound = record.get("bound", {})
    for name, value in (record.get("report") or {}).items():
        where = f" at ({', '.join(f'{x:.4g}' for x in places[name])})" if name in places else ""
        if (output := bound.get("outputs", {}).get(name)) is not None:
            words = of_outputs(bound["words"])
            most, why = "at most" if words.startswith("guaranteed") else "about", f"; {words}"
            where = f" (error {most} {output['error']:.2g}{'' if words == 'guaranteed' else why})"
        if value is None:
            found[name] = "not finite"
        elif name == goal.get("name"):
            found[name] = with_error(value, goal["error"])
        else:
            found[name] = f"{with_uncertainty(record, f'report.{name}', '.6g')}{where}"
    return found


def lookup(record: Mapping[str, Any], key: str) -> Any:
    """Value at a dotted key of a record, or of a row with dotted keys; None if there is none."""
    if key in record:
        return record[key]
    value: Any = record
    for step in key.split("."):
        value = value.get(step) if isinstance(value, Mapping) else None
    return value


def with_uncertainty(record: Mapping[str, Any], key: str, form: str, *, short: bool = False) -> str:
    """A value with its uncertainty, in words; the value alone where no uncertainty was asked for.

    Args:
        record: Of a solution, or a row of a study.
        key: The value's dotted key.
        form: Of the value where its error is not known.
        short: Without the order and the last change.
    """
    value, found = lookup(record, key), lookup(record, f"uncertainty.{key}")
    if not found:
        return f"{value:{form}}"
    if found["error"] is None:
        change = "" if short else f": the last change is {found['change']:.2g}"
        return f"{value:{form}} ({found['verdict']}{change})"
    order = "no order" if found["order"] is None else f"order {found['order']:.1f}"
    return f"{with_error(value, found['error'], form)}{'' if short else f' ({order})'}"
