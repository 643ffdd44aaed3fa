"""The catalogue of scenes as a table."""

from __future__ import annotations

from fenicsx_obstacle.scenes import catalogue

HEADS = ("name", "title", "free boundary", "regularity")


def list_scenes() -> str:
    """One line for each scene."""
    rows = [HEADS]
    for name in catalogue.names():
        tables = catalogue.scene(name).tables
        assert tables.exact is not None
        rows.append((name, tables.title, tables.exact.free, tables.exact.regularity))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
