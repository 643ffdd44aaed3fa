# %% [markdown]
# # An American put
#
# An American put is an option: its holder may sell a share at the price $K$ at any time until expiry. Let $S$ be the
# price of the share, $t$ the time to expiry, and $V(S, t)$ the value of the option. Selling the share at once gives the
# payoff $(K - S)^+ = \max(K - S, 0)$. Therefore $V$ is never below this payoff. Let $x = \ln(S/K)$. The model of Black
# and Scholes with volatility $\sigma$ and interest rate $r$ is the parabolic obstacle problem
#
# $$ V_t - \frac{\sigma^2}{2} V_{xx} + \left(\frac{\sigma^2}{2} - r\right) V_x + r V = p, \qquad V \ge \psi, \quad
#    p \ge 0, \quad p\,(V - \psi) = 0, \qquad \psi = K\,(1 - e^x)^+ . $$
#
# Here $\psi$ is the payoff as a function of $x$, and $p$ the multiplier of the constraint. It is best to exercise the
# option where $V = \psi$, that is, for $S \le S^*(t)$. The free boundary $S^*(t)$ is unknown. For $t \to \infty$ it
# tends to $K\,r/(r + \sigma^2/2)$.
#
# In the scene below, $\sigma^2/2$ is the tension, $\sigma^2/2 - r$ the drift, and $r$ the foundation. The output
# quantity `exercise` is $S^*$: the largest price at which a node is in contact.
#
# Run this tutorial in a clone with `.venv/bin/python demos/put.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import Scene, solve

comm = MPI.COMM_WORLD
K, interest, sigma, years = 100.0, 0.05, 0.2, 1.0
scene = Scene(
    title="American put",
    mesh={"shape": "interval", "x": [-2, 2], "cells": 1000},
    define={"payoff": f"max({K} - {K}*exp(x), 0)"},
    rate=1,
    tension=sigma**2 / 2,
    drift=[sigma**2 / 2 - interest],
    foundation=interest,
    lower="payoff",
    boundary=[{"value": "payoff"}],
    time={"end": years, "steps": 200, "scheme": "bdf2", "start": "payoff", "name": "years to expiry"},
    report={"exercise": f"{K}*exp(sup(where(contact > 0.5, x, -2)))"},
)
solution = solve(scene)
price, below, above = solution.at([[0.0], [-0.004], [0.004]])
delta = (above - below) / (2 * 0.004 * K)  # dV/dS at S = K

# %% [markdown]
# ## Comparison with a binomial tree
#
# The binomial tree of Cox, Ross and Rubinstein is a method without finite elements. Here the tree has 2000 steps. The
# code compares the price $V$ and the derivative *delta* $= \partial V/\partial S$ at $S = K$, one year before expiry.


# %%
def tree(steps=2000):
    """Price and delta at S = K."""
    dt = years / steps
    up = np.exp(sigma * np.sqrt(dt))
    q = (np.exp(interest * dt) - 1 / up) / (up - 1 / up)
    S = K * up ** np.arange(-steps, steps + 1, 2)
    V = np.maximum(K - S, 0)
    for step in range(steps - 1, -1, -1):
        if step == 0:
            delta = (V[1] - V[0]) / (S[1] - S[0])
        S = S[:-1] * up
        V = np.maximum(np.exp(-interest * dt) * (q * V[1:] + (1 - q) * V[:-1]), K - S)
    return V[0], delta


exact_price, exact_delta = tree()
history = solution.time_history
t, exercise = history.column("t"), history.column("exercise")
perpetual = K * interest / (interest + sigma**2 / 2)
if comm.rank == 0:
    print(f"price {price:.4f}, tree {exact_price:.4f}; delta {delta:.4f}, tree {exact_delta:.4f}")
    print(f"exercise below S = {exercise[-1]:.2f} one year before expiry, {perpetual:.2f} without expiry")
assert np.isclose(price, exact_price, rtol=5e-4)
assert np.isclose(delta, exact_delta, atol=1e-3)
assert np.all(np.diff(exercise[1:]) <= 0) and exercise[-1] > perpetual  # S* decreases with the time to expiry

# %% [markdown]
# ## Picture
#
# Left: the value one year before expiry, which is tangent to the payoff at $S^*$. Right: the exercise boundary $S^*$
# over the time to expiry. In the picture $S^*$ moves in steps of one cell, because the computed value is the position
# of a node.

# %%
line = solution.along([-0.6], [0.6], n=301)
if comm.rank == 0:
    S = K * np.exp(line.points[:, 0])
    page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    left.plot(S, np.maximum(K - S, 0), "k:", label="payoff")
    left.plot(S, line.u, "-", color="#0072B2", label="value, one year before expiry")
    left.plot(exercise[-1], K - exercise[-1], "o", color="#D55E00", label="exercise boundary $S^*$")
    left.set(xlabel="price of the share S", ylabel="value V", xlim=(60, 150), ylim=(-1, 41))
    left.legend(frameon=False)
    right.step(t[1:], exercise[1:], color="#D55E00")
    right.set(xlabel="years to expiry", ylabel="exercise boundary $S^*$")
    page.savefig("put.png", dpi=120)
