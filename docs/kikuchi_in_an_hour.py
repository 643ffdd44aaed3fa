# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Kikuchi's paper in an hour
#
# This notebook goes through the paper of N. Kikuchi, *Convergence of a penalty-finite element approximation for an
# obstacle problem*, Numer. Math. 37 (1981) 105-120. Numbers such as (3.4) are those of the paper. The meshes are
# coarse, so that each code cell runs in seconds. Statements about errors, orders and numbers of steps are checked by
# `assert`. Each section has exercises. If an exercise changes the data, remove the asserts that no longer apply.
#
# `.venv/bin/python docs/kikuchi_in_an_hour.py` runs the file as a script, on any number of ranks, and writes the
# pictures to `out/kikuchi`. Spyder and VS Code run single cells. To make a notebook, run
# `.venv/bin/pip install jupyterlab jupytext`, then `.venv/bin/jupytext --to notebook docs/kikuchi_in_an_hour.py`.
#
# First run the next code cell, which has imports and helper functions. After that the sections can be run in any order.
# The first run takes longer, because forms are compiled.

# %%
from itertools import pairwise
from pathlib import Path

import dolfinx.fem.petsc  # noqa: F401  (not imported by dolfinx.fem in newer releases)
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import ObstacleProblem, Scene, checkout, contact_pressure, penalty, solve, study
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.show.figures import COLOURS

checkout.add_tests("the seminar")
from tests.theory.constants import Stability  # noqa: E402

COMM = MPI.COMM_WORLD
plt.rcParams.update({"axes.prop_cycle": plt.cycler(color=COLOURS), "figure.constrained_layout.use": True})
plt.rcParams.update({"figure.figsize": (9, 3.3), "legend.fontsize": 8})

# a string with tension 1 and load f = 8, below the flat obstacle u <= c: contact for a <= x <= 1 - a
f, c = 8.0, 0.3
a = np.sqrt(2 * c / f)
string = Scene(title="string", mesh={"shape": "interval", "cells": 32}, tension=1, load=f, upper=c)

# a membrane on the unit disk with load f = 4, below the same obstacle: contact for r <= A. It is computed on the square
# inscribed in the disk, and the exact solution, which is radially symmetric, is the boundary value
side = ["-sqrt(0.5)", "sqrt(0.5)"]
disk = Scene(
    title="disk",
    mesh={"shape": "rectangle", "x": side, "y": side, "cells": 32},
    define={"A": 0.57771500355092659, "free": "1 - r^2 + 2*A^2*ln(max(r, A))"},
    tension=1,
    load=4,
    upper=c,
    boundary=[{"value": "free"}],
    exact=f"where(r < A, {c}, free)",
)


def everywhere(V, *functions):
    """Rows x, y and the nodal values of functions of V, ordered by y and then x: the same on every rank."""
    own = V.dofmap.index_map.size_local
    mine = np.column_stack([V.tabulate_dof_coordinates()[:own, :2], *(one.x.array[:own] for one in functions)])
    table = np.concatenate(COMM.allgather(mine))
    return table[np.lexsort(table[:, :2].round(9).T)].T


def orders(x, errors):
    """Observed orders log(e1/e0) / log(x1/x0) between neighbours."""
    return np.diff(np.log(errors)) / np.diff(np.log(x))


def say(*words):
    """Print on rank 0."""
    if COMM.rank == 0:
        print(*words)


def keep(page, name):
    """Write a picture on rank 0; a notebook shows it as well."""
    for axes in page.axes:
        axes.minorticks_off()
    if COMM.rank == 0:
        Path("out/kikuchi").mkdir(parents=True, exist_ok=True)
        page.savefig(f"out/kikuchi/{name}.png", dpi=120)


