"""Renew the tables and pictures of docs/stability.md from a run of the whole suite.

./obstacle hard && .venv/bin/python benchmarks/stability.py [out/hard]
"""

import shutil
import sys
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
LAST = "## Measured\n"


def renew(folder: Path) -> None:
    """Put tables.md in place of the tables, and the pictures beside."""
    page = DOCS / "stability.md"
    text = page.read_text()
    after = text.index(LAST)
    start = text.find("\n### ", after)
    kept = text if start < 0 else text[: start + 1]
    page.write_text(kept.rstrip("\n") + "\n\n" + (folder / "tables.md").read_text())
    for name in ("digits.png", "steps.png"):
        shutil.copy(folder / name, DOCS / name)


if __name__ == "__main__":
    renew(Path(sys.argv[1] if len(sys.argv) > 1 else "out/hard"))
