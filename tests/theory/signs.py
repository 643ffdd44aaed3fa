"""Signs, squares and regularity on a string: (2.6)-(2.7), (3.16), (3.23), (4.6), (4.10), E_I of section 5.

-u'' = f + p on (0, 1), u <= g, u(0) = u(1) = 0, with P1 and the vertex rule: small enough for dense matrices, and the
penalised solution and its limit are exact up to round-off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy import sparse

from fenicsx_obstacle.check.reference import active_sets
from fenicsx_obstacle.forms.rules import nodal_rule
from tests.theory.statement import Found, check, constant, rate, statement

LIMIT = 1e-11  # a residual below is round-off
SIZES = (16, 32, 64, 128)


@dataclass(frozen=True)
class String:
    """The discrete string on given nodes; matrices and vectors of the nodes inside.

    Attributes:
        nodes: From 0 to 1.
        tension: In each cell.
    """

    nodes: np.ndarray
    tension: np.ndarray | float = 1.0

    @property
    def A(self) -> np.ndarray:
        k = self.tension / np.diff(self.nodes)
        return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)

    @property
    def M(self) -> np.ndarray:
        """Consistent mass."""
        h = np.diff(self.nodes)
        return np.diag(h[:-1] + h[1:]) / 3 + (np.diag(h[1:-1], 1) + np.diag(h[1:-1], -1)) / 6

    @property
    def D(self) -> np.ndarray:
        """I(phi_i, 1) of the vertex rule."""
        left, right = nodal_rule("interval").weights
        h = np.diff(self.nodes)
        return right * h[:-1] + left * h[1:]

    @property
    def H(self) -> np.ndarray:
        """The full H1 product."""
        return self.A + self.M

    def solved(self, f: float, g: float, eps: float | None) -> np.ndarray:
        """The solution of (3.4), or without eps of the discrete variational inequality."""
        start, low, high = (np.full(len(self.D), value) for value in (0.0, -np.inf, g))
        u = active_sets(sparse.csc_matrix(self.A), f * self.D, self.D, low, high, start, eps)
        assert u is not None
        return u

    def norm(self, v: np.ndarray) -> float:
        """||v||_1."""
        return float(np.sqrt(v @ self.H @ v))


def even(n: int) -> String:
    """A string of n equal cells."""
    return String(np.linspace(0, 1, n + 1))


def uneven(n: int) -> String:
    """A string whose cells are h and h/2 by turns."""
    lengths = np.where(np.arange(n) % 2, 0.5, 1.0)
    return String(np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()]))


F, G, EPS = 8.0, 0.5, 1e-3


@statement("3.23", "Signs of the equation of the errors and of complementarity", "4.6")
def signs(comm: MPI.Comm) -> Found:
    """(3.23) with either sign, and the two lines of (4.6) that complementarity gives."""
    string = even(64)
    u, w = string.solved(F, G, None), string.solved(F, G, EPS)
    p, q = (string.A @ u - F * string.D) / string.D, -np.maximum(w - G, 0) / EPS
    e, d = string.A @ (w - u), string.D * (q - p)
    wrong, right = (float(np.abs(x).max() / np.abs(d).max()) for x in (e + d, e - d))
    gap = string.D * (u - G)
    worst = float(np.maximum(gap, 0).max())  # I(q, u^h - g) >= 0 for all q <= 0 means that no node is above g
    return Found([
        check("(3.23)", "a(u^h - u_eps^h, v) - I(p_eps^h - p^h, v), relative", "0", wrong, wrong > 1, "misprint"),
        check("(3.23)", "a(u_eps^h - u^h, v) - I(p_eps^h - p^h, v), relative", "0", right, right < LIMIT),
        check("(4.6)", "I(p^h, u^h - g)", "0", float(abs(p @ gap)), abs(p @ gap) < LIMIT),
        check("(4.6)", "largest (u^h - g)^+: I(q, u^h - g) >= 0 for all q <= 0", "0", worst, worst < LIMIT),
    ])  # fmt: skip


@statement("3.16", "Missing squares: both sides must have the same degree in the data", "4.10")
def degrees(comm: MPI.Comm) -> Found:
    """How the terms of (3.16) and (4.10) grow when load and obstacle, or the pressure, are multiplied by s."""
    string, scales = even(64), np.array([1.0, 2.0, 4.0])
    found = [string.solved(s * F, s * G, EPS) for s in scales]

    def degree(values: list[float]) -> float:
        return float(np.polyfit(np.log(scales), np.log(values), 1)[0])

    work = degree([float(s * F * string.D @ u) for s, u in zip(scales, found, strict=True)])
    norm = [string.norm(u) for u in found]
    v, p = np.sin(np.pi * string.nodes[1:-1]), -np.maximum(found[0] - G, 0) / EPS
    defect = [float(abs(s * p @ ((string.M - np.diag(string.D)) @ v))) for s in scales]
    return Found([
        constant("(3.16)", "degree of the right side, f(u_eps), in the data", "2", 2.0, work),
        constant("(3.16)", "degree of the left side as printed, ||u_eps||_1", "2", 1.0, degree(norm), "misprint"),
        constant("(3.16)", "degree of ||u_eps||_1^2", "2", 2.0, degree([x**2 for x in norm])),
        constant("(4.10)", "degree of E_I(p^h, v) in p^h, printed without ||p^h||_0", "0", 1.0, degree(defect),
                 "misprint"),
    ])  # fmt: skip


@statement("2.7", "u in H^2 needs a tension without jumps", "2.6")
def regular(comm: MPI.Comm) -> Found:
    """The L2 norm of second differences, a string whose tension jumps from 1 to 10 in the middle."""
    seconds = []
    for n in SIZES:
        string = String(np.linspace(0, 1, n + 1), np.where(np.arange(n) < n // 2, 1.0, 10.0))
        u = np.concatenate([[0], np.linalg.solve(string.A, F * string.D), [0]])
        seconds.append(float(np.sqrt(np.sum(np.diff(u, 2) ** 2) * n**3)))
    h = [1 / n for n in SIZES]
    return Found([rate("(2.6)-(2.7)", "|u^h|_2 by second differences, tension 1 and 10", 0.0, -0.5, h, seconds)])


@statement("E_I", "E_I(q, v) = (q, v) - I(q, v) of section 5: sign and order")
def defect(comm: MPI.Comm) -> Found:
    """Largest eigenvalue, norm on L2 x H1, and order with a smooth second argument, equal cells and unequal ones."""
    rows, h = [], [1 / n for n in SIZES]
    for words, make, order in (("equal cells", even, 2.0), ("cells h, h/2", uneven, 1.0)):
        norms, smooth, most = [], [], -np.inf
        for n in SIZES:
            string = make(n)
            E = string.M - np.diag(string.D)
            root, half = np.linalg.cholesky(string.M), np.linalg.cholesky(string.H)
            scaled = np.linalg.solve(root, np.linalg.solve(half, E).T)
            norms.append(float(np.linalg.norm(scaled, 2)))
            smooth.append(float(np.linalg.norm(np.linalg.solve(root, E @ np.sin(np.pi * string.nodes[1:-1])))))
            most = max(most, float(np.linalg.eigvalsh(E).max()))
        rows += [
            check("(5.7)", f"largest eigenvalue of E_I(d,d), {words}", "<= 0", most, most <= 0),
            rate("Sec. 5", f"sup E_I(q,v)/(||q||_0 ||v||_1), {words}", 2.0, 1.0, h, norms),
            rate("Sec. 5", f"sup E_I(q,v_I)/||q||_0, v = sin(pi x), {words}", 2.0, order, h, smooth),
        ]
    return Found(rows)
