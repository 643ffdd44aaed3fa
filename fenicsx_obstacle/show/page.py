"""The page of a result: scene, equation, output quantities, tables, pictures, versions, command.

The page is one file: it fetches nothing, needs no JavaScript, and prints.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from fenicsx_obstacle.parallel import write_text
from fenicsx_obstacle.problems.summary import report_in_words, with_uncertainty
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.explain import explained
from fenicsx_obstacle.show.tables import StudyTable
from fenicsx_obstacle.text import counted, patches_in_words, title_of, vector_in_words, with_error

NAME = "report.html"
_PARTS = {  # of the bound: what makes each smaller
    "discretisation": "a finer mesh makes it smaller",
    "penalty": "a smaller eps makes it smaller",
    "algebraic": "further iterations make it smaller",
    "data": "load, obstacle and boundary values between the nodes",
}
_FORMULA = [  # docs/bound.md has the theorem
    "S/2 + (S²/4 + η)^½ + ‖v - u‖, with S = ‖μ^½ ∇v - μ^-½ \u03c3‖ + R",
    "\u03c3: flux in balance with load and contact pressure λ; v: u moved off the obstacles; η = ∫ λ (v - obstacle)",
    "R: bound of what is not in balance",
    "discretisation is ‖μ^½ ∇u - μ^-½ \u03c3‖; penalty is in v - u and η, algebraic in R, data in all of them",
    "the parts do not add up to the bound",
]
_STYLE = """
body { color: #111; background: #fff; font: 16px/1.5 system-ui, sans-serif; max-width: 74rem; margin: 0 auto;
       padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: .5rem 0 0; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #ccc; }
pre { font: .8rem/1.45 ui-monospace, monospace; background: #f6f6f4; padding: .75rem; margin: 0;
      white-space: pre-wrap; overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
.wide table { font-size: .75rem; }
.wide th, .wide td { padding: .2rem .25rem; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .55rem; text-align: right; white-space: nowrap; }
th { border-bottom: 1px solid #111; vertical-align: bottom; }
th small { display: block; font-weight: normal; }
tbody tr + tr td { border-top: 1px solid #e4e4e0; }
.facts th { text-align: left; vertical-align: top; border: 0; font-weight: normal; color: #444; }
.facts td { text-align: left; border: 0; white-space: normal; overflow-wrap: anywhere; }
.facts td div { padding-left: 1.2em; text-indent: -1.2em; }
figure { margin: 1rem 0; break-inside: avoid; }
figure img, figure svg { display: block; max-width: 100%; height: auto; }
.near img { max-width: min(40rem, 100%); }
@media screen and (max-width: 40rem) { .far { overflow-x: auto; } .far img { max-width: none; width: 40rem; } }
.words td:first-child, .words th:first-child { text-align: left; }
.words td:first-child { font-weight: 600; }
.lead p { max-width: 46rem; }
.note { font-size: .85rem; color: #444; margin: .5rem 0; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(30rem, 100%), 1fr)); gap: 1rem; }
.plots figure { max-width: 46rem; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; }
               h2 { break-after: avoid; } table { font-size: 7pt; } th, td { padding: .1rem .25rem; } }
"""


def write_answer_page(
    path: Path, scene: Scene, record: Mapping[str, Any], picture: Path | None, time_history: Path | None = None,
    profiles: Mapping[str, str] | None = None, others: Mapping[str, Path] | None = None,
) -> None:  # fmt: skip
    """Write the page of an answer (one rank).

    Args:
        path: The file.
        scene: What was solved.
        record: Values of the answer, as in answer.json.
        picture: PNG file of the answer, or None.
        time_history: PNG file of all moments, or None.
        profiles: SVG elements of the profiles, by name.
        others: Further pictures, PNG or GIF, by what they show, if they could be drawn.
    """
    size = f"{counted(record['cells_total'], 'cell')}, {counted(record['dofs'], 'unknown')}"
    parts = [] if picture is None else [section("The solution", _picture(picture, _title(scene), wide=True))]
    if time_history is not None:
        parts.append(section("All moments", _picture(time_history, f"{_title(scene)}, over time", wide=True)))
    parts += [section("Profiles", plots(profiles))] if profiles else []
    drawn = {name: file for name, file in (others or {}).items() if file.exists()}  # not of every mesh
    parts += [section("Quantity with a tolerance", facts(_goal(record["goal"])))] if "goal" in record else []
    parts += [section("Error bound", facts(_bound(record["bound"])))] if "bound" in record else []
    parts += [
        section(name, _picture(file, f"{_title(scene)}: {name}", wide=file.suffix == ".gif"))
        for name, file in drawn.items()
    ]
    _write(path, scene, f"{_how(record)}; {size}.", [*parts, *_facts_of(scene, record)], record, record["command"])


def write_study_page(
    path: Path,
    scene: Scene,
    rows: Sequence[Mapping[str, Any]],
    rows_table: StudyTable,
    drawn: Mapping[str, str],
    picture: Path | None,
    command: str,
) -> None:
    """Write the page of a study (one rank).

    Args:
        path: The file.
        scene: What was solved in the last row.
        rows: All rows.
        rows_table: As printed.
        drawn: SVG elements by name.
        picture: PNG file of the last row's answer, or None.
        command: What made it.
    """
    headline = f"Study over {', '.join(rows_table.varied)}: {counted(len(rows), 'row')}; {_how(rows[-1])}."
    parts = [section("Table", _table(rows_table))]
    if drawn:
        parts.append(section(" and ".join(drawn).capitalize(), plots(drawn)))
    if picture is not None:
        parts.append(section("The last row's solution", _picture(picture, _title(scene), wide=True)))
    _write(path, scene, headline, [*parts, *_facts_of(scene, rows[-1], " of the last row")], rows[-1], command)


def write_cost_page(
    path: Path, scene: Scene, headline: str, parts: Sequence[str], versions: Mapping[str, str], command: str
) -> None:
    """Write the page of `cost` (one rank).

    Args:
        path: The file.
        scene: What was solved.
        headline: In one line.
        parts: Sections.
        versions: Of the program and its libraries.
        command: What made it.
    """
    about = [
        section("Assembled terms, and what is not included", facts(explained(scene))),
        section("Scene", pre(scene.toml())),
    ]
    _write(path, scene, headline, [*parts, *about], {"versions": versions}, command)


def _write(
    path: Path, scene: Scene, headline: str, parts: Sequence[str], record: Mapping[str, Any], command: str
) -> None:
    title = _title(scene)
    head = [f"<h1>{escape(title)}</h1>", f'<p class="note">{escape(headline)}</p>']
    how = section("Reproduce", pre(command) + facts(record["versions"].items()))
    write_text(path, _page(title, [*head, *parts, how]))


def _title(scene: Scene) -> str:
    return title_of(scene.tables.title, scene.name)


def _how(record: Mapping[str, Any]) -> str:
    return f"{record['method']}, {record['element']}, {counted(record['ranks'], 'rank')}"


def _page(title: str, parts: Iterable[str]) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def section(title: str, body: str) -> str:
    """A part of the page with its heading."""
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column is of words."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>\n" for row in rows)
    return f'<div class="wide words"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def paragraph(text: str) -> str:
    """A paragraph."""
    return f"<p>{escape(text)}</p>"


def plots(drawn: Mapping[str, str], *, wide: bool = False) -> str:
    """SVG elements by what they show, side by side, or each as wide as the page."""
    figures = "".join(f'<figure role="img" aria-label="{escape(name)}">{svg}</figure>' for name, svg in drawn.items())
    return figures if wide else f'<div class="plots">{figures}</div>'


def pre(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{escape(text)}</pre>"


def _table(table: StudyTable) -> str:
    heads, first = "", table.rows[0]
    blank = "&nbsp;" if table.by else ""
    for before, cell in zip([None, *first], first, strict=False):
        # the source of an order stands in the column before it: 'paper:' and '1'
        below = f"{before.expected} {cell.expected}" if before is not None and cell.head == "order" else ""
        heads += f"<th>{escape(cell.head)}<small>{escape(below) or blank}</small></th>"
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell.value)}</td>" for cell in cells) + "</tr>\n" for cells in table.rows
    )
    text = "".join(f'<p class="note">{escape(note)}</p>' for note in table.notes())
    return f'<div class="wide"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>{body}</tbody></table></div>{text}'


def _picture(path: Path, title: str, *, wide: bool = False) -> str:
    """A picture; a wide one keeps a readable size on a narrow screen, where it can be moved sideways."""
    data, kind = b64encode(path.read_bytes()).decode(), path.suffix.removeprefix(".")
    size = "far" if wide else "near"
    return f'<figure class="{size}"><img alt="{escape(title)}" src="data:image/{kind};base64,{data}"></figure>'


def _facts_of(scene: Scene, record: Mapping[str, Any], which: str = "") -> list[str]:
    """Sections of a page: [report], output quantities, equation, and the scene itself."""
    report = list(report_in_words(record).items())
    return [
        *([section("Report" + which, facts(report))] if report else []),
        section("Output quantities" + which, facts(_figures(record))),
        section("Assembled terms, and what is not included", facts(explained(scene))),
        section("Scene" + which, pre(scene.toml())),
    ]


def _figures(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    contact, seconds = record["contact"], record["seconds"]
    newton, krylov = (counted(record[f"{name}_iterations"], f"{words} step")
                      for name, words in (("newton", "Newton"), ("krylov", "linear")))  # fmt: skip
    facts = [
        ("cells, unknowns", f"{record['cells_total']}, {record['dofs']}"),
        ("h, longest edge", f"{record['h']:.4g}, {record['h_max']:.4g}"),
        ("eps", "none" if record["eps"] is None else f"{record['eps']:.4g}"),
        ("iterations", f"{newton}, {krylov}, on the finest mesh"),
        ("energy", "none" if (J := record["energy"]) is None else with_uncertainty(record, J, ".10g", "energy")),
        ("contact area", with_uncertainty(record, contact["area"], ".6g", "contact", "area")),
    ]
    if "resultant" in contact:
        facts.append(("contact force", vector_in_words(contact["resultant"])))
        facts += [("contact", words) for words in patches_in_words(contact)]
        names = {"half_width": "half-width of the contact", "peak": "peak of p", "approach": "approach"}
        facts += [(name, f"{contact[key]:.6g}") for key, name in names.items() if contact.get(key) is not None]
    for side in [side for side in ("lower", "upper") if side in contact and "resultant" not in contact]:
        force = with_uncertainty(record, contact[side]["force"], ".6g", "contact", side, "force")
        facts.append((f"force on {side} obstacle", force))
    facts.append(("penetration", with_uncertainty(record, record["penetration"], ".4g", "penetration")))
    if "largest" in (time := record.get("time", {})):
        facts.append(("pictures", f"{time['name']} = {time['largest']:.4g}, the moment of the largest contact force"))
    facts += [("warning", remark) for remark in record.get("remarks", ())]
    if "reason" in record.get("uncertainty", {}):
        facts.append(("no uncertainty", record["uncertainty"]["reason"]))
    facts += [(f"error, {norm}", f"{value:.4g}") for norm, value in (record.get("errors") or {}).items()]
    spent = f"{seconds['solve']:.3g} for the solve, {seconds['mesh']:.3g} for the mesh, {seconds['total']:.3g} in all"
    facts += [("seconds", spent), ("memory of all ranks", f"{record['memory_mb']:.0f} MB")]
    return facts


def _goal(goal: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The quantity that had a tolerance, with its error and how far it is guaranteed."""
    relative = "" if goal["relative"] is None else f", {goal['relative']:.3g} of the value"
    known = [(goal["name"], f"{with_error(goal['value'], goal['error'])}{relative}"), ("the error is", goal["words"])]
    if goal["words"].partition(",")[0] == "estimated":
        on = f"estimated on a mesh with {goal['dofs']} unknowns"
        known += [("part: mesh", f"{goal['mesh']:.3g}: a finer mesh reduces it; {on}")]
        known += [("part: penalty", f"{goal['penalty']:.3g}: a smaller eps reduces it")]
    return known


def _bound(bound: Mapping[str, Any]) -> list[tuple[str, str | list[str]]]:
    """The bound of the energy error, how far it is guaranteed, its parts, and how they make it."""
    most = "at most" if bound["words"].startswith("certified") else "about"
    relative = "" if bound["relative"] is None else f", {bound['relative']:.3g} of the energy norm of u"
    known: list[tuple[str, str | list[str]]] = [("energy error", f"{most} {bound['total']:.4g}{relative}")]
    known.append(("it is", bound["words"]))
    known += [(f"part: {part}", f"{bound[part]:.4g}: {words}") for part, words in _PARTS.items()]
    known.append(("formula", _FORMULA))
    if bound.get("energy") is not None and bound["words"].startswith("certified"):
        known.append(("energy of the exact solution", "between {:.8g} and {:.8g}".format(*bound["energy"])))
    if bound["effectivity"] is not None:
        known.append(("bound over true error", f"{bound['effectivity']:.3g}"))
    return known


def facts(known: Iterable[tuple[str, str | list[str]]]) -> str:
    """A table of names with a text or several lines each; names without a text are omitted."""
    lines = ""
    for key, value in known:
        texts = value if isinstance(value, list) else [value]
        below = "".join(f"<div>{escape(text)}</div>" for text in texts)
        lines += f"<tr><th>{escape(key)}</th><td>{below}</td></tr>\n" if texts else ""
    return f'<table class="facts">\n{lines}</table>'