# %% [markdown]
# ## 1. The penalised problem and its contact pressure
#
# Let u be the deflection of a string with u = 0 at both ends, f the load, and g the obstacle above it. The obstacle
# problem is: find $u \le g$ with $-u'' = f + p$, where the contact pressure $p \le 0$ vanishes wherever $u < g$.
#
# The penalty method replaces the constraint by a force that grows with the penetration. With
# $a(u, v) = \int u' v'$ and $f(v) = \int f v$, find $u$ in the finite element space $V_h$ such that
#
# $$ a(u, v) + \frac1\varepsilon\, I((u-g)^+, v) = f(v) \quad \text{for all } v \in V_h. \qquad (3.4) $$
#
# I is a quadrature rule whose points are the nodes $x_i$ (3.5). The penalty therefore acts on each node separately. Its
# force per length at a node is the contact pressure there: $p_i = -(u-g)^+(x_i)/\varepsilon$, (3.7)-(3.8). There is no
# additional unknown.
#
# **Exercise 1.1.** Solve for $\varepsilon$ = 1e-2 and 1e-4. By which factor does the penetration change? Why is the
# factor not exactly 100?
#
# **Exercise 1.2.** Replace `upper=c` by `lower=-c` and f by -f in `string`. Which signs change in (3.4) and in the
# pressure?

# %%
eps = 1e-3
answer = solve(string, eps=eps)
V = answer.level.V
p = contact_pressure(answer.u, upper=c, eps=eps)
assert np.allclose(p.x.array, answer.pressure.x.array)

# the same from a residual of your own, without the penalty term
u, v = fem.Function(V), ufl.TestFunction(V)
F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - f * v * ufl.dx
ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0] * (1 - x[0]), 0))
ObstacleProblem(F, u, bcs=fem.dirichletbc(fem.Function(V), ends), upper=c).solve(eps=eps)
assert np.allclose(u.x.array, answer.u.x.array)

# with the penalty added, F is the residual of (3.4); it is 0 for u, except at the Dirichlet nodes (set to 0 below)
F += penalty(u, v, upper=c, eps=eps)
b = fem.petsc.assemble_vector(fem.form(F))
b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
b.array[ends[ends < len(b.array)]] = 0
assert b.norm() < 1e-9

x, _, heights, pressures = everywhere(V, answer.u, answer.pressure)
assert pressures.max() <= 0
assert np.isclose(heights.max() - c, eps * np.abs(pressures).max())  # penetration is eps |p|
say(f"largest pressure {-pressures.min():.4f}, penetration {heights.max() - c:.4f}")

page, (left, right) = plt.subplots(1, 2)
left.plot(x, heights, ".-", label="u")
left.axhline(c, color="0.5", label="g")
right.plot(x, pressures, ".-", label=r"$p_\epsilon$, $\epsilon = 10^{-3}$")
right.step([0, a, 1 - a, 1], [0, -f, 0, 0], "k:", where="post", label="p, exact")
left.set(title="u", xlabel="x")
right.set(title="contact pressure", xlabel="x")
left.legend()
right.legend()
keep(page, "1_string")

# %% [markdown]
# ## 2. eps tends to 0 on a fixed mesh
#
# Let $u_h$, $p_h$ be the solution and the pressure of the discrete inequality (3.19), computed by SNES VI. Let
# $u_\varepsilon$, $p_\varepsilon$ be the solution and the pressure of (3.4). $\|\cdot\|_0$ and $\|\cdot\|_1$ are the
# norms of $L^2$ and $H^1$. Theorem 3.3 states that
#
# $$ \|u_\varepsilon - u_h\|_1 \le C \varepsilon/h, \qquad \|p_\varepsilon - p_h\|_0 \le C \varepsilon/h^2.
#    \qquad (5.5) $$
#
# The picture below shows that both errors are of order $\varepsilon$ for small $\varepsilon$. For $\varepsilon > h^2$
# both errors hardly depend on the mesh, and the bounds (5.5) are not sharp. The orders in $\varepsilon$ are then about
# 3/4 for u and 1/4 for p. Section 7 explains these orders. Since the stiffness matrix is an M-matrix,
# $|u_\varepsilon - u_h| \le \varepsilon \max|p_h|$ at every node and for every $\varepsilon$.
#
# **Exercise 2.1.** Repeat with `cells=64` and `cells=1024`. How does the value of $\varepsilon$ at which the order
# changes depend on h?
#
# **Exercise 2.2.** Prove the nodal bound: show that $u_h + \varepsilon \max|p_h|$ is a supersolution of (3.4).

