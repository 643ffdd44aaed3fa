"""Renew the tables of docs/tables/hard_scenes.md from a run of the suite or of families.

./obstacle hard && .venv/bin/python benchmarks/stability.py [out/hard]
./obstacle hard drift --output out/drift && .venv/bin/python benchmarks/stability.py out/drift
"""

import sys
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
LAST = "## Measured\n"
HEADING = "\n### "
WHOLE = 60  # scenes at least: tables of the whole suite replace all others


def families(text: str) -> dict[str, str]:
    """The table of each family by its heading."""
    parts = (HEADING + part for part in ("\n" + text).split(HEADING)[1:])
    return {part.strip().partition("\n")[0]: part.strip("\n") for part in parts}


def renew(folder: Path) -> None:
    """Put the tables of tables.md in place of those of the same families."""
    page = DOCS / "tables" / "hard_scenes.md"
    text, new = page.read_text(), families((folder / "tables.md").read_text())
    start = text.find(HEADING, text.index(LAST))
    head, old = (text, {}) if start < 0 else (text[:start], families(text[start:]))
    whole = sum(table.count("\n") - 3 for table in new.values()) >= WHOLE
    tables = new if whole else {**old, **new}
    page.write_text("\n\n".join([head.rstrip("\n"), *tables.values()]) + "\n")


if __name__ == "__main__":
    renew(Path(sys.argv[1] if len(sys.argv) > 1 else "out/hard"))
