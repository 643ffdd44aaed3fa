"""The page of `cost`: pictures and tables with explanations that need no knowledge of penalty methods (one rank)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fenicsx_obstacle.io.origin import command, versions
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import cost_tables as tables
from fenicsx_obstacle.show import page
from fenicsx_obstacle.show.cost_plots import drawings
from fenicsx_obstacle.show.figures import save, svg
from fenicsx_obstacle.studies import price
from fenicsx_obstacle.studies.choices import Choice
from fenicsx_obstacle.studies.cost import CostStudy
from fenicsx_obstacle.studies.price import NORMS, Rows
from fenicsx_obstacle.text import title_of

READ = {
    "seconds": """Lower is more accurate, further right is slower: at a given time the lowest line is the best choice.
    If a
line falls by one digit while the time grows by d digits, each further digit takes 10^d times as long. Solid lines are
linear elements (P1), dashed lines quadratic ones (P2). The grey dotted line, if it is in the range of the plot, is the
error due to unbalanced forces and round-off.""",
    "prices": """The same rows against Poisson solves, memory and unknowns. One Poisson solve is the time of one linear
problem without obstacle on the finest uniform mesh of this page, solved by algebraic multigrid; this unit depends
little on the machine. Memory is the increase by a row over the memory of the program before it.""",
    "parts": """The error has two parts. Blue is the error of the mesh: the solution of the variational inequality on
    the
same mesh, without penalty, has this error. Red is the error of the penalty: the distance from that solution on the same
mesh. Black is the total error. Where red is above blue, a smaller eps reduces the error at no cost; where it is far
below, eps does not matter.""",
    "map": """Each box is one solve; a darker box has a larger error. eps grows upwards, h to the right. In each
    column the
error decreases with eps until the error of the mesh dominates. A star marks the largest eps whose error is at most a
tenth above that of a very small eps. In the hatched region round-off determines the contact set; the program rejects
such values of eps.""",
}
ABOUT = """{title}. The problem is solved approximately on a mesh; smaller cells are more accurate and take longer. This
page has, from runs on this machine, the time for each further digit of the solution, and the fastest method."""
MEASURES = """Errors are measured in several norms, relative to the size of the solution. Energy norm: the error of the
gradient, weighted by the tension; it decreases most slowly. L2 norm: the mean error of u. Maximum norm: the largest
error of u. Contact force: the error of the total force on the obstacle. Contact area: the error of the size of the
contact set."""
PENALTY = """A penalty method replaces the constraint by a stiff foundation; eps is its compliance, and a smaller eps
is a stiffer foundation. The variational inequality (VI) has the constraint itself."""
NEXT = """For each norm: the smallest error, the fastest method that reaches this error or twice this error, and its
time; then the time for a tenth of this error with the fastest method, extrapolated from the last three meshes. The last
column is about the error at which round-off dominates."""
CHEAPEST = """The fastest method for each relative error, and its time; times in brackets are extrapolated."""


def write_page(folder: Path, study: CostStudy, rows: Rows) -> list[str]:
    """Draw the plots and write the page.

    Returns:
        Names of the pictures.
    """
    drawn: dict[str, tuple[str, str]] = {}
    for name, words, figure in drawings(rows):
        save(figure, folder / f"{name}.png")
        drawn[name] = words, svg(figure, name)
    page.write_cost_page(folder / page.NAME, study.full, headline(rows), parts(rows, study, drawn), versions(),
                         command(study.comm.size))  # fmt: skip
    return [f"{name}.png" for name in drawn]


def headline(rows: Rows) -> str:
    """Time for one more digit in one line."""
    p = price.price(rows, "energy")
    if p is None:
        return "Cost of accuracy."
    far = (
        "; one more digit is not reached by extrapolation"
        if p.factor is None
        else f"; one more digit takes {p.factor:.2g} times that"
    )
    return f"Cost of accuracy: an energy error of {p.error:.1e} in {tables.duration(p.seconds)} by {p.choice}{far}."


def parts(rows: Rows, study: CostStudy, drawn: Mapping[str, tuple[str, str]]) -> list[str]:
    """The sections of the page."""
    heads = ["relative error", *(NORMS[norm] for norm in price.norms(rows))]
    found = [
        page.section("What this page is about", _about(study.full, rows)),
        page.section("Time for one more digit", _lead(NEXT) + page.table(tables.NEXT, tables.next_digit(rows))),
        page.section(
            "The fastest method for a given error", _lead(CHEAPEST) + page.table(heads, tables.by_tolerance(rows))
        ),
        page.section("The methods that are compared", _ways(study.choices)),
    ]
    for name, (words, element) in drawn.items():
        body = _lead(READ[name]) + page.plots({words: element}, wide=True)
        if name == "map" and (best := tables.best_eps(rows)):
            body += page.table(tables.BEST, best)
        found.append(page.section(words, body))
    found.append(page.section("Where each method ends, and why", page.facts(tables.ended(rows, study))))
    measured = page.table(tables.HEADS, [tables.cells(row) for row in price.solved(rows)])
    found.append(page.section("All rows", measured + f'<p class="note">{tables.TAS}</p>'))
    return found


def _about(scene: Scene, rows: Rows) -> str:
    texts = [ABOUT.format(title=title_of(scene.tables.title, scene.name)), MEASURES, PENALTY, tables.against(rows)]
    return _lead(*texts)


def _lead(*texts: str) -> str:
    return '<div class="lead">' + "".join(page.paragraph(text) for text in texts) + "</div>"


def _ways(choices: Sequence[Choice]) -> str:
    return page.facts((choice.name, choice.words) for choice in choices)