# %%
rows = study(string, vary={"eps": [10.0**-k for k in range(2, 11)]}, cells=256)
values = [row["eps"] for row in rows]
heights, pressures = ([row[f"to_vi.{key}"] for row in rows] for key in ("energy", "pressure_l2"))
say("  eps   |u_eps-u_h|_a  order   |p_eps-p_h|_0  order")
seen = [(np.nan, np.nan), *zip(orders(values, heights), orders(values, pressures), strict=True)]
for row, e, d, (order_e, order_d) in zip(rows, heights, pressures, seen, strict=True):
    say(f"{row['eps']:.0e}  {e:13.3e}  {order_e:5.2f}   {d:13.3e}  {order_d:5.2f}".replace("nan", "   "))
    assert row["to_vi.max"] <= row["eps"] * row["to_vi.pressure_max"] * (1 + 1e-6)
for errors, order in ((heights, 3 / 4), (pressures, 1 / 4)):
    assert np.allclose(orders(values, errors)[-3:], 1, atol=0.05)  # (5.5)
    assert np.isclose(orders(values[:3:2], errors[:3:2])[0], order, atol=0.1)  # between eps = 1e-2 and 1e-4

page, axes = plt.subplots(figsize=(6, 3.6))
axes.loglog(values, heights, "o-", label=r"$\|u_\epsilon-u_h\|_a$")
axes.loglog(values, pressures, "s-", label=r"$\|p_\epsilon-p_h\|_0$")
axes.loglog(values[3:], 0.1 * heights[-1] * np.array(values[3:]) / values[-1], "k:", label="order 1")
axes.axvline(256.0**-2, color="0.7")
axes.annotate("$h^2$", (256.0**-2, heights[-1]))
axes.set_xlabel(r"$\epsilon$")
axes.legend()
keep(page, "2_eps")

# %% [markdown]
# ## 3. h tends to 0, and eps with it
#
# This section compares the computed solutions with the exact ones. For the discrete inequality, the error of u in $H^1$
# has order 1 (5.6). The error of p in the dual norm $\|q\|_1^* = \sup_v (q, v)/\|v\|_1$, $v \in H^1_0$, also has order
# 1 (5.8). The penalty method with $\varepsilon = h^2$ has the same orders (5.9). With $\varepsilon = h$ the orders are
# lower, because the error of the penalty dominates. For u the error of the penalty is of order $\varepsilon^{3/4}$,
# because the pressure jumps at the free boundary.
#
# **Exercise 3.1.** What is the smallest power k for which $\varepsilon = h^k$ gives order 1 for u? Use section 2, then
# test your answer.
#
# **Exercise 3.2.** Add `errors.l2` to `keys`. Which $\varepsilon$ gives order 2 of the $L^2$ error?

# %%
cells, keys = [16, 32, 64], ("errors.h1", "errors.pressure_dual")
ways = {"eps = h": {"eps": "h"}, "eps = h^2": {"eps": "h^2"}, "inequality": {"method": "vi"}}
rows = {name: study(disk, vary={"cells": cells}, **how) for name, how in ways.items()}
h = [row["h"] for row in rows["inequality"]]
found = {(name, key): [row[key] for row in rows[name]] for name in rows for key in keys}
for (name, key), errors in found.items():
    say(f"{name:10} orders of {key:21}", orders(h, errors).round(2))
    if name == "eps = h":
        assert 0.55 < orders(h, errors)[-1] < 0.85
    else:
        assert min(orders(h, errors)) > 0.95  # (5.6), (5.8), (5.9)

page, row = plt.subplots(1, 2, sharey=True)
for axes, key, title in zip(row, keys, (r"error of u, $\|\cdot\|_1$", r"error of p, $\|\cdot\|_1^*$"), strict=True):
    for name, marker in zip(rows, "os^", strict=True):
        axes.loglog(cells, found[name, key], marker + "-", label=name)
    axes.loglog(cells, 0.5 * found["inequality", key][-1] * np.array(h) / h[-1], "k:", label="order 1")
    axes.set(title=title, xlabel="cells a side", ylim=(1e-3, 1.5), xticks=cells, xticklabels=cells)
