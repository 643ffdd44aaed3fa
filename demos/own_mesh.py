# %% [markdown]
# # Your own mesh: Gmsh, materials, tags and Functions
#
# A rectangular membrane with a stiff patch is fixed on the left and right sides. The other two sides are free. A load
# of 1 presses the membrane down onto a curved obstacle $\psi$. The height $u$ and the contact pressure $p$ satisfy
#
# $$ -\nabla \cdot (\mu \nabla u) = -1 + p, \qquad u \ge \psi, \quad p \ge 0, \quad p\,(u - \psi) = 0, \qquad
#    \mu = 20 \text{ in the patch}, \ 1 \text{ elsewhere}. $$
#
# Gmsh makes the mesh and its physical groups, which DOLFINx reads as `MeshTags`. The cells of the patch have the tag 5,
# the other cells have the tag 6, and the facets on the left and right sides have the tag 1.
#
# Run this tutorial in a clone with `.venv/bin/python demos/own_mesh.py`, or with `mpirun -n 2 .venv/bin/python
# demos/own_mesh.py`.

# %%
import gmsh
import numpy as np
from dolfinx import fem
from mpi4py import MPI

try:
    from dolfinx.io.gmsh import model_to_mesh  # from dolfinx 0.10 on
except ImportError:
    from dolfinx.io.gmshio import model_to_mesh

from fenicsx_obstacle import Scene, releases, solve

comm = MPI.COMM_WORLD
gmsh.initialize()
gmsh.option.setNumber("General.Verbosity", 1)
if comm.rank == 0:
    whole, patch = gmsh.model.occ.addRectangle(0, 0, 0, 2, 1), gmsh.model.occ.addRectangle(1, 0.2, 0, 0.6, 0.6)
    gmsh.model.occ.fragment([(2, whole)], [(2, patch)])
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [patch], 5)
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2) if tag != patch], 6)
    sides = [tag for _, tag in gmsh.model.getEntities(1) if gmsh.model.occ.getCenterOfMass(1, tag)[0] in (0, 2)]
    gmsh.model.addPhysicalGroup(1, sides, 1)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.1)
    gmsh.model.mesh.generate(2)
mesh, cell_tags, facet_tags = model_to_mesh(gmsh.model, comm, 0, gdim=2)[:3]
gmsh.finalize()

# %% [markdown]
# ## Names for tags, and one tension per material
#
# A `Scene` takes the mesh and its tags. The arguments `facet_names` and `cell_names` give names to tags. Data and
# boundary conditions refer to these names.
#
# With `tol=0.01` the package refines the mesh until the relative error in the energy norm is proved to be below 1 %.
# The tags are transferred to the cells and facets of each refined mesh. The domain is a polygon, so the mesh has no
# geometric error. The package cannot know this. It therefore reports 'certified on the polygon of the mesh'.

# %%
common = {
    "mesh": mesh,
    "facet_tags": facet_tags,
    "facet_names": {"sides": 1},
    "load": -1,
    "lower": "-0.02 - 0.05*(x - 1)^2",
    "boundary": [{"on": "sides", "value": 0}],
}
materials = Scene(
    **common, cell_tags=cell_tags, cell_names={"patch": 5, "rest": 6}, tension={"patch": 20.0, "rest": 1.0}
)
solution = solve(materials, tol=0.01, element="P2")
if comm.rank == 0:
    print(solution.summary())
    print(f"force on the obstacle {solution.force.lower:.4f}, contact area {solution.area:.4f}")
assert solution.adaptive.reached and solution.bound.relative <= 0.01
assert solution.bound.words == "certified on the polygon of the mesh"

# %% [markdown]
# ## The same with Functions
#
# Each item of data may also be a DOLFINx Function. Here the tension is a piecewise constant Function. The obstacle is
# the same formula as before.

# %%
mu = fem.Function(releases.functionspace(mesh, "DG", 0))
mu.x.array[:] = 1.0
mu.x.array[cell_tags.find(5)] = 20.0
again = solve(Scene(**common, tension=mu), tol=0.01, element="P2")
assert again.bound.relative <= 0.01
assert np.isclose(again.force.lower, solution.force.lower, rtol=1e-3)

# %% [markdown]
# The total load is 2. The obstacle carries one part of this load, and the fixed sides carry the rest. At points of the
# contact set outside the patch, $u = \psi$ and $\mu = 1$. The pressure there is
# $p = 1 - \nabla \cdot (\mu \nabla \psi) = 1.1$. Near the point (1.45, 0.5) the stiff patch does not touch the
# obstacle, and the pressure is zero.

# %%
assert 0 < solution.force.lower < 2
pressures = solution.at([[0.7, 0.5], [1.45, 0.5]], "pressure")
if comm.rank == 0:
    print(f"pressure at (0.7, 0.5): {pressures[0]:.4f}; in the patch, at (1.45, 0.5): {pressures[1]:.4f}")
assert np.isclose(pressures[0], 1.1, atol=0.01) and pressures[1] == 0

picture = solution.plot("own_mesh.png")
