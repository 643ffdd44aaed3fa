"""Solution: the frozen result of a converged solve."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgspec
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.discrete.levels import Level
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.problems.summary import main_values, summary
from fenicsx_obstacle.problems.values import Adaptive, Errors, Force, Profile, Quantity, Seconds
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.text import counted, nearest, shown, title_of

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import ArrayLike

    from fenicsx_obstacle.estimation.bound import Bound
    from fenicsx_obstacle.io.cut import Cut
    from fenicsx_obstacle.io.rows import Rows
    from fenicsx_obstacle.show.pictures import Picture

Files = dict[str, bytes]
T = TypeVar("T")
PARTITION = 1e-9  # round-off of a partition of unity


def _from_record(record: Mapping[str, Any], key: str, kind: type[T]) -> T | None:
    """A part of a record, typed; later versions may save more values. None if it is not there."""
    return None if record.get(key) is None else msgspec.convert(record[key], kind)


@dataclass(frozen=True, eq=False)
class Solution:
    """A converged solution with its pressure, contact set, history and values.

    Attributes:
        level: The mesh and its spaces, `level.mesh` and `level.V`.
        u: Solution, in the unit of the obstacles. It is a copy, which later solves do not change.
        pressure: Contact pressure p, in the unit of the load: >= 0 at the lower obstacle, <= 0 at the upper one. Its
            space Q_h has the contact nodes as nodes. With P1 it is the space of u, with P2 on triangles the
            Crouzeix-Raviart space: its values at the midpoints of edges have these signs, but between them p may have
            the opposite sign near the free boundary.
        contact: 1 at the contact nodes where u is in contact, 0 at the others; in the space of the pressure.
        lower: Lower obstacle at the nodes, or None.
        upper: Upper obstacle at the nodes, or None.
        history: The Newton steps.
        record: All values, as in answer.json.
        bound: Bound of the energy error, or None.
        tension: The tension in UFL, a number or a matrix; None for a form, and for a solution that was read from files.
    """

    level: Level
    u: fem.Function
    pressure: fem.Function
    contact: fem.Function
    lower: fem.Function | None
    upper: fem.Function | None
    history: tuple[Step, ...] = field(repr=False)
    record: Mapping[str, Any] = field(repr=False)
    bound: Bound | None = None
    tension: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        # the names that ParaView shows; XDMFFile cannot write two Functions with one name
        for name in ("pressure", "contact", "lower", "upper", "gap", "von_mises"):
            function = getattr(self, name, None)
            if function is not None:
                function.name = name

    def __repr__(self) -> str:
        r = self.record
        how = r["method"] if r["eps"] is None else f"{r['method']}, eps = {r['eps']:.3g}"
        return f"{type(self).__name__}({self.title!r}: {how}, {r['dofs']} unknowns; {', '.join(main_values(r))})"

    # figures

    @property
    def title(self) -> str:
        """The title of the problem."""
        return title_of(self.record["title"], self.record["scene"])

    @property
    def symbol(self) -> str:
        """The label of u in pictures."""
        return "u"

    @property
    def method(self) -> str:
        """penalty, successive or vi."""
        return str(self.record["method"])

    @property
    def eps(self) -> float | None:
        """Penalty parameter, in units of u/p; None for the variational inequality."""
        return self.record["eps"]

    @property
    def area(self) -> float:
        """Area of the contact set; for an obstacle on the boundary of a plane domain its length."""
        return self.record["contact"]["area"]

    @property
    def force(self) -> Force:
        """The contact forces, `force.lower` and `force.upper`, both >= 0; None for an obstacle that does not exist."""
        contact = self.record["contact"]
        return Force(*(contact[side]["force"] if side in contact else None for side in ("lower", "upper")))

    @property
    def penetration(self) -> float:
        """Largest distance by which u penetrates an obstacle, in the unit of u."""
        return self.record["penetration"]

    @property
    def energy(self) -> float | None:
        """a(u, u)/2 - f(u) plus the energy of the penalty; None if the problem has no energy."""
        return self.record["energy"]

    @property
    def iterations(self) -> int:
        """Number of Newton steps on the finest mesh."""
        return self.record["newton_iterations"]

    @property
    def dofs(self) -> int:
        """Number of unknowns on all ranks, including those with given values."""
        return self.record["dofs"]

    @property
    def report(self) -> dict[str, float | None]:
        """The values of the scene's [report] by name, in its units; None if a value is not finite."""
        return dict(self.record.get("report") or {})

    @property
    def errors(self) -> Errors | None:
        """The errors of u and p; None if the exact solution is not known."""
        return _from_record(self.record, "errors", Errors)

    @property
    def adaptive(self) -> Adaptive | None:
        """The adaptive meshes and whether the tolerance was reached; None if no tolerance was given."""
        return _from_record(self.record, "adaptive", Adaptive)

    @property
    def goal(self) -> Quantity | None:
        """The quantity that was given a tolerance, with its error; None if there is none."""
        return _from_record(self.record, "goal", Quantity)

    @property
    def seconds(self) -> Seconds:
        """Wall time of the solve."""
        seconds = self.record["seconds"]
        return Seconds(seconds["total"], seconds["mesh"], seconds["solve"])

    # fields

    @property
    def plain(self) -> Self:
        """Its interpolant on P1 simplices, for pictures and ParaView (first use is collective)."""
        return self if self.level.pair.nested_hierarchy else cast("Self", self.cut.plain)

    @property
    def shown(self) -> Self:
        """What pictures show: this solution (collective)."""
        return self

    @cached_property
    def cut(self) -> Cut:
        """The subdivision of the cells from which `plain` is made, for elements other than P1 (first use is
        collective)."""
        from fenicsx_obstacle.io.cut import cut

        return cut(self)

    def at(self, points: ArrayLike, of: str = "u") -> np.ndarray:
        """Values at points; not-a-number at points outside the mesh (collective).

        Args:
            points: One point, or an array of points whose last axis has the coordinates. Give either gdim coordinates,
                or three as in DOLFINx, where those beyond gdim are 0. All ranks must give the same points.
            of: "u"; "pressure"; "gap", the distance to the nearest obstacle; "slope", the gradient of u; or "flux", the
                tension times the gradient. Where adjacent cells have different values, the result is their mean.

        Returns:
            One value for each point, the same on all ranks: shape (n,) for n points, and shape () for one point. For
            slope and flux the shapes are (n, gdim) and (gdim,).

        Raises:
            InputError: If the points have a wrong number of coordinates or do not lie on the line or plane of the mesh;
                if there is no such quantity; or if the flux is requested and the tension is not known.
        """
        if not isinstance(of, str):
            raise InputError(f"at() takes the name of a quantity, such as of='pressure', not of={shown(of)}")
        gdim = self.level.mesh.geometry.dim
        try:
            given = np.asarray(points, dtype=np.float64)
        except (TypeError, ValueError):
            given = np.empty(())
        if given.ndim == 0 or given.shape[-1] not in (gdim, 3):
            got = shown(points) if given.ndim == 0 else f"shape {given.shape}"
            raise InputError(f"at() takes points, shape (n, {gdim}), or one point, shape ({gdim},), not {got}")
        flat = np.zeros((given[..., 0].size, 3))
        flat[:, : given.shape[-1]] = given.reshape(-1, given.shape[-1])
        if np.any(flat[:, gdim:] != 0):
            raise InputError(f"at() takes points of the mesh, shape (n, {gdim}); coordinates beyond these must be 0")
        return self.values(flat, of).reshape((*given.shape[:-1], *self._shape(of)))

    def along(self, start: ArrayLike, end: ArrayLike, n: int = 200) -> Profile:
        """All quantities along a line, for a plot (collective).

        Args:
            start: First point, with gdim coordinates.
            end: Last point.
            n: Number of equally spaced points.

        Returns:
            Arrays with one value for each point: s, the distance from the first point; u; pressure; gap; slope; flux.

        Raises:
            InputError: As `at`, or if there are fewer than two points.
        """
        gdim = self.level.mesh.geometry.dim
        try:
            ends = [np.asarray(point, dtype=np.float64) for point in (start, end)]
        except (TypeError, ValueError):
            ends = [np.empty(0)]
        if not isinstance(n, Integral) or n < 2 or any(point.shape != (gdim,) for point in ends):
            raise InputError(
                f"along() takes two points with {counted(gdim, 'coordinate')} each, and a whole number n >= 2"
            )
        return self.on(np.linspace(ends[0], ends[1], n))

    def on(self, points: np.ndarray) -> Profile:
        """All quantities at consecutive points of a curve (collective).

        Args:
            points: Shape (n, gdim), the same on every rank.

        Raises:
            InputError: As `at`.
        """
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return Profile(points, s, **self._quantities(points))

    def _quantities(self, points: np.ndarray) -> dict[str, Any]:
        """The values of a profile at points, by name (collective)."""
        values: dict[str, Any] = {name: self.at(points, name) for name in ("u", "pressure", "slope")}
        free = self.lower is None and self.upper is None
        values["gap"] = np.full(len(points), np.inf) if free else self.at(points, "gap")
        with suppress(InputError):  # the points are right, so that it is the tension that is not known
            values["flux"] = self.at(points, "flux")
        return values

    def values(self, points: np.ndarray, of: str = "u") -> np.ndarray:
        """Values at points, shape (n, 3), the same on every rank; not-a-number outside the mesh (collective).

        Args:
            points: The same on every rank.
            of: As for `at`.
        """
        found = [self._with_infinities(function, points) for function in self._components(of)]
        return found[0] if not self._shape(of) else np.column_stack(found)

    def _shape(self, of: str) -> tuple[int, ...]:
        return (self.level.mesh.geometry.dim,) if of in ("slope", "flux") else ()

    def _components(self, of: str) -> list[fem.Function]:
        """A quantity as Functions of this mesh (collective)."""
        known = ("u", "pressure", "gap", "slope", "flux")
        if of not in known:
            raise InputError(f"at() has no quantity '{of}'" + nearest(of, known))
        if of == "gap":
            gap = fem.Function(self.level.V)
            gap.x.array[:] = np.inf
            for obstacle, sign in ((self.lower, 1), (self.upper, -1)):
                if obstacle is not None:
                    np.minimum(gap.x.array, sign * (self.u.x.array - obstacle.x.array), out=gap.x.array)
            return [gap]
        if of in ("slope", "flux"):
            vector, degree = ufl.grad(self.u), self._slope_degree
            if of == "flux":
                vector, degree = self._tension * vector, degree + self._tension_degree
            space = releases.functionspace(self.level.mesh, "DG", degree)
            components = [fem.Function(space) for _ in range(self.level.mesh.geometry.dim)]
            for axis, component in enumerate(components):
                component.interpolate(releases.expression(vector[axis], space))
            return components
        return [getattr(self, of)]

    @cached_property
    def _tension(self) -> Any:
        """The tension in UFL (first use is collective).

        Raises:
            InputError: If it is not known.
        """
        if self.tension is None:
            raise InputError(
                "at() has no flux here: the tension of a form is not known, nor that of a solution read without "
                "a scene; 'slope' is the gradient of u"
            )
        return self.tension

    @property
    def _tension_degree(self) -> int:
        """Degree of the polynomials of the sampled tension in a cell, those of `Level.W`."""
        return 0 if self.level.pair.degree == 1 else self.level.pair.degree

    @property
    def _slope_degree(self) -> int:
        """Degree of the gradients of V_h."""
        pair = self.level.pair
        return pair.degree - 1 if pair.nested_hierarchy or pair.has_p1_coarse_space else pair.degree

    def _with_infinities(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        """Values of a Function on this mesh, infinite where it is infinite at a node that counts there (collective)."""
        values = function.x.array
        if total(self.level.comm, np.count_nonzero(np.isinf(values))) == 0:
            return self._evaluated(function, points)
        finite, infinite = fem.Function(function.function_space), fem.Function(function.function_space)
        finite.x.array[:] = np.where(np.isinf(values), 0.0, values)
        infinite.x.array[:] = np.isinf(values)
        there = np.abs(self._evaluated(infinite, points)) > PARTITION
        return np.where(there, np.inf, self._evaluated(finite, points))

    def _evaluated(self, function: fem.Function, points: np.ndarray) -> np.ndarray:
        """Values of a Function on this mesh (collective)."""
        from fenicsx_obstacle.discrete.points import values_of  # only if requested

        parents = None if self.level.pair.nested_hierarchy else self.cut.parents
        return values_of(function, points, level=self.plain.level, parents=parents)

    def functions(self) -> dict[str, fem.Function]:
        """The scalar fields by name, those that exist."""
        named = {key: getattr(self, key) for key in ("u", "pressure", "contact", "lower", "upper")}
        return {key: function for key, function in named.items() if function is not None}

    def by_cell(self) -> dict[str, fem.Function]:
        """Further fields that have one value in each cell, by name."""
        return {}

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields on P1 simplices at owned nodes, as files and pictures have them (local)."""
        owned = self.level.owned
        return self.with_gap({name: function.x.array[:owned].real for name, function in self.functions().items()})

    @staticmethod
    def with_gap(own: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Fields at owned nodes, and with them the distance of u to the nearest obstacle (local)."""
        gaps = [sign * (own[name] - own["u"]) for name, sign in (("lower", -1), ("upper", 1)) if name in own]
        if gaps:
            own["gap"] = gaps[0] if len(gaps) == 1 else np.minimum(*gaps)
        return own

    def tables(self) -> dict[str, np.ndarray]:
        """Further arrays of fields.h5 by their names, the same on every rank."""
        return {}

    def on_pieces(self, level: Level, fields: Mapping[str, fem.Function], parents: np.ndarray) -> Self:
        """This solution on P1 simplices that its cells were cut into (local).

        Args:
            level: The simplices.
            fields: Those of `functions` there.
            parents: For each owned simplex the cell it was cut from.
        """
        fields["u"].name = self.u.name
        return replace(self, level=level, tension=None, **fields)

    def summary(self) -> str:
        """The main values in a few lines of text."""
        return summary(self.record, self.title)

    # files and pictures

    @checked()
    def save(self, folder: str | Path) -> None:
        """Write answer.json, history.csv, fields.xdmf and fields.h5 into a folder, for a scene also scene.toml
        (collective). ParaView opens fields.xdmf.

        Raises:
            InputError: If the folder cannot be written.
        """
        from fenicsx_obstacle.io.folder import save  # with h5py

        if str(folder) == "":
            raise InputError("save: folder = '': an empty name; take '.' for the present folder")
        save(self, Path(folder))

    def files(
        self, folder: Path, mesh: Mapping[str, Rows], element: Mapping[str, Rows], parts: Mapping[str, np.ndarray]
    ) -> Files:
        """Further files of the folder by their names, on rank 0 (collective).

        Args:
            folder: Where they will be.
            mesh: Points, cells and fields, as in fields.h5.
            element: Its group `element`.
            parts: The named parts of the mesh, on rank 0.
        """
        return {}

    @classmethod
    @checked()
    def read(cls, folder: str | Path, comm: MPI.Comm = MPI.COMM_WORLD) -> Solution:
        """A saved solution with the element it was computed with, on any number of ranks (collective).

        Args:
            folder: A folder of `save`.
            comm: The ranks that share its mesh.

        Raises:
            InputError: If the folder has no saved solution.
        """
        from fenicsx_obstacle.io.folder import read

        fields = read(Path(folder), comm).fields
        if "nodes" in fields:
            from fenicsx_obstacle.problems.vector_valued import saved  # no scalar solution needs it

            return saved(fields)
        return cls(**{name: value for name, value in fields.items() if name != "error"})

    @checked()
    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw u with its obstacles, free boundary and pressure (collective).

        Args:
            path: A file to write, too: .png, .pdf or .svg.

        Returns:
            The picture, which notebooks display, with a note on the library that drew it.

        Raises:
            InputError: If the name has another ending, or the file cannot be written.
        """
        from fenicsx_obstacle.show.pictures import draw_answer

        return draw_answer(self.shown, None if path is None else Path(path))
