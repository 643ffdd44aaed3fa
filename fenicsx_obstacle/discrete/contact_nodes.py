"""Contact nodes of vector-valued problems: one unit normal N_i, one weight D_i and one gap for each node.

At a contact node the constraint is lower <= of(u) <= upper with of(u) = N_i . u, up to a term independent of u and a
factor. A Householder reflection H_i maps N_i to a coordinate axis, so that one component of H_i u is the normal
displacement and the constraint a simple bound. The penalty and the variational inequality take the same N_i, D_i and
bounds.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Derivative, Zero
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle import releases
from fenicsx_obstacle.data.admissible import worst
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.fields import check_real, foreign
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.discrete.assembly import NO_WEIGHT, assembled, beyond_round_off
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.rules import facet_of, midpoint_rule, nodal_rule
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import cell_facets
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.validation import place
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.text import shown

KINK = 0.8  # least length of the mean of unit normals: two facets whose normals differ by 74 degrees
HELD = 1e-6  # least length of a unit normal's part in free directions; below it the node is held
ROUND_OFF = 1e-14  # of a unit normal
BEYOND = 1e-10  # relative to displacements and the obstacle there: what a held node may be beyond it
PLACE = 1e-14  # of the size of the body: round-off of a gap


class ContactNodes:
    """Normals, weights and rotations at the nodes of facets where contact can be.

    Arrays have one row for each local contact node, ghosts included, in ascending order of the nodes.

    Attributes:
        nodes: Local numbers.
        dofs: Local dof of the normal component of each.
        weights: D_i = int w phi_i over the facets, for a weight w; a force is p_i D_i.
        facet_nodes: Local numbers of the nodes of each owned contact facet, shape (facets, nodes of a facet).
        normals: Unit normals in the directions in which u is free, shape (nodes, components).
        turned: Nodes whose normal is along no coordinate axis.
        held: Of nodes that are held along the normal: local numbers, and N, factor and offset with of(u) = factor N . u
            + offset.
    """

    def __init__(self, level: Level, of: Any, u: fem.Function, weight: Any, fixed: np.ndarray, name: str):
        """Integrate over the facets named `contact` (collective).

        Args:
            level: With V of u.
            of: What the obstacles bound: a scalar UFL expression, linear in u plus what does not depend on u.
            u: The unknown.
            weight: UFL factor of the surface measure, such as the radius in axial symmetry; None for 1.
            fixed: Local dofs where u is given.
            name: Of the problem, for messages.

        Raises:
            InputError: If `of` is no such expression, or facets that meet at a node have too different normals.
        """
        normal, rest = _parts_of(of, u, f"{name}: of")
        V, bs, mesh = level.V, level.components, level.mesh
        dim, facets = mesh.topology.dim - 1, level.facets["contact"]
        own = np.sort(facets[facets < mesh.topology.index_map(dim).size_local]).astype(np.int32)
        tags = dmesh.meshtags(mesh, dim, own, np.ones(len(own), dtype=np.int32))
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)(1)
        cell = facet_of(releases.cell_name(mesh))
        rule = (
            midpoint_rule(cell) if (cell, level.pair.degree) == ("triangle", 2) else nodal_rule(cell, level.pair.degree)
        )
        dI, v = rule.on(ds), ufl.TestFunction(V)
        length = ufl.sqrt(ufl.dot(normal, normal))
        D = _integrals((1 if weight is None else weight) * v[0] * ds, V)[:, 0]
        sums = _integrals(ufl.dot(normal, v) * dI, V)
        sizes = _integrals((length * v[0] + v[1]) * dI, V)
        on = beyond_round_off(V, D) & beyond_round_off(V, sizes[:, 1])
        if total(mesh.comm, np.count_nonzero(beyond_round_off(V, -D))) > 0:
            raise InputError(f"{name}: measure: its weight is negative somewhere: a node would have a negative area")
        self._check_normals(level, on, sums, sizes, name)
        self.facet_nodes = _facet_nodes(level, own)
        self._beside = _weightless(level, self.facet_nodes, on)
        nodes = np.flatnonzero(on)
        mean = sums[nodes] / sizes[nodes, :1]
        unit = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        scale = sizes[nodes, 0] / sizes[nodes, 1]
        offset = np.zeros(len(nodes)) if rest is None else _integrals(rest * v[0] * dI, V)[nodes, 0] / sizes[nodes, 1]
        held = np.zeros(sizes.size, dtype=bool)
        held[fixed] = True
        held = held.reshape(sizes.shape)[nodes]
        free = np.where(held, 0.0, unit)
        lengths = np.linalg.norm(free, axis=1)
        touchable = lengths > HELD
        self.components, self.nodes = bs, nodes[touchable]
        self.weights, self._lengths = D[self.nodes], lengths[touchable]
        self._scale, self._offset = scale[touchable], offset[touchable]
        self._in_held_directions = np.where(held, unit, 0.0)[touchable]
        self.held = nodes[~touchable], unit[~touchable], scale[~touchable], offset[~touchable]
        self.normals = free[touchable] / self._lengths[:, None]
        axis = np.argmax(np.abs(self.normals) > np.abs(self.normals).max(axis=1, initial=0.0)[:, None] - 1e-6, axis=1)
        self.dofs = bs * self.nodes + axis
        self._set_reflections(axis)

    def _check_normals(self, level: Level, on: np.ndarray, sums: np.ndarray, sizes: np.ndarray, name: str) -> None:
        """Reject nodes without a normal (collective)."""
        length = np.linalg.norm(sums, axis=1)
        for bad, what in (
            (sizes[:, 0] <= NO_WEIGHT * sizes[:, 1], "of does not depend on u"),
            (length < KINK * sizes[:, 0], "facets with different normals meet, so that their common node has none; "
             "give one normal for each part, or round the edge,"),
        ):  # fmt: skip
            points = level.nodes.T[on & bad]
            found = [one for one in level.comm.allgather(points[0].tolist() if len(points) else None) if one]
            if found:
                raise InputError(f"{name}: of: {what} at {place(min(found)[: level.mesh.geometry.dim])}")

    def _set_reflections(self, axis: np.ndarray) -> None:
        """Householder reflections with H e = N, for e the coordinate axis that is nearest to N."""
        difference = -self.normals.copy()
        difference[np.arange(len(axis)), axis] += 1.0
        square = np.einsum("ij,ij->i", difference, difference)
        turned = square > ROUND_OFF**2
        self.turned = self.nodes[turned]
        d = difference[turned]
        self._H = np.eye(self.components) - 2 * d[:, :, None] * d[:, None, :] / square[turned][:, None, None]

    def rotated(self, values: np.ndarray) -> np.ndarray:
        """Values at local or owned dofs, from Cartesian components to normal and tangential ones, or back."""
        bs, count = self.components, np.searchsorted(self.turned, len(values) // self.components)
        out = values.copy()
        if count:
            table = out.reshape(len(values) // bs, bs)
            table[self.turned[:count]] = np.einsum("nij,nj->ni", self._H[:count], table[self.turned[:count]])
        return out

    def rotation(self, A: PETSc.Mat) -> PETSc.Mat:
        """The map `rotated` as a matrix with the layout of A; it is its own inverse (collective)."""
        bs, (first, end) = self.components, A.getOwnershipRange()
        count = np.searchsorted(self.turned, (end - first) // bs)
        turned = np.zeros(end - first, dtype=bool)
        rows = (bs * self.turned[:count, None] + np.arange(bs)).ravel()
        turned[rows] = True
        indptr = np.concatenate([[0], np.cumsum(np.where(turned, bs, 1))])
        columns, values = np.empty(indptr[-1], dtype=PETSc.IntType), np.ones(indptr[-1])
        columns[indptr[:-1][~turned]] = first + np.flatnonzero(~turned)
        places = indptr[rows][:, None] + np.arange(bs)
        columns[places] = first + bs * np.repeat(self.turned[:count], bs)[:, None] + np.arange(bs)
        values[places] = self._H[:count].reshape(bs * count, bs)
        R = PETSc.Mat().createAIJ((A.getSizes()[0], A.getSizes()[1]), bsize=bs, comm=A.comm,
                                  csr=(indptr.astype(PETSc.IntType), columns, values))  # fmt: skip
        R.assemble()
        return R

    def extended(self, values: np.ndarray, V: fem.FunctionSpace) -> np.ndarray:
        """Values at local nodes; those of nodes of weight 0 are extrapolated linearly on their facets (collective).

        P2 has such nodes at the vertices of triangles, and in axial symmetry on the axis.

        Args:
            values: At local nodes; valid at the contact nodes.
            V: The vector-valued space.
        """
        if self._beside is None:
            return values
        targets, known, factors = self._beside
        around = values[known]
        at = np.einsum("ij,ij->i", factors, around)
        at = np.where((around <= 0).all(axis=1), np.minimum(at, 0.0), at)  # extrapolation does not change the sign
        at = np.where((around >= 0).all(axis=1), np.maximum(at, 0.0), at)
        around = AroundNodes(V, targets)
        sums, counts = around.sums(at), around.sums(np.ones(len(at)))
        return np.where(counts > 0, sums / np.maximum(counts, 1.0), values)

    def bounds(self, g: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Bounds of the normal component at the contact nodes.

        Args:
            g: Values of an obstacle at local nodes.
            given: Values of u that are held, at local dofs.
        """
        bs = self.components
        held = given.reshape(len(given) // bs, bs)[self.nodes]
        taken = np.einsum("ij,ij->i", self._in_held_directions, held)
        return ((g[self.nodes] - self._offset) / self._scale - taken) / self._lengths


def _parts_of(of: Any, u: fem.Function, place: str) -> tuple[Any, Any]:
    """The vector N with of(u) = N . u + rest, and the rest, or None where that is 0.

    Raises:
        InputError: If `of` is not like that.
    """
    wanted = "expected a scalar UFL expression that is linear in u, such as ufl.dot(u, n)"
    if not isinstance(of, ufl.core.expr.Expr) or of.ufl_shape != () or extract_arguments(of):
        raise InputError(f"{place} = {shown(of)}: {wanted}")
    if u not in extract_coefficients(of):
        raise InputError(f"{place} does not depend on u: {wanted}")
    if foreign(of, u.function_space.mesh.ufl_domain()):
        raise InputError(f"{place} holds a FacetNormal, a Function or coordinates of another mesh than u: {wanted}")
    check_real(of, place)
    lowered = apply_algebra_lowering(of)
    if any(isinstance(node, Derivative) and u in extract_coefficients(node) for node in unique_pre_traversal(lowered)):
        raise InputError(f"{place} holds derivatives of u: {wanted}")
    v = ufl.Argument(u.function_space, 0)
    if u in extract_coefficients(apply_derivatives(apply_algebra_lowering(ufl.derivative(of, u, v)))):
        raise InputError(f"{place} is not linear in u: {wanted}")
    size = u.ufl_shape[0]
    rest = ufl.replace(of, {u: Zero((size,))})
    unit_vectors = [ufl.as_vector([float(i == k) for i in range(size)]) for k in range(size)]
    normal = ufl.as_vector([ufl.replace(of, {u: e}) - rest for e in unit_vectors])
    return normal, None if isinstance(rest, Zero) else rest


def _facet_nodes(level: Level, own: np.ndarray) -> np.ndarray:
    """Nodes of owned facets in ascending order, shape (facets, nodes of a facet) (local)."""
    V, dim, table = level.V, level.mesh.topology.dim - 1, cell_facets(level.mesh)
    cells, numbers = np.nonzero(np.isin(table, own))
    first = np.unique(table[cells, numbers], return_index=True)[1]
    closures = [np.sort(V.dofmap.dof_layout.entity_closure_dofs(dim, k)) for k in range(table.shape[1])]
    return releases.cell_dofs(V)[cells[first, None], np.array(closures)[numbers[first]]]


def _weightless(level: Level, rows: np.ndarray, on: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Nodes of weight 0 on owned contact facets, once for each facet, and the nodes and factors from which they are
    extrapolated; None if there are none on any rank (collective).

    Args:
        level: With V.
        rows: Nodes of these facets.
        on: Whether a local node has a weight.
    """
    mesh, V = level.mesh, level.V
    flags = fem.Function(V)  # owners decide
    flags.x.array.reshape(len(on), level.components)[:, 0] = on
    flags.x.scatter_forward()
    weighty = flags.x.array.reshape(len(on), level.components)[:, 0] > 0.5
    targets, known, factors = [], [], []
    for row in rows:
        there = weighty[row]
        if there.all() or not there.any():
            continue
        x = level.nodes.T[row]
        x = np.column_stack([np.ones(len(row)), x - x.mean(axis=0)])
        inverse = np.linalg.pinv(x[there])
        for number in np.flatnonzero(~there):
            targets.append(row[number])
            known.append(row[there])
            factors.append(x[number] @ inverse)
    if total(mesh.comm, len(targets)) == 0:
        return None
    if not targets:
        return np.empty(0, dtype=np.int64), np.empty((0, 1), dtype=np.int64), np.empty((0, 1))
    return np.array(targets), np.array(known), np.array(factors)


def _integrals(linear: ufl.Form, V: fem.FunctionSpace) -> np.ndarray:
    """A linear form at local nodes, ghosts included, shape (nodes, components) (collective)."""
    values, components = assembled(linear, V).x.array.copy(), V.dofmap.index_map_bs
    return values.reshape(len(values) // components, components)


class HeldBeyond(InputError):
    """A given value of u is beyond an obstacle.

    Attributes:
        point: Where, shape (3,).
        distance: By how much.
    """

    def __init__(self, message: str, point: np.ndarray, distance: float):
        super().__init__(message)
        self.point, self.distance = point, distance


class VectorData(Data):
    """The data of a vector-valued problem: obstacles bound the normal components at contact nodes."""

    def __init__(self, model: Model, level: Level, bcs: Any, *, of: Any, u: fem.Function, weight: Any = None):
        """Store the arguments; data are sampled on first use.

        Args:
            model: With obstacles on the facets named `contact`.
            level: Mesh and V.
            bcs: Dirichlet conditions of V or of its components.
            of: What the obstacles bound, as for `ContactNodes`.
            u: The unknown.
            weight: As for `ContactNodes`.
        """
        super().__init__(model, level, bcs=bcs, live=True)
        self._of, self._u, self._weight = of, u, weight
        self._scalar = self.on(level.scalar)

    @cached_property
    def contact(self) -> ContactNodes:
        """Normals and weights (first use is collective)."""
        return ContactNodes(self.level, self._of, self._u, self._weight, self.fixed[0], self.model.source)

    def _thin_obstacle(self, obstacles: Mapping[int, Field], none: float) -> fem.Function:
        level, contact, given = self.level, self.contact, self.fixed[1].x.array
        on_q = self._scalar._thin_obstacle(obstacles, none).x.array
        g = np.full(len(given) // level.components, none)
        g[level.node_of] = on_q
        self._check_held(g, given, 1.0 if none > 0 else -1.0)
        function = fem.Function(level.V)
        function.x.array[:] = none
        function.x.array[contact.dofs] = contact.bounds(g, given)
        function.x.scatter_forward()
        return function

    def _check_held(self, g: np.ndarray, given: np.ndarray, side: float) -> None:
        """Reject values of bcs beyond an obstacle (collective).

        Raises:
            HeldBeyond: With the place where they are farthest beyond it; of places alike the first by coordinates.
        """
        comm, (nodes, normals, factor, offset) = self.level.comm, self.contact.held
        size = max(largest(comm, np.abs(given)), 0.0) + np.where(np.isfinite(g[nodes]), np.abs(g[nodes]), 0.0)
        u = given.reshape(len(given) // self.level.components, self.level.components)[nodes]
        beyond = side * (np.einsum("ij,ij->i", normals, u) - (g[nodes] - offset) / factor)
        beyond[beyond <= BEYOND * size + PLACE * self.extent] = -np.inf
        excess = np.full(len(given), -np.inf)
        excess[self.level.components * nodes] = beyond
        found = worst(self, excess)
        if found is not None:
            most, point, _ = found
            word = "upper" if side > 0 else "lower"
            raise HeldBeyond(
                f"{self.model.source}: a given value of u is beyond the {word} obstacle by {most:.3g} at "
                f"{self.place(point)}, so that no u satisfies both",
                point,
                most,
            )
