# %% [markdown]
# # A certified tolerance
#
# To prove that a structure is safe, an estimate of the error is not enough: you need a bound. `solve(scene,
# tol=0.03)` refines the mesh and reduces the penalty parameter until the relative error in the energy norm $\|v\|_a =
# (\int \mu |\nabla v|^2)^{1/2}$ is *proved* to be below 3 %. This works for scenes with a tension $\mu$ and a load
# $f$ on a mesh of triangles. The page *Error bound* of the documentation lists all cases that are covered.
#
# The proof is an inequality without unknown constants. Let $u$ be the exact solution, $u_h$ the computed solution, and
# $\psi$ the lower obstacle. The computed solution may violate the constraint slightly. Therefore the program
# constructs a function $v_h$ close to $u_h$ with $v_h \ge \psi$ everywhere. From $u_h$ it also constructs a multiplier
# $\lambda \ge 0$ and a flux $\sigma$ with $-\nabla \cdot \sigma = f + \lambda$. Then
#
# $$ \|u - v_h\|_a \le \frac S2 + \sqrt{\frac{S^2}4 + \int \lambda\,(v_h - \psi)}, \qquad
#    S = \|\mu^{1/2} \nabla v_h - \mu^{-1/2} \sigma\|_0 . $$
#
# The bound of $\|u - u_h\|_a$ is this bound plus $\|v_h - u_h\|_a$. The page *Error bound* contains the proof,
# and further terms for a load that varies within triangles. All terms can be computed, and all are sums over
# triangles. The program refines the triangles whose contributions are large.
#
# Run this tutorial in a clone with `.venv/bin/python demos/certified.py`.

# %%
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from mpi4py import MPI

from fenicsx_obstacle import releases, solve

comm = MPI.COMM_WORLD

# %% [markdown]
# The scene `ball` comes with the package. The exact solution of this scene is known, so that the bound can be compared
# with the true error. The computation of the bound does not use the exact solution.

# %%
tolerances = [0.3, 0.1, 0.03]
solutions = [solve("ball", tol=tolerance) for tolerance in tolerances]
bounds = [solution.bound for solution in solutions]
errors = [solution.errors.energy for solution in solutions]
unknowns = [solution.dofs for solution in solutions]
if comm.rank == 0:
    print("tolerance  unknowns  relative bound  bound   true error  bound/error")
    for tolerance, n, bound, error in zip(tolerances, unknowns, bounds, errors, strict=True):
        print(f"{tolerance:9.2f}  {n:8d}  {bound.relative:14.4f}  {bound.total:.4f}  {error:10.4f}"
              f"  {bound.total / error:11.2f}  {bound.words}")  # fmt: skip
for tolerance, bound, error in zip(tolerances, bounds, errors, strict=True):
    assert bound.guaranteed and bound.words == "certified"
    assert bound.relative <= tolerance
    assert error <= bound.total <= 3 * error

# %% [markdown]
# The bound is at least as large as the error, and at most three times as large. `solution.bound` also contains the
# parts of the bound:
#
# - `discretisation`: the part due to the mesh
# - `penalty`: the part due to the penalty parameter
# - `algebraic`: the part due to the iterative solvers
# - `data`: the part due to data that the mesh does not resolve
#
# The text `bound.words` states the assumptions of the bound. A load that is a Python callable is known by samples only.
# In this case the text is *certified for the sampled load*: the bound is proved if the load varies between the samples
# no more than the samples show. `bound.guaranteed` is true only if the text is *certified*.
#
# The tolerance may be too small for the memory of the machine, or for a budget such as `solve(..., budget="60s")`.
# Then the program returns the best solution, and `solution.adaptive.reached` is false.
#
# ## Picture
#
# Left: the last mesh. It is fine where the curvature of $u$ is large, and finest beside the free boundary. Right: the
# bound decreases like $N^{-1/2}$ with the number of unknowns $N$. This is the best possible order for linear elements.

# %%
last = solutions[-1]
path = last.adaptive.path
mesh = last.level.mesh
corners = comm.gather(mesh.geometry.x[releases.geometry_dofs(mesh)])
if comm.rank == 0:
    triangles = np.concatenate(corners)[:, :, :2]
    page, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    left.add_collection(PolyCollection(triangles, facecolor="none", edgecolor="#0072B2", linewidth=0.15))
    left.add_patch(plt.Circle((0, 0), 0.69797, fill=False, color="#D55E00", label="free boundary"))
    left.set(xlim=(-2, 2), ylim=(-2, 2), aspect="equal", title=f"mesh for 3 %: {len(triangles)} triangles")
    left.legend(loc="lower left")
    n = np.array([step.dofs for step in path])
    right.loglog(n, [step.total for step in path], "o-", color="#0072B2", label="certified bound, all meshes")
    right.loglog(unknowns, errors, "s", color="#D55E00", label="true error")
    right.loglog(n, 0.6 * errors[-1] * np.sqrt(n[-1] / n), "k:", label="order $N^{-1/2}$")
    right.set(xlabel="unknowns N", title="error in the energy norm")
    right.legend(frameon=False)
    page.savefig("certified.png", dpi=120)
