# ---
# jupyter:
#   jupytext:
#     text_representation: {extension: .py, format_name: percent}
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Kikuchi's paper in an hour
#
# N. Kikuchi, *Convergence of a penalty-finite element approximation for an obstacle problem*, Numer. Math. 37 (1981)
# 105-120, statement by statement, on meshes so small that each cell takes seconds. Numbers such as (3.4) are the
# paper's; what is claimed in words is checked by `assert`.
#
# This file is a Python script, on any number of ranks: `.venv/bin/python docs/kikuchi_in_an_hour.py` writes its
# pictures into `out/kikuchi`. Spyder and VS Code show it as cells. For a notebook:
# `.venv/bin/pip install jupyterlab jupytext`, then `.venv/bin/jupytext --to notebook docs/kikuchi_in_an_hour.py`.
#
# Each section needs the next cell and no other. The first run compiles forms: it takes longer, once.

# %%
import itertools
from pathlib import Path

import dolfinx.fem.petsc  # noqa: F401  (not imported by dolfinx.fem in newer releases)
import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import Scene, contact_pressure, penalty, solve, solve_form, study
from fenicsx_obstacle.show.figures import COLOURS

COMM = MPI.COMM_WORLD
plt.rcParams.update({"axes.prop_cycle": plt.cycler(color=COLOURS), "figure.constrained_layout.use": True})


def everywhere(V, *functions):
    """Rows x, y and the nodal values of functions of V, ordered by y and then x: the same on every rank."""
    own = V.dofmap.index_map.size_local
    mine = np.column_stack([V.tabulate_dof_coordinates()[:own, :2], *(f.x.array[:own] for f in functions)])
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


# a string of unit tension, loaded by f = 8, under a flat ceiling of height c: contact for a <= x <= 1 - a
f, c = 8.0, 0.3
a = np.sqrt(2 * c / f)
string = Scene(title="string", mesh={"shape": "interval", "cells": 32}, tension=1, load=f, upper=c)

# a radial membrane, f = 4, under the same ceiling: contact for r <= a_disk, on a square with the exact boundary values
disk = Scene(
    title="disk", tension=1, load=4, upper=c, define={"A": 0.57771500355092659, "free": "1 - r^2 + 2*A^2*ln(max(r, A))"},
    mesh={"shape": "rectangle", "x": ["-sqrt(0.5)", "sqrt(0.5)"], "y": ["-sqrt(0.5)", "sqrt(0.5)"], "cells": 32},
    boundary=[{"value": "free"}], exact=f"where(r < A, {c}, free)",
)  # fmt: skip

# %% [markdown]
# ## 1. The penalised problem, and the pressure for free
#
# Wanted is u <= g with -u'' = f + p, p <= 0, and p = 0 where u < g: the contact pressure p holds the string back. The
# penalty method replaces the wall by springs. Find u in V_h with
#
# $$ a(u, v) + \tfrac1\varepsilon I((u-g)^+, v) = f(v) \quad \text{for all } v \in V_h, \qquad (3.4) $$
#
# where I is a quadrature rule whose points are the nodes (3.5). Then $p_i = -(u-g)^+(x_i)/\varepsilon$, (3.7)-(3.8), is
# the force of the springs. No multiplier is solved for.

# %%
eps = 1e-3
answer = solve(string, eps=eps)
V = answer.level.V
p = contact_pressure(answer.u, upper=c, eps=eps)
assert np.allclose(p.x.array, answer.pressure.x.array)

# the same from a residual of your own: one added line makes it (3.4)
u, v = fem.Function(V), ufl.TestFunction(V)
F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx - f * v * ufl.dx
ends = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0] * (1 - x[0]), 0))
solve_form(F, u, bcs=[fem.dirichletbc(fem.Function(V), ends)], upper=c, eps=eps)
F += penalty(u, v, upper=c, eps=eps)  # <---
b = fem.petsc.assemble_vector(fem.form(F))
b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
b.array[ends[ends < len(b.array)]] = 0  # the supports at both ends react
assert np.abs(b.array).max(initial=0) < 1e-9 and np.allclose(u.x.array, answer.u.x.array)

x, _, heights, pressures = everywhere(V, answer.u, answer.pressure)
assert pressures.max() <= 0
assert np.isclose((heights - c).max(), -eps * pressures.min())  # it sinks in by eps |p|
say(f"largest pressure {-pressures.min():.4f}, penetration {heights.max() - c:.4f}")

