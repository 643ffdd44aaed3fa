"""What TOML cannot represent: data that are objects, measured data in files beside a saved scene, meshes with tags."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from fenicsx_obstacle.data.measured.surface import Table
from fenicsx_obstacle.effects.field import Field, Names
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.tags import check_tags
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.text import shown

Objects = dict[str, Any]  # by the names that stand for them in the tables
_BEFORE, _AFTER = "<data from Python: ", ">"
PREFIX = "data-"  # of the names of files of measured data


def is_object(value: Any) -> bool:
    """Whether a value is a Constant, a Function, a UFL expression, a callable, a Table or a Field."""
    return (
        isinstance(value, Field | Table)
        or hasattr(value, "ufl_shape")
        or (callable(value) and not isinstance(value, type))
    )


def plain(value: Any, objects: Objects, place: str = "") -> Any:
    """Tables in which objects are replaced by names, and NumPy's numbers and arrays by those of Python."""
    if isinstance(value, Table) and value.file is not None:
        return plain(value.in_toml, objects, place)
    if is_object(value):
        name = f"{_BEFORE}{place}{_AFTER}"
        objects[name] = value
        return name
    if isinstance(value, Mapping):
        found = {}
        for key, part in value.items():
            name = str(key) if isinstance(key, int | np.integer) else key  # the number of a tag
            found[name] = plain(part, objects, f"{place}.{name}" if place else str(name))
        return found
    if isinstance(value, list | tuple):
        return [plain(part, objects, f"{place}[{number}]") for number, part in enumerate(value)]
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def stands_for_an_object(value: Any) -> bool:
    """Whether a value of a table is such a name."""
    return isinstance(value, str) and value.startswith(_BEFORE) and value.endswith(_AFTER)


def field_of(name: str, objects: Objects, place: str) -> Field:
    """The datum that a name stands for; of a saved scene it can be named, but not evaluated.

    Raises:
        InputError: If it is no scalar.
    """
    if name not in objects:
        return _Gone(name, place)
    from fenicsx_obstacle.data.fields import field  # only where there is one: it imports finite elements

    return field(objects[name], place)


class _Gone(Field):
    """A placeholder for an object of a saved scene, which cannot be evaluated."""

    def __init__(self, text: str, source: str):
        self.text, self.source = text, source

    def on(self, level: Level) -> Field:  # on all ranks, before any of them asks for values
        return self._raise()

    def at(self, x: np.ndarray, names: Names, cells: np.ndarray | None = None) -> np.ndarray:
        return self._raise()

    def _raise(self) -> NoReturn:
        raise InputError(f"{self.source} was given in Python and is not in the file; set it again by `change`")


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


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """A mesh of the caller's own, and the names of its parts.

    Attributes:
        mesh: The mesh.
        facets: Local facets of each named part of the boundary or curve inside.
        cells: Owned cells of each named material.
    """

    mesh: Any
    facets: dict[str, np.ndarray]
    cells: dict[str, np.ndarray]

    @classmethod
    def of(cls, mesh: Any, facet_tags: Any, cell_tags: Any, facet_names: Any, cell_names: Any) -> OwnMesh:
        """From MeshTags and the names of their values (collective if there are tags).

        Raises:
            InputError: If tags are of another mesh or dimension, or a name is of no facet or cell.
        """
        dim = mesh.topology.dim
        facets = _named(mesh, facet_tags, facet_names, dim - 1, "facet")
        cells = _named(mesh, cell_tags, cell_names, dim, "cell")
        own = mesh.topology.index_map(dim).size_local
        return cls(mesh, facets, {name: found[found < own] for name, found in cells.items()})


def _named(mesh: Any, tags: Any, names: Any, dim: int, kind: str) -> dict[str, np.ndarray]:
    """Entities by the names of their tags; without names by the numbers."""
    if tags is None:
        if names:
            raise InputError(f"scene: {kind}_names needs {kind}_tags, the MeshTags that have these numbers")
        return {}
    check_tags(tags, mesh, dim, f"scene: {kind}_tags")
    if names is None:
        names = {str(one): one for one in set().union(*mesh.comm.allgather(np.unique(tags.values).tolist()))}
    if not isinstance(names, Mapping):
        raise InputError(f"scene: {kind}_names = {shown(names)}: expected a dict, such as {{'rim': 1}}")
    found = {}
    for name, number in names.items():
        numbers = number if isinstance(number, list | tuple) else (number,)
        if not isinstance(name, str) or not all(isinstance(one, int | np.integer) for one in numbers):
            got = f"{shown(name)}: {shown(number)}"
            raise InputError(f"scene: {kind}_names = {{{got}}}: expected names with their tags, such as {{'rim': 1}}")
        there = [tags.find(int(one)) for one in numbers]
        found[str(name)] = np.unique(np.concatenate(there)).astype(np.int32)
        if total(mesh.comm, len(found[str(name)])) == 0:
            raise InputError(f"scene: {kind}_names: '{name}' = {number}: no {kind} has this tag")
    return found
