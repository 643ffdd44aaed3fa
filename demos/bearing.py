# %% [markdown]
# # A journal bearing
#
# A shaft turns in a bearing. The clearance is the difference of their radii. The eccentricity $e$ is the distance
# between their axes, divided by the clearance. Let $\theta$ be the angle around the axis. The thickness of the oil film
# is $H = 1 + e \cos\theta$ in units of the clearance.
#
# The unknown $u$ is the pressure of the film, relative to the pressure of the air. It satisfies Reynolds' equation.
# Where the gap opens, the film cavitates: its pressure cannot fall below the pressure of the air. Therefore $u \ge 0$.
# The multiplier $p$ of this constraint is 0 where $u > 0$. It is positive only where the film cavitates. The
# dimensionless problem on the surface of a cylinder is
#
# $$ -\nabla \cdot (H^3 \nabla u) = 6 e \sin\theta + p, \qquad u \ge 0, \quad p \ge 0, \quad p\,u = 0 . $$
#
# The scene file `demos/bearing.toml` describes this problem for a bearing whose length is equal to its diameter. The
# mesh is made by Gmsh from `demos/bearing.geo`. The scene has two output quantities. The *Sommerfeld number* $S$ is
# proportional to viscosity times speed divided by the load. The *attitude* is the angle in degrees between the load and
# the line through both axes.
#
# Run this tutorial in a clone with `.venv/bin/python demos/bearing.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI
from scipy.interpolate import NearestNDInterpolator
from scipy.optimize import brentq

from fenicsx_obstacle import Scene, solve, study

comm = MPI.COMM_WORLD
bearing = Scene.read("demos/bearing.toml")

# %% [markdown]
# ## Several eccentricities
#
# `study` solves the scene for several values of a parameter. Here the parameter is the eccentricity, `ecc` in the table
# `[define]` of the scene. `study` returns a list with one dictionary per value. The known values of $S$ and of the
# attitude are from Raimondi and Boyd (1958).

# %%
known = {0.1: (1.33, 79.5), 0.2: (0.631, 74.02), 0.4: (0.264, 63.10), 0.6: (0.121, 50.58), 0.8: (0.0446, 36.24)}
rows = study(bearing, vary={"define.ecc": list(known)})
found = [(row["report.sommerfeld"], row["report.attitude"]) for row in rows]
if comm.rank == 0:
    print("eccentricity  S       known   attitude  known")
    for eccentricity, computed, reference in zip(known, found, known.values(), strict=True):
        print(f"{eccentricity:12.1f}  {computed[0]:.4f}  {reference[0]:.4f}  {computed[1]:8.2f}  {reference[1]:.2f}")
assert np.allclose([S for S, _ in found], [S for S, _ in known.values()], rtol=0.013)
assert np.allclose([angle for _, angle in found], [angle for _, angle in known.values()], atol=0.6)

# %% [markdown]
# ## The eccentricity for a given load
#
# In practice load, speed and viscosity are given. They determine $S$, and the eccentricity is unknown. Here SciPy's
# `brentq` finds the eccentricity $e$ with $S(e) = 0.2$. In parallel all ranks must call `solve` equally often. Here
# they do: all ranks get the same value of $S$, and `brentq` therefore takes the same steps on each rank.


# %%
def excess(eccentricity):
    """S - 0.2 (collective)."""
    return solve(bearing.change({"define.ecc": eccentricity})).report["sommerfeld"] - 0.2


eccentricity = brentq(excess, 0.3, 0.6, xtol=1e-4)
solution = solve(bearing.change({"define.ecc": eccentricity}))
if comm.rank == 0:
    print(f"S = 0.2 at the eccentricity {eccentricity:.3f}; narrowest gap {1 - eccentricity:.3f} of the clearance")
assert abs(solution.report["sommerfeld"] - 0.2) < 1e-3
assert np.isclose(eccentricity, 0.475, atol=0.01)

# %% [markdown]
# ## Picture
#
# Left: the pressure on the unrolled cylinder at $S = 0.2$, with the boundary of the cavitated region. The film is
# periodic: all nodes are drawn at $\theta - 2\pi$, $\theta$ and $\theta + 2\pi$. At the ends the pressure is given, and
# no node is in contact; for the picture each takes the value of the nearest other node. Right: $S$ for the
# eccentricities of the study, the known values, and the eccentricity with $S = 0.2$.

# %%
V = solution.u.function_space
own = V.dofmap.index_map.size_local
points = V.tabulate_dof_coordinates()[:own]
everywhere = comm.gather(np.column_stack([points, solution.u.x.array[:own], solution.contact.x.array[:own]]))
if comm.rank == 0:
    x, y, z, u, contact = np.concatenate(everywhere).T
    theta = np.arctan2(y, x) % (2 * np.pi)
    theta = np.concatenate([theta - 2 * np.pi, theta, theta + 2 * np.pi])
    z, u, contact = (np.tile(values, 3) for values in (z, u, contact))
    inner = ~np.isclose(np.abs(z), 1)
    nearest = NearestNDInterpolator(np.column_stack([theta, z])[inner], contact[inner])
    page, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained", width_ratios=(1.5, 1))
    image = left.tricontourf(theta, z, u, levels=20, cmap="viridis")
    left.tricontour(theta, z, nearest(theta, z), levels=[0.5], colors="white")
    left.set(xlabel=r"$\theta$", ylabel="z", title="film pressure; white: boundary of the cavity")
    left.set(xlim=(0, 2 * np.pi), ylim=(-1, 1))
    page.colorbar(image, ax=left, ticks=[0, 0.5, 1, 1.5, 2])
    right.semilogy(list(known), [S for S, _ in found], "-", color="#0072B2", label="computed")
    right.semilogy(list(known), [S for S, _ in known.values()], "o", color="#D55E00", label="Raimondi and Boyd")
    right.semilogy(eccentricity, 0.2, "k*", markersize=11, label="S = 0.2")
    right.set(xlabel="eccentricity $e$", ylabel="Sommerfeld number S")
    right.legend(frameon=False)
    page.savefig("bearing.png", dpi=120)
