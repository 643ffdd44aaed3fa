"""What the tables of a scene say before there are effects: names, data, mesh and element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.measured.surface import Table
from fenicsx_obstacle.effects.effect import Elastic, find
from fenicsx_obstacle.effects.field import ByCells, Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair, pair_for, pairs
from fenicsx_obstacle.scenes import formulas
from fenicsx_obstacle.scenes.fields import FormulaField
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.from_python import Objects, OwnMesh, field_of, stands_for_an_object
from fenicsx_obstacle.scenes.tables import DataTable, Tables, as_structure
from fenicsx_obstacle.scenes.vocabulary import CONSTANTS, COORDINATES, TIME, Vocabulary
from fenicsx_obstacle.text import nearest

NORMAL_FLUX = "normal_flux"  # tension du/dn: on a part of the boundary only
JUMP = "jump"  # of tension du/dn across a curve inside
FIELDS = ("u", "p", "contact", "slope", "flux", NORMAL_FLUX, JUMP)
RESERVED = {
    *COORDINATES,
    *CONSTANTS,
    *FIELDS,
    TIME,
    "distance",
    "eps",
    "h",
    *formulas.FUNCTIONS,
    *formulas.FUNCTIONALS,
}


@dataclass(frozen=True)
class Definitions(Vocabulary):
    """The tables of a scene, with the names, the data, the mesh and the element in them; effects are read with it.

    Attributes:
        source: Where the scene comes from, for messages.
        folder: Where relative file names start.
        tables: The tables of the scene, as in TOML.
        own_mesh: A DOLFINx mesh of the caller's own, or None.
        objects: Data that are not numbers or formulas, by their names in the tables.
        define: Formula of each defined name, in order.
        pair: V_h, the rule I and Q_h.
    """

    source: str
    folder: Path
    tables: Tables
    own_mesh: OwnMesh | None
    objects: Objects
    define: Mapping[str, Formula]
    pair: Pair

    @classmethod
    def of(cls, typed: Tables, source: str, folder: Path, mesh: OwnMesh | None, objects: Objects) -> Definitions:
        """Those of typed tables.

        Raises:
            InputError: If a name of [define] or the element is wrong, or there is no mesh.
        """
        pair = pair_of(typed, source, typed.mesh.cell if mesh is None else releases.cell_name(mesh.mesh))
        if mesh is None and (typed.mesh.shape is None) == (typed.mesh.file is None):
            raise InputError(f"{source}: [mesh] needs either a 'shape' or a 'file'")
        return cls(source, folder, typed, mesh, objects, _definitions(typed, source), pair)

    @property
    def moves(self) -> bool:  # type: ignore[override]
        return self.tables.time is not None

    @property
    def mesh(self) -> Any:
        """The caller's own DOLFINx mesh, or None."""
        return None if self.own_mesh is None else self.own_mesh.mesh

    @property
    def of_body(self) -> bool:
        """Whether u is the displacement of an elastic body."""
        return any(issubclass(find(key), Elastic) and bool(find(key).vector_valued) for key in self.tables.effects)

    def field(self, value: Any, place: str) -> Field:
        """A number, a formula, a table of measured data or an object as a datum; `place` is its table and key."""
        if isinstance(value, DataTable):
            return self._table(value, place).on(f"{self.source}: {place}")
        if stands_for_an_object(value):
            found = field_of(str(value), self.objects, f"{self.source}: {place}")
            if found.moves and not self.moves:
                raise InputError(f"{found.source}: the callable takes x and t, and the scene has no time: give time=")
            return found
        return FormulaField(self.formula(value, place), self)

    def _table(self, given: DataTable, place: str) -> Table:
        """Measured data; numbers of their tables may be formulas of constants."""

        def number(key: str, value: Any) -> Any:
            if isinstance(value, tuple):
                return [number(key, one) for one in value]
            return self.number(value, f"{place} {key}")

        keys = {key: getattr(given, key) for key in DataTable.__struct_fields__ if key != "file"}
        values: dict[str, Any] = {key: None if one is None else number(key, one) for key, one in keys.items()}
        return Table(given.file, **values, folder=self.folder)

    def value(self, value: Any, place: str) -> Field:
        """A number, a formula, or one of these for each material.

        Raises:
            InputError: If it is anything else.
        """
        if isinstance(value, bool) or not isinstance(value, float | int | str | dict) or value == {}:
            wanted = "a number, a formula or {material = value}"
            raise InputError(f"{self.source}: {place} = {value!r}: expected {wanted}")
        if not isinstance(value, dict):
            return self.field(value, place)
        if isinstance(value.get("file"), str):
            return self.field(as_structure(value, DataTable, f"{self.source}: {place}"), place)
        for name, part in value.items():
            if isinstance(part, dict) and isinstance(part.get("file"), str):
                value = {**value, name: as_structure(part, DataTable, f"{self.source}: {place}.{name}")}
            elif isinstance(part, dict | list):
                raise InputError(f"{self.source}: {place}.{name} = {part!r}: expected a number or a formula")
        return ByCells({name: self.field(part, f"{place}.{name}") for name, part in value.items()},
                       f"{self.source}: {place}")  # fmt: skip

    def components(
        self,
        raw: Any,
        place: str,
        counts: Sequence[int] = (2, 3),
        wanted: str = "a list of two or three numbers or formulas",
    ) -> tuple[Field, ...]:
        """The components of a vector.

        Args:
            raw: As it stands in the scene.
            place: Where, for messages.
            counts: How many components there may be.
            wanted: The same, in words.

        Raises:
            InputError: If it is not a list of so many numbers or formulas.
        """
        known = isinstance(raw, list | tuple) and len(raw) in counts
        if not known or any(isinstance(one, list | dict) for one in raw):
            raise InputError(f"{self.source}: {place} = {raw!r}: expected {wanted}")
        return tuple(self.field(one, f"{place}[{k}]") for k, one in enumerate(raw))

    def table(
        self, raw: Any, place: str, needed: Sequence[str], optional: Sequence[str] = (), one_of: Sequence[str] = ()
    ) -> dict[str, Any]:
        """A table of several data, with checked keys.

        Raises:
            InputError: If it is no table, a key is unknown or a needed one is missing, or all of `one_of`.
        """
        wanted = ", ".join((*needed, *optional))
        if not isinstance(raw, dict):
            raise InputError(f"{self.source}: {place} = {raw!r}: expected a table of {wanted}")
        for key in raw:
            if key not in (*needed, *optional):
                raise InputError(f"{self.source}: {place} unknown key '{key}' (known: {wanted})")
        for key in needed:
            if key not in raw:
                raise InputError(f"{self.source}: {place}: the key '{key}' is missing")
        if one_of and not set(one_of) & set(raw):
            raise InputError(f"{self.source}: {place}: needs {' or '.join(one_of)}")
        return raw


def _definitions(typed: Tables, source: str) -> dict[str, Formula]:
    """The formulas of [define], each of the names before it."""
    definitions: dict[str, Formula] = {}
    known = {*CONSTANTS, *COORDINATES, "distance", *([] if typed.time is None else [TIME])}
    for key, value in typed.define.items():
        place = f"{source}: [define] {key}"
        formulas.check_name(key, place)
        if key in RESERVED:
            raise InputError(f"{place}: '{key}' has a meaning already; choose another name")
        definitions[key] = formulas.parse(value, place)
        definitions[key].check_names(known)
        known.add(key)
    return definitions


def pair_of(typed: Tables, source: str, cell: str | None) -> Pair:
    """The element that [solve] names, or the default one of some cells."""
    asked, known = typed.solve.element, pairs()
    name = pair_for(cell or "") if asked is None else asked
    if name not in known:
        raise InputError(f"{source}: [solve] element = {name!r} is not known" + nearest(name, known))
    return known[name]
