"""A `System` on a mesh: what checks, bounds and results ask of it."""

from __future__ import annotations

from functools import cached_property
from typing import Any, cast

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.model import Model
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.effects.effect import Effect, OnPart, WithTension, is_support
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.mesh.transfer import downward
from fenicsx_obstacle.parallel import largest, smallest


class MeshSystem(System):
    """A system whose unknowns are the dofs of a mesh.

    All methods are collective.

    Attributes:
        data: The data of the model on this mesh.
        model: What is to be solved.
        level: The mesh and V.
        law: The forms.
        vector_valued: Whether u has several components.
        drift: The `discrete.residence_time.Drift` of a model that has one, otherwise None.
    """

    data: Data
    model: Model
    level: Level
    law: Forms
    on_mesh = True
    vector_valued = False
    drift: Any = None

    @property
    def h(self) -> float:  # type: ignore[override]
        return self.level.h

    def heights(self) -> list[np.ndarray]:
        at_rest = [np.zeros(1)] if any(is_support(effect) for effect in self.model.effects) else []
        return at_rest + [values for values in self.soft_obstacles() if values is not None]

    def soft_obstacles(self) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Local nodal values of the lower and the upper soft obstacle; None where there is none."""
        soft: Any = next((effect for effect in self.model.effects if effect.role == "soft obstacle"), None)
        sides = (None, None) if soft is None else (soft.lower, soft.upper)
        lower, upper = (None if side is None else self.data.height(side).x.array for side in sides)
        return lower, upper

    def pushes(self) -> tuple[float, float] | None:
        found = [push for effect in self.model.effects if (push := _push(effect, self.data)) is not None]
        if len(found) < len(self.model.effects):
            return None
        return sum(smallest(self.comm, push) for push in found), sum(largest(self.comm, push) for push in found)

    def tension(self) -> float | None:
        found = self.model.elastic.stiffness(self.data)
        return None if found is None else largest(self.comm, found)

    @property
    def compliance_power(self) -> float:
        dim = self.level.mesh.topology.dim
        if not self.data.thin:
            return 2.0 / dim
        return 0.0 if dim == 1 else 1.0 / (dim - 1)

    @property
    def nodal_forms(self) -> Nodal:
        """The forms of affine effects with contact at nodes."""
        assert isinstance(self.law, Nodal)
        return self.law

    def in_q(self, values: np.ndarray) -> fem.Function:
        """The function of Q_h with these values at the owned points of I (collective).

        Args:
            values: One for each owned dof of V_h, or of Q_h where the pair is not nodal.
        """
        level, q = self.level, fem.Function(self.level.Q)
        if level.Q is level.V or not level.pair.nodal:
            q.x.array[: len(values)] = values
        else:
            everywhere = fem.Function(level.V)
            everywhere.x.array[: len(values)] = values
            everywhere.x.scatter_forward()
            q.x.array[:] = everywhere.x.array[level.node_of]
        q.x.scatter_forward()
        return q

    def points_of(self, q: fem.Function) -> np.ndarray:
        """The values at owned points of I of a function of Q_h, the inverse of `in_q` (collective)."""
        level = self.level
        if level.Q is level.V or not level.pair.nodal:
            return q.x.array[: len(self.weights)].copy()
        everywhere = fem.Function(level.V)
        everywhere.x.array[level.node_of] = q.x.array
        return everywhere.x.array[: self.owned].copy()

    def pressures(self, p: np.ndarray) -> fem.Function:
        """The same of pressures, whose Q_h may have more nodes (collective)."""
        return self.in_q(p)

    def elastic_at(self, w: np.ndarray) -> np.ndarray:
        """a(w + r, .) - f at owned dofs for this w; the state stays as it is (collective)."""
        kept, out = self.w.copy(), self.law.vector()
        self.w[:] = w
        self.state.share()
        self.law.elastic(out)
        self.w[:] = kept
        self.state.share()
        found = out.array_r.copy()
        out.destroy()
        return found

    def solution(self) -> fem.Function:
        """u = w + r."""
        u = fem.Function(self.level.V, name="u")
        u.x.array[: self.owned] = self.u
        u.x.scatter_forward()
        return u

    @cached_property
    def transfer(self) -> Transfer:  # type: ignore[override]
        """Interpolation from the next coarser problem; by default from the mesh that this one was refined from (first
        use is collective)."""
        return next(downward(self.level.on_meshes if self.level.grids else self.level))

    @property
    def has_energy(self) -> bool:  # type: ignore[override]
        w, data, effects = self.law.w, self.data, self.model.effects
        derived = (e.energy(w, data) is not None or e.terms(w, self.law.v, data) is None for e in effects)
        return all(effect.convex for effect in effects) and all(derived)


def cell_means(level: Level) -> PETSc.Mat:
    """The map from values at owned dofs of V_h to the means of the nodal values of each cell, at the owned dofs of Q_h
    (collective)."""
    own, dofs = own_cells(level.mesh), releases.cell_dofs(level.V)
    rows = releases.cell_dofs(level.Q)[:own, 0]  # pressures are constant on cells
    columns = level.V.dofmap.index_map.local_to_global(dofs[:own].ravel().astype(np.int32)).reshape(own, -1)
    inverse = np.argsort(rows)
    columns = columns[inverse].astype(PETSc.IntType)
    count = columns.shape[1]
    starts = np.arange(0, columns.size + 1, count, dtype=PETSc.IntType)
    size = (own, None), (level.owned, None)
    return PETSc.Mat().createAIJ(
        size, csr=(starts, columns.ravel(), np.full(columns.size, 1.0 / count)), comm=level.comm
    )


def _push(effect: Effect, data: Data) -> np.ndarray | None:
    """Local values of its part of f, and 0, for the maximum principle; None if there is no such principle.

    0 alone says that its part of a(., .) lets constants be compared with solutions: it contains gradients of u, or
    draws u towards the `heights`.
    """
    values: Any = ()
    if effect.role == "load":
        values = data.values(effect.value)
    elif effect.role == "part load" and isinstance(effect, OnPart):
        values = data.on_part(effect.value, effect.part).x.array
    elif effect.role == "point forces":
        values = [force for _, force in cast(Any, effect.value)]
    elif not effect.role and not isinstance(effect, WithTension):
        return None
    return np.append(values, 0.0)
