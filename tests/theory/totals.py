"""Theorem 5.1: errors of u_eps and p_eps against u and p, penalty and discretisation together, along eps = h^k."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

from tests.theory.in_h import CEILING, CONE, claims
from tests.theory.mesh_sequences import VI, Measured, MeshSequence, errors, gap
from tests.theory.statement import Curve, Finding, Found, Panel, check, statement

WHERE = "Thm 5.1, (5.9)"
POWERS = {"h": 1.0, "h^(4/3)": 4 / 3, "h^2": 2.0, "h^3": 3.0}
SEQUENCE = replace(CEILING, cells=(64, 128, 256))
AT = 64  # cells of the mesh on which the two parts are compared


@statement("5.1", "u_eps tends to u and p_eps to p with order 1, if eps is of order h^2", "5.9")
def totals(comm: MPI.Comm) -> Found:
    """On a pressure with a jump: h^(4/3) is enough for u in H1, h^2 for the rest (collective)."""
    seen = errors(SEQUENCE, [VI, *POWERS], comm, dual=True)
    findings = []
    for eps, k in POWERS.items():
        # (5.5) and (5.6) give eps/h + h for both, (5.5) and (5.7) eps/h^2 + 1 for p in L2
        below, s = k >= 2, SEQUENCE.smooth
        displacement = {"h1": min(1.0, k * (1 + s) / 2), "l2": min(2.0, k)}
        pressure = {"dual": 1 + s if below else k * (1 + s) / 2}
        findings += claims(WHERE, seen, eps, min(1.0, k - 1), {**displacement, **pressure})
        findings += claims(WHERE, seen, eps, min(0.0, k - 2), {"pressure_l2": s if below else k * s / 2})
    findings += [finding for one in (CEILING, CONE) for finding in _parts(replace(one, cells=(AT,)), comm)]
    return Found(findings, [_panel(seen, name, label) for name, label in (
        ("h1", "|u - u_eps|_1"), ("dual", "|p - p_eps|_1*"), ("pressure_l2", "|p - p_eps|_0"))])  # fmt: skip


def _parts(one: MeshSequence, comm: MPI.Comm) -> list[Finding]:
    """The penalty's part of the error compared with the mesh's."""
    whole, part = errors(one, [VI, "h^(4/3)"], comm), gap(one, ["h^2"], comm)
    share = part["h^2", "e"][0] / whole[VI, "h1"][0]
    more = whole["h^(4/3)", "h1"][0] / whole[VI, "h1"][0]
    on = f"N = {one.cells[0]}, {one.words}"
    return [check(WHERE, f"|u_eps - u_h|_1 over |u - u_h|_1, eps = h^2, {on}", "C", share, share < 1),
            check(WHERE, f"|u - u_eps|_1 over |u - u_h|_1, eps = h^(4/3), {on}", "", more, more > 1)]  # fmt: skip


def _panel(seen: Measured, name: str, label: str) -> Panel:
    words = {VI: "eps = 0", **{eps: f"eps = {eps}" for eps in POWERS}}
    return Panel("", "h", label, [Curve(words[eps], seen.h, seen[eps, name]) for eps in words])
