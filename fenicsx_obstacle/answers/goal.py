"""From a tolerance for one output quantity to a solution: energy, contact force, or a quantity of [report].

The error is estimated on a finer mesh: all cells of the mesh are refined, those at the free boundary once more, those
in which a datum jumps, or an obstacle is beyond u between the nodes, three times more, and the problem is solved there.
The change of the quantity, times `BEYOND` for what still finer meshes would change, and the part of the penalty are the
estimate. Where it comes from is said by the dual weighted residual (`dual_weighted`), and there the mesh is refined.
The energy has a guaranteed error instead wherever there is an error bound.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.adapt import BULK, STALLED, Adaptation, Estimate
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.budget import Budget
from fenicsx_obstacle.answers.jumps import BETWEEN, cells_with_jumps, hidden_contact, unresolved
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.estimation.dual_weighted import adjoint_of, contributions, energy_contributions
from fenicsx_obstacle.mesh.around_nodes import AroundNodes, with_ghosts
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.levels import Level
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.problems.summary import lookup
from fenicsx_obstacle.scenes.functionals import Report, check_differentiable
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import nearest, of_outputs

BEYOND = 4 / 3  # of order 2 in h, halved cells remove three quarters of the error
AT_FREE_BOUNDARY = 1  # further refinements there: h/4
AT_JUMPS = 3  # where data jump inside cells: h/16, as finer meshes may have a jump at the same wrong place
LEAST_SHARE = 0.05  # of the sum of the absolute values of all contributions: they cancel by chance
NOT_DIFFERENTIABLE = ("contact.area", "penetration")  # keys of a record
ENERGY = "energy"  # in a record; [report] may have a quantity of this name


class GoalAdaptation(Adaptation):
    """Adaptive refinement until the error of a quantity is below a tolerance, or a budget is spent.

    Attributes:
        goal: As the user named it.
        words: 'estimated', 'estimated, not settled' with the reason, or how far the error of the energy is guaranteed.
    """

    power, steady = 2, False
    goal: str
    error: Estimate

    def __init__(self, scene: Scene, goal: str, tolerance: tuple[float, bool], budget: Budget | None, comm: MPI.Comm):
        """Check the quantity.

        Raises:
            InputError: If it is not known or has no derivative, or the element no estimate.
        """
        super().__init__(scene, comm, tolerance, budget)
        if not (scene.pair.nested_hierarchy and scene.pair.at_vertices):
            raise InputError(f"{scene.source}: --of is for the element P1, not for {scene.pair.name}")
        self.goal, self.words = goal, "estimated"
        self._bounded: bool | None = None
        self._hidden = False  # an obstacle is beyond u inside cells of the finest mesh
        self._key = scene.quantities.get(goal, "")  # in a record
        if self._key in NOT_DIFFERENTIABLE:
            raise InputError(f"{scene.source}: --of {goal}: it does not depend on u differentiably, so that its error "
                             "cannot be estimated")  # fmt: skip
        if not self._key:
            known = [one for one, key in scene.quantities.items() if key not in NOT_DIFFERENTIABLE]
            raise InputError(f"{scene.source}: --of {goal}: no quantity '{goal}'" + nearest(goal, known))
        if goal in scene.report:
            check_differentiable(scene, goal)

    def answer(self, *, yardstick: bool) -> Answer:
        """The first answer whose estimate is below the tolerance, or the best that the budget allows (collective)."""
        answer, error = super().answer(yardstick=yardstick), self.error
        goal = {
            "name": self.goal, "value": error.value, "error": error.total, "relative": error.relative,
            "words": self.words, "mesh": error.discretisation, "penalty": error.penalty, "dofs": error.dofs,
        }  # fmt: skip
        adaptive = {"of": self.goal, **answer.record["adaptive"]}
        return replace(answer, record=self.comm.bcast({**answer.record, "goal": goal, "adaptive": adaptive}))

    def assessed(self, context: SolverContext) -> Answer:
        """The answer on one mesh; `error` is then that of the quantity (collective)."""
        if self._bounded is None and self._key == ENERGY:
            with suppress(InputError):  # where there is no error bound for the scene
                self._bounded = context.estimator is not None
        answer = self._guaranteed(context) if self._bounded else None
        if answer is None:
            if self._bounded:
                context.estimator.set_load(resolved=False)
            self._bounded, answer = False, self.with_eps(context, lambda: self._refined(context))
            reason = unresolved(context.problem.data)  # no finer mesh is known to have a jump at the right place
            reason = BETWEEN if reason is None and self._hidden else reason
            self.words = "estimated" if reason is None else f"estimated, not settled: {reason}"
        self.note(answer, self.error.unknowns)
        return answer

    def share(self) -> float:
        """The share of the estimate whose cells are refined next."""
        return BULK[1]

    def limit(self) -> float:
        """The tolerance in the unit of the quantity."""
        size = abs(self.error.value) if self.relative else 1.0
        if size == 0.0 < self.error.total and len(self.path) > STALLED:  # on coarse meshes it may be 0 by chance
            raise InputError(f"{self.scene.source}: --of {self.goal}: it is 0; give --tol-absolute")
        return self.tolerance * size

    def _guaranteed(self, context: SolverContext) -> Answer | None:
        """The solution on one mesh, whose energy is taken in the middle of its bounds; None where they are not proved
        (collective)."""
        answer = self.balanced(context)
        bound = answer.bound
        assert bound is not None and bound.indicator is not None
        if bound.energy is None or not bound.certified:
            return None
        self.words = of_outputs(bound.words)
        low, high = bound.energy
        half = (high - low) / 2
        self.error = Estimate(low + half, half, 0.0, bound.indicator, answer.dofs, answer.dofs)
        return answer

    def _refined(self, context: SolverContext) -> tuple[Answer, Estimate]:
        """The solution on one mesh, and the estimate from a finer one (collective).

        Parts of mesh and penalty have signs, and a sum of absolute values is far above the error where they cancel.
        """
        answer = context.answer(self.options, errors=False)
        options = replace(self.options, eps=answer.record["eps"]) if answer.record["eps"] is not None else self.options
        finer: list[SolverContext] = []
        values = [self._value(answer)]
        try:
            below, cells, fine = context, np.ones(own_cells(answer.level.mesh), dtype=bool), answer
            while len(finer) <= AT_JUMPS and total(self.comm, np.count_nonzero(cells)) > 0:
                below = below.refined(cells)
                finer.append(below)
                fine = below.answer(options, errors=False)
                values.append(self._value(fine))
                hidden = hidden_contact(below.problem.data, fine.u.x.array, fine.contact.x.array > 0.5)
                cells = cells_with_jumps(below.problem.data) | hidden
                self._hidden = total(self.comm, np.count_nonzero(hidden)) > 0
                if len(finer) <= AT_FREE_BOUNDARY:
                    cells |= at_free_boundary(fine)
            return answer, self._compared(context, answer, finer, fine, values)
        finally:
            for one in reversed(finer):
                one.close()

    def _value(self, answer: Answer) -> float:
        """The quantity of an answer.

        Raises:
            InputError: If it has none.
        """
        found = lookup(answer.record, self._key)
        if found is None:
            raise InputError(f"{self.scene.source}: --of {self.goal}: it is not finite" if self._key != ENERGY else
                             f"{self.scene.source}: --of energy: the scene has none")  # fmt: skip
        return found

    def _derivative(self, problem: Problem, answer: Answer, side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The derivative with respect to u and to the nodal forces, at owned dofs (collective).

        Args:
            problem: Holds the solution.
            answer: The solution.
            side: 1 at nodes that may press against the lower obstacle, -1 at those at the upper one, else 0.
        """
        if self._key.startswith("contact."):
            sign = 1.0 if self._key == "contact.lower.force" else -1.0
            return np.zeros(len(side)), np.where(side == sign, sign, 0.0)
        report = Report(problem.data, self.scene)
        fields = {"u": answer.u, "p": answer.pressure, "contact": answer.contact}
        report.evaluate(fields, problem.elastic.array_r)
        per_force, D = np.zeros(len(side)), problem.weights
        per_force[side != 0] = problem.thickness / D[side != 0]
        return report.derivative(self.goal, per_force)

    def _compared(
        self, context: SolverContext, answer: Answer, finer: list[SolverContext], fine: Answer, values: list[float]
    ) -> Estimate:
        """The estimate from the quantity on all meshes and the solution on the finest one (collective)."""
        finest, below = finer[-1].problem, [one.problem for one in reversed(finer[:-1])]
        own, coarse = finest.level.owned, context.problem.level.owned
        chain, given = [finest, *below], answer.u.x.array[:coarse]
        if self._key == ENERGY:
            nodal = energy_contributions(finest, below, given)
            pressure, eps = fine.pressure.x.array[:own] / finest.thickness, fine.record["eps"] or 0.0
            penalty = eps * total(self.comm, finest.weights * pressure**2) / 2
        else:
            side, before = _sides(fine, own), _sides(answer, coarse)
            of_coarse = _where_all(chain, before == 1).astype(int) - _where_all(chain, before == -1)
            q, w = self._derivative(finest, fine, np.where(side != 0, side, of_coarse))
            adjoint = adjoint_of(finest, finer[-1].multigrid, (side != 0) & (side == of_coarse), q, w)
            nodal = contributions(finest, below, given, before != 0, adjoint)
            lower, upper = finest.gaps()
            beyond = np.where(side != 0, np.minimum(lower, 0.0) - np.minimum(upper, 0.0), 0.0)
            penalty = abs(total(self.comm, adjoint.m * beyond))
        indicator = _in_cells(finest.level, np.abs(nodal))
        for level in [one.problem.level for one in reversed(finer)]:
            assert level.coarse is not None and level.parents is not None
            indicator = np.bincount(level.parents, indicator, own_cells(level.coarse.mesh))
        changes = BEYOND * abs(values[1] - values[0]), abs(values[-1] - values[0])
        mesh = max(*changes, LEAST_SHARE * total(self.comm, indicator))
        unknowns = answer.dofs + sum(one.problem.level.dofs for one in finer)
        return Estimate(values[0], mesh, penalty, indicator, finest.level.dofs, unknowns)


