"""Files of measured data beside a saved scene, so that it can be solved again elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.measured.table import Table

PREFIX = "data-"  # of the names of these files


class DataFiles:
    """Measured data of a scene, by the names of their files beside the saved scene.

    Attributes:
        contents: What is in each file.
    """

    def __init__(self, folder: Path, objects: Mapping[str, Any]):
        """Begin with none.

        Args:
            folder: Where relative names of the scene start.
            objects: Its data that are no numbers or formulas, by the names that stand for them.
        """
        self.contents: dict[str, bytes] = {}
        self._folder, self._objects = folder, objects
        self._names: dict[Any, str] = {}

    def renamed(self, raw: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of a scene with the names of these files (rank 0 reads the files).

        Raises:
            InputError: If a file cannot be read.
        """
        return {key: value if key == "mesh" else self._with_names(value) for key, value in raw.items()}

    def _with_names(self, value: Any) -> Any:
        if isinstance(value, dict):
            found = {key: self._with_names(part) for key, part in value.items()}
            return found | ({"file": self._of_file(value["file"])} if isinstance(value.get("file"), str) else {})
        if isinstance(value, list | tuple):
            return [self._with_names(part) for part in value]
        table = self._objects.get(value) if isinstance(value, str) else None
        return {**table.in_toml, "file": self._of_arrays(value, table)} if isinstance(table, Table) else value

    def _of_file(self, file: str) -> str:
        path = self._folder / file
        try:
            return self._named(path, path.name, path.read_bytes)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: {getattr(error, 'strerror', error)}") from None

    def _of_arrays(self, key: str, table: Table) -> str:
        def archive() -> bytes:
            packed = BytesIO()
            np.savez_compressed(packed, **table.arrays)
            return packed.getvalue()

        return self._named(key, "arrays.npz", archive)

    def _named(self, key: Any, name: str, content: Any) -> str:
        """The name of a file, which is read where it has none yet."""
        if key not in self._names:
            free = wanted = PREFIX + name.removeprefix(PREFIX)
            number = 1
            while free in self.contents:
                number += 1
                free = f"{Path(wanted).stem}-{number}{Path(wanted).suffix}"
            self._names[key], self.contents[free] = free, content()
        return self._names[key]
