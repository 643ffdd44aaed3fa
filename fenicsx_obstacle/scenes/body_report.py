"""Output quantities of elastic bodies: of the contact, and those of [report]."""

from __future__ import annotations

import ast
from collections.abc import Mapping

import numpy as np

from fenicsx_obstacle.effects.boundary.obstacle import HERTZ
from fenicsx_obstacle.fields.contact_table import ContactTable
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.scenes.bodies import Body, Facing, part_of
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.functionals import Report
from fenicsx_obstacle.scenes.report import BODY_QUANTITIES
from fenicsx_obstacle.scenes.scene import Scene

MIN_NODES_ACROSS = 3  # in contact: with fewer the pressure has no shape, and the width is that of the cells
LOADED = 1e-9  # of the largest pressure: a node with more is in contact
SAME_PLACE = 1e-6  # of the width: nodes so near each other are at one place across the contact
SAME_ROW = 0.25  # the same in space, of the root of the area of a node
INNER = 0.9  # of the half-width: the pressure at its edge says little about the peak


class BodyReport(Report):
    """The [report] of a scene with an elastic body on one mesh."""

    def __init__(self, body: Body, scene: Scene):
        super().__init__(body.data, scene)

    def of(self, solution: Solution, known: Mapping[str, float]) -> dict[str, float | None]:
        """All output quantities, in order; None if one is not finite (collective).

        Args:
            solution: On this mesh.
            known: Those of `contact_quantities`.
        """
        found = solution.functions()
        parts = {f"u_{axis}": found[f"u{k}"] for k, axis in enumerate("xyz"[: self._dim])}
        self._nodal = {**parts, "p": solution.pressure, "contact": solution.contact}
        if solution.von_mises is not None:
            self._nodal["von_mises"] = solution.von_mises
        return self._evaluated(known)

    @property
    def _dim(self) -> int:
        return self.level.mesh.geometry.dim

    def _is_known(self, formula: Formula) -> bool:
        names = {node.id for node in ast.walk(formula.tree) if isinstance(node, ast.Name)}
        return super()._is_known(formula) and not names & set(BODY_QUANTITIES)


def contact_quantities(body: Body, solution: Solution) -> dict[str, float]:
    """Numbers of the contact by their names in [report]; those that a body does not have are not-a-number.

    half_width and peak are those of the first sphere or cylinder: the half-width by the second moment of the pressure
    about its centre, for a pressure of Hertz's shape; the peak by a fit of p^2, linear in the square of the distance
    from the centre. Both are not-a-number if the contact has fewer than `MIN_NODES_ACROSS` nodes across. Other
    obstacles have the largest pressure as peak.
    """
    nodes, found = solution.nodes, dict.fromkeys(BODY_QUANTITIES, np.nan)
    moment = np.atleast_1d(nodes.moment())
    found |= {f"force_{axis}": float(x) for axis, x in zip("xyz", nodes.resultant, strict=False)}
    names = ("moment",) if len(moment) == 1 else ("moment_x", "moment_y", "moment_z")
    found |= {name: float(x) for name, x in zip(names, moment, strict=True)}
    found |= {"contact_area": solution.area, "peak": float(nodes.pressure.max(initial=0.0))}
    round_one = _round(body)
    if round_one is not None:
        found["half_width"], found["peak"] = _hertzian(round_one, part_of(round_one, nodes))
    if (moved := body.pressing or body.moved) is not None:
        found["approach"] = float(moved.travel.value)
    return found


def contact_remarks(body: Body, solution: Solution) -> tuple[str, ...]:
    """What the user should know of the contact, in words."""
    one = _round(body)
    if one is None or not np.isnan(_hertzian(one, part_of(one, solution.nodes))[0]):
        return ()
    return (
        f"the contact with the {one.obstacle.kind} has fewer than {MIN_NODES_ACROSS} nodes across: it is narrower than "
        "the cells, so that half-width and peak are not known; take smaller cells there ([mesh] cells or refine, or "
        "a mesh graded towards the contact)",
    )


def _round(body: Body) -> Facing | None:
    """The first sphere or cylinder."""
    return next((one for one in body.facing if one.obstacle.kind in HERTZ), None)


def _hertzian(one: Facing, nodes: ContactTable) -> tuple[float, float]:
    """Half-width and peak of the pressure below a sphere or a cylinder; 0 without contact, not-a-number if too few
    nodes are in contact."""
    forces = nodes.pressure * nodes.areas
    if not forces.sum() > 0:
        return 0.0, 0.0
    arms = nodes.points - np.array(one.obstacle.point)
    across = [nodes.resultant / np.linalg.norm(nodes.resultant)]
    across += [np.array(one.obstacle.direction)] if one.obstacle.direction else []
    for unit in across:
        arms = arms - (arms @ unit)[:, None] * unit
    loaded = nodes.pressure > LOADED * nodes.pressure.max()
    if _nodes_across(arms[loaded], nodes.areas[loaded], arms.shape[1] - len(across)) < MIN_NODES_ACROSS:
        return np.nan, np.nan
    square = (arms**2).sum(axis=1)
    half_width = float(np.sqrt(HERTZ[one.obstacle.kind] * (forces @ square) / forces.sum()))
    peak = float(nodes.pressure.max())
    inner = square < (INNER * half_width) ** 2
    if np.count_nonzero(inner) > 2:
        peak = float(np.sqrt(max(np.polyfit(square[inner], nodes.pressure[inner] ** 2, 1)[1], 0.0)))
    return half_width, peak


def _nodes_across(arms: np.ndarray, areas: np.ndarray, dim: int) -> int:
    """How many nodes in contact lie side by side, in the direction where they are fewest.

    Nodes on one side of the centre only are those of one half of a symmetric contact: they count with their mirror
    images.

    Args:
        arms: Positions of the nodes from the centre, shape (nodes, gdim).
        areas: Of the nodes.
        dim: Of the space that contains the arms: 1 or 2.
    """
    tolerance = SAME_PLACE * float(np.linalg.norm(arms, axis=1).max())
    if arms.shape[1] == 3:
        tolerance = max(tolerance, SAME_ROW * float(np.sqrt(areas.mean())))
    counts = []
    for unit in np.linalg.eigh(arms.T @ arms)[1].T[-dim:]:
        places, count, last = np.sort(arms @ unit), 0, -np.inf
        for place in places:
            if place - last > tolerance:
                count, last = count + 1, place
        if places[0] >= -tolerance or places[-1] <= tolerance:
            at_centre = np.abs(places).min() <= tolerance
            count = 2 * count - int(at_centre)
        counts.append(count)
    return min(counts)
