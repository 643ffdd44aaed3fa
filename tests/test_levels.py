"""Meshes: shapes, refinement, files; the same on any number of ranks."""

import msgspec
import numpy as np
import pytest
import ufl
from dolfinx import fem

from fenicsx_obstacle import InputError, Scene, releases, solve
from fenicsx_obstacle.mesh import levels
from fenicsx_obstacle.mesh.shapes import SHAPES
from fenicsx_obstacle.mesh.transfer import downward, ends_of
from fenicsx_obstacle.parallel import gathered, on_root, total
from fenicsx_obstacle.scenes import meshes
from fenicsx_obstacle.scenes.tables import MeshTable
from tests.conftest import COMM, DEMOS, slow_except

MESHES = {
    "interval": ({"shape": "interval", "cells": 9}, 1.0),
    "rectangle": ({"shape": "rectangle", "x": [0, 2], "cells": 6}, 2.0),
    "crossed": ({"shape": "rectangle", "cells": 4, "diagonal": "crossed"}, 1.0),
    "union-jack": ({"shape": "rectangle", "cells": 4, "diagonal": "union-jack"}, 1.0),
    "box": ({"shape": "box", "cells": 3}, 1.0),
    "l-shape": ({"shape": "l-shape", "x": [-1, 1], "y": [-1, 1], "cells": 6}, 3.0),
}


def measure(level, integral=ufl.dx):
    constant = fem.Constant(level.mesh, 1.0)
    return total(COMM, fem.assemble_scalar(releases.form(constant * integral(domain=level.mesh))))


def build(mesh):
    return meshes.build(Scene(mesh=mesh, tension=1), COMM)


@pytest.mark.parametrize("name", MESHES)
def test_area_and_boundary_survive_refinement(name):
    mesh, area = MESHES[name]
    level = build({**mesh, "refine": 1})
    assert abs(measure(level) - area) < 1e-12
    assert level.cells == level.coarse.cells * 2**level.mesh.topology.dim
    assert np.isclose(level.h, level.coarse.h / 2)
    owned = level.mesh.topology.index_map(level.mesh.topology.dim - 1).size_local
    named = np.unique(np.concatenate(list(level.facets.values())))
    assert np.array_equal(named[named < owned], np.sort(level.boundary_facets[level.boundary_facets < owned]))
    assert np.isclose(measure(level, ufl.ds), measure(level.coarse, ufl.ds))


@pytest.mark.parametrize("name", MESHES)
def test_fine_dofs_are_means_of_coarse_dofs(name):
    """A linear function is the same on both levels; a condition holds where it does at both ends of the edge."""
    level = build({**MESHES[name][0], "refine": 2})
    for fine in level.on_meshes.downward[:2]:
        linear = [f.tabulate_dof_coordinates() @ [1.0, 2.0, 3.0] for f in (fine.coarse.V, fine.V)]
        assert np.allclose(linear[0][ends_of(fine)].mean(axis=1), linear[1][: fine.owned])
        below = linear[0] < 1.2345
        both = next(downward(fine)).all_of(below[: fine.coarse.owned])
        assert np.array_equal(both, below[ends_of(fine)].all(axis=1)[: fine.owned])


@pytest.mark.parametrize("shape", ["interval", "rectangle", "disk"])
def test_grids_between_are_those_of_meshes(shape):
    """Halved several times at once, a mesh has the points, parts and coarse matrices of meshes halved one by one.

    P^T A P is the stiffness on the mesh between; on a disk, whose new boundary points leave their edges, nearly.
    """
    at_once = build({"shape": shape, "cells": 4, "refine": 3})
    between, names = at_once.on_meshes, at_once.facets
    assert len(at_once.grids) == 2 and not between.grids and len(between.downward) == 4
    one_by_one = between.downward[-1]
    for _ in range(3):
        one_by_one = levels.refined(one_by_one)
    for level in (between, one_by_one):
        assert level.h == at_once.h and np.isclose(level.h_max, at_once.h_max)
        assert {name: total(COMM, len(some)) for name, some in level.facets.items()} == {
            name: total(COMM, len(some)) for name, some in names.items()
        }
        assert np.isclose(measure(level), measure(at_once), rtol=1e-14)
    places = [gathered(COMM, level.points.T[: level.owned]) for level in (at_once, one_by_one)]
    if COMM.rank == 0:
        here, there = ({tuple(row) for row in np.round(one, 12) + 0.0} for one in places)
        assert here == there and len(here) == len(places[0])
    fine, transfers = stiffness(at_once), list(downward(at_once))
    coarse = [stiffness(level) for level in between.downward[1:]]
    assert len(transfers) == 3
    for transfer, A in zip(transfers, coarse, strict=True):
        fine = fine.ptap(transfer.P)
        assert np.isclose(fine.norm(), A.norm(), rtol=0.05 if shape == "disk" else 1e-12)
        ones = transfer.interpolate(np.ones(transfer.P.getLocalSize()[1]))
        assert np.array_equal(ones, np.ones(len(ones)))
        x = np.random.default_rng(COMM.rank).random(transfer.P.getLocalSize()[1])
        assert np.array_equal(transfer.inject(transfer.interpolate(x)), x)