row[1].legend(loc="center left", bbox_to_anchor=(1, 0.5))
keep(page, "3_h")

# %% [markdown]
# ## 4. Stability in L2 and in the dual norm
#
# The inf-sup condition of $V_h$ and the pressure space $Q_h$ is
#
# $$ \sup_{v \in V_h} I(q, v)/\|v\|_1 \ge \alpha_h \|q\|_0 \quad \text{for all } q \in Q_h \qquad (3.18) $$
#
# with $\alpha_h > 0$. The paper proves (3.18) with $\alpha_h = h/C$ for P1 (Example 2) and for Q1 with the trapezoid
# rule (Example 3). The order of $\alpha_h$ is optimal. For a q that changes sign from node to node, $I(q, v)/\|v\|_1$
# is at most of order $h\,\|q\|_0$ for every v. The bounds (5.5) contain $1/h$ and $1/h^2$ because $\alpha_h$ is of
# order h.
#
# In the dual norm of section 3 no power of h is lost, because the dual norm of such an oscillating q is small too. Let
# $\beta_h$ be the constant of (3.18) with $\|q\|_1^*$ in place of $\|q\|_0$. $\beta_h$ is bounded away from 0 as h
# tends to 0. For this reason (5.8) and (5.9) contain no negative power of h. Both constants are computed for pressures
# q that are 0 at the boundary nodes, because every v in $V_h$ vanishes there.
#
# **Exercise 4.1.** Add `"P1-voronoi"` to the loop, with `"diagonal": "crossed"` in its mesh. This is P1 with the
# Voronoi area of each node as its weight in I (see section 6). For which of the two
# constants does the order in h then differ from that of P1?
#
# **Exercise 4.2.** Why is $\alpha_h = 0$ if q need not vanish at the boundary nodes?


# %%
def stability(name, n):
    """alpha_h and beta_h of an element (V_h and Q_h), on n x n squares, which are cut into triangles for P1."""
    scene = Scene(mesh={"shape": "rectangle", "cells": n}, tension=1).change({"solve.element": name})
    level = meshes.build(scene, COMM)
    return Stability(level.mesh, level.pair)


sizes = [4, 8, 16]
alpha, beta = {}, {}
for name in ("P1", "Q1", "Q2"):
    some = [stability(name, n) for n in sizes]
    alpha[name], beta[name] = [one.alpha() for one in some], [one.beta() for one in some]
    say(f"{name}  alpha_h/h", np.round(np.multiply(alpha[name], sizes), 3), "  beta_h", np.round(beta[name], 3))
    assert np.allclose(np.diff(np.log2(alpha[name])), -1, atol=0.15) and min(beta[name]) > 0.95

page, axes = plt.subplots(figsize=(6, 3.6))
for name, marker in zip(alpha, "os^", strict=True):
    (line,) = axes.loglog(sizes, alpha[name], marker + "-", label=rf"$\alpha_h$, {name}")
    axes.loglog(sizes, beta[name], marker + "--", color=line.get_color(), label=rf"$\beta_h$, {name}")
axes.set(xlabel="cells a side", xticks=sizes, xticklabels=sizes)
axes.legend(loc="center left", bbox_to_anchor=(1, 0.5), handlelength=4)
keep(page, "4_stability")

# %% [markdown]
# ## 5. A pair that is not stable
#
# Example 3 also treats Q1 with the one-point Gauss rule for I. For this pair $\alpha_h$ need not be positive. The
# penalty now acts at the centres of the cells. On $n \times n$ cells there are $n^2$ centres, but only $(n - 1)^2$
# interior nodes. Let the kernel be the space of pressures q with $I(q, v) = 0$ for all v in $V_h$. Its dimension is
# $n^2 - (n - 1)^2 = 2n - 1$. A checkerboard is in the kernel, because its mean over the four cells around each node is
# 0. The equations determine $p_h$ only up to a q of the kernel, and only the condition $p_h \le 0$ limits the size of
# this q. u is as accurate as with the trapezoid rule, but the pressure is not.
#
# **Exercise 5.1.** Which pressures other than the checkerboard are in the kernel? Show that each of them is a sum of
# two pressures: one alternates in sign from cell to cell along x, the other along y.
#
# **Exercise 5.2.** Solve by the penalty method, with `eps="h^2"` in place of `method="vi"`. Does the pressure oscillate
# less?

