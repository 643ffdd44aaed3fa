"""A scene with an elastic body, as an ObstacleProblem on its mesh."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc
from scipy.spatial import cKDTree

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.options import EpsFormula, SolverOptions
from fenicsx_obstacle.algebra.system import with_infinities
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.measured.surface import MeasuredField
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.discrete.assembly import assembled
from fenicsx_obstacle.discrete.contact_nodes import HELD, KINK, HeldBeyond
from fenicsx_obstacle.effects.boundary.obstacle import Obstacle
from fenicsx_obstacle.effects.domain.elasticity import Elasticity
from fenicsx_obstacle.effects.effect import residual
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.fields.contact_table import ContactTable
from fenicsx_obstacle.mesh.cells import corners, own_cells
from fenicsx_obstacle.mesh.levels import Level, at_surface, over, vector_pair
from fenicsx_obstacle.mesh.reference_cell import Reference
from fenicsx_obstacle.parallel import first_given, largest, total
from fenicsx_obstacle.problems.obstacle_problem import ObstacleProblem
from fenicsx_obstacle.problems.solution import Solution
from fenicsx_obstacle.scenes.rigid_surfaces import box_gap, facets_gap, table_gap

if TYPE_CHECKING:
    from fenicsx_obstacle.check.verification import Verification

MAX_SLOPE = 0.2  # norm of the gradient of u in the middle of a cell: strains and rotations are small
MAX_SHARE = 0.2  # of the longest side of the body: displacements are small
FIRST = 1e-4  # of the radius of an obstacle, or of the body: its first step after it touches
REACHED = 1e-8  # relative difference of a force
MOST_MOVES = 60
SAME = 1e-9  # of the size of the body: one point
CLOSE = 0.95  # cosine of the angle of two directions of the gap that one node may have


class _Problem(ObstacleProblem):
    def __init__(self, name: str, *given: Any, **options: Any):
        self.name = name
        super().__init__(*given, **options)


@dataclass(frozen=True, eq=False)
class Facing:
    """An obstacle and the nodes that face it.

    Attributes:
        obstacle: The obstacle.
        facets: Local facets of its part of the boundary.
        dofs: Local dofs of V_h there.
        points: Their coordinates on all ranks, shape (n, gdim).
        travel: How far it has moved along `obstacle.moves`.
    """

    obstacle: Obstacle
    facets: np.ndarray
    dofs: np.ndarray
    points: np.ndarray
    travel: fem.Constant

    @property
    def place(self) -> np.ndarray:
        """Its centre, or a point on it, where it is now."""
        return np.array(self.obstacle.point) + float(self.travel.value) * np.array(self.obstacle.moves or 0.0)


class Body:
    """The elastic body of a scene on one mesh.

    Attributes:
        model: Its effects, and what is given on its boundary.
        level: Mesh and scalar spaces.
        data: The data of the model, sampled.
        law: Hooke's law.
        facing: The obstacles.
        gap: In V_h; 0 where there is no obstacle.
        problem: Its ObstacleProblem.
    """

    def __init__(self, model: Model, level: Level):
        """Sample, compile and assemble (collective).

        Raises:
            InputError: If the data are invalid.
        """
        level = at_surface(replace(level, pair=vector_pair(level.pair)))  # pressures at all nodes
        self.model, self.level = model, level
        self.data, self.vectors = Data(model, level), over(level)
        mesh, V = level.mesh, self.vectors.V
        gdim = mesh.geometry.dim
        if mesh.topology.dim != gdim or gdim == 1:
            raise InputError(f"{model.source}: elasticity is for plane and solid meshes, not for surfaces or intervals")
        if model.radial:
            _ = self.data.radius  # rejects a mesh on both sides of the axis
        elastic = model.elastic
        assert isinstance(elastic, Elasticity)
        self.u, v = fem.Function(V, name="u"), ufl.TestFunction(V)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are among the remarks
            F, self.law = residual(model.effects, self.u, v, self.data), elastic.law(self.u, self.data)
        self._normals, self._places, self.gap = fem.Function(V), fem.Function(V), fem.Function(level.V)
        self._places.x.array.reshape(-1, gdim)[self.vectors.node_of] = level.points[:gdim].T
        self.facing = [self._faced(effect) for effect in model.effects if isinstance(effect, Obstacle)]
        if not self.facing:
            raise InputError(f"{model.source}: an elastic body without contact: give a [[boundary]] an obstacle")
        if sum(one.obstacle.force is not None for one in self.facing) > 1:
            raise InputError(
                f"{model.source}: several obstacles with a force: one can be moved until its force is reached"
            )
        self._values = list[tuple[fem.Function, Field, int]]()
        self._gaps = [self._gap_of(one) for one in self.facing]
        self._go_places()
        bcs = self._conditions()
        self._check_effect()
        on_facets = self._over(np.concatenate([one.facets for one in self.facing]))
        with self._naming_parts():
            self.problem = _Problem(
                model.source, F, self.u, bcs=bcs, lower=self.gap, of=-ufl.dot(self.u, self._normals),
                measure=self.law.over(on_facets), stress=self.law.stress,
            )  # fmt: skip

    def _check_effect(self) -> None:
        """Reject an obstacle where u is given along its direction at all nodes (collective)."""
        normals, node_of = self._normals.x.array.reshape(-1, self.level.mesh.geometry.dim), self.vectors.node_of
        parts, held = self.model.boundary, np.zeros(normals.shape, dtype=bool)
        given = []  # by parts: nodes where u is given along the direction of an obstacle, at least in part
        for part, facets in zip(parts, self.data.facets, strict=True):
            there = node_of[self.data.dofs_on(facets)]
            along = [k for k, field in enumerate(part.components) if field is not None]
            held[there[:, None], along] = True
            given.append(there[np.abs(normals[there][:, along]).max(axis=1, initial=0.0) > HELD])
        for one in self.facing:
            there = node_of[one.dofs]
            free = np.linalg.norm(np.where(held[there], 0.0, normals[there]), axis=1)
            if largest(self.level.comm, free) > HELD:
                continue
            shared = [total(self.level.comm, np.count_nonzero(np.isin(nodes, there))) > 0 for nodes in given]
            others = " and ".join(f"no. {number + 1}" for number, found in enumerate(shared) if found)
            raise InputError(
                f"{self.model.source}: {parts[one.obstacle.part].name} obstacle has no effect where u is given along "
                f"its direction, by {others}; leave out one of both, or write 'free' for this component"
            )

    @contextmanager
    def _naming_parts(self) -> Iterator[None]:
        """Name the tables of the scene in the message of a given value of u beyond an obstacle (collective)."""
        try:
            yield
        except HeldBeyond as error:
            near, parts = SAME * self.data.extent, self.model.boundary
            others = [
                number
                for number, part in enumerate(parts)
                if part.components and self._has(self.data.dofs_on(self.data.facets[number]), error.point, near)
            ]
            facing = [one for one in self.facing if self._has(one.dofs, error.point, near)]
            if not others or not facing:
                raise
            values = " and ".join(f"{parts[number].name} value" for number in others)
            obstacle, travel = facing[0].obstacle, facing[0].travel.value
            goal = "" if obstacle.force is None else " towards its force"
            moved = f", moved by {travel:.4g}{goal}," if obstacle.moves else ""
            raise InputError(
                f"{self.model.source}: {values} and the obstacle of {parts[obstacle.part].name}{moved} "
                f"exclude each other: the given u is beyond the obstacle by {error.distance:.3g} at "
                f"{self.data.place(error.point)}; change one, or leave this place out of one of both parts"
            ) from None

    def _has(self, dofs: np.ndarray, point: np.ndarray, near: float) -> bool:
        """Whether a point is among those of some dofs (collective)."""
        there = np.linalg.norm(self.level.points.T[dofs] - point, axis=1) <= near
        return total(self.level.comm, np.count_nonzero(there)) > 0

    @property
    def pressing(self) -> Facing | None:
        """The obstacle that moves until its force is reached, or None."""
        return next((one for one in self.facing if one.obstacle.force is not None), None)

    def go_to(self, t: float) -> None:
        """Take loads, given displacements and places of obstacles at a time (collective).

        Raises:
            InputError: If one is not finite, or out of bounds.
        """
        assert self.data.moment is not None
        self.data.moment.t = t
        self.data.move()
        for given, field, part in self._values:
            given.interpolate(self.data.on_part(field, part))
        self._go_places()

    def _go_places(self) -> None:
        """Move the obstacles whose travel is given, and compute the gaps (collective)."""
        for one in self.facing:
            if one.obstacle.travel is not None:
                one.travel.value = float(self.data.at(one.obstacle.travel, np.zeros((3, 1)))[0])
        self.place()

    def place(self) -> None:
        """Compute the gaps, with the obstacles where they are now (collective).

        Raises:
            InputError: If a gap is not a number.
        """
        lowest = [self._lowest(one) for one in self.facing]
        for one in self.facing:
            self.gap.x.array[one.dofs] = -np.inf
        for one, own in zip(self.facing, lowest, strict=True):  # the nearest one at nodes of several
            self.gap.x.array[one.dofs] = np.maximum(self.gap.x.array[one.dofs], own)
        self.gap.x.scatter_forward()
        self.data.refuse_infinite(self.gap, words=f"{self.model.source}: the gap to an obstacle", none=-np.inf)

    def _lowest(self, one: Facing) -> np.ndarray:
        """What -u . n must not be below because of an obstacle where it is now, at the nodes that face it
        (collective)."""
        found = with_infinities(-self._gaps[self.facing.index(one)]())
        if largest(self.level.comm, found) == -np.inf:
            raise InputError(f"{one.obstacle.source}: no line along n from a node of its part meets it")
        return found

    def _gap_of(self, one: Facing) -> Callable[[], np.ndarray]:
        """A function that returns the gap to an obstacle where it is now, at the nodes that face it; both are
        collective.

        Gaps to a sphere, a cylinder or a half-space are those of the true surface of the body, at the nodes of V_h.
        """
        gdim, obstacle, dofs = self.level.mesh.geometry.dim, one.obstacle, one.dofs
        normals = self._normals.x.array.reshape(-1, gdim)[self.vectors.node_of[dofs]]
        moves, points, value = obstacle.moves or (0.0,) * gdim, self.level.points.T[dofs, :gdim], obstacle.value

        def shift() -> np.ndarray:
            return float(one.travel.value) * np.array(moves)

        if obstacle.kind == "gap":
            assert value is not None
            return lambda: self.data.on_part(value, obstacle.part).x.array[dofs] + normals @ shift()
        if obstacle.kind == "box":
            centre, near = np.array(obstacle.point), SAME * self.data.extent
            return lambda: box_gap(points, normals, centre + shift(), obstacle.sizes, near)
        if isinstance(value, MeasuredField) and obstacle.kind == "stl":
            to_nearest = facets_gap(value, self.level.comm, points, normals)
            return lambda: to_nearest(shift())
        if isinstance(value, MeasuredField):
            return lambda: table_gap(value, self.level.comm, points, normals, shift())
        n = [self._normals[k] for k in range(gdim)]
        gap = obstacle.gap(self._places, n, [part * one.travel for part in moves])
        compiled = releases.expression(gap, self.level.V)

        def interpolated() -> np.ndarray:
            here = fem.Function(self.level.V)
            here.interpolate(compiled)
            return np.asarray(here.x.array[dofs])

        return interpolated

    def solve(self, options: SolverOptions) -> Solution:
        """Solve; an obstacle with a force is moved until it presses with it (collective).

        Raises:
            InputError: If no u can satisfy the data, or the force is not reached.
            NotConverged: With PETSc's reason.
        """
        eps = options.eps
        if isinstance(eps, EpsFormula):
            eps = eps.value(self.level.h)
        solve = partial(self._solved, "auto" if options.method == "vi" else eps, options.method)
        solution = solve() if self.pressing is None else self._pressed(self.pressing, solve)
        self._check_small(solution)
        return solution

    def verify(self, solution: Solution) -> Verification:
        """Check a solution, with an obstacle that has a force where the solution found it (collective)."""
        if self.pressing is not None:
            self.pressing.travel.value = solution.record["contact"]["approach"]
            self.place()
        return self.problem.verify(solution)

    def _solved(self, eps: Any, method: str) -> Solution:
        with self._naming_parts():
            solution = self.problem.solve(eps=eps, method=method)
        return solution

    def _pressed(self, one: Facing, solve: Callable[[], Solution]) -> Solution:
        """The solution with the obstacle moved until it presses with its force (collective).

        The power of the force that is nearly linear in the approach for Hertz's contact is interpolated linearly
        between the nearest points on both sides (regula falsi in the version of Illinois).
        """
        obstacle, place = one.obstacle, f"{one.obstacle.source}.force"
        assert obstacle.force is not None
        power = 2 / 3 if obstacle.kind == "sphere" else 1.0
        goal = obstacle.force**power
        size = obstacle.radius or self.data.extent
        touching, step = self._touching(one), FIRST * size
        low, high = (touching, -goal), (np.nan, np.nan)  # places, and how far beyond the goal the power of the force is
        travel, last = touching + step, 0
        for _ in range(MOST_MOVES):
            self._move(one, travel)
            solution = solve()
            force = float(part_of(one, solution.nodes).resultant @ np.array(obstacle.moves))
            if abs(force - obstacle.force) <= REACHED * obstacle.force:
                return solution
            beyond = max(force, 0.0) ** power - goal
            if beyond < 0:
                high = (high[0], high[1] / 2) if last == -1 else high
                low, last = (travel, beyond), -1
            else:
                low = (low[0], low[1] / 2) if last == 1 else low
                high, last = (travel, beyond), 1
            if np.isnan(high[0]):
                share = (beyond + goal) / goal  # of the power of the force that is reached
                travel = touching + (travel - touching) * min(max(1.1 / max(share, 1e-9), 1.5), 20.0)
                if travel - touching > size + self.data.extent:
                    break
            else:
                travel = low[0] - low[1] * (high[0] - low[0]) / (high[1] - low[1])
                if low[0] == touching and travel - touching <= SAME * self.data.extent:
                    low = (np.nan, np.nan)  # other loads press the body against it where it touches the body at rest
                if np.isnan(low[0]):
                    travel, step = high[0] - step, 2 * step
        raise InputError(f"{place} = {obstacle.force:g}: is not reached; does the obstacle move towards the body?")

    def _move(self, one: Facing, travel: float) -> None:
        """Move an obstacle, and nodes of u that touch it with it, as a start (collective)."""
        gdim, nodes, before = self.level.mesh.geometry.dim, self.vectors.node_of[one.dofs], self.gap.x.array.copy()
        one.travel.value = travel
        self.place()
        u, n = (part.x.array.reshape(-1, gdim) for part in (self.u, self._normals))
        reached = np.einsum("ij,ij->i", u[nodes], n[nodes]) + before[one.dofs]  # u . n - gap
        after, near = self.gap.x.array[one.dofs], SAME * self.data.extent
        closed = (reached >= -near) & np.isfinite(after)
        beyond = before[one.dofs][closed] - after[closed] + near  # the start is put on it
        u[nodes[closed]] += beyond[:, None] * n[nodes[closed]]

    def _touching(self, one: Facing) -> float:
        """How far an obstacle is moved until it touches the body at rest (collective).

        Raises:
            InputError: If it does not come nearer.
        """

        def least(travel: float) -> float:
            one.travel.value = travel
            return -largest(self.level.comm, self._lowest(one))

        nearer = least(0.0) - least(FIRST * self.data.extent)
        if nearer <= 0:
            raise InputError(f"{one.obstacle.source}.moves = {list(one.obstacle.moves)}: away from the body")
        travel = 0.0
        for _ in range(MOST_MOVES):  # along a curved surface the gap is not linear
            travel += (gap := least(travel)) * FIRST * self.data.extent / nearer
            if abs(gap) <= SAME * self.data.extent:
                break
        return travel

    def _admissible(self, share: float) -> str:
        """Loads that make displacements by this factor smaller, in words: with Hertz's contact slopes grow like the
        square root of the force, of balls like its cube root."""
        dim, forces = self.level.mesh.geometry.dim, []
        for one in self.facing:
            if one.obstacle.force is not None:
                forces.append(one.obstacle.force * share ** (dim if one.obstacle.radius else 1))
        if not forces:
            return f"loads up to about {share:.2g} times these"
        return f"a force up to about {', '.join(f'{force:.2g}' for force in forces)}"

    def _check_small(self, solution: Solution) -> None:
        """Reject solutions that are no small displacements (collective).

        Raises:
            InputError: With the slope or the displacement, its place, and the loads that are admissible.
        """
        level, reference = self.level, Reference(self.level.mesh)
        cells, middle = np.arange(own_cells(level.mesh)), reference.weights(reference.vertices.mean(axis=0))
        parts = [self.vectors.component(solution.u, k) for k in range(self.vectors.components)]
        squares = sum((reference.gradients(part, cells, middle[None, None]) ** 2).sum(axis=(1, 2)) for part in parts)
        slopes = np.sqrt(squares), corners(level.mesh, cells).mean(axis=1)
        sizes = np.sqrt(sum(part.x.array**2 for part in parts)) / self.data.extent, level.points.T
        for what, of_body, (values, points), most in (
            ("slopes", "", slopes, MAX_SLOPE),
            ("a size", " of the body's", sizes, MAX_SHARE),
        ):
            found = largest(level.comm, values)
            if found > most:
                mine = points[np.argmax(values)] if np.max(values, initial=0.0) == found else None
                at, share = first_given(level.comm, mine), most / found
                assert at is not None
                raise InputError(
                    f"{self.model.source}: displacements with {what} up to {found:.2g}{of_body}, at "
                    f"{self.data.place(at)}: elasticity is for small ones, up to {most:g}; take "
                    f"{self._admissible(share)}, a stiffer body, or an obstacle that is nearer"
                )

    def _faced(self, obstacle: Obstacle) -> Facing:
        """An obstacle with its nodes; sets the directions of the gap there (collective)."""
        level, gdim = self.level, self.level.mesh.geometry.dim
        obstacle.check(gdim, axial=self.model.radial)
        others = [effect.part for effect in self.model.effects if isinstance(effect, Obstacle)]
        facets = self.data.last_facets(obstacle.part, others)
        if total(level.comm, len(facets)) == 0:
            raise InputError(
                f"{obstacle.source}: has no effect: a later [[boundary]] has an obstacle on all its facets"
            )
        own_facets = facets[facets < level.mesh.topology.index_map(level.mesh.topology.dim - 1).size_local]
        if total(level.comm, np.count_nonzero(~np.isin(own_facets, level.boundary_facets))) > 0:
            raise InputError(f"{obstacle.source}: a part of it is inside the body; contact is on the boundary")
        dofs = self.data.dofs_on(facets)
        own = dofs[dofs < level.owned]
        points = np.concatenate(level.comm.allgather(self.vectors.nodes.T[self.vectors.node_of[own], :gdim]))
        self._set_normals(obstacle, facets, dofs)
        return Facing(obstacle, facets, dofs, points, fem.Constant(level.mesh, PETSc.ScalarType(0.0)))

    def _set_normals(self, obstacle: Obstacle, facets: np.ndarray, dofs: np.ndarray) -> None:
        """The directions of the gap at the nodes of a part (collective)."""
        node_of, gdim = self.vectors.node_of, self.level.mesh.geometry.dim
        table = self._normals.x.array.reshape(-1, gdim)
        nodes = node_of[dofs]
        if obstacle.measured:
            found = np.tile(obstacle.measured, (len(nodes), 1))
        elif obstacle.kind == "plane":
            found = -np.tile(obstacle.direction, (len(nodes), 1))
        else:
            found = self._of_body(obstacle, facets)[nodes]
        before = table[nodes]
        other = (np.linalg.norm(before, axis=1) > 0) & (np.einsum("ij,ij->i", before, found) < CLOSE)
        points = self.level.points.T[dofs[other]]
        bad = [one for one in self.level.comm.allgather(points[0].tolist() if len(points) else None) if one]
        if bad:
            raise InputError(
                f"{obstacle.source}: meets another part with an obstacle, whose gap has another direction; leave "
                f"facets between them, or give both the same 'along', at {self.data.place(np.array(min(bad)))}"
            )
        table[nodes] = found
        self._normals.x.scatter_forward()

    def _of_body(self, obstacle: Obstacle, facets: np.ndarray) -> np.ndarray:
        """Means of the normals of facets, at local nodes; of quadratic elements linear between vertices
        (collective)."""
        mesh, gdim = self.level.mesh, self.level.mesh.geometry.dim
        linear = releases.functionspace(mesh, "Lagrange", 1, gdim)
        ds, v, n = self._over(facets), ufl.TestFunction(linear), ufl.FacetNormal(mesh)
        sums, sizes = (assembled(form, linear) for form in (ufl.inner(n, v) * ds, v[0] * ds))
        vectors, weights = sums.x.array.reshape(-1, gdim), sizes.x.array.reshape(-1, gdim)[:, 0]
        lengths = np.linalg.norm(vectors, axis=1)
        there = weights > 0
        kinks = there & (lengths < KINK * weights)
        found = [np.round(x, 12).tolist() for x in linear.tabulate_dof_coordinates()[kinks][:1]]
        found = [x for part in mesh.comm.allgather(found) for x in part]
        if found:
            place = ", ".join(f"{x:.4g}" for x in min(found)[:gdim])
            raise InputError(f"{obstacle.source}: the body has an edge at ({place}), where facets with different "
                             "normals meet; give 'along', or a table [[boundary]] for each side")  # fmt: skip
        vectors[there] /= lengths[there][:, None]
        on_body = fem.Function(self.vectors.V)
        on_body.interpolate(sums)
        units = on_body.x.array.reshape(-1, gdim).copy()
        size = np.linalg.norm(units, axis=1)
        units[size > 0] /= size[size > 0][:, None]
        return units

    def _over(self, facets: np.ndarray) -> ufl.Measure:
        mesh = self.level.mesh
        tags = dmesh.meshtags(mesh, mesh.topology.dim - 1, np.unique(facets), np.ones(len(np.unique(facets)), np.int32))
        return ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)

    def _conditions(self) -> list[Any]:
        """Dirichlet conditions of the components that are given (collective)."""
        V, mesh, found = self.vectors.V, self.level.mesh, []
        for number, part in enumerate(self.model.boundary):
            if part.components and len(part.components) != mesh.geometry.dim:
                wanted = f"u has {mesh.geometry.dim} components"
                raise InputError(f"{self.model.source}: {part.name} value: has {len(part.components)}, but {wanted}")
            for k, field in enumerate(part.components):
                if field is not None:
                    dofs = fem.locate_dofs_topological(
                        (V.sub(k), self.vectors.Q), mesh.topology.dim - 1, self.data.facets[number]
                    )
                    given = fem.Function(self.vectors.Q)
                    given.interpolate(self.data.on_part(field, number))
                    self._values.append((given, field, number))
                    found.append(fem.dirichletbc(given, dofs, V.sub(k)))
        return found


def part_of(one: Facing, nodes: ContactTable) -> ContactTable:
    """The contact nodes that face an obstacle."""
    size = np.ptp(nodes.points, axis=0).max(initial=0.0)
    near = cKDTree(one.points).query(nodes.points)[0] <= SAME * size
    return ContactTable(*(column[near] for column in vars(nodes).values()))
