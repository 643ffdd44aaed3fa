"""The rows of a study on disk: JSON lines as they come, a CSV table of them."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path
from typing import Any

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import write_text


class RowFile:
    """rows.jsonl and rows.csv in a folder (one rank).

    Raises:
        InputError: If the folder cannot be written.
    """

    def __init__(self, folder: Path):
        self.folder, self.rows = folder, list[dict[str, Any]]()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "rows.jsonl").write_text("")
        except OSError as error:
            raise InputError(f"{folder}: {error.strerror}; choose another folder with --output") from None

    def add(self, row: dict[str, Any]) -> None:
        """Write a row; when this returns it is on the disk."""
        self.rows.append(row)
        with (self.folder / "rows.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")
            file.flush()
            os.fsync(file.fileno())
        write_text(self.folder / "rows.csv", _csv([flat(row) for row in self.rows]))


def flat(row: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """One level of dotted keys."""
    result: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, dict):
            result |= flat(value, f"{prefix}{key}.")
        else:
            result[prefix + key] = value
    return result


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    heads = list(dict.fromkeys(key for row in rows for key in row))
    writer = csv.DictWriter(text, heads)
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