def at_free_boundary(answer: Answer) -> np.ndarray:
    """The owned cells with vertices in contact and others without."""
    level = answer.level
    touches = answer.contact.x.array[releases.cell_dofs(level.V)[: own_cells(level.mesh)]] > 0.5
    return touches.any(axis=1) & ~touches.all(axis=1)


def _sides(answer: Answer, own: int) -> np.ndarray:
    """1 at owned nodes in contact with the lower obstacle, -1 with the upper one, else 0."""
    touches = answer.contact.x.array[:own] > 0.5
    return np.where(touches, np.sign(answer.pressure.x.array[:own]), 0.0).astype(int)


def _where_all(chain: list[Problem], coarse: np.ndarray) -> np.ndarray:
    """Whether a condition on owned coarse nodes holds at all those that an owned node of the first mesh is interpolated
    from (collective)."""
    for problem in reversed(chain):
        coarse = problem.transfer.all_of(coarse)
    return coarse


def _in_cells(level: Level, nodal: np.ndarray) -> np.ndarray:
    """Nodal values, each divided among the cells around the node, by owned cells (collective)."""
    around = AroundNodes(level.V, releases.cell_dofs(level.V)[: own_cells(level.mesh)])
    counts = around.sums(np.ones(around.nodes.shape))
    return (with_ghosts(level.V, nodal) / np.maximum(counts, 1.0))[around.nodes].sum(axis=1)
