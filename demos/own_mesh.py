"""A membrane of two materials on a mesh from Gmsh: tags, a Function as tension, a formula as obstacle, a certified 1 %.

mpirun -n 2 python3 own_mesh.py
"""

import gmsh
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
if comm.rank == 0:  # a square with a stiff patch, held on the left and on the right
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

mu = fem.Function(releases.functionspace(mesh, "DG", 0), name="mu")
mu.x.array[:] = 1.0
mu.x.array[cell_tags.find(5)] = 20.0

scene = Scene(
    mesh=mesh, facet_tags=facet_tags, facet_names={"sides": 1}, tension=mu, load=-1, lower="-0.02 - 0.05*(x - 1)^2",
    boundary=[{"on": "sides", "value": 0}],
)  # fmt: skip
solution = solve(scene, tol=0.01, element="P2")
if comm.rank == 0:
    print(solution.summary())
    print(f"force {solution.force.lower:.4f}, contact area {solution.area:.4f}")
