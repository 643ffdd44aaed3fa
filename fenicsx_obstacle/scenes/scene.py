"""Scene: an obstacle problem from a TOML file or from Python, without a mesh."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from fenicsx_obstacle.algebra.options import EpsFormula, SolverOptions
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.data.time_discretization import TimeDiscretization
from fenicsx_obstacle.effects.effect import Effect, known
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import Pair
from fenicsx_obstacle.scenes import tables
from fenicsx_obstacle.scenes.definitions import Definitions
from fenicsx_obstacle.scenes.formulas import Formula
from fenicsx_obstacle.scenes.from_python import Objects, OwnMesh, plain, with_files
from fenicsx_obstacle.scenes.from_tables import check_body, check_exact, check_parts, effects_of, model_of
from fenicsx_obstacle.scenes.report import of_profile, parse_report
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.text import nearest, shown

if TYPE_CHECKING:
    from fenicsx_obstacle.estimation.norms import ExactSolution
    from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem


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
class Scene(Definitions):
    """The description of an obstacle problem: mesh, data, output quantities and solver options.

    Make it by `Scene(mesh=..., tension=1, lower="0.3 - x^2")` or `Scene.read("ball.toml")`, and solve it by `solve`.
    It has all attributes of `Definitions`, such as `tables`.

    Attributes:
        effects: One object per effect that the scene names.
        report: Output quantities, in order.
        model: The problem data without formulas.
        options: The table [solve], without the element.
    """

    effects: tuple[Effect, ...]
    report: Mapping[str, Formula]
    model: Model
    options: SolverOptions

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
        tables.set_values(raw, changes or {}, str(path))
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
        tables.set_values(raw, {str(key): value for key, value in changes.items()}, self.source)
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
        """Set all attributes: from what the tables say by themselves to what depends on several of them."""
        objects = dict(objects or {})
        given = Definitions.of(tables.checked(plain(raw, objects), source), source, folder, mesh, objects)
        effects = effects_of(given)
        model = model_of(given, effects)
        check_exact(given)
        check_body(given, effects)
        report = parse_report(given)
        solve = given.tables.solve
        options = SolverOptions(solve.method, _eps(given, solve.eps), solve.start, f"{source}: [solve]")
        check_parts(given)
        for name in given.tables.profile:
            of_profile(given, name)
        vars(self).update(vars(given), effects=effects, model=model, report=report, options=options)

    @property
    def name(self) -> str:
        """Short name, for files."""
        return Path(self.source).stem

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
    def quantities(self) -> dict[str, str]:
        """The output quantities by the names that commands take, with their dotted keys in the record of a solution."""
        forces = {f"force.{side}": f"contact.{side}.force" for side in self.sides}
        if len(forces) == 1:
            forces["force"] = next(iter(forces.values()))
        contact = {"area": "contact.area", "penetration": "penetration", **forces} if forces else {}
        return {"energy": "energy", **contact, **{name: f"report.{name}" for name in self.report}}

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
            changes["eps"] = _eps(self, changes["eps"])
        return replace(self.options, **changes)

    def with_options(self, options: SolverOptions) -> Scene:
        """The scene with these values in its table [solve]."""
        eps = options.eps.text if isinstance(options.eps, EpsFormula) else options.eps
        solve = msgspec.structs.replace(self.tables.solve, method=options.method, start=options.start, eps=eps)
        return self._with(tables=msgspec.structs.replace(self.tables, solve=solve), options=options)

    def with_pair(self, pair: Pair) -> Scene:
        """The scene with the element of its mesh, which the cells of a file may have chosen."""
        return self._with(pair=pair)

    def _with(self, **attributes: Any) -> Scene:
        """A copy with other attributes."""
        new = copy(self)
        vars(new).update(attributes)
        return new

    def only_scalar(self, what: str) -> None:
        """Reject a scene with an elastic body.

        Args:
            what: What is for scalar u only.

        Raises:
            InputError: In one sentence.
        """
        if self.model.vector_valued:
            raise InputError(f"{self.source}: {what}: for scalar u only, not for elastic bodies")

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

        ranks = comm or MPI.COMM_WORLD
        if self.model.vector_valued:
            from fenicsx_obstacle.scenes.bodies import Body  # only where a scene names an elastic body

            if self.time is not None:
                raise InputError(f"{self.source}: an ObstacleProblem is one equilibrium; solve() takes [time]")
            return Body(self.model, meshes.build(self, ranks)).problem
        return ObstacleProblem.of_model(self.model, meshes.build(self, ranks))

    def toml(self) -> str:
        """The scene as TOML text that `Scene.read` takes."""
        return msgspec.toml.encode(self.tables).decode()

    def with_data(self) -> tuple[str, dict[str, bytes]]:
        """The same text with measured data in files beside it, and the contents of these by their names.

        Raises:
            InputError: If a file cannot be read any more.
        """
        raw, contents = with_files(msgspec.to_builtins(self.tables), self.folder, self.objects)
        return msgspec.toml.encode(tables.checked(raw, self.source)).decode(), contents


def _eps(given: Definitions, value: float | str) -> float | str | EpsFormula:
    """A value of [solve] eps as options take it: a formula may use names of [define]."""
    if not isinstance(value, str) or value == "auto":
        return value
    place = "[solve] eps"
    return EpsFormula(value, lambda h: given.number(value, place, {"h": h}), "h" in given.formula(value, place).names)
