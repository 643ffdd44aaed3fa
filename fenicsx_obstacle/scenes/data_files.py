"""Files of measured data beside a saved scene, so that it can be solved again elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.measured.table import Table

PREFIX = "data-"  # of the names of these files


def with_files(
    raw: Mapping[str, Any], folder: Path, objects: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Tables of a scene with the names of files beside the saved scene, and what is in each file (rank 0 reads them).

    Args:
        raw: The tables.
        folder: Where relative names of files in them start.
        objects: Data that are no numbers or formulas, by the names that stand for them.

    Raises:
        InputError: If a file cannot be read.
    """
    contents, names = dict[str, bytes](), dict[Any, str]()

    def named(key: Path | str, wanted: str, content: Callable[[], bytes]) -> str:
        """The name of a file, whose content is taken where it has none yet."""
        if key not in names:
            names[key] = free = PREFIX + wanted.removeprefix(PREFIX)
            number = 1
            while names[key] in contents:
                number += 1
                names[key] = f"{Path(free).stem}-{number}{Path(free).suffix}"
            contents[names[key]] = content()
        return names[key]

    def of_file(path: Path) -> str:
        try:
            return named(path, path.name, path.read_bytes)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: {getattr(error, 'strerror', error)}") from None

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            found = {key: renamed(part) for key, part in value.items()}
            return found | ({"file": of_file(folder / value["file"])} if isinstance(value.get("file"), str) else {})
        if isinstance(value, list | tuple):
            return [renamed(part) for part in value]
        table = objects.get(value) if isinstance(value, str) else None
        if not isinstance(table, Table):
            return value
        return {**table.in_toml, "file": named(value, "arrays.npz", partial(_archive, table))}

    return {key: value if key == "mesh" else renamed(value) for key, value in raw.items()}, contents


def _archive(table: Table) -> bytes:
    """The arrays of measured data, as the content of a file."""
    packed = BytesIO()
    np.savez_compressed(packed, **table.arrays)
    return packed.getvalue()