page, (left, right) = plt.subplots(1, 2, figsize=(9, 3))
left.plot(x, heights, ".-", label="u")
left.axhline(c, color="0.5", label="g")
right.plot(x, pressures, ".-", label=r"$p_\epsilon$, $\epsilon = 10^{-3}$")
right.step([0, a, 1 - a, 1], [0, -f, 0, 0], "k:", where="post", label="p, exact")
left.set_title("heights")
right.set_title("contact pressure")
for axes in (left, right):
    axes.set_xlabel("x")
    axes.legend()
keep(page, "1_string")

# %% [markdown]
# ## 2. eps tends to 0 on a fixed mesh
#
# Theorem 3.3: with $u^h, p^h$ the solution of the discrete inequality (3.19), which SNES VI computes,
#
# $$ \|u_\varepsilon^h - u^h\|_1 \le C \varepsilon/h, \qquad \|p_\varepsilon^h - p^h\|_0 \le C \varepsilon/h^2. \qquad (5.5) $$
#
# Both are of order eps once the contact set stays, and at every node $0 \le u_\varepsilon^h - u^h \le \varepsilon \max|p^h|$, as
# the stiffness matrix is an M-matrix. While $\varepsilon > h^2$ the mesh does not matter, and (5.5) is pessimistic: there the
# orders are about 3/4 and 1/4. Section 7 computes why.

# %%
rows = study(string, vary={"eps": [10.0**-k for k in range(1, 11)]}, cells=256)
steps = [row["eps"] for row in rows]
distance, of_pressure = ([row[f"to_vi.{key}"] for row in rows] for key in ("energy", "pressure_l2"))
say("     eps  |u_eps-u_h|_a  order  |p_eps-p_h|_0  order")
for k, row in enumerate(rows):
    seen = [" " * 5, " " * 5] if k == 0 else [f"{orders(steps, e)[k - 1]:5.2f}" for e in (distance, of_pressure)]
    say(f"{row['eps']:8.0e}  {distance[k]:13.3e}  {seen[0]}  {of_pressure[k]:13.3e}  {seen[1]}")
    assert row["to_vi.max"] <= row["eps"] * row["to_vi.pressure_max"] * (1 + 1e-6)
for errors in (distance, of_pressure):
    assert np.allclose(orders(steps, errors)[-3:], 1, atol=0.05)  # (5.5)
for errors, order in ((distance, 3 / 4), (of_pressure, 1 / 4)):
    assert np.isclose(orders(steps[1:4:2], errors[1:4:2])[0], order, atol=0.1)  # eps = 1e-2 and 1e-4

page, axes = plt.subplots(figsize=(6, 3.6))
axes.loglog(steps, distance, "o-", label=r"$\|u_\epsilon-u_h\|_a$")
axes.loglog(steps, of_pressure, "s-", label=r"$\|p_\epsilon-p_h\|_0$")
axes.loglog(steps[4:], 0.1 * distance[-1] * np.array(steps[4:]) / steps[-1], "k:", label="order 1")
axes.axvline(256.0**-2, color="0.7")
axes.annotate("$h^2$", (256.0**-2, distance[-1]))
axes.set_xlabel(r"$\epsilon$")
axes.legend()
keep(page, "2_eps")

# %% [markdown]
# ## 3. h tends to 0 with eps
#
# Against the exact solution, for the discrete inequality, $\|u - u^h\|_1 \le Ch$ (5.6) and $\|p - p^h\|_1^* \le Ch$ (5.8), the
# norm dual to $H^1_0$. With $\varepsilon = h^2$ the penalty keeps both orders (5.9). With $\varepsilon = h$ it does not: on a
# pressure that jumps, as here at the free boundary, it costs $\varepsilon^{3/4}$.

# %%
cells = [8, 16, 32, 64]
found = {eps: study(disk, vary={"cells": cells}, eps=eps) for eps in ("h", "h^2")}
h = [row["h"] for row in found["h^2"]]
say("eps   orders of |u-u_eps|_1       orders of |p-p_eps|_1*")
observed = {}
for eps, rows in found.items():
    for key in ("errors.h1", "errors.pressure_dual"):
        observed[eps, key] = orders(h, [row[key] for row in rows])
    say(
        f"{eps:4}", *(np.array2string(observed[eps, key], precision=2) for key in ("errors.h1", "errors.pressure_dual"))
    )
assert observed["h^2", "errors.h1"][-1] > 0.95 and observed["h^2", "errors.pressure_dual"][-1] > 1  # (5.9)
assert 0.6 < observed["h", "errors.h1"][-1] < 0.85