def stiffness(level):
    u, v = ufl.TrialFunction(level.V), ufl.TestFunction(level.V)
    A = fem.petsc.assemble_matrix(releases.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx))
    A.assemble()
    return A


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_xdmf_with_numbered_tags(cell, folder):
    """A file of DOLFINx. XDMF has no names: the numbers of its tags serve."""
    from dolfinx import io
    from dolfinx import mesh as dmesh

    square = dmesh.create_unit_square(COMM, 6, 6, getattr(dmesh.CellType, cell))
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


GEO = """
SetFactory("OpenCASCADE");
Rectangle(1) = {0, 0, 0, 0.5, 1};
Rectangle(2) = {0.5, 0, 0, 0.5, 1};
BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; }
MeshSize{ PointsOf{ Surface{:}; } } = 0.15;
middle() = Curve In BoundingBox {0.49, -1, -1, 0.51, 2, 1};
left() = Curve In BoundingBox {-0.01, -1, -1, 0.01, 2, 1};
right() = Curve In BoundingBox {0.99, -1, -1, 1.01, 2, 1};
Physical Curve("middle") = {middle()};
Physical Curve("left") = {left()};
Physical Curve("right") = {right()};
Physical Surface("steel") = {1};
Physical Surface("rubber") = {2};
"""


@pytest.fixture
def halves(folder):
    """Two materials with an interior curve between them."""
    on_root(COMM, lambda: (folder / "halves.geo").write_text(GEO))
    ends = [{"on": "left", "value": 0}, {"on": "right", "value": 1}]
    return lambda **given: Scene(**{"mesh": {"file": str(folder / "halves.geo")}, "boundary": ends, **given})


@pytest.mark.slow
@pytest.mark.parametrize("refine", slow_except([0, 1, 2], 1))
def test_materials(halves, refine):
    """Two springs in a row: the same force in both, u linear in each; refined cells keep their material."""
    scene = halves(
        tension={"steel": 2, "rubber": "x/x"}, exact="where(x < 1/2, 2/3*x, 1/3 + 4/3*(x - 1/2))",
        report={"force": "integral(flux, 'middle')", "half": "integral(1, 'steel')", "soft": "integral(u, 'rubber')",
                "most": "sup(flux)", "least": "inf(flux)", "middle": "at(u, 1/2, 0.3)"},
    )  # fmt: skip
    answer = solve(scene.change({"mesh.refine": refine}))
    expected = {"force": 4 / 3, "half": 0.5, "soft": 1 / 3, "most": 4 / 3, "least": 4 / 3, "middle": 1 / 3}
    for name, value in expected.items():
        assert np.isclose(answer.report[name], value, rtol=1e-8), name
    assert answer.record["errors"]["max"] < 1e-9
    assert answer.record["errors"]["energy"] < 1e-8


@pytest.mark.slow
def test_mistakes_in_materials(halves):
    cases = [
        ({"steal": 1, "rubber": 1}, "tension: no material named 'steal'; did you mean 'steel'"),
        ({"steel": 1}, "tension = {steel = 1}: no value for the material 'rubber'"),
        ({"steel": 1, "rubber": "-x"}, "must be positive; it is -"),
        ({"steel": 1, "rubber": "q"}, r"tension.rubber: unknown name 'q'"),
        ({"steel": 1, "rubber": [1]}, r"tension.rubber = \[1\]: expected a number or a formula"),
        ({}, "expected a number, a formula or {material = value}"),
    ]
    for tension, message in cases:
        with pytest.raises(InputError, match=message) as caught:
            solve(halves(tension=tension))
        assert len(set(COMM.allgather(str(caught.value)))) == 1
    with pytest.raises(InputError, match="no material named 'steel'; the mesh has no named groups of cells"):
        solve(Scene(mesh={"shape": "interval"}, tension={"steel": 1}))


