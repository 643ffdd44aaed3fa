"""Invariants of the theory, checked for every result: findings by name, each with value and limit.

Limits are what the theorem says plus what is known of the accuracy of the answers themselves (`solved`); none is
chosen. Where a theorem needs what an operator has not, the figure is given and nothing is claimed:

- balance, signs, complementarity and the law of the penalty are the discrete problem itself: any operator;
- uniqueness and the distance of the penalty from the inequality need (F(u) - F(v)) . (u - v) > 0, F(u) = a(u, .): all
  tensions, and drift where the symmetric part of its matrix is positive definite (`ReferenceProblem.held`);
- energies exist for all effects but drift, and are compared where they are convex;
- what is said node by node needs the maximum principle (`ReferenceProblem.monotone`): matrices with the signs of an
  M-matrix, with drift too, and soft obstacles in addition, never a tension that depends on the slope.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenicsx_obstacle import releases
from fenicsx_obstacle.check.finding import Finding
from fenicsx_obstacle.check.verification import EPSILON, ROUNDED, balance, contact_law
from fenicsx_obstacle.mesh.points import spread
from fenicsx_obstacle.parallel import largest, total
from tests.hard.solved import Solved


def of_one(s: Solved) -> list[Finding]:
    """What holds for a single answer, on any mesh (collective)."""
    return [balance(s), _equilibrium(s), *contact_law(s), *_signs(s)]


def _equilibrium(s: Solved) -> Finding:
    """(3.4) with v = 1: load, contact and edge reactions of the whole membrane; the load is integrated anew."""
    g = s.ground
    problem, data = g.problem, g.problem.data
    one, u = fem.Constant(problem.level.mesh, PETSc.ScalarType(1.0)), problem.solution()
    u.x.array[: problem.level.owned] = s.w + s.r
    u.x.scatter_forward()
    net = 0.0  # a(u, 1) - f(1)
    for effect in problem.model.effects:
        if effect.role == "point forces":  # of no form
            net -= total(g.comm, spread(problem.level, cast(Any, effect.value), effect.key))
        lumped = effect.role == "load" and problem.level.pair.own_weights
        form = effect.terms(u, one, data)
        if lumped:  # with the weights of its pair
            net -= total(g.comm, data.nodal(effect.value).x.array[: len(g.D)] * g.D)
        elif form is not None and any(integral.integrand() != 0 for integral in form.integrals()):
            net += total(g.comm, fem.assemble_scalar(releases.form(form)))
    contact, edge = total(g.comm, (g.D * s.p)[g.free]), total(g.comm, s.elastic[problem.fixed])
    # of the edge reactions, whose rows are no part of the solvers' balance
    edge_floor = total(g.comm, (ROUNDED * s.stiffness * (np.abs(s.w) + np.abs(s.r)))[problem.fixed])
    return Finding("loads, contact and edges balance", "(3.4), v = 1", abs(net - contact - edge),
                   s.left + edge_floor + EPSILON * problem.level.dofs * s.forces)  # fmt: skip


def _signs(s: Solved) -> list[Finding]:
    """N of (2.11), (3.14): an obstacle pushes and never pulls."""
    problem, found = s.ground.problem, []
    for gap, other, pull, name in (
        (problem.below, problem.above, -s.p, "lower"),
        (problem.above, problem.below, s.p, "upper"),
    ):
        if gap is not None and other is None:
            worst = max(largest(s.ground.comm, pull), 0.0)
            found.append(Finding(f"the {name} obstacle never pulls", "(3.14)", worst, 0.0))
    return found


def beside_inequality(s: Solved, vi: Solved) -> list[Finding]:
    """A penalised solution compared with the inequality's, of the same problem (collective).

    From a(e, e) + eps I(d, d) <= -eps I(d, p_h), e = u_eps - u_h, d = p_eps - p_h, on any mesh: a(e, e) <= (eps/4)
    ||p_h||_I^2 and ||p_eps||_I <= ||p_h||_I; for other operators with (F(u_eps) - F(u_h)) . e in place of a(e, e).
    Where the maximum principle holds, u_h shifted by eps max|p_h| is a supersolution of (3.4), and u_eps shifted by its
    penetration one of the inequality.
    """
    assert s.eps is not None
    g, monotone = s.ground, s.ground.monotone
    e, margin = vi.minus(s), s.z + vi.z
    apart, known = s.apart(vi)
    sizes = s.norm(s.p), vi.norm(vi.p)
    low, high = s.penetration("lower"), s.penetration("upper")
    margin_p = s.norm(s.q) + vi.norm(vi.q)
    most = max(largest(g.comm, np.abs(vi.p[g.touchable])) + largest(g.comm, (s.q + vi.q)[g.touchable]), 0.0)
    return [
        Finding("penalty and inequality: energy norm", "Thm 3.3", apart,
                np.sqrt(s.eps) / 2 * sizes[1] + s.R + vi.R + known, g.held),
        Finding("penalty and inequality: size of the pressure", "Thm 3.2", sizes[0], sizes[1] + margin_p,
                g.held or g.symmetric),
        Finding("penetration", "eps max|p_h|", max(low, high), s.eps * most, monotone),
        Finding("the inequality's u is farther from the lower obstacle", "0 <= u_h - u_eps",
                largest(g.comm, -e - high - margin), 0.0, monotone),
        Finding("but by no more than the penetration", "u_h - u_eps <= penetration",
                largest(g.comm, e - low - margin), 0.0, monotone),
        *_energies(s, vi, "energy below the inequality's"),
    ]  # fmt: skip


def falling(larger: Solved, smaller: Solved) -> list[Finding]:
    """Two answers of the penalty, eps falling: they move towards the obstacle, and store more energy (collective).

    J_eps = a(u, u)/2 - f(u) + I((u - g)^+ ^2)/(2 eps) grows as eps falls at each u, so its minimum does too. Where the
    maximum principle holds and there is one obstacle, u with the larger eps is a sub- or supersolution of the other.
    """
    g = larger.ground
    problem = g.problem
    one = (problem.below is None) != (problem.above is None)
    rise = larger.minus(smaller) * (1.0 if problem.above is None else -1.0)
    back = largest(g.comm, rise - larger.z - smaller.z)
    return [
        Finding("u moves out of the obstacle as eps falls", "Thm 3.1", back, 0.0, g.monotone and one),
        *_energies(larger, smaller, "energy rises as eps falls"),
    ]


def _energies(lower: Solved, upper: Solved, name: str) -> list[Finding]:
    """min J_eps <= min J_eps' <= min J for eps >= eps'."""
    if lower.energy is None or upper.energy is None:
        return []
    return [Finding(name, "J_eps <= J", lower.energy - upper.energy, sum(energy_round_off(s) for s in (lower, upper)))]


def energy_round_off(s: Solved) -> float:
    """How far the energy is known (collective), from its terms and the operations on them.

    - Slopes in a cell are sums of (w + r) grad phi, rounded relative to the sizes of these terms, not of the slope.
      With s = (sum of A_ii (|w_i| + |r_i|)^2)^(1/2), by Cauchy's inequality a(u, u)/2 is off by
      `ROUNDED` s a(u, u)^(1/2) and the square of `ROUNDED` s.
    - n terms are added in turn: each sum is rounded by half of machine epsilon of what is added so far, and with like
      terms by the same sign.
    - The state is off by R, and the energy, at its minimum, by R^2.
    """
    g, sizes = s.ground, np.abs(s.w) + np.abs(s.r)
    terms = abs(s.energy or 0.0) + s.forces * largest(g.comm, sizes)  # at least a(u, u)/2
    slopes = ROUNDED * np.sqrt(total(g.comm, s.stiffness * sizes**2))
    rounded = slopes * np.sqrt(2 * terms) + slopes**2
    second = s.R**2 if np.isfinite(s.R) else 0.0
    return rounded + EPSILON / 2 * g.problem.level.dofs * terms + second


def same(one: Solved, other: Solved, name: str, why: str = "unique") -> list[Finding]:
    """Two answers of the same problem with the same eps: (3.4), or (3.19), has one solution (collective)."""
    g = one.ground
    e = one.minus(other)
    pressures = np.abs(one.p - other.p) - one.q - other.q
    apart, known = one.apart(other)
    return [
        Finding(f"{name}: the same u in the energy norm", why, apart, one.R + other.R + known, g.held),
        Finding(f"{name}: the same u at every node", why, largest(g.comm, np.abs(e) - one.z - other.z), 0.0,
                g.monotone),
        Finding(f"{name}: the same pressure", why, largest(g.comm, pressures[g.touchable]), 0.0, g.monotone),
    ]  # fmt: skip