page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
for axes, key, title in (
    (left, "errors.h1", r"$\|u-u_\epsilon\|_1$"),
    (right, "errors.pressure_dual", r"$\|p-p_\epsilon\|_1^*$"),
):
    for (eps, rows), marker in zip(found.items(), "os", strict=True):
        axes.loglog(h, [row[key] for row in rows], marker + "-", label=rf"$\epsilon = {eps}$")
    axes.loglog(h, 0.5 * found["h^2"][-1][key] * np.array(h) / h[-1], "k:", label="order 1")
    axes.set_title(title)
    axes.set_xlabel("h")
    axes.legend()
keep(page, "3_h")

# %% [markdown]
# ## 5. A pair that is not stable
#
# Example 3: Q1 with one-point Gauss as I. The springs now sit at the centres of the cells. There are more centres than
# nodes, and a chessboard of pressures does no work on any v in V_h: I(q, v) = 0. The heights are as good as with the
# trapezoid rule, the pressure is not.

# %%
pages, answers = {}, {name: solve(disk, cells=16, element=name, method="vi") for name in ("Q1", "Q1-gauss")}
for name, answer in answers.items():
    p = everywhere(answer.level.Q, answer.pressure)[2]
    side = round(np.sqrt(len(p)))
    pages[name] = p.reshape(side, side)
    say(
        f"{name:9} L2 error of u {answer.record['errors']['l2']:.2e}, p from {p.min():.2f} to {p.max():.2f} (exact: -4 to 0)"
    )
assert answers["Q1-gauss"].record["errors"]["l2"] < 1.05 * answers["Q1"].record["errors"]["l2"]
assert np.isclose(pages["Q1"].min(), -4, atol=0.05) and pages["Q1-gauss"].min() < -6

page, row = plt.subplots(1, 2, figsize=(8.5, 3.6))
for axes, (name, values) in zip(row, pages.items(), strict=True):
    image = axes.imshow(values, origin="lower", extent=[-(0.5**0.5), 0.5**0.5] * 2, vmin=-8, vmax=0, cmap="viridis")
    axes.set_title(f"pressure of {name}")
page.colorbar(image, ax=list(row))
keep(page, "5_chessboard")

# %% [markdown]
# ## 6. The pressure may stall, and a cure
#
# Theorem 4.2 promises no more than $\|p - p^h\|_0 \le C$ (5.7), and it is sharp. Take a curved obstacle on a criss-cross mesh.
# Where u touches it, $p^h_i = (A g)_i/D_i - f_i$ for flat weights $D_i$, and a third of the areas around each node is no
# consistent weight for the second differences of g: the vertex in the middle of four triangles and the one amid eight are
# wrong by opposite amounts, on every mesh. Two ways out:
#
# - the penalty with $\varepsilon = h^2$ smooths the oscillation away (a much smaller eps brings it back);
# - `P1-voronoi` takes for $D_i$ the Voronoi area of the node, still a positive rule (3.6), with which $A/D$ is consistent.

# %%
curved = Scene(
    title="curved obstacle", mesh={"shape": "rectangle", "cells": 16, "diagonal": "crossed"}, tension=1,
    define={"hill": "sin(pi*x)*sin(pi*y)", "rho": "sqrt((x - 1/2)^2 + (y - 1/2)^2)"},
    load="2*pi^2*hill + 10*max(1 - 16*rho^2, 0)", upper="hill + 40*max(rho - 1/4, 0)^2",
)  # fmt: skip


def pressure_error(answer):
    """||p - p_h||_0 by quadrature, p = -10 (1 - 16 rho^2)^+ (collective)."""
    x = ufl.SpatialCoordinate(answer.level.mesh)
    p = -10 * ufl.max_value(1 - 16 * ((x[0] - 0.5) ** 2 + (x[1] - 0.5) ** 2), 0)
    square = (p - answer.pressure) ** 2 * ufl.dx(metadata={"quadrature_degree": 4})
    return np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(square))))


sizes = [16, 32, 64]
ways = {"P1, inequality": {"method": "vi"}, "P1, eps = h^2": {"eps": "h^2"}, "P1-voronoi, inequality": {"method": "vi", "element": "P1-voronoi"}}  # fmt: skip
errors, answers = {}, {}
for name, options in ways.items():
    answers[name] = [solve(curved, cells=n, **options) for n in sizes]
    errors[name] = [pressure_error(answer) for answer in answers[name]]
    say(f"{name:23} |p-p_h|_0 for {sizes} cells a side:", *(f"{error:.3f}" for error in errors[name]))
