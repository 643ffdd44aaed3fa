# %% [markdown]
# # On a cluster: job script, checkpoint, restart
#
# A slab of ice at its melting point is heated to the temperature 1 on the left side. The temperature $\theta$ of the
# water satisfies the heat equation. The front between water and ice moves with a speed proportional to the heat flux at
# the front (Stefan's problem). Duvaut's transformation $u = \int_0^t \theta\,dt$ turns Stefan's problem into an
# obstacle problem. With dimensionless quantities and the latent heat 1, it is
#
# $$ u_t - \Delta u = -1 + p, \qquad u \ge 0, \quad p \ge 0, \quad p\,u = 0, \qquad u = t \text{ on the left side} . $$
#
# The ice is the region where $u = 0$, and $p$ is the multiplier of the constraint. For a plane front the solution is
# known: the distance of the front from the left side is $s(t) = 2 \beta \sqrt t$, where
#
# $$ \sqrt\pi\, \beta\, e^{\beta^2} \operatorname{erf} \beta = 1, \qquad \beta = 0.6201 . $$
#
# ## The job
#
# A scene file can be solved without Python. Let `ice.toml` be a scene file with this problem. The following job script
# for Slurm uses two nodes with 32 processes each. The folder of the result must be on a file system that all nodes
# share.
#
# ```sh
# #!/bin/bash
# #SBATCH --nodes=2 --ntasks-per-node=32 --time=01:00:00
# module load fenicsx    # or activate the environment in which DOLFINx and this package are installed
# srun fenicsx-obstacle solve ice.toml --output $SCRATCH/ice
# ```
#
# The program saves its state in the file `$SCRATCH/ice/checkpoint.h5` every 20 seconds and at the end. If the job
# reaches its time limit, a second job with the option `--restart` continues from this file, on any number of processes:
#
# ```sh
# srun fenicsx-obstacle solve ice.toml --output $SCRATCH/ice --restart $SCRATCH/ice
# ```
#
# ## The same problem in Python
#
# This tutorial describes the same problem in Python, and solves it in two parts. On a cluster, run the tutorial with
# `srun python cluster.py`. On a workstation, run it in a clone with `mpirun -n 2 .venv/bin/python demos/cluster.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq
from scipy.special import erf

from fenicsx_obstacle import Answer, Scene, solve

comm = MPI.COMM_WORLD
scene = Scene(
    title="Melting ice",
    mesh={"shape": "rectangle", "x": [0, 2], "y": [0, 0.125], "cells": 128},
    rate=1,
    tension=1,
    load=-1,
    lower=0,
    boundary=[{"on": "left", "value": "t"}],
    time={"end": 1, "steps": 50, "scheme": "bdf2", "start": 0},
    report={"front": "2 - integral(contact)/0.125"},
)

# %% [markdown]
# The first part ends at $t = 0.5$. The argument `keep` is the folder of the checkpoint.

# %%
half = scene.change({"time.end": 0.5, "time.steps": 25})
first = solve(half, keep="ice")

# %% [markdown]
# The second part continues from the checkpoint up to $t = 1$. The answer `second` has the history of both parts. The
# code checks that this history agrees with the history of a run without interruption, and that the error of the front
# is smaller than one cell.

# %%
second = solve(scene, keep="ice", restart="ice")
whole = solve(scene)
front, t = (second.time_history.column(name)[1:] for name in ("front", "t"))
assert len(t) == 50 and np.isclose(t[-1], 1)
assert np.allclose(front, whole.time_history.column("front")[1:], atol=1e-9)

beta = brentq(lambda b: np.sqrt(np.pi) * b * np.exp(b**2) * erf(b) - 1, 0.1, 1)
assert np.isclose(beta, 0.6201, atol=1e-4)
error = np.abs(front[5:] - 2 * beta * np.sqrt(t[5:])).max()
if comm.rank == 0:
    print(
        f"front at t = 1: {front[-1]:.4f}, exact {2 * beta:.4f}; largest distance {error:.4f}, cells of {2 / 128:.4f}"
    )
assert error < 2 / 128  # one cell

# %% [markdown]
# ## Results
#
# `save` writes a folder in parallel: each process writes the data that it owns. `read` reads the folder on any number
# of processes, for example on a workstation. ParaView opens the file `fields.xdmf` in the folder.

# %%
second.save("ice")
read = Answer.read("ice")
assert np.isclose(read.at([0.5, 0.06]), second.at([0.5, 0.06]), rtol=1e-12)

# %% [markdown]
# The values in `second.report` are the same on every rank, and can be tested or printed without communication.
# Functions such as `second.u` are distributed over the ranks, as always in DOLFINx. The page *Performance* of the
# documentation has measured times on several processes.
#
# Left: $u$ at $t = 1$ along a horizontal line. Right: the position of the front over time in both parts.

# %%
line = second.along([0, 0.06], [2, 0.06], n=201)
if comm.rank == 0:
    page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    left.plot(line.s, line.u, color="#0072B2")
    left.axvspan(front[-1], 2, color="0.9")
    left.annotate("ice", (1.6, 0.3))
    left.annotate("water", (0.75, 0.6))
    left.set(xlabel="x", ylabel=r"u, the integral of $\theta$ over time", title="t = 1")
    before = t <= 0.5
    right.plot(t[before], front[before], "-", linewidth=3, color="#0072B2", label="first part")
    right.plot(t[~before], front[~before], "-", linewidth=3, color="#D55E00", label="second part, restarted")
    right.plot(t, 2 * beta * np.sqrt(t), "k:", label=r"$2 \beta \sqrt{t}$")
    right.set(xlabel="time t", title="melting front")
    right.legend(frameon=False)
    page.savefig("cluster.png", dpi=120)
