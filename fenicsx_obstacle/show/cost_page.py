"""The page of `cost`, for readers who know nothing of penalties: pictures, tables and what they mean (one rank)."""

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
    "seconds": """Down is more accurate, right is dearer: the lowest line at a given time is the best buy. A straight
line that falls by one digit over d digits of time makes each further digit cost 10^d times as much. Solid: linear
elements (P1); dashed: quadratic ones (P2). The grey dotted line, where it is near enough to be seen, is what
unbalanced forces and rounding leave: below it digits are noise.""",
    "prices": """The same rows by other prices. One Poisson solve is one linear problem without obstacle on the finest
uniform mesh here, solved by algebraic multigrid: a scale that depends little on the machine. Memory is what a row
takes beyond what the program occupied before.""",
    "parts": """Two things make the answer wrong: cells are not infinitely small, and the obstacle of a penalty method
gives way a little. Blue is the error that the mesh alone makes, found by solving the inequality without penalty on
the same mesh; red is how far the penalty moves the answer on that mesh; black is what is left in the end. Where red
is above blue a smaller eps is a free improvement; where it is far below, eps does not matter.""",
    "map": """Each box is one solve: the darker, the larger the error. Upward eps grows and the obstacle becomes soft,
to the right cells grow. Along a column from above, the error falls until the mesh alone decides; the stars mark where
that begins: the largest eps that makes the error at most a tenth larger than a tiny eps does. Hatched: eps so small
that rounding decides which points touch; the program refuses it.""",
}
ABOUT = """{title}. Something that may touch an obstacle but not cross it is computed on a mesh of cells,
approximately. Smaller cells are more accurate and take longer. This page says, from runs on this machine, what each
further digit of the answer costs, and which way of computing it is the cheapest."""
MEASURES = """Errors are measured in several ways, each relative to the size of the answer. Energy norm: the error of
slopes, weighted by the tension; the hardest to reduce. L2 norm: the error of heights, on average. Maximum norm: the
largest error of a height. Contact force: of the total force on the obstacle. Contact area: of the size of the region
that touches."""
PENALTY = """Penalty methods replace the hard obstacle by a very stiff cushion; eps is its softness: the smaller, the
harder. The variational inequality (VI) is the problem with the hard obstacle itself."""
NEXT = """For each way of measuring: the smallest error, who had it, or half of its accuracy, soonest, and the time;
then what an error ten times smaller would take, by whoever is cheapest there, if things go on as over the last three
meshes. The last column is about where rounding ends it."""
CHEAPEST = """The fastest choice for each relative error, and its time; in brackets where this is continued beyond the
rows."""


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
    """The price of the next digit in one line."""
    p = price.price(rows, "energy")
    if p is None:
        return "What accuracy costs."
    far = (
        "; one more digit is not in sight" if p.factor is None else f"; one more digit takes {p.factor:.2g} times that"
    )
    return f"What accuracy costs: an energy error of {p.error:.1e} in {tables.duration(p.seconds)} by {p.choice}{far}."


def parts(rows: Rows, study: CostStudy, drawn: Mapping[str, tuple[str, str]]) -> list[str]:
    """The sections of the page."""
    heads = ["relative error", *(NORMS[norm] for norm in price.norms(rows))]
    found = [
        page.section("What this page is about", _about(study.full, rows)),
        page.section("The price of the next digit", _lead(NEXT) + page.table(tables.NEXT, tables.next_digit(rows))),
        page.section("The cheapest way to an error", _lead(CHEAPEST) + page.table(heads, tables.by_tolerance(rows))),
        page.section("The ways that are compared", _ways(study.choices)),
    ]
    for name, (words, element) in drawn.items():
        body = _lead(READ[name]) + page.plots({words: element}, wide=True)
        if name == "map" and (best := tables.best_eps(rows)):
            body += page.table(tables.BEST, best)
        found.append(page.section(words, body))
    found.append(page.section("What is not there, and why", page.facts(tables.ended(rows, study))))
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