stalled, filtered, cured = errors.values()
assert np.allclose(stalled, 0.90, atol=0.02)
assert filtered[-1] < stalled[-1] / 5 and cured[-1] < stalled[-1] / 30
assert min(orders([1 / n for n in sizes], cured)) > 1.2

page, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6))
for (name, some), marker in zip(answers.items(), ("o-", "s-", "^-"), strict=True):
    x, y, p = everywhere(some[0].level.V, some[0].pressure)
    along = np.isclose(x, y)
    left.plot(x[along], p[along], marker, ms=4, label=name)
    right.loglog(sizes, errors[name], marker, label=name)
x = np.linspace(0, 1, 201)
left.plot(x, -10 * np.maximum(1 - 32 * (x - 0.5) ** 2, 0), "k:", label="exact")
left.set_title("pressure on the diagonal, 16 cells")
left.set_xlabel("x = y")
right.set_title(r"$\|p-p_h\|_0$")
right.set_xlabel("cells a side")
right.set_xticks(sizes, sizes)
right.minorticks_off()
left.legend(fontsize=8)
keep(page, "6_stall")

# %% [markdown]
# ## 7. The layer of width sqrt(eps), in closed form
#
# The penalised string of section 1, before any mesh: $-u'' = f - (u-c)^+/\varepsilon$. Let contact begin at $\alpha = 1/2 - b$.
#
# - Inside, $w = u - c$ solves $-w'' + w/\varepsilon = f$ with $w(\alpha) = 0$: $w = \varepsilon f\,(1 - \cosh((x-1/2)/\sqrt\varepsilon) /
#   \cosh(b/\sqrt\varepsilon))$. Its slope at $\alpha$ is $s = \sqrt\varepsilon f \tanh(b/\sqrt\varepsilon)$.
# - Outside, $u = c + s(x-\alpha) - f(x-\alpha)^2/2$, so that value and slope match. $u(0) = 0$ gives
#   $f\alpha^2/2 + s\alpha = c$, hence $\alpha = (\sqrt{s^2 + 2cf} - s)/f$: iterate, s hardly depends on alpha.
#
# So $p_\varepsilon = -f(1 - e^{-(x-\alpha)/\sqrt\varepsilon})$ near the free boundary, which lies $\sqrt\varepsilon$ too far out. Two such layers
# give $\|u_\varepsilon - u\|_a = f\,(5/3 - 4/e)^{1/2} \varepsilon^{3/4}$ and $\|p_\varepsilon - p\|_0 = f\,(4/e - 1)^{1/2} \varepsilon^{1/4}$ to leading order: the orders that
# (5.5) cannot see, and why eps = h^2 is needed where the pressure jumps.


# %%
def penalised(eps):
    """Start of contact, and u and p as functions of x."""
    alpha, root = a, np.sqrt(eps)
    for _ in range(50):
        slope = root * f * np.tanh((0.5 - alpha) / root)
        alpha = (np.sqrt(slope**2 + 2 * c * f) - slope) / f
    b = 0.5 - alpha

    def p(x):
        d = np.minimum(np.abs(x - 0.5), b) / root
        return -f * (1 - (np.exp(d - b / root) + np.exp(-d - b / root)) / (1 + np.exp(-2 * b / root)))

    def u(x):
        d = np.minimum(np.minimum(x, 1 - x) - alpha, 0.0)  # from the free boundary, outwards
        return c - eps * p(x) + slope * d - f * d**2 / 2

    return alpha, u, p


