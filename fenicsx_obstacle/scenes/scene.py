"""Scene: an obstacle problem from a TOML file or from Python, without a mesh."""

from __future__ import annotations

import keyword
import unicodedata
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from fenicsx_obstacle.algebra.options import EpsFormula, SolverOptions
from fenicsx_obstacle.discrete.model import Model, Part
from fenicsx_obstacle.discrete.time_discretization import TimeDiscretization
from fenicsx_obstacle.effects.effect import Effect, find, known
from fenicsx_obstacle.effects.field import ByCells, Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair, pair_for, pairs
from fenicsx_obstacle.measured.table import MeasuredField, Table
from fenicsx_obstacle.scenes import formulas, tables
from fenicsx_obstacle.scenes.boundary_table import check_parts, part_place
from fenicsx_obstacle.scenes.data_files import DataFiles
from fenicsx_obstacle.scenes.fields import FormulaField
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.from_python import Objects, OwnMesh, field_of, plain, stands_for_an_object
from fenicsx_obstacle.scenes.profile_table import check_profiles
from fenicsx_obstacle.scenes.report import FIELDS, parse_report
from fenicsx_obstacle.scenes.settings import set_values
from fenicsx_obstacle.scenes.tables import DataTable
from fenicsx_obstacle.scenes.time_table import moments
from fenicsx_obstacle.scenes.vocabulary import CONSTANTS, COORDINATES, TIME, Vocabulary
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.text import nearest, shown

if TYPE_CHECKING:
    from fenicsx_obstacle.estimation.norms import ExactSolution
    from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem

MAX_OPERATIONS = 5000  # of an exact solution: it is differentiated and compiled
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


def _check_effects(effects: Mapping[str, Any]) -> None:
    """Reject a keyword of a Scene that is neither an argument nor an effect.

    Raises:
        InputError: With the similar name of an argument or of an effect, if there is one.
    """
    arguments = [name for name, one in signature(Scene).parameters.items() if one.kind == one.KEYWORD_ONLY]
    for key in effects:
        if key not in known():
            hint = "; u on the boundary is given by boundary=" if key in ("bc", "bcs") else None
            raise InputError(
                f"scene: [effects] unknown effect '{key}'" + (hint or nearest(key, [*known(), *arguments]))
            )