# %%
answers = {name: solve(disk, cells=16, element=name, method="vi") for name in ("Q1", "Q1-gauss")}
pressures = {name: everywhere(answer.level.Q, answer.pressure)[2] for name, answer in answers.items()}
error = {name: answer.record["errors"]["l2"] for name, answer in answers.items()}
for name, p in pressures.items():
    say(f"{name:9} L2 error of u {error[name]:.2e}, p from {p.min():.2f} to {p.max():.2f}; exact: -4 to 0")
gauss = answers["Q1-gauss"].level
assert Stability(gauss.mesh, gauss.pair).kernel()[0] == 2 * 16 - 1
assert error["Q1-gauss"] < 1.05 * error["Q1"]
assert np.isclose(pressures["Q1"].min(), -4) and pressures["Q1-gauss"].min() < -6

page, row = plt.subplots(1, 2)
for axes, (name, p) in zip(row, pressures.items(), strict=True):
    n = round(np.sqrt(len(p)))  # nodes, or cells, a side
    image = axes.imshow(p.reshape(n, n), origin="lower", extent=[-(0.5**0.5), 0.5**0.5] * 2, vmin=-8, vmax=0)
    axes.set_title(f"pressure of {name}")
page.colorbar(image, ax=list(row))
keep(page, "5_chessboard")

# %% [markdown]
# ## 6. A pressure that does not converge in L2, and two remedies
#
# Theorem 4.2 states only that $\|p - p_h\|_0$ is bounded (5.7). If the obstacle is curved, $p_h$ does not converge in
# $L^2$ on certain meshes, such as criss-cross meshes. In contact u = g at the nodes, so that $p_i = (A g)_i/D_i - f_i$
# with the stiffness matrix A, the weight $D_i$ of the node in I, and the load $f_i$ at the node. On a criss-cross mesh
# $D_i = h^2/3$ at nodes with four triangles (centres of squares), and $D_i = 2h^2/3$ at nodes with eight triangles
# (corners of squares). A consistent approximation of $-\Delta g$ by $(A g)_i/D_i$ would need $D_i = h^2/2$ at all
# nodes. Instead, $(A g)_i/D_i$ tends to $-\Delta g$ times 3/2 at centres and times 3/4 at corners, and the pressure
# oscillates from node to node on every mesh.
#
# There are two remedies:
#
# - The penalty method with $\varepsilon = h^2$ damps this oscillation. With a much smaller $\varepsilon$ the
#   oscillation remains.
# - With the element `P1-voronoi` the weight of each node is its Voronoi area, here $h^2/2$. These weights are positive,
#   as (3.6) requires.
#
# **Exercise 6.1.** Replace the obstacle by a flat one. Why does the oscillation disappear?
#
# **Exercise 6.2.** Compute the factors 3/2 (centre of a square) and 3/4 (corner) by hand for $g = x^2$.

# %%
curved = Scene(
    title="curved obstacle",
    mesh={"shape": "rectangle", "cells": 16, "diagonal": "crossed"},
    define={"hill": "sin(pi*x)*sin(pi*y)", "rho": "sqrt((x - 1/2)^2 + (y - 1/2)^2)"},
    tension=1,
    load="2*pi^2*hill + 10*max(1 - 16*rho^2, 0)",  # so that u = hill, contact for rho <= 1/4
    upper="hill + 40*max(rho - 1/4, 0)^2",
)


