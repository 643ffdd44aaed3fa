"""Summary of the rows of the suite: verdicts and values of each scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tests.hard.cases import Case
from tests.hard.judge import EPS, METHODS
from tests.hard.row import Row

RESOLVED = 0.1  # change of the contact force from one mesh to the next


@dataclass(frozen=True)
class Summary:
    """Of one scene.

    Attributes:
        case: The scene.
        verdicts: How often each was given.
        unknowns: On the finer mesh.
        monotone: Whether the maximum principle holds on it; None where nothing was solved.
        steps: Most Newton steps on the finest level, by method.
        penetration: Largest penetration over eps max|p_h|: 1 at most by theory, with the maximum principle.
        work: Largest a(e, e) over (eps/4) ||p_h||_I^2: 1 at most by theory.
        moved: Largest relative change of the contact force between the meshes, by SNES VI; None without force.
        off: Largest |p_eps - p_h| over max|p_h| at eps = 1e-14.
        plain: The same of the pressure computed from the stored u.
        seconds: Of all processes.
    """

    case: Case
    verdicts: Counter[str]
    unknowns: int | None
    monotone: bool | None
    steps: dict[str, int]
    penetration: float | None
    work: float | None
    moved: float | None
    off: float | None
    plain: float | None
    seconds: float


def figures_of(case: Case, rows: Sequence[Row]) -> Summary:
    """The figures of one scene from its rows."""
    solved = [row for row in rows if row.get("dofs") and not row["trial"]]
    fine = [row for row in solved if row["mesh"] == case.meshes[1]]
    small = [row["digits"] for row in solved if row["asked"] == EPS[-2] and row.get("digits")]
    work = _most(_ratios(solved, "penalty and inequality: energy norm"))
    return Summary(
        case=case,
        verdicts=Counter(row["verdict"] for row in rows),
        unknowns=fine[0]["dofs"] if fine else None,
        monotone=fine[0]["monotone"] if fine else None,
        steps={method: max(row["newton_iterations"] for row in solved if row["method"] == method)
               for method in ("vi", *METHODS) if any(row["method"] == method for row in solved)},
        penetration=_most(_ratios(solved, "penetration")),
        work=None if work is None else work**2,
        moved=_moved(case, solved),
        off=_most(digits["off"] for digits in small),
        plain=_most(digits.get("from_heights") for digits in small),
        seconds=sum(row.get("seconds", 0.0) for row in rows),
    )  # fmt: skip


def _ratios(rows: Sequence[Row], name: str) -> list[float]:
    """Observed over limit where eps is so large that solvers' accuracy is no part of the limit."""
    found = [one for row in rows if (row["eps"] or 0.0) >= 1e-7 for one in row["findings"] if one["name"] == name]
    return [one["observed"] / one["limit"] for one in found if one["observed"] is not None and one["limit"]]


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _moved(case: Case, rows: Sequence[Row]) -> float | None:
    """Contact forces of the two meshes, by the inequality."""
    forces: list[dict[str, float]] = []
    for mesh in case.meshes:
        for row in rows:
            if row["mesh"] == mesh and row["method"] == "vi":
                contact = row["contact"]
                forces.append({side: contact[side]["force"] for side in ("lower", "upper") if side in contact})
    if len(forces) < 2 or max(forces[1].values(), default=0.0) <= 0.0:
        return None
    size = max(forces[1].values())
    return max(abs(forces[0][side] - forces[1][side]) for side in forces[1]) / size
