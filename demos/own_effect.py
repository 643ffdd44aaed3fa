# %% [markdown]
# # An effect of your own: a microswitch that is pulled in by a voltage
#
# A membrane is fixed at distance 1 above an electrode. Let $u$ be its displacement, positive upwards. A voltage pulls
# the membrane down with the force $\lambda/(1 + u)^2$ per area, where $\lambda$ is the square of the voltage in
# suitable units. An insulating layer of thickness 0.2 covers the electrode, and the membrane can rest on this layer.
# Therefore $u \ge -0.8$. With the contact pressure $p$ the problem on an interval is
#
# $$ -u'' + \frac{\lambda}{(1 + u)^2} = p, \qquad u \ge -0.8, \quad p \ge 0, \quad p\,(u + 0.8) = 0
#    \ \text{in } (-\tfrac12, \tfrac12), \qquad u(\pm\tfrac12) = 0 . $$
#
# The package does not contain this force. A new effect (a term of the equation) is defined by one class. The class
# contains:
#
# - `key`, the name of the effect in a scene;
# - `terms`, its term in the residual as UFL, with a test function `v`;
# - `energy`, its energy as UFL, here the integral of $-\lambda/(1 + u)$;
# - `affine` and `convex`, from which the package chooses the solver. Here both are false, because the term is not
#   linear in $u$, and the energy is not convex;
# - `equation`, `term` and `unit`, which appear in the output of `./obstacle explain`. `unit` is the unit of $\lambda$.
#
# `self.value` is what the user gives for $\lambda$: a number, a formula or a Function. `data.cellwise` returns the
# value of $\lambda$ in each cell. With `least=0.0` negative values are rejected. `data.dI` is the measure of the
# quadrature rule whose points are the nodes.
#
# Run this tutorial in a clone with `.venv/bin/python demos/own_effect.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI
from scipy.optimize import minimize_scalar

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.effects.effect import Effect, register

comm = MPI.COMM_WORLD


@register
class Electrostatic(Effect):
    """lambda/(1 + u)^2 on the left side of the equation, lambda >= 0.

    This term is a force per area, and 1 + u is a length. Therefore lambda has the unit of a force.
    """

    key = "electrostatic"
    equation = "electrostatic/(1 + u)^2"
    term = "+ int electrostatic/(1 + u)^2 v"
    unit = "force"
    affine = False
    convex = False

    def terms(self, u, v, data):
        return data.cellwise(self.value, least=0.0) / (1 + u) ** 2 * v * data.dI

    def energy(self, u, data):
        return -data.cellwise(self.value, least=0.0) / (1 + u) * data.dI


# %% [markdown]
# ## The exact equilibria
#
# Consider an equilibrium without contact. The distance $1 + u$ from the electrode has its minimum $\alpha$ in the
# middle. Multiply the equation by $u'$ and integrate from the middle. This gives $u'$ as a function of $u$, $\alpha$
# and $\lambda$. Integrate $1/u'$ over $u$ from the middle to the end of the interval. The result must be the length
# $\frac12$. Therefore exactly one load $\lambda$ belongs to each $\alpha$:
#
# $$ \lambda(\alpha) = 2\alpha \left(\sqrt{1 - \alpha}
#    + \alpha \,\mathrm{arsinh} \sqrt{\tfrac{1 - \alpha}{\alpha}}\right)^2 . $$
#
# The largest load is $\lambda = 1.400$, at $\alpha = 0.61$. This is the load of *pull-in*: for larger loads there is no
# equilibrium without contact, and the membrane moves down to the layer. When the load decreases again, the membrane
# stays on the layer until $\lambda = \lambda(0.2) = 0.560$. At this load the contact length becomes zero, and the
# membrane is *released*.


# %%
def load_of(distance):
    """lambda of the equilibrium without contact that has this distance in the middle."""
    return 2 * distance * (np.sqrt(1 - distance) + distance * np.arcsinh(np.sqrt((1 - distance) / distance))) ** 2


pull_in = -minimize_scalar(lambda distance: -load_of(distance), bounds=(0.3, 0.9), method="bounded").fun
release = load_of(0.2)
assert np.isclose(pull_in, 1.400, atol=1e-3) and np.isclose(release, 0.560, atol=1e-3)

# %% [markdown]
# ## The load rises and falls
#
# `electrostatic` is now a key of scenes, like `tension`. The load rises from 0 to 1.8 and falls to 0 again. The effect
# `rate` adds a damping force to the equation. The load changes slowly, and the state is therefore close to an
# equilibrium, except during pull-in and release. The first time step has the length `end/steps`. Because of the key
# `tolerance`, the program then chooses the length of each step so that the error that a step adds is smaller than
# `tolerance`. The steps are short during pull-in and release.

# %%
scene = Scene(
    title="Microswitch",
    mesh={"shape": "interval", "x": [-0.5, 0.5], "cells": 128},
    define={"squared_voltage": "1.8*min(t, 2 - t)"},
    tension=1,
    rate=0.003,
    electrostatic="squared_voltage",
    lower=-0.8,
    time={"end": 2, "steps": 200, "tolerance": 1e-3, "start": 0},
    report={"opening": "1 + at(u, 0)"},
)
history = solve(scene).time_history
t, distance, contact = (history.column(name)[1:] for name in ("t", "opening", "contact_area"))
load = 1.8 * np.minimum(t, 2 - t)

closed = np.flatnonzero(contact > 0)
up, down = load[closed[0]], load[closed[-1]]
if comm.rank == 0:
    print(f"pull-in at {up:.3f}, for an infinitely slow load {pull_in:.3f}")
    print(f"release at {down:.3f}, for an infinitely slow load {release:.3f}")
assert pull_in < up < 1.02 * pull_in
assert abs(down - release) < 0.02
assert np.isclose(distance.min(), 0.2, atol=1e-3)

# %% [markdown]
# The picture shows the distance in the middle over the load. The dashed black line shows the equilibria without
# contact. Where there is no contact, the computed curve follows the stable part of this line. For loads between release
# and pull-in there are two stable states, one with contact and one without. The history of the load determines the
# state of the membrane.

# %%
if comm.rank == 0:
    page, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    half = np.argmax(t >= 1) + 1
    axes.plot(load[:half], distance[:half], "-", color="#0072B2", linewidth=3, label="load rises")
    axes.plot(load[half - 1 :], distance[half - 1 :], "-", color="#D55E00", linewidth=3, label="load falls")
    alpha = np.linspace(0.2, 0.9999, 300)
    axes.plot(load_of(alpha), alpha, "k--", linewidth=1, label=r"equilibria $\lambda(\alpha)$")
    axes.set(xlabel=r"load $\lambda$", ylabel="distance in the middle", ylim=(0, 1.05))
    axes.annotate("pull-in", (pull_in, 0.45), textcoords="offset points", xytext=(12, 0))
    axes.annotate("release", (release, 0.3), textcoords="offset points", xytext=(-52, 0))
    axes.legend(frameon=False)
    page.savefig("own_effect.png", dpi=120)