def pressure_error(answer):
    """||p - p_h||_0 by quadrature, with the exact p = -10 (1 - 16 rho^2)^+."""
    x = ufl.SpatialCoordinate(answer.level.mesh)
    p = -10 * ufl.max_value(1 - 16 * ((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2), 0)
    square = (p - answer.pressure) ** 2 * ufl.dx(metadata={"quadrature_degree": 4})
    return np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(square))))


cells = [16, 24, 32]
ways = {
    "P1, inequality": {"method": "vi"},
    "P1, eps = h^2": {"eps": "h^2"},
    "P1-voronoi, inequality": {"method": "vi", "element": "P1-voronoi"},
}
answers = {name: [solve(curved, cells=n, **options) for n in cells] for name, options in ways.items()}
errors = {name: [pressure_error(answer) for answer in some] for name, some in answers.items()}
for name, some in errors.items():
    say(f"{name:23} |p-p_h|_0 for {cells} cells a side:", np.round(some, 3))
stalled, filtered, cured = errors.values()
assert np.allclose(stalled, 0.90, atol=0.02)
assert pressure_error(solve(curved, cells=16, eps=1e-8)) > 0.9
assert np.all(orders(cells, filtered) < -1) and np.all(orders(cells, cured) < -1.2)

page, (left, right) = plt.subplots(1, 2)
for name, marker in zip(answers, "os^", strict=True):
    x, y, p = everywhere(answers[name][0].level.V, answers[name][0].pressure)
    left.plot(x[np.isclose(x, y)], p[np.isclose(x, y)], marker + "-", markersize=4, label=name)
    right.loglog(cells, errors[name], marker + "-")
x = np.linspace(0, 1, 201)
left.plot(x, -10 * np.maximum(1 - 32 * (x - 0.5) ** 2, 0), "k:", label="exact")
left.set(title="pressure on the diagonal, 16 cells a side", xlabel="x = y")
left.legend()
right.set(title=r"$\|p-p_h\|_0$", xlabel="cells a side", xticks=cells, xticklabels=cells, ylim=(0.01, 1.5))
keep(page, "6_stall")

# %% [markdown]
# ## 7. The layer of width sqrt(eps), in closed form
#
# The penalised equation of the string before discretisation,
# $-u_\varepsilon'' = f - (u_\varepsilon - c)^+/\varepsilon$, has a solution $u_\varepsilon$ in closed form. Let
# contact begin at $x = \alpha$, and let $b = 1/2 - \alpha$.
#
# - In contact $w = u_\varepsilon - c$ solves $-w'' + w/\varepsilon = f$ with $w(\alpha) = 0$. By symmetry
#   $w = \varepsilon f\, [1 - \cosh((x - \frac12)/\sqrt\varepsilon) / \cosh(b/\sqrt\varepsilon)]$. Its slope at $\alpha$
#   is $s = \sqrt\varepsilon f \tanh(b/\sqrt\varepsilon)$.
# - For $x < \alpha$, $u_\varepsilon = c + s(x - \alpha) - f(x - \alpha)^2/2$. At $\alpha$ this function has the value c
#   and the slope s. The condition $u_\varepsilon(0) = 0$ gives $\alpha = (\sqrt{s^2 + 2cf} - s)/f$. Since s hardly
#   depends on $\alpha$, a fixed-point iteration for $\alpha$ converges in a few steps.
#
# Let u, p be the solution of the obstacle problem without penalty (section 1). Its contact set begins at $x = a$. The
# contact set of the penalised solution $u_\varepsilon$, $p_\varepsilon$ begins earlier, at about
# $x = a - \sqrt\varepsilon$. From there, $p_\varepsilon$ grows to its full size in a layer of width
# $\sqrt\varepsilon$. Let $z = (x - \alpha)/\sqrt\varepsilon$ in the layer on the left. For $z < 0$ both pressures
# are 0, and the slopes agree to leading order. For $z > 0$, to leading order:
#
# - $p_\varepsilon = -f(1 - e^{-z})$, while p jumps from 0 to $-f$ at $z = 1$;
# - $u_\varepsilon' = \sqrt\varepsilon f e^{-z}$, while $u' = \sqrt\varepsilon f (1 - z)^+$.
#
# The layer on the right is the mirror image. With the energy norm $\|v\|_a = a(v, v)^{1/2}$, for both layers together
# and up to higher orders,
#
# $$ \|p_\varepsilon - p\|_0^2 = 2 f^2 \varepsilon^{1/2} \left[ \int_0^1 (1 - e^{-z})^2 dz + \int_1^\infty e^{-2z} dz
#    \right] = f^2 (4/e - 1)\, \varepsilon^{1/2}, $$
# $$ \|u_\varepsilon - u\|_a^2 = 2 f^2 \varepsilon^{3/2} \left[ \int_0^1 (e^{-z} - 1 + z)^2 dz
#    + \int_1^\infty e^{-2z} dz \right] = f^2 (5/3 - 4/e)\, \varepsilon^{3/2}. $$
#
# Take the square roots: the orders in $\varepsilon$ are 3/4 for u and 1/4 for p, as in section 2. There is such a layer
# wherever the pressure jumps. With $\varepsilon = h^2$ the layer has the width of one element.
#
# **Exercise 7.1.** Verify the two integrals, 4/e - 1 and 5/3 - 4/e.
#
# **Exercise 7.2.** What are the orders if p is continuous and its slope jumps? The scene `smooth_square` has such a
# pressure. Compare with the rows of this scene in the output of `./obstacle theory 3.3`.


