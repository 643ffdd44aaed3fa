"""The discrete problem on one mesh: a `System` made from effects, or from a form, and their data."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.algebra.system import Check
from fenicsx_obstacle.data.admissible import check_admissible
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.data.time_discretization import EQUILIBRIA, INERTIA
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.discrete.limit_load import HINT, check_limit_load, torn
from fenicsx_obstacle.discrete.mesh_system import MeshSystem, cell_means
from fenicsx_obstacle.discrete.solvability import check_support
from fenicsx_obstacle.effects.effect import of_model_problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total

MEANINGLESS_LOAD = 1e3  # times the forces at the start: such a load is one that has no part in the solution


class Problem(MeshSystem):
    """A model on one mesh, checked and ready for a solver; forms compile once, whatever eps.

    All methods are collective.
    """

    def __init__(self, data: Data, prefix: str = ""):
        """Assemble what stays."""
        self.data, self.model, self.level = data, data.model, data.level
        model, level = self.model, self.level
        self.prefix, self.source, self.comm = prefix, model.source, level.comm
        check_admissible(data)
        self.affine = all(effect.affine for effect in model.effects)
        self.all_points, self.weights_are_sparse = level.pair.at_vertices, data.thin
        self.to_points = None if level.pair.nodal else cell_means(level)
        if model.time is not None:
            self.at_rest, self.share = model.time.order == EQUILIBRIA, model.time.share
        self.fixed = np.zeros(level.owned, dtype=bool)
        self.fixed[data.fixed[0][data.fixed[0] < level.owned]] = True
        self._look_at_data()
        self._set_law(self._make_forms())
        self.hint, self.checks = self._checks()
        self.load = self._load_sum()
        check_limit_load(self)
        self._check_support()
        self.set_reference(self.cold_start())

    @property
    def symmetric(self) -> bool:  # type: ignore[override]
        return all(effect.symmetric for effect in self.model.effects)  # for a form it changes with its coefficients

    def _look_at_data(self) -> None:
        """Refer to the present arrays of the data."""
        data, own = self.data, self.level.owned
        self.given = data.fixed[1].x.array[:own]
        self.lower, self.upper = (None if side is None else side.x.array[:own] for side in (data.lower, data.upper))

    def _make_forms(self) -> Forms:
        """The object that assembles the residual.

        Raises:
            InputError: If the element is not for these data.
        """
        model, pair = self.model, self.level.pair
        if self.data.thin and not pair.at_vertices:
            raise InputError(f"{model.source}: obstacles on the boundary are for elements P1 and Q1")
        if pair.own_weights:
            others = [effect.key for effect in model.effects if not of_model_problem(effect)]
            others += ["[time]"] * (model.time is not None)
            if others:
                message = f"element {pair.name} is for tension and load, not for {others[0]}"
                raise InputError(f"{model.source}: {message}")
        return (Nodal if self.affine and pair.nodal else Forms)(model.effects, self.data)

    def _checks(self) -> tuple[str, tuple[Check, ...]]:
        """A hint, and the checks that only some effects need."""
        hint, checks = "", list[Check]()
        if any(effect.role == "film" for effect in self.model.effects):
            hint = HINT
            checks.append(torn)
        if any(effect.role == "drift" for effect in self.model.effects):
            from fenicsx_obstacle.discrete.residence_time import Drift, trapped  # only where a model has drift

            self.drift = Drift.of(self.data)
            checks.append(trapped)
        return hint, tuple(checks)

    def _check_support(self) -> None:
        """Check what holds u, and note what only contact holds."""
        check_support(self)

    def move(self, u_values: np.ndarray) -> bool:
        """As before.

        Raises:
            InputError: If no u can satisfy the data.
        """
        changed = self._take_data(stiffness=self.data.move())
        self.set_reference(u_values)
        if self.model.time is not None and self.model.time.order == INERTIA:
            self.load = self._forces()  # at u = 0 mass over the square of a step outweighs all forces
        return changed

    def renew(self, *, stiffness: bool) -> None:
        """As before.

        Raises:
            InputError: If no u can satisfy the data.
        """
        self.data.renew()
        self._take_data(stiffness=stiffness)
        self.set_reference(self.cold_start())

    def _take_data(self, *, stiffness: bool) -> bool:
        """Assemble again what depends on changed data; returns whether the stiffness has changed."""
        self._look_at_data()
        changed = self.law.renew(self.A, stiffness=stiffness)
        if self.data.moving:
            check_admissible(self.data)
        if changed:
            self.__dict__.pop("m_matrix", None)
        if self.drift is not None and (changed or not (self.affine and self.nodal)):  # otherwise the forms do not tell
            self.drift = self.drift.of(self.data)
        self.load = self._load_sum()
        check_limit_load(self)
        self._check_support()
        return changed

    def _load_sum(self) -> float:
        """Sum of |f_i| over free dofs, f being minus the residual of u = 0, which is the state afterwards."""
        self.w[:] = self.state.r[:] = 0.0
        self.state.share_all()
        self.law.set_reference()
        return self._forces()

    def judge_load(self) -> None:
        """Where F(0) is no measure of the forces that act, as of ln(u) or 1/u, take the load of the tangent of F at the
        present u, F'(u) u - F(u)."""
        if self.affine:
            return
        x, residual = self.vector(), self.law.vector()
        self.residual(x, residual, penalised=False)
        elastic = self.elastic.array_r
        if not self.load <= MEANINGLESS_LOAD * total(self.comm, np.abs(elastic)):
            A = self.jacobian(x, penalised=False)
            x.array[:] = self.u
            A.mult(x, residual)
            load = total(self.comm, np.abs(residual.array_r - elastic)[~self.fixed])
            self.load = load if np.isfinite(load) else 0.0
        for vector in (x, residual):
            vector.destroy()

    def reactions(self) -> np.ndarray:
        """a(u, .) - f at owned dofs in the last state: where u is given, the reaction of the support (collective).

        With inertia a step averages the forces of its two ends: those of its end count, beside the mass times the
        acceleration of the step, which at a support belongs to half a cell.
        """
        elastic, before = self.elastic.array_r, self.law.impulse
        if before is None:
            return elastic
        out = self.law.vector()
        self.law.at_rest(out)
        found = (elastic + out.array_r + before) / 2
        out.destroy()
        return found

    def _forces(self) -> float:
        """Sum of |a(u, .) - f| over free dofs at the present u."""
        self.law.elastic(self.elastic)
        return total(self.comm, np.abs(self.elastic.array_r[~self.fixed]))
