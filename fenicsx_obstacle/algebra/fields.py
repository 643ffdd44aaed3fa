"""Stopping test of several fields with units of their own, such as velocity and pressure: each is in balance."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenicsx_obstacle.algebra.data_scales import EPSILON, ROUNDOFF_MARGIN
from fenicsx_obstacle.algebra.stopping import NEARLY_CONSTANT, SMALL_CORRECTION, Stopping
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.parallel import total

ROUNDED = 1e-14  # of |A| |u|: what a direct solver leaves


def stopping_of(problem: System, **how: Any) -> Stopping:
    """The stopping test of a system; `how` has the other attributes of `Stopping`."""
    return (Stopping if problem.fields is None else FieldsStopping)(problem, **how)


class FieldsStopping(Stopping):
    """The stopping test of several fields; no number is a scale for all of them."""

    def _is_balanced(self, active: np.ndarray, elastic: np.ndarray, floor: float) -> bool:
        """Whether forces are in balance in each field, whose unit and size may be others than those of the other fields
        (collective).

        Args:
            active: Which obstacle holds each owned dof.
            elastic: Forces without those of contact.
            floor: 0.
        """
        problem = self.problem
        assert problem.fields is not None
        count, number = problem.fields
        far = len(self.history) < 2 or self.history[-1].changed > 0  # then round-off is no reason to stop
        load, inner = problem.matrices.forces_within()
        held = problem.fixed | problem.active_dofs(active != 0)
        acting = np.where(held, elastic, load - elastic), np.where(held, 0.0, inner)
        residual, stiffness, u = np.abs(self._unbalanced(elastic)[1]), problem.matrices.diagonal, np.abs(problem.u)
        columns = [np.bincount(number, np.abs(one), count) for one in (residual, *acting)]
        unbalanced, forces, inner = problem.comm.allreduce(np.array(columns))
        balanced = bool(np.all(unbalanced <= np.maximum(self.tolerance * forces, 0.0 if far else ROUNDED * inner)))
        if problem.affine or not balanced:  # a direct solver leaves round-off
            return balanced
        limit = SMALL_CORRECTION * (problem.spread(problem.u) + NEARLY_CONSTANT * u)
        own = (stiffness > 0) & (limit > 0)
        moved = np.maximum(residual[own] / stiffness[own] - ROUNDOFF_MARGIN * EPSILON * u[own], 0.0)
        left = total(problem.comm, moved / limit[own])
        return left <= 1 or self._in_vain(left)

    def _is_determined(self, active: np.ndarray) -> bool:
        """True: `System.checks` has what takes its place."""
        return True

    def round_off(self) -> float:
        """0: round-off is that of each field."""
        return 0.0

    @property
    def _nothing(self) -> float:
        return 0.0