# %%
def penalised(eps):
    """Start of contact, and u and p as functions of x."""
    alpha, width = a, np.sqrt(eps)
    for _ in range(50):
        s = width * f * np.tanh((0.5 - alpha) / width)
        alpha = (np.sqrt(s**2 + 2 * c * f) - s) / f

    def p(x):
        inside = np.minimum(np.abs(x - 0.5), 0.5 - alpha)  # cosh itself would overflow
        far, near = np.exp(-(0.5 - alpha + inside) / width), np.exp(-(0.5 - alpha - inside) / width)
        return -f * (1 - (near + far) / (1 + np.exp(-(1 - 2 * alpha) / width)))

    def u(x):
        outside = np.minimum(np.minimum(x, 1 - x) - alpha, 0)
        return c - eps * p(x) + s * outside - f * outside**2 / 2

    return alpha, u, p


page, (left, right) = plt.subplots(1, 2)
t = (np.arange(200000) + 0.5) / 400000  # the left half, finely
exact = np.where(t < a, f * (a * t - t**2 / 2), c)
say("  eps   (a-alpha)/eps^(1/2)  |u_eps-u|_a/eps^(3/4)  |p_eps-p|_0/eps^(1/4)  computed - closed form")
for eps, marker in ((1e-3, "o"), (1e-4, "s"), (1e-5, "^")):
    alpha, u, p = penalised(eps)
    answer = solve(string, cells=1024, eps=eps)
    x, _, heights, pressures = everywhere(answer.level.V, answer.u, answer.pressure)
    off = np.abs(heights - u(x)).max()
    assert off < 1024.0**-2  # of order h^2

    e, d = np.gradient(u(t) - exact, t), p(t) + f * (t > a)
    found = {1 / 2: a - alpha, 3 / 4: np.sqrt(np.mean(e**2)), 1 / 4: np.sqrt(np.mean(d**2))}
    leading = {1 / 2: 1, 3 / 4: f * np.sqrt(5 / 3 - 4 / np.e), 1 / 4: f * np.sqrt(4 / np.e - 1)}
    scaled = {order: value / eps**order for order, value in found.items()}
    for order, value in scaled.items():
        assert abs(value / leading[order] - 1) < 8 * np.sqrt(eps)  # the next term
    say(f"{eps:.0e}  {scaled[1 / 2]:19.3f}  {scaled[3 / 4]:21.3f}  {scaled[1 / 4]:21.3f}  {off:22.1e}")

    z, near = (x - alpha) / np.sqrt(eps), np.abs(x - a) < 0.2
    (line,) = left.plot(x[near][::8], pressures[near][::8], marker, markersize=4, label=rf"$\epsilon$ = {eps:.0e}")
    left.plot(x[near], p(x[near]), "k-", linewidth=0.8)
    layer = np.abs(z - 1.5) < 4.5
    right.plot(z[layer], pressures[layer], marker, markersize=4, color=line.get_color())
