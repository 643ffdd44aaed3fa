"""Meshes: shapes, refinement, files; the same on any number of ranks."""

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

from fenicsx_obstacle import InputError, Scene, releases, solve
from fenicsx_obstacle.discrete import levels
from fenicsx_obstacle.parallel import largest, on_root, total

MESHES = {
    "interval": ({"shape": "interval", "cells": 9}, 1.0),
    "rectangle": ({"shape": "rectangle", "x": [0, 2], "cells": 6}, 2.0),
    "crossed": ({"shape": "rectangle", "cells": 4, "diagonal": "crossed"}, 1.0),
    "union-jack": ({"shape": "rectangle", "cells": 4, "diagonal": "union-jack"}, 1.0),
    "box": ({"shape": "box", "cells": 3}, 1.0),
    "l-shape": ({"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 6}, 3.0),
}


def measure(level, form=1.0):
    constant = fem.Constant(level.mesh, 1.0)
    return total(COMM, fem.assemble_scalar(releases.form(form * constant * ufl.dx(domain=level.mesh))))


def build(mesh):
    return levels.build(Scene(mesh=mesh, tension=1), COMM)


@pytest.mark.parametrize("name", MESHES)
def test_area_and_boundary_survive_refinement(name):
    mesh, area = MESHES[name]
    level = build({**mesh, "refine": 1})
    assert abs(measure(level) - area) < 1e-12
    assert level.cells == level.coarse.cells * 2**level.mesh.topology.dim
    assert np.isclose(level.h, level.coarse.h / 2)
    ds = ufl.ds(domain=level.mesh)
    perimeter = total(COMM, fem.assemble_scalar(releases.form(fem.Constant(level.mesh, 1.0) * ds)))
    named = np.unique(np.concatenate(list(level.facets.values())))
    assert np.array_equal(named, np.sort(level.boundary_facets)) or level.mesh.comm.size > 1
    coarse = total(
        COMM,
        fem.assemble_scalar(releases.form(fem.Constant(level.coarse.mesh, 1.0) * ufl.ds(domain=level.coarse.mesh))),
    )
    assert np.isclose(perimeter, coarse)


@pytest.mark.parametrize("name", MESHES)
def test_fine_dofs_are_means_of_coarse_dofs(name):
    """P1 prolongation: a linear function on the coarse level is the same function on the fine one."""
    level = build({**MESHES[name][0], "refine": 2})
    for fine in (level, level.coarse):
        linear = [f.tabulate_dof_coordinates() @ [1.0, 2.0, 3.0] for f in (fine.coarse.V, fine.V)]
        assert np.allclose(linear[0][fine.ends].mean(axis=1), linear[1][: fine.owned])


def test_disk_approaches_the_circle():
    """Refined boundary vertices move onto the circle; the area tends to pi with order 2."""
    level = build({"shape": "disk", "radius": 1, "cells": 8, "refine": 2})
    errors = []
    while level is not None:
        errors.append(np.pi - measure(level))
        rim = fem.locate_dofs_topological(level.V, 1, level.facets["circle"])
        assert np.allclose(np.linalg.norm(level.V.tabulate_dof_coordinates()[rim], axis=1), 1) or not len(rim)
        level = level.coarse
    assert errors[0] < errors[1] / 3.5 < errors[2] / 12


def test_more_ranks_than_cells():
    """Ranks that own nothing work along."""
    answer = solve(Scene(mesh={"shape": "interval", "cells": 2}, tension=1, load=8, upper=0.3), eps=1e-8)
    assert np.isclose(largest(COMM, answer.u.x.array), 0.3, atol=1e-6)
    one = solve(Scene(mesh={"shape": "rectangle", "cells": 1}, tension=1, load=8, upper=0.3))
    assert one.record["dofs"] == 4


def gmsh_square(path, order=1, recombine=False):
    import gmsh

    gmsh.initialize([], False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], 7)
    for name, lines in (("floor", [1]), ("rest", [2, 3, 4])):
        tag = gmsh.model.addPhysicalGroup(1, lines)
        gmsh.model.setPhysicalName(1, tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2)
    if recombine:
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.finalize()


def test_gmsh_names(folder):
    """Physical names are what [[boundary]] on means; refinement keeps them."""
    on_root(COMM, gmsh_square, folder / "square.msh")
    scene = Scene(
        mesh={"file": str(folder / "square.msh"), "refine": 1}, tension=1, exact="y",
        boundary=[{"on": "floor", "value": 0}, {"on": "rest", "value": "y"}],
    )  # fmt: skip
    assert solve(scene).record["errors"]["max"] < 1e-9
    with pytest.raises(InputError, match="no part named 'flor'; did you mean 'floor'"):
        solve(scene.change({"boundary": [{"on": "flor", "value": 0}]}))


def test_broken_mesh_files(folder):
    on_root(COMM, gmsh_square, folder / "curved.msh", 2)
    on_root(COMM, gmsh_square, folder / "quads.msh", 1, True)

    def write():
        (folder / "broken.msh").write_text("$MeshFormat\n4.1 0 8\nnonsense")
        (folder / "broken.xdmf").write_text("<Xdmf><Domain>")
        (folder / "mesh.stl").write_text("solid")

    on_root(COMM, write)
    cases = {
        "curved.msh": "P1 needs straight",
        "quads.msh": "uadri",
        "broken.msh": "holds no cells|cannot read",
        "broken.xdmf": "not XDMF",
        "mesh.stl": "ends in .msh",
    }
    for name, message in cases.items():
        with pytest.raises(InputError, match=message) as caught:
            solve(Scene(mesh={"file": str(folder / name)}, tension=1))
        assert name in str(caught.value)


def test_xdmf_with_numbered_tags(folder):
    """XDMF has no names: the numbers of its tags serve."""
    from dolfinx import io
    from dolfinx import mesh as dmesh

    square = dmesh.create_unit_square(COMM, 6, 6)
    square.topology.create_connectivity(1, 2)
    left = dmesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[0], 0))
    tags = dmesh.meshtags(square, 1, np.sort(left), np.full(len(left), 3, np.int32))
    tags.name = "sides"
    with io.XDMFFile(COMM, str(folder / "square.xdmf"), "w") as file:
        file.write_mesh(square)
        if releases.VERSION >= (0, 7):
            file.write_meshtags(tags, square.geometry)
        else:
            file.write_meshtags(tags)
    boundary = [{"on": "3", "value": 0}, {"where": "x == 1", "value": 1}]
    scene = Scene(mesh={"file": str(folder / "square.xdmf")}, tension=1, boundary=boundary, exact="x")
    assert solve(scene).record["errors"]["max"] < 1e-9