page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
z = np.linspace(-3, 6, 200)
say("   eps  (a - alpha)/sqrt(eps)  |u_eps-u|_a / eps^(3/4)  |p_eps-p|_0 / eps^(1/4)  computed - closed form")
for eps, marker in ((1e-3, "o"), (1e-4, "s"), (1e-5, "^")):
    alpha, u, p = penalised(eps)
    x, _, heights, pressures = everywhere(*(lambda r: (r.level.V, r.u, r.pressure))(solve(string, cells=1024, eps=eps)))
    off = np.abs(heights - u(x)).max()
    assert off < 1e-5

    t = (np.arange(200000) + 0.5) / 400000  # midpoints on the left half
    contact = t > a
    gap = p(t) + f * contact
    tension = np.gradient(u(t) - np.where(contact, c, f * (a * t - t**2 / 2)), t)
    energy, l2 = (np.sqrt(np.mean(part**2)) for part in (tension, gap))
    say(
        f"{eps:6.0e}  {(a - alpha) / np.sqrt(eps):21.4f}  {energy / eps**0.75:23.4f}  {l2 / eps**0.25:23.4f}  {off:23.1e}"
    )
    leading = {
        np.sqrt(eps): a - alpha,
        f * np.sqrt(5 / 3 - 4 / np.e) * eps**0.75: energy,
        f * np.sqrt(4 / np.e - 1) * eps**0.25: l2,
    }
    for term, value in leading.items():
        assert abs(value / term - 1) < 8 * np.sqrt(eps)  # up to a part sqrt(eps)
    near = np.abs(x - a) < 0.2
    left.plot(
        x[near][::8],
        pressures[near][::8],
        marker,
        ms=4,
        color=COLOURS["os^".index(marker)],
        label=rf"computed, $\epsilon$ = {eps:.0e}",
    )
    left.plot(x[near], p(x[near]), "k-", lw=0.8)
    within = (z[0] < (x - alpha) / np.sqrt(eps)) & ((x - alpha) / np.sqrt(eps) < z[-1])
    right.plot((x[within] - alpha) / np.sqrt(eps), pressures[within], marker, ms=4)
right.plot(z, -f * (1 - np.exp(-np.maximum(z, 0))), "k-", lw=0.8, label="$-f(1-e^{-z})$")
left.set_title("pressure at the free boundary")
left.set_xlabel("x")
right.set_title(r"the same against $z = (x-\alpha)/\sqrt{\epsilon}$")
right.set_xlabel("z")
left.legend(fontsize=8)
right.legend(fontsize=8)
keep(page, "7_layer")

# %% [markdown]
# ## 8. The iteration (3.4)*
#
# (3.4) is linear once the contact set is known. So guess it (none), solve, take as the next guess where u > g, and stop
# when it stays: u then solves (3.4) exactly. As the matrix is an M-matrix, u falls from step to step and the sets
# shrink, so that the iteration is finite. It is Newton's method for (3.4). Below it is written out for the string, beside the
# package's own.
#
# On a fine mesh with a small eps the set loses about one layer of nodes per step, so that counts double as h halves. Starting
# from the solution on the next coarser mesh (nested iteration) ends that.

# %%
n, eps = 64, 1e-6
A = (2 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1)) * n
D = np.full(n - 1, 1 / n)
sets, last = [np.zeros(n - 1, bool)], np.inf
while True:
    u = np.linalg.solve(A + np.diag(sets[-1] * D / eps), f * D + sets[-1] * D * c / eps)
    assert len(sets) < 3 or np.all(u <= last + 1e-12)  # u falls
    sets, last = [*sets, u > c], u
    if np.array_equal(sets[-1], sets[-2]):
        break
for before, after in itertools.pairwise(sets[1:]):
    assert not np.any(after & ~before)  # sets shrink
ours = solve(string, cells=n, eps=eps, method="successive")
assert [step.active for step in ours.history] == [s.sum() for s in sets]
assert np.allclose(everywhere(ours.level.V, ours.u)[2][1:-1], u)

sizes = [32, 64, 96]
counts = {"(3.4)*": {"method": "successive"}, "nested": {"start": "nested"}}
histories = {name: [solve(disk, cells=m, eps=1e-8, **how).history for m in sizes] for name, how in counts.items()}
counts = {name: [len(history) - 1 for history in some] for name, some in histories.items()}
for name, some in counts.items():
    say(f"{name:7} linear solves on the finest of {sizes} cells a side:", *some)
for history in histories["(3.4)*"]:
    active = [step.active for step in history[1:]]
    assert active == sorted(active, reverse=True)
assert counts["(3.4)*"][-1] > 2 * counts["(3.4)*"][0] and max(counts["nested"]) <= 4

page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
left.imshow(sets, aspect="auto", cmap="Blues", extent=[0, 1, len(sets) - 0.5, -0.5], interpolation="nearest")
left.set_title(f"contact sets of (3.4)*, string, {n} cells")
left.set_xlabel("x")
left.set_ylabel("step")
for (name, some), marker in zip(counts.items(), "os", strict=True):
    right.plot(sizes, some, marker + "-", label=name)
right.set_ylim(0)
right.set_xticks(sizes)
right.set_title(r"linear solves, disk, $\epsilon = 10^{-8}$")
right.set_xlabel("cells a side")
right.legend()
keep(page, "8_iteration")