say("limit  " + " " * 14 + "{:5.3f}  {:21.3f}  {:21.3f}".format(*leading.values()))
z = np.linspace(-3, 6, 200)
right.plot(z, -f * (1 - np.exp(-np.maximum(z, 0))), "k-", linewidth=0.8, label="$-f(1-e^{-z})$")
left.set(title="pressure: computed (marks), closed form (lines)", xlabel="x")
right.set(title=r"the same against $z = (x-\alpha)/\sqrt{\epsilon}$", xlabel="z")
left.legend()
right.legend()
keep(page, "7_layer")

# %% [markdown]
# ## 8. The iteration (3.4)*
#
# If the contact set were known, (3.4) would be linear. The iteration (3.4)* starts with the empty set as contact set.
# In each step it solves the linear problem for the current set. The nodes at which this solution is larger than g form
# the next set. The iteration stops when two consecutive sets are equal. Then u solves (3.4) exactly. This iteration is
# Newton's method for (3.4). With an M-matrix, u and the sets decrease after the first step, so that the iteration ends
# after finitely many steps. The code below programs the iteration for the string in NumPy and compares it with the
# iteration of the package.
#
# For a small $\varepsilon$ each step removes about one layer of nodes from the set, so that the number of steps grows
# like 1/h. Nested iteration starts from the solution on a mesh with cells of twice the size. The number of steps of
# nested iteration does not grow.
#
# **Exercise 8.1.** Start from the set of all nodes in place of the empty set. Does each set still contain the next one?
#
# **Exercise 8.2.** Write (3.4)\* for the 3 x 3 matrix of `CYCLE` in `tests/theory/iteration.py` and observe its
# cycle.

# %%
n, eps = 64, 1e-6
A = (2 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1)) * n
D = np.full(n - 1, 1 / n)
sets, solutions = [np.zeros(n - 1, dtype=bool)], []
while len(sets) < 2 or np.any(sets[-1] != sets[-2]):
    penalty_diagonal = sets[-1] * D / eps
    solutions.append(np.linalg.solve(A + np.diag(penalty_diagonal), D * f + penalty_diagonal * c))
    sets.append(solutions[-1] > c)
for before, after in pairwise(solutions[1:]):
    assert np.all(after <= before + 1e-12)
for before, after in pairwise(sets[1:]):
    assert np.all(before | ~after)
answer = solve(string, cells=n, eps=eps, method="successive")
assert [step.active for step in answer.history] == [np.count_nonzero(one) for one in sets]
assert np.allclose(everywhere(answer.level.V, answer.u)[2][1:-1], solutions[-1])

cells = [16, 32, 64]  # 16 has no coarser mesh to start from
cold = [solve(disk, cells=m, eps=1e-8, method="successive").history for m in cells]
nested = [solve(disk, cells=m, eps=1e-8).history for m in cells]
for history in cold:
    active = [step.active for step in history[1:]]
    assert active == sorted(active, reverse=True)
steps = {"(3.4)*": [len(history) - 1 for history in cold], "nested": [len(history) - 1 for history in nested]}
for name, some in steps.items():
    say(f"{name:6} linear solves, {cells} cells a side:", *some)
assert steps["(3.4)*"][-1] > 2 * steps["(3.4)*"][0] and max(steps["nested"]) <= 4

page, (left, right) = plt.subplots(1, 2)
left.imshow(sets, aspect="auto", cmap="Blues", extent=[0, 1, len(sets) - 0.5, -0.5], interpolation="nearest")
left.set(title=f"contact sets of (3.4)*, string, {n} cells", xlabel="x", ylabel="step")
for (name, some), marker in zip(steps.items(), "os", strict=True):
    right.plot(cells, some, marker + "-", label=name)
right.set(title=r"linear solves, disk, $\epsilon = 10^{-8}$", xlabel="cells a side", xticks=cells, ylim=(0, None))
right.legend()
keep(page, "8_iteration")
