"""The discrete problem on one mesh: a `System` made from effects, or from a form, and their data."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem

from fenicsx_obstacle.algebra.system import Check, System
from fenicsx_obstacle.algebra.transfer import Transfer
from fenicsx_obstacle.discrete.admissible import check_admissible
from fenicsx_obstacle.discrete.assembly import Forms, Nodal
from fenicsx_obstacle.discrete.data import Data
from fenicsx_obstacle.discrete.duality import cell_means, in_q
from fenicsx_obstacle.discrete.limit_load import HINT, check_limit_load
from fenicsx_obstacle.discrete.solvability import Support, check_support, forces_at_work
from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA
from fenicsx_obstacle.discrete.transfer import to_parents
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import largest, smallest, total

if TYPE_CHECKING:
    from fenicsx_obstacle.discrete.residence import Drift


class Problem(System):
    """A model on one mesh, ready for a solver; forms compile once, whatever eps.

    All methods are collective.

    Attributes:
        data: The data of the model on this mesh.
        model: What is to be solved.
        level: The mesh and V.
        law: The forms.
    """

    law: Forms
    on_mesh = True
    vector_valued = False

    def __init__(self, data: Data, prefix: str = ""):
        """Assemble what stays."""
        self.data, self.model, self.level = data, data.model, data.level
        model, level = self.model, self.level
        self.prefix, self.source, self.comm = prefix, model.source, level.comm
        check_admissible(data)
        self.affine = all(effect.affine for effect in model.effects)
        self.symmetric = all(effect.symmetric for effect in model.effects)
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
        self._support()
        self.set_reference(self.cold_start())

    @property
    def h(self) -> float:  # type: ignore[override]
        return self.level.h

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
            others = [effect.key for effect in model.effects if not effect.in_model_problem]
            others += ["[time]"] * (model.time is not None)
            if others:
                message = f"element {pair.name} is for tension and load, not for {others[0]}"
                raise InputError(f"{model.source}: {message}")
        return (Nodal if self.affine and pair.nodal else Forms)(model.effects, self.data)

    def _checks(self) -> tuple[str, tuple[Check, ...]]:
        """A hint, and the checks that only some effects need; none of their modules is loaded for other effects."""
        hint, checks = "", list[Check]()
        if any(effect.greatest(self.data) is not None for effect in self.model.effects):
            from fenicsx_obstacle.discrete.torn_film import torn

            hint = HINT
            checks.append(torn)
        if any(effect.velocity is not None for effect in self.model.effects):
            from fenicsx_obstacle.discrete.trapped_drift import trapped

            checks.append(trapped)
        return hint, tuple(checks)

    def _check_support(self) -> Support:
        """The result of `check_support`."""
        return check_support(self)

    def _support(self) -> None:
        """Note what holds u."""
        found, own = self._check_support(), self.owned
        self.start = None if found.start is None else found.start[:own]
        self.floating, self.borne, self.balanced = found.floating, found.borne, found.balanced
        if found.borne is not None or found.balanced is not None:
            count, component = self.level.parts
            self.parts = count, component[:own]

    def heights(self) -> list[np.ndarray]:
        return [np.atleast_1d(heights) for effect in self.model.effects for heights in effect.heights(self.data)]

    def pushes(self) -> tuple[float, float] | None:
        found = [push for effect in self.model.effects if (push := effect.push(self.data)) is not None]
        if not found or len(found) < len(self.model.effects):
            return None
        return (sum(smallest(self.comm, push[0]) for push in found), sum(largest(self.comm, push[1]) for push in found))

    def tension(self) -> float | None:
        found = self.model.elastic.stiffness(self.data)
        return None if found is None else largest(self.comm, found)

    @property
    def compliance_power(self) -> float:
        dim = self.level.mesh.topology.dim
        if not self.data.thin:
            return 2.0 / dim
        return 0.0 if dim == 1 else 1.0 / (dim - 1)

    def move(self, u_values: np.ndarray) -> bool:
        """As before.

        Raises:
            InputError: If no u can satisfy the data.
        """
        changed = self._take_data(stiffness=self.data.move())
        self.set_reference(u_values)
        self.load = forces_at_work(self, self.load)
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
        if changed or not (self.affine and self.nodal):  # otherwise the forms do not tell
            self.__dict__.pop("drift", None)
        self.load = self._load_sum()
        check_limit_load(self)
        self._support()
        return changed

    @property
    def nodal_forms(self) -> Nodal:
        """The forms of affine effects with contact at nodes."""
        assert isinstance(self.law, Nodal)
        return self.law

    def in_components(self, u_values: np.ndarray) -> np.ndarray:
        """Values of u in the components of w."""
        return u_values

    def in_q(self, values: np.ndarray) -> fem.Function:
        """Values at owned points of I as a Function of Q_h (collective)."""
        return in_q(self.level, values)

    def pressures(self, p: np.ndarray) -> fem.Function:
        """The same of pressures, whose Q_h may have more nodes (collective)."""
        return self.in_q(p)

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
        return to_parents(self.level.on_meshes if self.level.grids else self.level)

    @property
    def has_energy(self) -> bool:  # type: ignore[override]
        w, data, effects = self.law.w, self.data, self.model.effects
        derived = (e.energy(w, data) is not None or e.terms(w, self.law.v, data) is None for e in effects)
        return all(effect.convex for effect in effects) and all(derived)

    @cached_property
    def drift(self) -> Drift | None:
        """The drift of the model, if it has one; renewed with the stiffness (first use is collective)."""
        velocity = next((found for effect in self.model.effects if (found := effect.velocity) is not None), None)
        if velocity is None:
            return None
        from fenicsx_obstacle.discrete.peclet import peclet  # only where a model has drift
        from fenicsx_obstacle.discrete.residence import Drift

        return Drift(velocity, peclet(self.data, velocity))

    def _load_sum(self) -> float:
        """Sum of |f_i| over free dofs, f being minus the residual of u = 0, which is the state afterwards."""
        self.w[:] = self.state.r[:] = 0.0
        self.state.share_all()
        self.law.set_reference()
        self.law.elastic(self.elastic)
        return total(self.comm, np.abs(self.elastic.array_r[~self.fixed]))