@dataclass(frozen=True, init=False)
class Scene(Vocabulary):
    """The description of an obstacle problem: mesh, data, output quantities and solver options.

    Make it by `Scene(mesh=..., tension=1, lower="0.3 - x^2")` or `Scene.read("ball.toml")`, and solve it by `solve`.

    Attributes:
        name: Short name, for files.
        tables: The tables of the scene, as in TOML.
        model: The problem data without formulas.
        effects: One object per effect that the scene names.
        pair: V_h, the rule I and Q_h.
        report: Output quantities, in order.
        options: The table [solve], without the element.
        own_mesh: A DOLFINx mesh of the caller's own, or None.
        objects: Data that are not numbers or formulas, by their names in the tables.
        folder: Where relative file names start.
    """

    name: str
    source: str
    tables: tables.Tables
    effects: tuple[Effect, ...]
    pair: Pair
    define: Mapping[str, Formula]
    report: Mapping[str, Formula]
    model: Model
    options: SolverOptions
    own_mesh: OwnMesh | None
    objects: Objects
    folder: Path

    def __init__(
        self,
        *,
        mesh: Any,
        facet_tags: Any = None,
        cell_tags: Any = None,
        facet_names: Mapping[str, Any] | None = None,
        cell_names: Mapping[str, Any] | None = None,
        lower: Any = None,
        upper: Any = None,
        boundary: Any = ({"value": 0.0},),
        exact: Any = None,
        define: Mapping[str, float | str] | None = None,
        report: Mapping[str, float | str] | None = None,
        time: Mapping[str, Any] | None = None,
        profile: Mapping[str, Mapping[str, Any]] | None = None,
        title: str = "",
        u: str = "u",
        **effects: Any,
    ):
        """Make a scene in Python; collective if the mesh has tags.

        A datum (an obstacle, a value on the boundary, an effect) may be

        - a number, or a formula in x, y, z (and t), such as "0.3 - r^2";
        - a callable of x, an array of shape (3, n), or of x and t;
        - a Constant; a Function on this mesh, or on another mesh that covers it; a UFL expression on this mesh. These
          keep the values that they have when `solve` is called: they do not depend on the time t.

        Args:
            mesh: A DOLFINx mesh, or a table such as {"shape": "rectangle", "cells": 32} or {"file": "plate.msh"}.
            facet_tags: MeshTags of facets of the mesh.
            cell_tags: MeshTags of cells of the mesh.
            facet_names: A dict with names of boundary parts, and of curves inside the domain, and for each name its tag
                or a list of tags: {"rim": 1}. By default the name of a tag is its number: "1".
            cell_names: A dict with names of materials and their tags, of the same form.
            lower: Lower obstacle, a datum.
            upper: Upper obstacle, a datum.
            boundary: A table as in [[boundary]], or a list of them: boundary=[{"on": "rim", "value": 0}]. By default
                u = 0 on the whole boundary.
            exact: Exact solution, not a callable; or a table as in [exact]: exact={"u": "x", "pressure": 0}.
            define: Names for numbers and formulas, as in [define].
            report: Output quantities by name, as in [report]: report={"force": "integral(p)"}.
            time: Time steps, as in [time]: time={"end": 1, "steps": 100, "start": 0}.
            profile: Lines along which the solution is written, as in [profile]: {"middle": {"from": [0, 0.5], "to": [1,
                0.5]}}.
            title: Title of pictures and reports.
            u: Label of the unknown on axes.
            **effects: One datum for each effect: tension=1, load=-2. A dict has one datum for each material:
                tension={"steel": 1, "tin": 2}.

        Raises:
            InputError: If the data are invalid. Data that need a mesh are checked when the scene is solved.
        """
        if not isinstance(mesh, dict) and not hasattr(mesh, "topology"):
            wanted = "expected a DOLFINx mesh or a table such as {'shape': 'disk'} or {'file': 'plate.msh'}"
            raise InputError(f"scene: mesh = {shown(mesh)}: {wanted}")
        _check_effects(effects)
        parts = [boundary] if isinstance(boundary, Mapping) else [] if boundary is None else boundary
        given = parts if isinstance(parts, list | tuple) else [parts]
        if any(hasattr(part, "dof_indices") for part in given):
            wanted = "expected tables such as {'on': 'left', 'value': 0}; conditions of DOLFINx are for ObstacleProblem"
            raise InputError(f"scene: boundary: {wanted}")
        raw = {
            "title": title, "u": u, "define": {} if define is None else define, "effects": effects,
            "mesh": mesh if isinstance(mesh, dict) else {},
            "obstacle": {key: value for key, value in (("lower", lower), ("upper", upper)) if value is not None},
            "boundary": parts, "report": {} if report is None else report,
            "profile": {} if profile is None else profile, "time": time,
            "exact": exact if exact is None or isinstance(exact, Mapping) else {"u": exact},
        }  # fmt: skip
        tags = (facet_tags, cell_tags, facet_names, cell_names)
        if isinstance(mesh, dict) and any(one is not None for one in tags):
            raise InputError("scene: tags and names of parts go with a DOLFINx mesh; a shape has names of its own")
        self._fill(raw, "scene", Path(), None if isinstance(mesh, dict) else OwnMesh.of(mesh, *tags))

    def __repr__(self) -> str:
        return f"Scene({self.tables.title or self.name!r}, source={self.source!r})"

    @classmethod
    @checked()
    def read(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Scene:
        """Scene from a TOML file (every rank reads it), with other values as in `change`.

        Raises:
            InputError: Naming file, table and key.
        """
        path = Path(path)
        raw = tables.read_toml(path)
        set_values(raw, changes or {}, str(path))
        self = cls.__new__(cls)
        self._fill(raw, str(path), path.parent, None)
        return self

    @checked()
    def change(self, changes: Mapping[str, Any]) -> Scene:
        """The same scene with other values: `scene.change({"mesh.cells": 64, "define.ecc": 0.9})`.

        Raises:
            InputError: If a key is unknown or a value does not fit it.
        """
        raw = msgspec.to_builtins(self.tables)
        set_values(raw, {str(key): value for key, value in changes.items()}, self.source)
        return self.with_tables(raw)

    def with_tables(self, raw: dict[str, Any]) -> Scene:
        """A scene on the same mesh with other tables, as in TOML.

        Raises:
            InputError: If a key is unknown or a value does not fit it.
        """
        new = Scene.__new__(Scene)
        new._fill(raw, self.source, self.folder, self.own_mesh, self.objects)
        return new

    def with_mesh_file(self, file: str) -> Scene:
        """The scene of a mesh of the caller's own, with that mesh in a file."""
        new = Scene.__new__(Scene)
        raw = {**msgspec.to_builtins(self.tables), "mesh": {"file": file}}
        raw["solve"]["element"] = self.pair.name  # which the cells of the mesh may have chosen
        new._fill(raw, self.source, self.folder, None, self.objects)
        return new

    def _fill(
        self, raw: dict[str, Any], source: str, folder: Path, mesh: OwnMesh | None, objects: Objects | None = None
    ) -> None:
        objects = dict(objects or {})
        typed = tables.checked(plain(raw, objects), source)
        set_ = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731  (the class is frozen)
        set_("name", Path(source).stem)
        set_("source", source)
        set_("folder", folder)
        set_("tables", typed)
        set_("own_mesh", mesh)
        set_("objects", objects)
        set_("moves", typed.time is not None)
        set_("define", self._definitions())
        set_("effects", self._effects())
        set_("pair", self._pair(typed.mesh.cell if mesh is None else mesh.cell))
        if mesh is None and (typed.mesh.shape is None) == (typed.mesh.file is None):
            raise InputError(f"{source}: [mesh] needs either a 'shape' or a 'file'")
        set_("model", self._model())
        for field in self.model.data:
            if isinstance(field, FormulaField):
                field.check_names(self.known_names)
        if typed.exact is not None:
            self._check_exact(typed.exact.u, "[exact] u")
            if typed.exact.pressure is not None:
                self._check_exact(typed.exact.pressure, "[exact] pressure")
        if self.model.vector_valued:
            self._check_body()
        set_("report", parse_report(self, typed.report, RESERVED))
        solve, place = typed.solve, f"{source}: [solve]"
        set_("options", SolverOptions(solve.method, self._eps(solve.eps), solve.start, place))
        check_parts(self)
        check_profiles(self)
        set_("model", replace(self.model, time=moments(self)))

    @property
    def time(self) -> TimeDiscretization | None:
        """The moments, or None."""
        return self.model.time

    @property
    def exact(self) -> ExactSolution | None:
        """The exact solution, or None."""
        table = self.tables.exact
        if table is None:
            return None
        from fenicsx_obstacle.estimation.norms import ExactSolution  # reading a scene imports no finite elements

        pressure = None if table.pressure is None else self.field(table.pressure, "[exact] pressure")
        return ExactSolution(self.field(table.u, "[exact] u"), pressure)

    @property
    def sides(self) -> list[str]:
        """The names of the given obstacles, in the domain or on its boundary: lower, upper."""
        if self.model.vector_valued:  # the pressure of obstacles on the body is >= 0
            return ["lower"] if any(part.obstacle is not None for part in self.tables.boundary) else []
        places = self.tables.boundary if self.model.thin else [self.tables.obstacle]
        return [side for side in ("lower", "upper") if any(getattr(place, side) is not None for place in places)]

    @property
    def penalised(self) -> bool:
        """Whether there is an eps."""
        return bool(self.sides) and self.options.method != "vi"

    def options_with(self, **changes: Any) -> SolverOptions:
        """`options` with other values, as in [solve]: `scene.options_with(method="penalty", eps="h^2")`.

        Raises:
            InputError: If a value does not fit its key.
        """
        if "eps" in changes:
            changes["eps"] = self._eps(changes["eps"])
        return replace(self.options, **changes)

    def with_options(self, options: SolverOptions) -> Scene:
        """The scene with these values in its table [solve]."""
        eps = options.eps.text if isinstance(options.eps, EpsFormula) else options.eps
        solve = msgspec.structs.replace(self.tables.solve, method=options.method, start=options.start, eps=eps)
        new = copy(self)
        object.__setattr__(new, "tables", msgspec.structs.replace(self.tables, solve=solve))
        object.__setattr__(new, "options", options)
        return new

    def _eps(self, value: float | str) -> float | str | EpsFormula:
        """A value of [solve] eps as options take it: a formula may use names of [define]."""
        if not isinstance(value, str) or value == "auto":
            return value
        formula = self.formula(value, "[solve] eps")
        return EpsFormula(value, partial(self._eps_at, value), "h" in formula.names)

    def _eps_at(self, text: str, h: float) -> float:
        return self.number(text, "[solve] eps", {"h": h})

    def _definitions(self) -> dict[str, Formula]:
        definitions: dict[str, Formula] = {}
        known = {*CONSTANTS, *COORDINATES, "distance", *([TIME] if self.moves else [])}
        for key, value in self.tables.define.items():
            place = f"[define] {key}"
            if not key.isidentifier() or keyword.iskeyword(key) or unicodedata.normalize("NFKC", key) != key:
                wanted = "letters, digits and _, and no word of Python"
                raise InputError(f"{self.source}: {place}: not a name; take {wanted}")
            if key in RESERVED:
                raise InputError(f"{self.source}: {place}: '{key}' has a meaning already; choose another name")
            formula = self.formula(value, place)
            formula.check_names(known)
            definitions[key] = formula
            known.add(key)
        return definitions

    def use_cells(self, cell: str) -> None:
        """Take the default element for the cells of a file, once these are known, where [solve] names no element."""
        object.__setattr__(self, "pair", self._pair(cell))  # the class is frozen

    def _pair(self, cell: str | None) -> Pair:
        asked, known = self.tables.solve.element, pairs()
        name = pair_for(cell or "") if asked is None else asked
        if name not in known:
            raise InputError(f"{self.source}: [solve] element = {name!r} is not known" + nearest(name, known))
        return known[name]

    def _effects(self) -> tuple[Effect, ...]:
        """The effects of [effects] and [[boundary]]; only modules of named effects are imported."""
        keys = known()
        for key in self.tables.effects:
            if key not in keys:
                raise InputError(f"{self.source}: [effects] unknown effect '{key}'" + nearest(key, keys))
        elastic = [key for key in self.tables.effects if find(key).elastic]
        if not elastic:
            raise InputError(f"{self.source}: [effects] has no stiffness: add 'tension = 1'")
        if len(elastic) > 1:
            raise InputError(f"{self.source}: [effects] names {' and '.join(elastic)}: only one of them is allowed")
        effects = [find(key).read(value, f"[effects] {key}", self) for key, value in self.tables.effects.items()]
        for number, part in enumerate(self.tables.boundary):
            for key in sorted(known("boundary")):
                raw = getattr(part, key)
                if raw is not None:
                    effects.append(find(key).read(raw, f"{part_place(number)} {key}", self, part=number))
        self._check_kinds(effects)
        for effect in effects:
            if (why := effect.conflict(effects)) is not None:
                place = "[effects]" if effect.table == "effects" else "[[boundary]]"
                raise InputError(f"{self.source}: {place} {why}")
        return tuple(effects)

    @property
    def of_body(self) -> bool:
        """Whether u is the displacement of an elastic body."""
        return any(find(key).elastic and bool(find(key).vector_valued) for key in self.tables.effects)

    def _check_kinds(self, effects: list[Effect]) -> None:
        """Reject effects of scalar u beside an elastic body, and the other way round."""
        wanted = next(effect.vector_valued for effect in effects if effect.elastic)
        for effect in effects:
            if effect.vector_valued not in (None, wanted):
                place = "[effects]" if effect.table == "effects" else part_place(getattr(effect, "part", 0))
                why = "is for scalar u, not for elastic bodies" if wanted else "is for elastic bodies ('elasticity')"
                given = " = " + effect.text if effect.key == "load" else ""
                hint = "; give a list of components" if effect.key == "load" and wanted else ""
                raise InputError(f"{self.source}: {place} {effect.key}{given}: {why}{hint}")

    @property
    def mesh(self) -> Any:
        """The caller's own DOLFINx mesh, or None."""
        return None if self.own_mesh is None else self.own_mesh.mesh

    def field(self, value: Any, place: str) -> Field:
        """A number, a formula, a table of measured data or an object as a datum; `place` is its table and key."""
        if isinstance(value, DataTable):
            return self._table(value, place).on(f"{self.source}: {place}")
        if stands_for_an_object(value):
            found = field_of(str(value), self.objects, f"{self.source}: {place}")
            if found.moves and self.tables.time is None:
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

    def _model(self) -> Model:
        """Without time, which depends on the effects."""
        parts = []
        for number, table in enumerate(self.tables.boundary):
            place = part_place(number)
            on = (table.on,) if isinstance(table.on, str) else table.on
            given = self._given(table, place, "where", "value", "lower", "upper")
            if isinstance(components := given.get("value"), tuple):
                given = {**given, "value": None, "components": components}
            parts.append(Part(place, on, **given))
        sides = self._given(self.tables.obstacle, "[obstacle]", "lower", "upper")
        return Model(self.effects, **sides, boundary=tuple(parts), source=self.source)

    def _given(self, table: Any, place: str, *keys: str) -> dict[str, Any]:
        """The data of a table that are given."""
        values = {key: getattr(table, key) for key in keys}
        return {key: self._datum(value, f"{place} {key}") for key, value in values.items() if value is not None}

    def _datum(self, value: Any, place: str) -> Field | tuple[Field | None, ...]:
        """A datum, or the components of a displacement, None for one that is "free"."""
        if not isinstance(value, tuple):
            return self.field(value, place)
        return tuple(None if one == "free" else self.field(one, f"{place}[{k}]") for k, one in enumerate(value))

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
            return self.field(tables.data_table(value, f"{self.source}: {place}"), place)
        for name, part in value.items():
            if isinstance(part, dict) and isinstance(part.get("file"), str):
                value = {**value, name: tables.data_table(part, f"{self.source}: {place}.{name}")}
            elif isinstance(part, dict | list):
                raise InputError(f"{self.source}: {place}.{name} = {part!r}: expected a number or a formula")
        return ByCells({name: self.field(part, f"{place}.{name}") for name, part in value.items()},
                       f"{self.source}: {place}")  # fmt: skip

    def _check_exact(self, value: float | str, place: str) -> None:
        if stands_for_an_object(value):
            return
        formula = self.formula(value, place)
        formula.check_names({*self.known_names, "eps"})
        if (count := self.operations(formula)) > MAX_OPERATIONS:
            words = f"{count:.3g} operations after its definitions are inserted; the limit is {MAX_OPERATIONS}"
            raise InputError(f"{formula.place}: {words}")
        if "distance" in self.needs(formula):
            raise InputError(f"{formula.place}: 'distance' has no gradient, so it is not allowed in [exact]")

    def only_scalar(self, what: str) -> None:
        """Reject a scene with an elastic body.

        Args:
            what: What is for scalar u only.

        Raises:
            InputError: In one sentence.
        """
        if self.model.vector_valued:
            raise InputError(f"{self.source}: {what}: for scalar u only, not for elastic bodies")

    def _check_body(self) -> None:
        """Reject tables that elastic bodies do not have."""
        own = self.tables
        for name, given, why in (
            ("exact", own.exact, "is for scalar u; compare output quantities under [report]"),
            ("obstacle", own.obstacle != tables.ObstacleTable(), "bounds a scalar u; give [[boundary]] an obstacle"),
        ):
            if given:
                raise InputError(f"{self.source}: [{name}] with elasticity: {why}")
        from fenicsx_obstacle.effects.boundary.obstacle import FROM_FILES, Obstacle  # no scalar scene needs it

        for effect in self.effects:
            if isinstance(effect, Obstacle) and effect.kind in FROM_FILES:
                data, of_facets = effect.value, effect.kind == "stl"
                if not isinstance(data, MeasuredField) or (of_facets and data.facets is None):
                    wanted = '{file = "surface.stl"}' if of_facets else "{file = ...} of measured data"
                    raise InputError(f"{effect.source}.{effect.kind} = {getattr(data, 'text', '')}: expected {wanted}")
        if self.pair.name not in ("P1", "P2", "Q1", "Q2"):
            raise InputError(f"{self.source}: [solve] element = '{self.pair.name}': elastic bodies take P1, P2, Q1, Q2")

    def problem(self, comm: Any = None) -> ObstacleProblem:
        """The scene on its mesh, as a problem that is solved from Python (collective).

        Args:
            comm: Ranks that share the mesh, by default all; not used if the scene has a DOLFINx mesh.

        Raises:
            InputError: If the scene has [time], or no u can satisfy the data.
        """
        from mpi4py import MPI

        from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
        from fenicsx_obstacle.scenes import meshes

        ranks = self.mesh.comm if self.mesh is not None else comm or MPI.COMM_WORLD
        if self.model.vector_valued:
            from fenicsx_obstacle.scenes.bodies import Body  # only where a scene names an elastic body

            if self.time is not None:
                raise InputError(f"{self.source}: an ObstacleProblem is one equilibrium; solve() takes [time]")
            return Body(self, meshes.build(self, ranks)).problem
        return ObstacleProblem.of_model(self.model, meshes.build(self, ranks))

    def toml(self) -> str:
        """The scene as TOML text that `Scene.read` takes."""
        return msgspec.toml.encode(self.tables).decode()

    def with_data(self) -> tuple[str, dict[str, bytes]]:
        """The same text with measured data in files beside it, and the contents of these by their names.

        Raises:
            InputError: If a file cannot be read any more.
        """
        kept = DataFiles(self.folder, self.objects)
        raw = kept.renamed(msgspec.to_builtins(self.tables))
        return msgspec.toml.encode(tables.checked(raw, self.source)).decode(), kept.contents
