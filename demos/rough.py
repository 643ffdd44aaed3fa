# %% [markdown]
# # A rough surface from a file
#
# An obstacle may be read from a file of measured heights. The file may contain an array, an image, an STL surface, or
# a table with the columns x, y and z. This tutorial first writes such a file with the heights $z$ of a self-affine
# surface. The power spectrum of this surface falls like $|k|^{-2 - 2H}$. Here $k$ is the wave vector, and $H = 0.8$
# the Hurst exponent. Many fractured or ground surfaces have such a spectrum.
#
# A membrane with tension 1 is fixed at the height 0 on the boundary of a square. The surface is below it, at the height
# $z - 0.1$. The load $f$ presses the membrane down:
#
# $$ -\Delta u = -f + p, \qquad u \ge z - 0.1, \quad p \ge 0, \quad p\,(u - z + 0.1) = 0 \ \text{in } (0, 1)^2 . $$
#
# The tutorial computes the contact area and the contact force for several loads.
#
# Run this tutorial in a clone with `.venv/bin/python demos/rough.py`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import Scene, solve, study

comm = MPI.COMM_WORLD
HURST, SIZE = 0.8, 512


def surface():
    """Heights with mean 0 and standard deviation 0.01, shape (SIZE, SIZE)."""
    noise = np.fft.fft2(np.random.default_rng(1).standard_normal((SIZE, SIZE)))
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(SIZE), np.fft.fftfreq(SIZE)))
    k[0, 0] = np.inf
    z = np.fft.ifft2(noise * k ** (-1 - HURST)).real
    return 0.01 * z / z.std()


z = surface()
if comm.rank == 0:
    axis = np.linspace(0, 1, SIZE)
    np.savez_compressed("rough.npz", x=axis, y=axis, z=z)
comm.barrier()

# %% [markdown]
# The next cell checks the spectrum of $z$ along straight lines. This one-dimensional spectrum must fall like
# $|k|^{-1 - 2H}$: its exponent is larger by 1 than that of the surface.

# %%
power = np.abs(np.fft.fft(z, axis=1)[:, 1:128] ** 2).mean(axis=0)
slope = np.polyfit(np.log(np.arange(4, 64)), np.log(power[3:63]), 1)[0]
assert abs(slope + 1 + 2 * HURST) < 0.15

# %% [markdown]
# ## The scene
#
# The entry `lower = {file = "rough.npz"}` names the file in place of a formula or a number. The key `shift` moves the
# surface down by 0.1. The name of the file is relative to the folder of the scene file.

# %%
SCENE = """
title = "Membrane pressed on a rough surface"
define = {load = 4}
mesh = {shape = "rectangle", cells = 128}
effects = {tension = 1, load = "-load"}
obstacle = {lower = {file = "rough.npz", shift = [0, 0, -0.1]}}
boundary = [{value = 0}]
"""
if comm.rank == 0:
    Path("rough.toml").write_text(SCENE)
comm.barrier()
loads = [2, 4, 8, 16, 32, 64, 128]
rows = study("rough.toml", vary={"define.load": loads})
areas = [row["contact.area"] for row in rows]
forces = [row["contact.lower.force"] for row in rows]
if comm.rank == 0:
    for load, area, force in zip(loads, areas, forces, strict=True):
        print(f"load {load:4d}  contact area {area:.4f}  force {force:8.4f}  share of the load {force / load:.3f}")
assert np.all(np.diff(areas) > 0) and np.all(np.diff(forces) > 0)
assert np.all(np.array(forces) < loads)  # the boundary carries the rest
assert np.all(np.diff(np.divide(forces, loads)) > 0)

# %% [markdown]
# ## Picture
#
# Left: the heights $z$ in grey, and the nodes in contact at the load 8 in orange. The contact set consists of many
# small spots. Right: the contact area, and the share of the load that the surface carries. The boundary carries the
# rest of the load.

# %%
solution = solve(Scene.read("rough.toml").change({"define.load": 8}))
own = solution.level.V.dofmap.index_map.size_local
points = solution.level.V.tabulate_dof_coordinates()[:own]
spots = comm.gather(points[solution.contact.x.array[:own] > 0.5])
if comm.rank == 0:
    x, y, _ = np.concatenate(spots).T
    page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    image = left.imshow(z, origin="lower", extent=[0, 1, 0, 1], cmap="Greys_r")
    page.colorbar(image, ax=left, label="height z")
    left.plot(x, y, "s", color="#D55E00", markersize=1.3)
    left.set(xlabel="x", ylabel="y", title="contact nodes at the load 8")
    right.semilogx(loads, areas, "o-", color="#0072B2", label="contact area (of 1)")
    right.semilogx(loads, np.divide(forces, loads), "s-", color="#D55E00", label="share of the load on the surface")
    right.set(xlabel="load f", ylim=(0, 1))
    right.legend(frameon=False)
    page.savefig("rough.png", dpi=120)
