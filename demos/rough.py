"""A self-affine rough surface under a membrane: contact area and force over the load, as one picture.

python3 demos/rough.py [FOLDER]

Writes into FOLDER, by default out/rough: the heights rough.npz, the scene rough.toml that reads them, and rough.png.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import Scene, study

HURST, SIZE, SEED = 0.8, 512, 1
ROUGHNESS = 0.01  # standard deviation of the heights
LOADS = [2, 4, 8, 16, 32]
SCENE = """\
title = "Membrane pressed on a rough surface"
[define]
load = 4                            # pressure on the membrane
[mesh]
shape = "rectangle"
cells = 256
[effects]
tension = 1
load = "-load"
[obstacle]
lower = {file = "rough.npz", shift = [0, 0, -0.1]}
[[boundary]]
value = 0
[profile.middle]
from = [0, 0.5]
to = [1, 0.5]
n = 1000
[report]
carried = "integral(p)/load"        # share of the load that the surface carries
"""


def surface(size=SIZE, hurst=HURST, seed=SEED):
    """Heights whose power spectrum falls like |k|^(-2 - 2 hurst), with mean 0, shape (size, size)."""
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal((size, size)))
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    k[0, 0] = np.inf
    z = np.fft.ifft2(noise * k ** (-1 - hurst)).real
    return ROUGHNESS * z / z.std()


def main(folder, cells=256):
    """Solve for all loads and draw (collective); returns the rows."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        axis = np.linspace(0, 1, SIZE)
        np.savez_compressed(folder / "rough.npz", x=axis, y=axis, z=surface())
        (folder / "rough.toml").write_text(SCENE)
    comm.barrier()
    rows = study(Scene.read(folder / "rough.toml", {"mesh.cells": cells}), {"define.load": LOADS})
    if comm.rank == 0:
        page, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), dpi=150, layout="constrained")
        left.semilogx(LOADS, [row["contact.area"] for row in rows], "o-", color="#0072B2")
        left.set(xlabel="load", ylabel="contact area (of 1)")
        right.loglog(LOADS, LOADS, ":", color="0.4", label="all of the load")
        right.loglog(LOADS, [row["contact.lower.force"] for row in rows], "s-", color="#D55E00", label="surface")
        right.set(xlabel="load", ylabel="force carried")
        right.legend(frameon=False)
        for axes in (left, right):
            axes.grid(True, color="0.9")
        page.savefig(folder / "rough.png")
        for load, row in zip(LOADS, rows, strict=True):
            print(f"load {load:3d}  contact area {row['contact.area']:.4f}  force {row['contact.lower.force']:.4f}")
    return rows


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/rough"))
