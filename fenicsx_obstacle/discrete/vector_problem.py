"""Vector-valued problems with contact on the boundary: (3.4) for the normal component at contact nodes.

The unknown is H u instead of u, with H the reflections of `ContactNodes`: one component at a contact node is N_i . u.
In these components the penalised residual is

    A w + (A r - f) + D chi (w - gap)/eps,

D, chi and gap only at normal components. So everything that solves scalar problems applies: the penalty is diagonal,
bounds of the variational inequality are simple, and w counts from the obstacle (gap form).
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle.algebra.system import Check
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.discrete.contact_nodes import VectorData
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.discrete.rigid_motions import BodySystem, check_held, moves_freely
from fenicsx_obstacle.parallel import total


class VectorForms(Nodal):
    """Matrix and load of affine forms, in normal and tangential components (all methods collective).

    Attributes:
        displacement: u in Cartesian components, in the forms.
    """

    data: VectorData

    def _set_contact_measure(self) -> None:
        self.contact = self.data.contact

    def _unknown(self) -> tuple[fem.Function, fem.Function]:
        self.displacement = fem.Function(self.data.level.V, name="u")
        return self.displacement, self.displacement

    def _point_weights(self) -> np.ndarray:
        values, contact = np.zeros(len(self.w.x.array)), self.contact
        values[contact.dofs] = contact.weights
        return values[: self.data.level.owned]

    def _load(self) -> None:
        super()._load()
        self.minus_load.array[:] = self.contact.rotated(self.minus_load.array_r)

    def _assembled(self) -> PETSc.Mat:
        self._cartesian = super()._assembled()
        if total(self.data.level.comm, len(self.contact.turned)) == 0:
            return self._cartesian
        self._rotation = self.contact.rotation(self._cartesian)
        return self._cartesian.PtAP(self._rotation)

    def _assemble_again(self) -> None:
        self._filled(self._cartesian)
        if self.stiffness is not self._cartesian:
            self._cartesian.PtAP(self._rotation, result=self.stiffness)

    def take_displacement(self) -> None:
        """Update the displacement in the forms."""
        self.displacement.x.array[:] = self.contact.rotated(self.w.x.array + self.reference.x.array)

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        self.take_displacement()
        return super().energy(penalised=penalised, moving=moving)


class NonlinearVectorForms(VectorForms):
    """The same for forms that are assembled at every evaluation (all methods collective)."""

    def set_reference(self) -> None:
        """Nothing is kept that depends on r."""

    def elastic(self, out: PETSc.Vec) -> None:
        self.take_displacement()
        self._assemble(out, self._form("elastic"))
        out.array[:] = self.contact.rotated(out.array_r)

    def forces_at(self, u_values: np.ndarray | float) -> np.ndarray:
        return Forms.forces_at(self, u_values)  # not by the matrix, which is that of one state

    def energy(self, *, penalised: bool, moving: bool = True) -> float:
        self.take_displacement()
        return Forms.energy(self, penalised=False, moving=moving) + (self.penalty_energy() if penalised else 0.0)

    def jacobian(self, A: PETSc.Mat, *, penalised: bool) -> None:
        self.take_displacement()
        self.renew(A, stiffness=True)
        super().jacobian(A, penalised=penalised)

    def _load(self) -> None:
        self.minus_load.set(0.0)


class VectorProblem(BodySystem, Problem):
    """A vector-valued problem on one mesh; u and obstacles of its methods are Cartesian, w, r and gaps are not."""

    law: VectorForms
    eps_share = 1e-3  # D_i/A_ii is about .7 h/E* for degree 1 and .3 h/E* for degree 2

    def _make_forms(self) -> VectorForms:
        return (VectorForms if self.affine else NonlinearVectorForms)(self.model.effects, self.data)

    def _checks(self) -> tuple[str, tuple[Check, ...]]:
        return "", (moves_freely,)

    @property
    def extent(self) -> float:  # type: ignore[override]
        return self.data.extent

    def _check_support(self) -> None:
        self.loose = check_held(self)
        self.floating = self.loose is not None

    def cold_start(self) -> np.ndarray:
        """u = 0 but for given values; beyond the obstacle at all contact nodes, where contact alone holds the body."""
        if not self.floating:
            return self.flat()
        w = self.data.contact.rotated(self._given_values())
        for bound, sign in self.bounded_sides():
            there = np.isfinite(bound)
            w[there] = bound[there] + sign * self.data.extent
        return self.data.contact.rotated(w)

    def flat(self) -> np.ndarray:
        """Displacements of the data: given values, and those of contact nodes that obstacles displace, otherwise 0."""
        return self.between(self._given_values())

    def _given_values(self) -> np.ndarray:
        return np.where(self.fixed, self.given, 0.0)

    def between(self, u_values: np.ndarray) -> np.ndarray:
        contact = self.data.contact
        return contact.rotated(np.clip(contact.rotated(u_values), *self.obstacles()))

    def set_reference(self, u_values: np.ndarray) -> None:
        super().set_reference(self.in_components(u_values))

    def in_components(self, u_values: np.ndarray) -> np.ndarray:
        return self.data.contact.rotated(u_values)

    def solution(self) -> fem.Function:
        u = super().solution()
        u.x.array[:] = self.data.contact.rotated(u.x.array)
        return u

    def in_q(self, values: np.ndarray) -> fem.Function:
        return self._of_nodes(self._at_nodes(values))

    def points_of(self, q: fem.Function) -> np.ndarray:
        contact, everywhere = self.data.contact, fem.Function(self.level.V)
        at_nodes = np.zeros(len(everywhere.x.array) // self.level.components)
        at_nodes[self.level.node_of] = q.x.array
        everywhere.x.array[contact.dofs] = at_nodes[contact.nodes]
        return everywhere.x.array[: self.owned].copy()

    def pressures(self, p: np.ndarray) -> fem.Function:
        return self._of_nodes(self.data.contact.extended(self._at_nodes(p), self.level.V))

    def gap_function(self, gaps: np.ndarray) -> fem.Function:
        """Gaps at owned dofs as a Function of Q, infinite where there is no obstacle, not-a-number off the contact
        boundary (collective)."""
        contact, V = self.data.contact, self.level.V
        on, at_nodes = np.zeros(len(self.level.nodes.T)), self._at_nodes(gaps)
        on[contact.nodes] = 1.0
        near, infinite = (contact.extended(flags, V) > 0 for flags in (on, np.isinf(at_nodes).astype(float)))
        found = np.where(infinite, np.inf, contact.extended(np.where(np.isinf(at_nodes), 0.0, at_nodes), V))
        return self._of_nodes(np.where(near, found, np.nan))

    def _at_nodes(self, values: np.ndarray) -> np.ndarray:
        """Values at owned dofs, at local nodes: those of normal components, elsewhere 0 (collective)."""
        contact, everywhere = self.data.contact, fem.Function(self.level.V)
        everywhere.x.array[: self.level.owned] = values
        everywhere.x.scatter_forward()
        found = np.zeros(len(everywhere.x.array) // self.level.components)
        found[contact.nodes] = everywhere.x.array[contact.dofs]
        return found

    def _of_nodes(self, values: np.ndarray) -> fem.Function:
        found = fem.Function(self.level.Q)
        found.x.array[:] = values[self.level.node_of]
        return found