@pytest.mark.slow
def test_curve_that_is_not_in_the_mesh(folder):
    """A curve beside the surface, and an entity in two groups, are refused with a reason."""
    loose = GEO + "Point(90) = {0.1, 0.2, 0}; Point(91) = {0.3, 0.2, 0}; Line(99) = {90, 91};\n"
    loose += 'Physical Curve("loose") = {99};'
    on_root(COMM, (folder / "loose.geo").write_text, loose)
    on_root(COMM, (folder / "doubled.geo").write_text, GEO + 'Physical Surface("all") = {1, 2};')
    scene = Scene(mesh={"file": str(folder / "loose.geo")}, tension=1, boundary=[{"on": "loose", "value": 0}])
    with pytest.raises(InputError, match="'loose' is not on the mesh; a part inside must be embedded"):
        solve(scene)
    with pytest.raises(InputError, match="surface 1 is in the physical groups 'steel' and 'all'"):
        solve(scene.change({"mesh.file": str(folder / "doubled.geo")}))


@pytest.mark.slow
@pytest.mark.parametrize("refine", slow_except([0, 1], 0))
def test_cylinder_surface_is_periodic(refine):
    """No seam at theta = pi: u = z and u = cos(theta) are found up to the polygon, whose triangles lean a little."""
    mesh = {"file": str(DEMOS / "bearing.geo"), "refine": refine}
    report = {"area": "integral(1)", "groove": "integral(1, 'groove')", "rim": "integral(1, 'ends')",
              "seam": "at(u, -1, 0, 0.25)", "off": "at(u, cos(1), sin(1), 0.25)"}  # fmt: skip
    answer = solve(Scene(mesh=mesh, tension=1, boundary=[{"on": "ends", "value": "z"}], exact="z", report=report))
    assert answer.record["errors"]["max"] < 2e-4
    assert np.isclose(answer.report["area"], 4 * np.pi, rtol=3e-3)
    assert np.isclose(answer.report["groove"], 2)
    assert np.isclose(answer.report["rim"], 4 * np.pi, rtol=3e-3)
    assert np.isclose(answer.report["seam"], 0.25, atol=2e-4)
    assert np.isclose(answer.report["off"], 0.25, atol=2e-4)
    wave = solve(Scene(mesh=mesh, tension=1, load="cos(theta)", exact="cos(theta)",
                       boundary=[{"on": "ends", "value": "cos(theta)"}]))  # fmt: skip
    assert wave.record["errors"]["max"] < 0.01


@pytest.mark.parametrize(("name", "cells"), [("rectangle", 32), ("box", 16)])
def test_a_shape_begins_coarse_and_ends_with_its_own_grid(name, cells):
    """Halving edges leads to the grid asked for: its vertices, and edges along its own diagonal only."""
    level = build({"shape": name, "cells": cells})
    assert level.coarse is not None
    assert level.dofs == (cells + 1) ** level.mesh.topology.dim
    corners = level.mesh.geometry.x[releases.geometry_dofs(level.mesh)]
    edges = np.concatenate([corners[:, i] - corners[:, j] for i in range(corners.shape[1]) for j in range(i)])
    steps = np.round(edges / level.h).astype(int)
    assert np.abs(steps).max(initial=1) == 1
    # all in the directions of (1, 1, 1), none across
    assert not np.any((steps.min(axis=1, initial=0) < 0) & (steps.max(axis=1, initial=0) > 0))


@pytest.mark.serial
def test_shapes_have_keys_of_the_mesh_table():
    """Each shape that scenes can name takes keys of [mesh], and is made of them."""
    keys = {field.name for field in msgspec.structs.fields(MeshTable)}
    for name, recipe in SHAPES.items():
        assert set(recipe.keys) <= keys - {"shape", "file", "cells", "refine"}
        shape = meshes.shape_of(Scene(mesh={"shape": name, "cells": 4}, tension=1, load=1, boundary=[{"value": 0}]))
        assert shape.cells[0] == 4 and len(shape.lower) == len(shape.cells)
