"""A self-affine rough surface under a membrane: contact area and force over the load, as one picture.

python3 demos/rough.py [FOLDER]

Writes rough.npz, which demos/rough.toml reads, beside that scene, and rough.png into FOLDER, by default out/rough.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpi4py import MPI

from fenicsx_obstacle import Scene, study

HURST, SIZE, SEED = 0.8, 512, 1
ROUGHNESS = 0.01  # standard deviation of the heights
LOADS = [2, 4, 8, 16, 32]


def surface(size=SIZE, hurst=HURST, seed=SEED):
    """Heights whose power spectrum falls like |k|^(-2 - 2 hurst), with mean 0, shape (size, size)."""
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal((size, size)))
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    k[0, 0] = np.inf
    z = np.fft.ifft2(noise * k ** (-1 - hurst)).real
    return ROUGHNESS * z / z.std()


def main(folder, cells=256):
    """Solve for all loads and draw (collective); returns the rows."""
    demos, comm = Path(__file__).parent, MPI.COMM_WORLD
    if comm.rank == 0:
        axis = np.linspace(0, 1, SIZE)
        np.savez_compressed(demos / "rough.npz", x=axis, y=axis, z=surface())
    comm.barrier()
    rows = study(Scene.read(demos / "rough.toml", {"mesh.cells": cells}), {"define.load": LOADS})
    if comm.rank == 0:
        page = Figure(figsize=(9, 3.6), dpi=150, constrained_layout=True)
        FigureCanvasAgg(page)
        left, right = page.subplots(1, 2)
        left.semilogx(LOADS, [row["contact.area"] for row in rows], "o-", color="#0072B2")
        left.set(xlabel="load", ylabel="contact area (of 1)")
        right.loglog(LOADS, LOADS, ":", color="0.4", label="all of the load")
        right.loglog(LOADS, [row["contact.lower.force"] for row in rows], "s-", color="#D55E00", label="surface")
        right.set(xlabel="load", ylabel="force carried")
        right.legend(frameon=False)
        for axes in (left, right):
            axes.grid(True, color="0.9")
        folder.mkdir(parents=True, exist_ok=True)
        page.savefig(folder / "rough.png")
        for load, row in zip(LOADS, rows, strict=True):
            print(f"load {load:3d}  contact area {row['contact.area']:.4f}  force {row['contact.lower.force']:.4f}")
    return rows


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/rough"))