def test_own_mesh():
    """A DOLFINx mesh of the caller's own; cells other than simplices are refused."""
    from dolfinx import mesh as dmesh

    answer = solve(Scene(mesh=dmesh.create_unit_square(COMM, 5, 5), tension=1, load=1))
    assert answer.record["cells_total"] == 50
    with pytest.raises(InputError, match="quadrilateral cells"):
        solve(Scene(mesh=dmesh.create_unit_square(COMM, 3, 3, cell_type=dmesh.CellType.quadrilateral), tension=1))


@pytest.mark.parametrize("name", ["rectangle", "box"])
def test_a_shape_begins_coarse_and_ends_with_its_own_grid(name):
    """Halving edges leads to the grid asked for: its vertices, and edges along its own diagonal only."""
    shape = {"rectangle": {"shape": "rectangle", "cells": 32}, "box": {"shape": "box", "cells": 16}}[name]
    level = build(shape)
    assert level.coarse is not None
    assert level.dofs == (shape["cells"] + 1) ** level.mesh.topology.dim
    corners = level.mesh.geometry.x[releases.geometry_dofs(level.mesh)]
    edges = np.concatenate([corners[:, i] - corners[:, j] for i in range(corners.shape[1]) for j in range(i)])
    steps = np.round(edges / level.h).astype(int)
    assert np.abs(steps).max(initial=1) == 1
    # all in the directions of (1, 1, 1), none across
    assert not np.any((steps.min(axis=1, initial=0) < 0) & (steps.max(axis=1, initial=0) > 0))
