"""From the tables of a scene to its effects, data and time, with the checks that need no mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fenicsx_obstacle.data.measured.surface import MeasuredField
from fenicsx_obstacle.data.model import Model, Part
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA, INERTIA, RATE, TimeDiscretization
from fenicsx_obstacle.effects.effect import Effect, Elastic, OnPart, find, known
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.scenes.definitions import Definitions
from fenicsx_obstacle.scenes.fields import FormulaField
from fenicsx_obstacle.scenes.from_python import stands_for_an_object
from fenicsx_obstacle.scenes.tables import ACTING, OF_BODIES, BoundaryTable, ObstacleTable, part_place
from fenicsx_obstacle.scenes.vocabulary import TIME
from fenicsx_obstacle.text import nearest, plain

MAX_OPERATIONS = 5000  # of an exact solution: it is differentiated and compiled
OF_BODY = ("P1", "P2", "Q1", "Q2")  # elements of an elastic body
# columns of history.csv, beside t: [report] has no quantity of their names
COUNTS = ("step", "dt", "newton", "krylov")
USUAL = ("energy", "kinetic", "contact_area", "force_lower", "force_upper", "penetration")


def effects_of(given: Definitions) -> tuple[Effect, ...]:
    """The effects of [effects] and [[boundary]]; only modules of named effects are imported.

    Raises:
        InputError: For unknown effects, and for effects that exclude each other.
    """
    source, keys = given.source, known()
    for key in given.tables.effects:
        if key not in keys:
            raise InputError(f"{source}: [effects] unknown effect '{key}'" + nearest(key, keys))
    elastic = [key for key in given.tables.effects if issubclass(find(key), Elastic)]
    if not elastic:
        raise InputError(f"{source}: [effects] has no stiffness: add 'tension = 1'")
    if len(elastic) > 1:
        raise InputError(f"{source}: [effects] names {' and '.join(elastic)}: only one of them is allowed")
    effects = [find(key).read(raw, f"[effects] {key}", given) for key, raw in given.tables.effects.items()]
    for number, part in enumerate(given.tables.boundary):
        for key in sorted(known("boundary")):
            raw = getattr(part, key)
            if raw is not None:
                effects.append(find(key).read(raw, f"{part_place(number)} {key}", given, part=number))
    _check_kinds(effects, source)
    for effect in effects:
        if (why := effect.conflict(effects)) is not None:
            place = "[[boundary]]" if isinstance(effect, OnPart) else "[effects]"
            raise InputError(f"{source}: {place} {why}")
    return tuple(effects)


def _check_kinds(effects: Sequence[Effect], source: str) -> None:
    """Reject effects of scalar u beside an elastic body, and the other way round."""
    wanted = next(effect.vector_valued for effect in effects if isinstance(effect, Elastic))
    for effect in effects:
        if effect.vector_valued not in (None, wanted):
            place = part_place(effect.part) if isinstance(effect, OnPart) else "[effects]"
            why = "is for scalar u, not for elastic bodies" if wanted else "is for elastic bodies ('elasticity')"
            load = f" = {effect}" if effect.key == "load" else ""
            hint = "; give a list of components" if effect.key == "load" and wanted else ""
            raise InputError(f"{source}: {place} {effect.key}{load}: {why}{hint}")


def model_of(given: Definitions, effects: tuple[Effect, ...]) -> Model:
    """Effects, obstacles, boundary values and time.

    Raises:
        InputError: If a formula has an unknown name, or the data contradict each other.
    """
    parts = []
    for number, table in enumerate(given.tables.boundary):
        place = part_place(number)
        on = (table.on,) if isinstance(table.on, str) else table.on
        data = _data(given, table, place, "where", "value", "lower", "upper")
        if isinstance(components := data.get("value"), tuple):
            data = {**data, "value": None, "components": components}
        parts.append(Part(place, on, **data))
    sides = _data(given, given.tables.obstacle, "[obstacle]", "lower", "upper")
    time = moments_of(given, effects)
    model = Model(effects, **sides, boundary=tuple(parts), time=time, source=given.source)
    for field in model.data:
        if isinstance(field, FormulaField):
            field.formula.check_names(given.known_names)
    return model


def _data(given: Definitions, table: Any, place: str, *keys: str) -> dict[str, Any]:
    """The data of a table that are given."""
    values = {key: getattr(table, key) for key in keys}
    return {key: _datum(given, value, f"{place} {key}") for key, value in values.items() if value is not None}


def _datum(given: Definitions, value: Any, place: str) -> Field | tuple[Field | None, ...]:
    """A datum, or the components of a displacement, None for one that is "free"."""
    if not isinstance(value, tuple):
        return given.field(value, place)
    return tuple(None if one == "free" else given.field(one, f"{place}[{k}]") for k, one in enumerate(value))


def check_exact(given: Definitions) -> None:
    """Reject an exact solution that cannot be differentiated.

    Raises:
        InputError: Naming the key.
    """
    table = given.tables.exact
    for key in () if table is None else ("u", "pressure"):
        value = getattr(table, key)
        if value is None or stands_for_an_object(value):
            continue
        formula = given.formula(value, f"[exact] {key}")
        formula.check_names({*given.known_names, "eps"})
        if (count := given.operations(formula)) > MAX_OPERATIONS:
            words = f"{count:.3g} operations after its definitions are inserted; the limit is {MAX_OPERATIONS}"
            raise InputError(f"{formula.place}: {words}")
        if "distance" in given.needs(formula):
            raise InputError(f"{formula.place}: 'distance' has no gradient, so it is not allowed in [exact]")


def check_body(given: Definitions, effects: Sequence[Effect]) -> None:
    """Reject tables that elastic bodies do not have.

    Raises:
        InputError: Naming the table.
    """
    if not given.of_body:
        return
    own = given.tables
    for name, there, why in (
        ("exact", own.exact, "is for scalar u; compare output quantities under [report]"),
        ("obstacle", own.obstacle != ObstacleTable(), "bounds a scalar u; give [[boundary]] an obstacle"),
    ):
        if there:
            raise InputError(f"{given.source}: [{name}] with elasticity: {why}")
    from fenicsx_obstacle.effects.boundary.obstacle import FROM_FILES, Obstacle  # no scalar scene needs it

    for effect in effects:
        if isinstance(effect, Obstacle) and effect.kind in FROM_FILES:
            data, of_facets = effect.value, effect.kind == "stl"
            if not isinstance(data, MeasuredField) or (of_facets and data.facets is None):
                wanted = '{file = "surface.stl"}' if of_facets else "{file = ...} of measured data"
                raise InputError(f"{effect.source}.{effect.kind} = {getattr(data, 'text', '')}: expected {wanted}")
    if given.pair.name not in OF_BODY:
        taken = ", ".join(OF_BODY)
        raise InputError(f"{given.source}: [solve] element = '{given.pair.name}': elastic bodies take {taken}")


def check_parts(given: Definitions) -> None:
    """Reject tables [[boundary]] without data or with contradictory data.

    Raises:
        InputError: Naming the part.
    """
    for number, part in enumerate(given.tables.boundary):
        _check_part(given, part, f"{given.source}: {part_place(number)}")


def _check_part(given: Definitions, part: BoundaryTable, place: str) -> None:
    _check_kind(part, place, of_body=given.of_body)
    acting = [key for key in ACTING if getattr(part, key) is not None]
    if part.value is None and not acting:
        taken = [key for key in ACTING if key == "spring" or (key in OF_BODIES) == given.of_body]
        raise InputError(f"{place}: the key 'value' is missing, or {', '.join(taken)}")
    partly = isinstance(part.value, tuple) and "free" in part.value  # of an elastic body: rollers may carry a load
    if part.value is not None and acting and not partly:
        raise InputError(f"{place}: {acting[0]} has no effect where u is given by 'value'; use separate tables")
    if part.on == ():
        raise InputError(f"{place} on = []: has no part")
    if part.on is not None and part.where is not None:
        raise InputError(f"{place}: 'on' and 'where' exclude each other")
    if part.where is not None and not stands_for_an_object(part.where):
        needed = given.needs(given.formula(part.where, ""))
        if "distance" in needed:
            raise InputError(f"{place} where: 'distance' is 0 on the whole boundary")
        if TIME in needed:
            raise InputError(f"{place} where: parts of the boundary cannot depend on time; 't' is for values")


def _check_kind(part: BoundaryTable, place: str, *, of_body: bool) -> None:
    """Reject scalar data of displacements, and the other way round."""
    if not of_body:
        if isinstance(part.value, tuple):
            raise InputError(f"{place} value = [{', '.join(map(plain, part.value))}]: a list is for elastic bodies")
        return
    if part.value is not None and not isinstance(part.value, tuple):
        wanted = 'u has several components: give a list, such as [0, "free"]'
        raise InputError(f"{place} value = {plain(part.value)}: {wanted}")
    for side in ("lower", "upper"):
        if getattr(part, side) is not None:
            raise InputError(f"{place} {side}: bounds a scalar u; of an elastic body take 'obstacle'")


def moments_of(given: Definitions, effects: Sequence[Effect]) -> TimeDiscretization | None:
    """The moments of a scene; None without [time].

    Raises:
        InputError: If [time] and the effects contradict each other.
    """
    table, source = given.tables.time, given.source
    moving = {effect.order: effect.key for effect in effects if effect.order}
    if table is None:
        if moving:
            raise InputError(f"{source}: [effects] {moving[max(moving)]} needs a table [time] with end, steps, start")
        return None
    for name in given.tables.report:
        if name in (*COUNTS, *USUAL):
            raise InputError(f"{source}: [report] {name}: history.csv has a column of this name; choose another")
    order = max(moving, default=EQUILIBRIA)
    end = given.number(table.end, "[time] end")
    if end <= 0:
        raise InputError(f"{source}: [time] end = {table.end}: must be positive")
    without = "without rate or inertia an equilibrium is computed at each time"
    wrong = {
        "start": (order == EQUILIBRIA, without),
        "velocity": (order != INERTIA, "it needs inertia"),
        "scheme": (order != RATE, "euler and bdf2 are for rate without inertia"),
        "tolerance": (order != RATE, "it needs rate without inertia"),
    }
    for key, (refused, why) in wrong.items():
        if refused and getattr(table, key) is not None:
            raise InputError(f"{source}: [time] {key}: {why}")
    if order > EQUILIBRIA and table.start is None:
        raise InputError(f"{source}: [time]: the key 'start' is missing, u at t = 0")
    fields = {key: None if (value := getattr(table, key)) is None else given.field(value, f"[time] {key}")
              for key in ("start", "velocity")}  # fmt: skip
    scheme = {EQUILIBRIA: "equilibria", RATE: table.scheme or "euler", INERTIA: "midpoint"}[order]
    return TimeDiscretization(
        order, end, table.steps, fields["start"], fields["velocity"], scheme, table.tolerance, table.frames,
        table.name,
    )  # fmt: skip
