"""Numbers of the pages are those of stored results: docs/measured has a JSON file for each measured table.

A comment `measured: NAME` stands above each table that is written from docs/measured/NAME.json. A comment
`numbers: NAME NAME` stands above a paragraph, or in a row of a table, whose numbers must all occur in these files, to
the digits that are shown. After a new measurement change the JSON file, and write the tables by this command:

    .venv/bin/python docs/_extensions/measured.py
"""

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent
FOLDER = ROOT / "docs" / "measured"
TABLE = re.compile(r"(?<=<!-- measured: )(\w+) -->\n((?:\|.*\n)*)")
PARAGRAPH = re.compile(r"^<!-- numbers: ([\w ]+) -->\n((?:.+\n)+)", re.MULTILINE)
ROW = re.compile(r"^\|.*<!-- numbers: ([\w ]+) -->.*$", re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.^-])(\d+(?:\.(\d+))?(?:e(-?\d+))?)(?![\w.]*\w)")


def pages() -> list[Path]:
    """README.md, the paper, and the pages in docs."""
    docs = ROOT / "docs"
    return [
        ROOT / "README.md",
        docs / "paper" / "paper.md",
        *sorted(docs.glob("*.md")),
        *sorted(docs.glob("tables/*.md")),
    ]


def stored(name: str) -> dict[str, Any]:
    """A result: its commands, date, commit, columns and rows."""
    return json.loads((FOLDER / f"{name}.json").read_text())


def table(name: str) -> str:
    """A result as a table of Markdown."""
    result = stored(name)
    rows = [result["columns"], ["---"] * len(result["columns"]), *result["rows"]]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def numbers(text: str) -> list[tuple[str, float, float]]:
    """Numbers of a text without its links and code: each as written, its value, and half of its last digit."""
    text = re.sub(r"<!--.*?-->|`[^`]*`|\]\([^)]*\)", "", text)
    return [
        (word, float(word), 0.5 * 10.0 ** (int(power or 0) - len(decimals or "")))
        for word, decimals, power in NUMBER.findall(text)
    ]


def values(result: dict[str, Any]) -> list[float]:
    """Every number of a result, and the number of its rows."""
    return [len(result["rows"]), *(value for _, value, _ in numbers(json.dumps(result).replace("`", "")))]


def faults() -> list[str]:
    """A sentence for each table that is not the stored one, and for each number that no stored result has."""
    found = []
    for page in pages():
        text = page.read_text()
        found += [f"{page.name}: the table is not docs/measured/{name}.json" for name, rows in TABLE.findall(text)
                  if rows != table(name)]  # fmt: skip
        for match in [*PARAGRAPH.finditer(text), *ROW.finditer(text)]:
            known = [value for name in match[1].split() for value in values(stored(name))]
            found += [
                f"{page.name}: no result in {match[1]} has the number {word}"
                for word, value, half in numbers(match[0])
                if not any(abs(value - other) <= half * (1 + 1e-9) for other in known)
            ]
    return found


def setup(_app: Any) -> dict[str, bool]:
    """Warn of each fault of the pages of this Sphinx application, which ends the build."""
    from sphinx.util import logging

    for fault in faults():
        logging.getLogger(__name__).warning(fault)
    return {"parallel_read_safe": True}


if __name__ == "__main__":
    for page in pages():
        page.write_text(TABLE.sub(lambda match: f"{match[1]} -->\n{table(match[1])}", page.read_text()))
