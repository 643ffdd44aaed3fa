"""One page that holds a whole result: scene, equation, figures, table, pictures, versions, command.

The page is one file: it fetches nothing, needs no JavaScript, and prints.
"""

from __future__ import annotations

import shlex
import sys
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from fenicsx_obstacle.parallel import write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show import plots
from fenicsx_obstacle.show.explain import explain
from fenicsx_obstacle.show.figures import svg
from fenicsx_obstacle.show.tables import EARLIER, Cell

NAME = "report.html"
_STYLE = """
body { color: #111; background: #fff; font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto;
       padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: .5rem 0 0; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #ccc; }
pre, .wide { overflow-x: auto; }
pre { font: .8rem/1.45 ui-monospace, monospace; background: #f6f6f4; padding: .75rem; margin: 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .55rem; text-align: right; white-space: nowrap; }
th { border-bottom: 1px solid #111; vertical-align: bottom; }
th small { display: block; font-weight: normal; }
tr + tr td { border-top: 1px solid #e4e4e0; }
.facts th { text-align: left; border: 0; font-weight: normal; color: #444; }
.facts td { text-align: left; white-space: normal; overflow-wrap: anywhere; }
figure { margin: 1rem 0; break-inside: avoid; }
figure img, figure svg { display: block; max-width: 100%; height: auto; }
figcaption, .note { font-size: .85rem; color: #444; }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); gap: 1rem; }
@media print { pre { white-space: pre-wrap; } body { max-width: none; padding: 0; font-size: 10pt; }
               h2 { break-after: avoid; } table { font-size: 7pt; } th, td { padding: .1rem .25rem; } }
"""


def write_page(
    path: Path,
    scene: Scene,
    record: Mapping[str, Any],
    picture: Path | None,
    *,
    rows: Sequence[Mapping[str, Any]] = (),
    table: Sequence[Sequence[Cell]] = (),
    varied: Sequence[str] = (),
    plotted: bool = False,
) -> None:
    """Write the page of an answer or of a study (one rank).

    Args:
        path: The file.
        scene: What was solved; of a study the last row's.
        record: Figures of the answer, or the last row.
        picture: PNG file of the answer, or None.
        rows: Rows of a study.
        table: Their cells, as printed.
        varied: Keys that vary.
        plotted: Whether orders are measured, so that there are plots.
    """
    title = scene.tables.title or scene.name
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="note">{escape(_headline(record, rows, varied))}</p>',
    ]
    if table:
        parts.append(_section("Table", _table(table)))
    if plotted:
        drawn = (("convergence", plots.convergence(rows, varied)), ("cost", plots.cost(rows, varied)))
        both = "".join(f'<figure role="img" aria-label="{name}">{svg(page, name)}</figure>' for name, page in drawn)
        parts.append(_section("Orders and cost", f'<div class="plots">{both}</div>'))
    if picture is not None:
        which = "The last row's solution" if rows else "The solution"
        parts.append(_section(which, _picture(picture, title)))
    parts += [
        _section("Figures" + (" of the last row" if rows else ""), _facts(_figures(record))),
        _section("What is assembled, and what is left out", _pre(explain(scene))),
        _section("Scene" + (" of the last row" if rows else ""), _pre(scene.toml())),
        _section("Reproduce", _pre(command(record["ranks"])) + _facts(record["versions"].items())),
    ]
    write_text(path, _page(title, parts))


def command(ranks: int) -> str:
    """The command that this process runs, as one types it."""
    program, *arguments = sys.argv
    if program.endswith(("__main__.py", "fenicsx-obstacle")):
        words = ["./obstacle", *(["--ranks", str(ranks)] if ranks > 1 else []), *arguments]
    else:
        words = [*(["mpirun", "-n", str(ranks)] if ranks > 1 else []), "python3", program, *arguments]
    return shlex.join(words)


def _page(title: str, parts: Iterable[str]) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _section(title: str, body: str) -> str:
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>"


def _pre(text: str) -> str:
    return f"<pre>{escape(text)}</pre>"


def _headline(record: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], varied: Sequence[str]) -> str:
    how = f"{record['method']}, {record['element']}, {record['ranks']} rank{'s' * (record['ranks'] > 1)}"
    if rows:
        return f"Study over {', '.join(varied)}: {len(rows)} row{'s' * (len(rows) > 1)}; {how}."
    return f"{how}; {record['cells_total']} cells, {record['dofs']} unknowns."


def _table(table: Sequence[Sequence[Cell]]) -> str:
    heads = "".join(
        f"<th>{escape(cell.head)}<small>{escape(cell.expected) or '&nbsp;'}</small></th>" for cell in table[0]
    )
    body = "".join("<tr>" + "".join(f"<td>{escape(cell.value)}</td>" for cell in cells) + "</tr>\n" for cells in table)
    notes = ["Below each measured quantity stands where the order beside it comes from: the paper, or the best that "
             "P1 can give."] if any(cell.head == "order" for cell in table[0]) else []  # fmt: skip
    notes += [EARLIER] if any("*" in cell.value for cells in table for cell in cells) else []
    text = "".join(f'<p class="note">{escape(note)}</p>' for note in notes)
    return f'<div class="wide"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>{body}</tbody></table></div>{text}'


def _picture(path: Path, title: str) -> str:
    data = b64encode(path.read_bytes()).decode()
    return f'<figure><img alt="{escape(title)}" src="data:image/png;base64,{data}"></figure>'


def _figures(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    contact, seconds = record["contact"], record["seconds"]
    facts = [
        ("cells, unknowns", f"{record['cells_total']}, {record['dofs']}"),
        ("h, longest edge", f"{record['h']:.4g}, {record['h_max']:.4g}"),
        ("eps", "none" if record["eps"] is None else f"{record['eps']:.4g}"),
        ("iterations", f"{record['newton_iterations']} Newton, {record['krylov_iterations']} CG"),
        ("energy", "none" if record["energy"] is None else f"{record['energy']:.10g}"),
        ("contact area", f"{contact['area']:.6g}"),
    ]
    facts += [(f"force on {side} obstacle", f"{contact[side]['force']:.6g}")
              for side in ("lower", "upper") if side in contact]  # fmt: skip
    facts.append(("penetration", f"{record['penetration']:.4g}"))
    facts += [(f"error, {norm}", f"{value:.4g}") for norm, value in (record.get("errors") or {}).items()]
    facts += [(name, f"{value:.6g}") for name, value in (record.get("report") or {}).items()]
    facts.append(("seconds", f"{seconds['solve']:.3g} for the solve, {seconds['mesh']:.3g} for the mesh"))
    return facts


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    lines = "".join(f"<tr><th>{escape(key)}</th><td>{escape(str(value))}</td></tr>\n" for key, value in facts)
    return f'<table class="facts">\n{lines}</table>'
