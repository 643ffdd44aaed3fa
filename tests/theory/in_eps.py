"""Theorem 3.3: errors of u_eps and p_eps against u_h and p_h, in eps and in h, by the smoothness of the pressure.

With p in H^t for all t < s, and eps below h^2, u_eps - u_h is of order eps h^(s-1) and p_eps - p_h of order
eps h^(s-2). Above h^2 the mesh is not felt, and the orders are eps^((1+s)/2) and eps^(s/2). A pressure of more than
s = 1 leaves u_eps - u_h at order eps. The paper's eps/h and eps/h^2 are s = 0: a pressure that is barely in L2.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

from tests.theory.mesh_sequences import CURVE, JUMP, KINK, SINGULAR, VI, Eps, Measured, MeshSequence, gap
from tests.theory.statement import Curve, Finding, Found, Panel, check, constant, rate, statement

WHERE, STABLE = "Thm 3.3, (5.5)", "(3.23), (3.24)"
DECADES = (1e-5, 1e-6, 1e-7, 1e-8)
SMALL = 1e-7  # far below h^2
LARGE = (1e-3, 1e-4)  # above h^2 on the finest mesh
FINE, SOME, QUADS = (64, 128, 256), (16, 32, 64, 128), {"mesh.cell": "quadrilateral"}
# eps of order h must be small compared with the square of the size of the contact set: where that is small, a part of h
SCENES = (
    (MeshSequence("disk_flat", "disk_flat", JUMP, cells=FINE), "h"),
    (MeshSequence("halfplane", "halfplane", JUMP, cells=FINE), "h"),
    (MeshSequence("torsion_disk", "torsion_disk", JUMP, cells=FINE), "h/4"),
    (MeshSequence("smooth_square", "smooth_square", KINK, cells=FINE), "h/16"),
    (MeshSequence("cone", "cone", SINGULAR, cells=FINE), "h"),
    # contact is one node wide at places that look random: the mean of more meshes
    (MeshSequence("ring_wedge", "ring_wedge", CURVE, cells=(8, 16, 32, 64, 128, 256)), "h"),
)
PAIRS = (
    MeshSequence("disk_flat, criss-cross", "disk_flat", JUMP, {"mesh.diagonal": "crossed"}, SOME),
    MeshSequence("disk_flat, Q1", "disk_flat", JUMP, QUADS, SOME),
    MeshSequence("disk_flat, Q2", "disk_flat", JUMP, {**QUADS, "solve.element": "Q2"}, (8, 16, 32, 64)),
)
AT = 64  # cells of the mesh on which pairs are compared


@statement("3.3", "u_eps - u_h and p_eps - p_h: order 1 in eps, and its dependence on h", "5.5", "3.24")
def in_eps(comm: MPI.Comm) -> Found:
    """At fixed h, at fixed eps, along eps = h^k, and uniformly in h (collective)."""
    fixed = [gap(MeshSequence(one.words, one.name, one.smooth, cells=(32,)), DECADES, comm) for one, _ in SCENES[::3]]
    scenes = [gap(one, (SMALL, along, "h^2", "h^3", *LARGE), comm) for one, along in SCENES]
    pairs = [gap(one, (SMALL, "h^2"), comm) for one in PAIRS]
    findings = [finding for one in fixed for finding in at_fixed_h(one)]
    findings += [finding for one in (*scenes, *pairs) for finding in at_fixed_eps(one)]
    findings += [finding for one, (_, along) in zip(scenes, SCENES, strict=True) for finding in together(one, along)]
    findings += [finding for one in scenes for finding in uniformly(one)]
    findings += constants([*scenes, *pairs])
    return Found(findings, _panels(fixed[0], [*scenes, *pairs]))


def at_fixed_h(one: Measured) -> list[Finding]:
    """Order 1 in eps of both, on the one mesh."""
    eps, e, d = ([one[value, name][0] for value in DECADES] for name in ("eps", "e", "d"))
    on = f"{one.on.words}, N = {one.on.cells[0]}"
    return [rate(WHERE, f"|u_eps - u_h|_1 in eps, {on}", 1, 1, eps, e),
            rate(WHERE, f"|p_eps - p_h|_0 in eps, {on}", 1, 1, eps, d)]  # fmt: skip


def at_fixed_eps(one: Measured) -> list[Finding]:
    """Orders in h, which are negative, at an eps far below h^2."""
    s, on = one.on.smooth, f"eps = {SMALL:g}, {one.on.words}"
    return [rate(WHERE, f"|u_eps - u_h|_1 in h, {on}", -1, min(s, 1) - 1, one.h, one[SMALL, "e"]),
            rate(WHERE, f"|p_eps - p_h|_0 in h, {on}", -2, s - 2, one.h, one[SMALL, "d"])]  # fmt: skip


def together(one: Measured, along: Eps) -> list[Finding]:
    """Orders in h where eps is a power of h, `along` its first."""
    s, findings = one.on.smooth, []
    for value, k in ((along, 1), ("h^2", 2), ("h^3", 3)):
        # where u_eps does not yet feel the mesh, a p_h that is not bounded in L2 is all the distance
        of_e = k * (1 + min(s, 1)) / 2 if k < 2 else k + min(s, 1) - 1
        of_d = max(s, 0) * k / 2 + min(s, 0) if k < 2 else k + s - 2
        on = f"eps = {value}, {one.on.words}"
        findings.append(rate(WHERE, f"|u_eps - u_h|_1 in h, {on}", k - 1, of_e, one.h, one[value, "e"]))
        findings.append(rate(WHERE, f"|p_eps - p_h|_0 in h, {on}", k - 2, of_d, one.h, one[value, "d"]))
    return findings


def uniformly(one: Measured) -> list[Finding]:
    """Above h^2: order 0 in h, between the two finest meshes, and the order in eps; a bounded p alone gives 1/2."""
    eps, e = [one[value, "eps"][-1] for value in LARGE], [one[value, "e"][-1] for value in LARGE]
    words, finest, order = one.on.words, one.on.cells[-1], (1 + min(one.on.smooth, 1)) / 2
    on = f"eps = {LARGE[1]:g}, {LARGE[0]:g}, N = {finest}, {words}"
    return [rate(WHERE, f"|u_eps - u_h|_1 in h, eps = {LARGE[0]:g}, N = {finest}, {words}", -1, 0, one.h[-2:],
                 one[LARGE[0], "e"][-2:]),
            rate(STABLE, f"|u_eps - u_h|_1 in eps, {on}", 1 / 2, order, eps, e)]  # fmt: skip


def constants(all_found: Sequence[Measured]) -> list[Finding]:
    """(B) with v = p_h: |e|_a <= eps |p_h|_a; what eps/h is sharp for; and how little the pair matters above h^2."""
    most = max(max(values) for one in all_found for (_, name), values in one.values.items() if name == "part")
    first = all_found[0]
    findings = [check(STABLE, "|u_eps - u_h|_a over eps |p_h|_a, the most", "1 at most", most, most <= 1)]
    for one in all_found:
        if one.on.smooth <= 0:
            relative = [e / size for e, size in zip(one[SMALL, "e"], one[VI, "size"], strict=True)]
            findings.append(rate(WHERE, f"|u_eps - u_h|_1 over |p_h|_0 in h, eps = {SMALL:g}, {one.on.words}", -1,
                                 -1, one.h, relative))  # fmt: skip
    for one in all_found:
        if one.on.changes:
            same = one["h^2", "e"][one.on.cells.index(AT)] / first["h^2", "e"][first.on.cells.index(AT)]
            findings.append(constant(WHERE, f"|u_eps - u_h|_1 over that of P1, eps = h^2, N = {AT}, {one.on.words}",
                                     "C of the pair", 1.0, same))  # fmt: skip
    return findings


def _panels(fixed: Measured, found: Sequence[Measured]) -> list[Panel]:
    straight, collapse = found[1], []  # a free boundary of no curvature: no other length than h and eps^(1/2)
    epsilons = [value for value, name in straight.values if name == "e"]
    for place, cells in enumerate(straight.on.cells):
        points = sorted((straight[value, "eps"][place], straight[value, "e"][place]) for value in epsilons)
        h = straight.h[place]
        collapse.append(Curve(f"N = {cells}", [eps / h**2 for eps, _ in points],
                              [e * h**0.5 / eps for eps, e in points]))  # fmt: skip
    told: set[float] = set()
    curves = []
    for one in found:
        s = one.on.smooth
        curves.append(Curve(one.on.words, one.h, [e / SMALL for e in one[SMALL, "e"]],
                            None if s in told else min(s, 1) - 1))  # fmt: skip
        told.add(s)
    return [
        Panel(f"{fixed.on.words}, N = {fixed.on.cells[0]}", "eps", "distance", [
            Curve("|u_eps - u_h|_1", DECADES, [fixed[value, "e"][0] for value in DECADES], 1),
            Curve("|p_eps - p_h|_0", DECADES, [fixed[value, "d"][0] for value in DECADES], 1)]),
        Panel(f"eps = {SMALL:g}", "h", "|u_eps - u_h|_1 / eps", curves),
        Panel(f"{straight.on.words}: one curve for all h", "eps / h^2", "|u_eps - u_h|_1 h^(1/2) / eps", collapse),
    ]  # fmt: skip
