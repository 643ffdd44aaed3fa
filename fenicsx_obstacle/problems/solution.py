"""Solution: the frozen result of a converged solve."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle.algebra.stopping import Step
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.scalar import Fields, Force
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.problems.summary import main_values, summary
from fenicsx_obstacle.problems.values import Adaptive, Errors, Profile, Quantity, Seconds
from fenicsx_obstacle.signatures import checked
from fenicsx_obstacle.text import counted, shown, title_of

if TYPE_CHECKING:
    from typing import Self

    from numpy.typing import ArrayLike

    from fenicsx_obstacle.check.verification import Verification
    from fenicsx_obstacle.estimation.bound import Bound
    from fenicsx_obstacle.fields.contact_table import ContactTable
    from fenicsx_obstacle.io.rows import Rows
    from fenicsx_obstacle.show.pictures import Picture

Files = dict[str, bytes]
T = TypeVar("T")


def _from_record(record: Mapping[str, Any], key: str, kind: type[T]) -> T | None:
    """A part of a record, typed; later versions may save more values. None if it is not there."""
    return None if record.get(key) is None else msgspec.convert(record[key], kind)


@dataclass(frozen=True, eq=False)
class Solution:
    """A converged solution with its pressure, contact set, history and values.

    Attributes:
        fields: u, pressure, contact set and obstacles on the mesh; the attributes below give each.
        history: The Newton steps.
        record: All values, as in answer.json.
        bound: Bound of the energy error, or None.
        tension: The tension in UFL, a number or a matrix; None for a form, and for a solution that was read from files.
    """

    fields: Fields
    history: tuple[Step, ...] = field(repr=False)
    record: Mapping[str, Any] = field(repr=False)
    bound: Bound | None = None
    tension: Any = field(default=None, repr=False)
    _problem: Callable[[], Any] | None = field(default=None, repr=False)  # that exists as long as its owner keeps it

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
        """The contact forces, `force.lower` and `force.upper`, both >= 0; None for an obstacle that does not exist. For
        bodies also the `resultant` on the body and its `moment`."""
        contact = self.record["contact"]
        return self.fields.force(*(contact[side]["force"] if side in contact else None for side in ("lower", "upper")))

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
        return msgspec.convert(self.record["seconds"], Seconds)

    # fields

    @property
    def level(self) -> Level:
        """The mesh and its spaces, `level.mesh` and `level.V`."""
        return self.fields.level

    @property
    def u(self) -> fem.Function:
        """Solution, in the unit of the obstacles. It is a copy, which later solves do not change."""
        return self.fields.u

    @property
    def pressure(self) -> fem.Function:
        """Contact pressure p, in the unit of the load: >= 0 at the lower obstacle, <= 0 at the upper one.

        Its space Q_h has the contact nodes as nodes. With P1 it is the space of u, with P2 on triangles the
        Crouzeix-Raviart space: its values at the midpoints of edges have these signs, but between them p may have the
        opposite sign near the free boundary.
        """
        return self.fields.pressure

    @property
    def contact(self) -> fem.Function:
        """1 at the contact nodes where u is in contact, 0 at the others; in the space of the pressure."""
        return self.fields.contact

    @property
    def lower(self) -> fem.Function | None:
        """Lower obstacle at the nodes, or None."""
        return self.fields.lower

    @property
    def upper(self) -> fem.Function | None:
        """Upper obstacle at the nodes, or None."""
        return self.fields.upper

    @property
    def nodes(self) -> ContactTable:
        """Coordinates, normals, areas, pressures and gaps of the contact nodes of a vector-valued solution."""
        return self._of_vectors("nodes")

    @property
    def gap(self) -> fem.Function:
        """Distance of a vector-valued solution to the nearest obstacle, a Function; not-a-number at nodes that are not
        on the contact boundary."""
        return self._of_vectors("gap")

    @property
    def von_mises(self) -> fem.Function | None:
        """Von Mises stress of a vector-valued solution in the middle of each cell, piecewise constant; None if no
        stress was given."""
        return self._of_vectors("von_mises")

    def _of_vectors(self, name: str) -> Any:
        if not hasattr(self.fields, name):
            raise AttributeError(f"'{name}' is of vector-valued solutions")
        return getattr(self.fields, name)

    def functions(self) -> dict[str, fem.Function]:
        """The scalar fields by name, those that exist; components of a vector-valued u are u0, u1, u2."""
        return self.fields.functions()

    @property
    def plain(self) -> Self:
        """Its interpolant on P1 simplices, for pictures and ParaView (first use is collective)."""
        plain = self.fields.plain
        return self if plain is self.fields else replace(self, fields=plain, tension=None)

    @property
    def shown(self) -> Self:
        """What pictures show: this solution (collective)."""
        return self

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
        flat, shape = self._in_space(points)
        return self.values(flat, of).reshape((*shape, *self.fields.shape(of)))

    def _in_space(self, points: ArrayLike) -> tuple[np.ndarray, tuple[int, ...]]:
        """The points of `at` with three coordinates, shape (n, 3), and the shape in which they were given."""
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
        return flat, given.shape[:-1]

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
        flat, shape = self._in_space(points)
        if len(shape) != 1:
            raise InputError(f"on() takes points, shape (n, {self.level.mesh.geometry.dim})")
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])[: len(flat)]
        return Profile(np.asarray(points), s, **self.fields.along(flat, self._known_tension))

    def values(self, points: np.ndarray, of: str = "u") -> np.ndarray:
        """Values at points, shape (n, 3), the same on every rank; not-a-number outside the mesh (collective).

        Args:
            points: The same on every rank.
            of: As for `at`.
        """
        return self.fields.values(points, of, self._known_tension if of == "flux" else None)

    @property
    def _known_tension(self) -> Any:
        """The tension in UFL, or None (first use is collective)."""
        return self.tension

    def verify(self) -> Verification:
        """Check the solution against its problem, whose data are taken as they are now: balance of forces, obstacles,
        pressure, contact; small linear problems are solved again by another method (collective).

        Returns:
            The findings. It is true if all hold, and prints as a table.

        Raises:
            InputError: If the problem does not exist any more, or was one in time.
        """
        problem = None if self._problem is None else self._problem()
        if problem is None:
            raise InputError("verify: the problem of this solution does not exist any more: keep its ObstacleProblem")
        return problem.verify(self)

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
        save(Path(folder), self.fields, self.history, self.record, self.files)

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

        saved = read(Path(folder), comm)
        return cls(replace(saved.fields, error=None), saved.history, saved.record, saved.bound)

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
        from fenicsx_obstacle.show.pictures import draw

        shown = self.shown
        sides = [side for side in ("lower", "upper") if side in shown.record["contact"]]
        return draw(shown.fields, sides, shown.title, self.symbol, None if path is None else Path(path))
