"""Meshes from Gmsh: every file that a user can save is solved, or rejected with a reason."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from fenicsx_obstacle import InputError, Scene, solve, study
from fenicsx_obstacle.mesh import meshing
from fenicsx_obstacle.mesh.cells import corners, own_cells, volumes
from fenicsx_obstacle.mesh.files import content_of
from fenicsx_obstacle.parallel import on_root, total
from fenicsx_obstacle.scenes.meshes import build
from tests.conftest import COMM, slow_except
from tests.helpers import grid, mesh_of

FORMATS = [(2.2, 0, 0), (2.2, 1, 1), (4.1, 1, 0), (4.1, 0, 1)]  # version, binary, also what is in no group
GROUPED = [*((kind, *one) for kind in ("names", "nothing") for one in FORMATS),
           *((kind, *one) for kind in ("curves", "cells", "numbers") for one in FORMATS[::3])]  # fmt: skip


def saved(path, draw, version=4.1, binary=0, everything=1, order=1, dim=None):
    """Draw a model in Gmsh, mesh it and save it (one rank)."""
    import gmsh

    gmsh.initialize([], False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
        draw(gmsh.model)
        gmsh.model.mesh.generate(gmsh.model.getDimension() if dim is None else dim)
        gmsh.model.mesh.setOrder(order)
        for name, value in (("MshFileVersion", version), ("Binary", binary), ("SaveAll", everything)):
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def disk_of_arcs(model):
    """The unit disk of four arcs, whose common centre is a node that no cell has."""
    geo = model.geo
    centre, *rim = (geo.addPoint(x, y, 0) for x, y in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)))
    arcs = [geo.addCircleArc(rim[i], centre, rim[(i + 1) % 4]) for i in range(4)]
    geo.addPlaneSurface([geo.addCurveLoop(arcs)])
    geo.synchronize()


def square(model):
    model.occ.addRectangle(0, 0, 0, 1, 1)
    model.occ.synchronize()


def file_of(folder, draw, name="mesh.msh", **how):
    on_root(COMM, lambda: saved(folder / name, draw, **how))
    return folder / name


def level_of(path, **mesh):
    return build(Scene(mesh={"file": str(path), **mesh}, tension=1), COMM)


def size_of(level):
    """The sum of the volumes of all cells."""
    return total(COMM, volumes(corners(level.mesh)[: own_cells(level.mesh)]))


def facets(level, name=None):
    """Number of facets of a part, or on the whole boundary; each counts on its owner."""
    own = level.mesh.topology.index_map(level.mesh.topology.dim - 1).size_local
    found = level.boundary_facets if name is None else level.facets[name]
    return total(COMM, np.count_nonzero(found < own))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "version", "binary", "everything"), slow_except(GROUPED, *GROUPED[:4:3]))
def test_physical_groups(folder, kind, version, binary, everything):
    """No groups, as Gmsh's first export, groups of curves or cells only, with one number in several dimensions, with
    names: all cells are the mesh, and all sides the boundary."""

    def draw(model):
        disk_of_arcs(model)
        if kind not in ("cells", "nothing"):
            model.addPhysicalGroup(1, [1, 2], 5)
        if kind not in ("curves", "nothing"):
            model.addPhysicalGroup(2, [1], 5)
        if kind == "numbers":
            model.addPhysicalGroup(0, [2, 3], 5)
        if kind == "names":
            model.setPhysicalName(1, 5, "half")
            model.setPhysicalName(2, 5, "body")

    path = file_of(folder, draw, version=version, binary=binary, everything=everything)
    level = level_of(path)
    if kind == "nothing" or (version == 2.2 and everything):  # Gmsh leaves the groups out then
        assert level.facets == level.groups == {} and level.remarks == ()
        answer = solve(Scene(mesh={"file": str(path)}, tension=1, boundary=[{"value": "x - 2*y"}], exact="x - 2*y"))
        assert answer.record["errors"]["max"] < 1e-9
        assert answer.record["dofs"] - answer.record["free"] == facets(answer.level)
        return
    if kind == "curves" and not everything:  # the file holds the curves alone
        assert level.mesh.topology.dim == 1
        return
    curve, body = ("half", "body") if kind == "names" else ("5", "5")
    assert set(level.facets) == ({curve} if kind != "cells" else set())
    assert set(level.groups) == ({body} if kind != "curves" else set())
    if kind != "cells":
        assert 2 * facets(level, curve) == facets(level)
    if kind != "curves":
        assert total(COMM, len(level.groups[body])) == level.cells


def two_squares(model):
    occ = model.occ
    occ.addRectangle(0, 0, 0, 1, 1)
    occ.addRectangle(1, 0, 0, 1, 1)
    occ.fragment([(2, 1)], [(2, 2)])
    occ.synchronize()


@pytest.mark.slow
def test_cells_that_are_in_no_group(folder):
    """With groups of cells the others are not part of the mesh, as in what Gmsh saves itself; that is said."""

    def draw(model):
        two_squares(model)
        model.setPhysicalName(2, model.addPhysicalGroup(2, [1]), "steel")

    level = level_of(file_of(folder, draw))
    assert set(level.groups) == {"steel"} and total(COMM, len(level.groups["steel"])) == level.cells
    (remark,) = level.remarks
    assert remark.startswith("1 surface in no physical group, such as 2:") and remark.endswith("not part of the mesh")


@pytest.mark.slow
def test_a_group_that_holds_nothing(folder):
    """A group without a mesh is no fault as long as nothing is on it."""

    def draw(model):
        two_squares(model)
        model.setPhysicalName(1, model.addPhysicalGroup(1, [4]), "side")
        point = model.occ.addPoint(5, 5, 0)
        lone = model.occ.addLine(point, model.occ.addPoint(6, 5, 0))
        model.occ.synchronize()
        model.setPhysicalName(1, model.addPhysicalGroup(1, [lone]), "lone")
        model.mesh.setTransfiniteCurve(lone, 2)
        model.mesh.generate(2)
        model.mesh.clear([(1, lone)])

    scene = Scene(mesh={"file": str(file_of(folder, draw, dim=0))}, tension=1, load=1)
    assert solve(scene).level.remarks == ("the physical group 'lone' holds no mesh",)
    with pytest.raises(InputError, match="on = 'lone': no facet of the mesh lies on it"):
        solve(scene.change({"boundary": [{"on": "lone", "value": 0}]}))


def test_what_is_no_mesh_of_one_kind(folder):
    """Triangles beside quadrilaterals are rejected on all ranks; other wrong files are in tests/cli/broken."""

    def mixed(model):
        two_squares(model)
        model.mesh.setRecombine(2, 2)

    with pytest.raises(InputError, match=r"mesh\.msh: .*uadri"):
        level_of(file_of(folder, mixed))


def of_cubes(dim):
    """A square or cube of 3 cells a side; its first side, and the whole, are groups without names."""

    def draw(model):
        geo = model.geo
        line = geo.addLine(geo.addPoint(0, 0, 0), geo.addPoint(1, 0, 0))
        geo.mesh.setTransfiniteCurve(line, 4)
        found = geo.extrude([(1, line)], 0, 1, 0, [3], recombine=True)
        side = line
        if dim == 3:
            side = found[1][1]
            found = geo.extrude([found[1]], 0, 0, 1, [3], recombine=True)
        geo.synchronize()
        model.addPhysicalGroup(dim - 1, [side], 5)
        model.addPhysicalGroup(dim, [found[1][1]], 8)

    return draw


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dim", "order", "element"),
    slow_except([(2, 1, "Q1"), (2, 2, "Q2"), (3, 1, "Q1"), (3, 2, "Q1"), (3, 1, "Q2")], (2, 1, "Q1")),
)
def test_quadrilaterals_and_hexahedra(folder, dim, order, element):
    """A linear u is exact on the cells of files, of degree 2 by their vertices; groups have their numbers."""
    path, u = file_of(folder, of_cubes(dim), order=order, everything=0), "x - 2*y + 3"
    scene = Scene(mesh={"file": str(path)}, tension=1, boundary=[{"on": "5", "value": u}, {"value": u}], exact=u,
                  report={"size": "integral(1)", "side": "integral(1, '5')", "group": "integral(1, '8')"})  # fmt: skip
    answer = solve(scene, **({} if element == "Q1" else {"element": element}))  # Q1 is the default
    assert answer.record["errors"]["max"] < 1e-9 and answer.record["cells_total"] == 3**dim
    assert answer.record["element"] == element
    assert np.allclose(list(answer.report.values()), 1, rtol=1e-12)
    assert any("degree 2" in remark for remark in answer.level.remarks) == (order == 2)
    with pytest.raises(InputError, match="refine is for simplices; take smaller cells in the file"):
        solve(scene, element=element, refine=1)


def cap(model):
    """The part of the unit sphere below z = sin(0.3), without its lid."""
    occ = model.occ
    ball = occ.addSphere(0, 0, 0, 1, -1, -np.pi / 2, 0.3)
    occ.synchronize()
    sphere = next(tag for _, tag in model.getEntities(2) if model.getType(2, tag) == "Sphere")
    occ.remove([(3, ball)])
    occ.remove([(2, tag) for _, tag in model.getEntities(2) if tag != sphere], recursive=True)
    occ.synchronize()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["step", "geo"])
def test_a_surface_in_space_stays_one(folder, suffix):
    """On surfaces in space new vertices lie on them, and at the rim on its circle: the area has order 2."""
    path = file_of(folder, cap, "cap.step")
    if suffix == "geo":
        on_root(COMM, (folder / "cap.geo").write_text, 'SetFactory("OpenCASCADE"); Merge "cap.step";')
    exact = 2 * np.pi * (1 + np.sin(0.3))
    levels = [level_of(path.with_suffix(f".{suffix}"), refine=n) for n in (0, 1, 2)]
    errors = [exact - size_of(level) for level in levels]
    assert np.log2(errors[1] / errors[2]) > 1.9
    x = levels[2].mesh.geometry.x
    assert np.allclose(np.linalg.norm(x, axis=1), 1, atol=1e-9)
    rim = fem.locate_dofs_topological(levels[2].V, 1, levels[2].boundary_facets)
    assert np.allclose(levels[2].points[2, rim], np.sin(0.3), atol=1e-9)


def plate(model):
    """A square with a round hole."""
    occ = model.occ
    square, hole = occ.addRectangle(0, 0, 0, 2, 2), occ.addDisk(1, 1, 0, 0.5, 0.5)
    occ.cut([(2, square)], [(2, hole)])
    occ.synchronize()


@pytest.mark.slow
def test_step(folder):
    """A STEP file is meshed by Gmsh; its curves have their numbers as names, and keep their shape when refined."""
    file_of(folder, plate, "plate.step")
    level = level_of(folder / "plate.step", refine=2)
    assert set(level.facets) == {"1", "2", "3", "4", "5"}
    (hole,) = [name for name in level.facets if facets(level, name) % 48 == 0]
    nodes = fem.locate_dofs_topological(level.V, 1, level.facets[hole])
    assert np.allclose(np.hypot(*(level.points[:2, nodes] - 1)), 0.5, atol=1e-9)
    assert np.isclose(size_of(level), 4 - 6 * np.sin(2 * np.pi / 48), rtol=1e-9)  # around a polygon with 48 equal sides
    with pytest.raises(InputError, match=r"no part named 'rim' .known: 1, 2, 3, 4, 5."):
        solve(Scene(mesh={"file": str(folder / "plate.step")}, tension=1, boundary=[{"on": "rim", "value": 0}]))


@pytest.mark.serial
def test_names_of_bodies(tmp_path):
    """Bodies and sides have the names of the CAD file; bodies of one name are one material."""
    from fenicsx_obstacle.mesh.gmsh_model import name_bodies

    def bodies(model):
        for k, name in enumerate(("Shapes/steel", "Shapes/Open CASCADE STEP translator 7.6 1", "Shapes/steel")):
            model.setEntityName(2, model.occ.addRectangle(2 * k, 0, 0, 1, 1), name)
        model.occ.synchronize()
        name_bodies(model)

    saved(tmp_path / "bodies.msh", bodies)
    level = build(Scene(mesh={"file": str(tmp_path / "bodies.msh")}, tension=1), MPI.COMM_SELF)
    areas = {name: volumes(corners(level.mesh)[cells]).sum() for name, cells in level.groups.items()}
    assert areas == pytest.approx({"steel": 2, "2": 1}) and len(level.facets) == 12


def test_nodes_with_gaps_and_without_cells(folder):
    """Node numbers may have gaps, and nodes no cell."""
    text = """$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n6\n7 0 0 0\n11 1 0 0\n500 1 1 0\n90 0 1 0\n3 9 9 9
1000000 -5 2 0\n$EndNodes\n$Elements\n3\n4 2 2 0 1 7 11 500\n9 2 2 0 1 7 500 90\n12 1 2 8 3 7 11\n$EndElements\n"""
    on_root(COMM, (folder / "gaps.msh").write_text, text)
    level = level_of(folder / "gaps.msh")
    assert level.dofs == 4 and level.cells == 2 and level.mesh.geometry.dim == 2
    assert set(level.facets) == {"8"} and facets(level, "8") == 1


BOXES = {
    "partly": ([(0, 0, 0, 1, 1, 1), (1, 0.25, 0.25, 1, 0.5, 0.5)], True),
    "three": ([(0, 0, 0, 1, 1, 1), (1, 0, 0, 1, 1, 1), (0, 1, 0, 2, 1, 1)], True),
    "apart": ([(0, 0, 0, 1, 1, 1), (2, 0, 0, 1, 1, 1)], False),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BOXES)
def test_bodies_of_a_step_file_that_touch_share_nodes(folder, name):
    boxes, common = BOXES[name]

    def assembly(model):
        for box in boxes:
            model.occ.addBox(*box)
        model.occ.synchronize()

    level = level_of(file_of(folder, assembly, "assembly.step"))
    assert level.connected.count == (1 if common else 2)
    assert set(level.groups) == {str(number + 1) for number in range(len(boxes))}
    assert np.isclose(size_of(level), sum(np.prod(box[3:]) for box in boxes), rtol=1e-9)
    if not common:
        assert set(level.facets) == {str(number) for number in range(1, 13)}  # as they are in the file


def test_bodies_of_a_step_file_that_overlap(folder):
    def assembly(model):
        model.occ.addRectangle(0, 0, 0, 1, 1)
        model.occ.addRectangle(0.5, 0.25, 0, 1, 0.5)
        model.occ.synchronize()

    with pytest.raises(InputError, match=r"surfaces 1 and 2 overlap at \(0.75, 0.5, .*BooleanDifference"):
        level_of(file_of(folder, assembly, "overlap.step"))


def test_groups_of_cells_and_of_curves_with_one_number(folder):
    """normal_flux and jump are of curves only; of other quantities the message names a way out."""

    def square(model):
        two_squares(model)
        outer = [tag for _, tag in model.getBoundary(model.getEntities(2), combined=True, oriented=False)]
        model.removePhysicalGroups()
        model.addPhysicalGroup(1, outer, 1)
        for tag in (1, 2):
            model.addPhysicalGroup(2, [tag], tag)

    path = file_of(folder, square)
    scene = Scene(mesh={"file": str(path)}, tension={"1": 1, "2": 5}, load={"1": -3, "2": -6}, lower=-0.02,
                  boundary=[{"on": "1", "value": 0}],
                  report={"force": "integral(p)", "reaction": 'integral(normal_flux, "1")',
                          "load": "9"})  # fmt: skip
    report = solve(scene).report
    # what the edge takes, the contact force and the load balance
    assert np.isclose(-report["reaction"], report["force"] - report["load"], rtol=1e-6)
    for wrong in ('integral(u, "1")', 'integral(2*u + p, "1")'):
        with pytest.raises(InputError, match=r"'1' is the name of cells and of facets.*Physical Curve"):
            solve(scene.change({"report.force": wrong}))


SQUARE = """Point(1) = {0, 0, 0, 0.5}; Point(2) = {1, 0, 0, 0.5}; Point(3) = {1, 1, HEIGHT, 0.5};
Point(4) = {0, 1, 0, 0.5}; Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Line Loop(1) = {1, 2, 3, 4};
"""
OCC = 'SetFactory("OpenCASCADE"); Mesh.MeshSizeMax = 0.5;\n'
UNIT = OCC + "Rectangle(1) = {0, 0, 0, 1, 1};\n"
STRAIGHT = {  # whether all curves are lines, and all surfaces planes
    "rectangle": (UNIT, True),
    "disk": (OCC + "Disk(1) = {0, 0, 0, 1};", False),
    "of points": (SQUARE.replace("HEIGHT", "0") + "Plane Surface(1) = {1};", True),
    "twisted": (SQUARE.replace("HEIGHT", "0.3") + "Surface(1) = {1};", False),
    "box": (OCC + "Box(1) = {0, 0, 0, 1, 1, 1};", True),
    "two lines meshed as one": (
        SQUARE.replace("HEIGHT", "0") + "Plane Surface(1) = {1}; Compound Line {1, 2};", False),
    "a wire": ("Point(1) = {0, 0, 0, 0.3}; Point(2) = {1, 0, 0, 0.3}; Line(1) = {1, 2};", True),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(STRAIGHT, *list(STRAIGHT)[:4]))
def test_straight_boundaries_are_known_from_the_geometry(folder, name):
    """Only where all CAD curves are lines, and surfaces planes, is the domain the polygon of its mesh, refined or not:
    ruled surfaces, as of extruded curves, and compounds may be anything."""
    text, expected = STRAIGHT[name]
    on_root(COMM, (folder / "shape.geo").write_text, text + "\n")
    level = level_of(folder / "shape.geo")
    assert level.straight is expected and level.polygonal is expected
    if level.mesh.topology.dim == 2:
        assert level_of(folder / "shape.geo", refine=1).polygonal is expected


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".geo", ".GEO"])
def test_a_mesh_is_of_the_files_as_they_are(folder, suffix):
    """A .geo may read other files: when these change the mesh does, and its content; the text of the .geo stays."""
    file = folder / f"shape{suffix}"
    on_root(COMM, file.write_text, f'{UNIT}Include "side.txt";\n')

    def found(size):
        on_root(COMM, (folder / "side.txt").write_text, f"Mesh.MeshSizeMax = {size};\n")
        return level_of(file).dofs, on_root(COMM, content_of, file)

    coarse, fine, again = found(0.5), found(0.05), found(0.5)
    assert fine[0] > 2 * coarse[0] and fine[1] != coarse[1] and again == coarse
    assert on_root(COMM, lambda: {one.name for one in folder.iterdir()}) == {file.name, "side.txt"}


@pytest.mark.slow
def test_the_geometry_is_part_of_the_content(folder):
    """Two ellipses with the same vertices: the refined meshes differ."""
    found = []
    for middle in (1.0, 1.2):
        text = f"""Point(1) = {{0, 0, 0, 9}}; Point(2) = {{1, 0, 0, 9}}; Point(3) = {{.5, {middle}, 0, 9}};
            Line(1) = {{1, 2}}; Bezier(2) = {{2, 3, 1}}; Transfinite Curve {{1, 2}} = 3; Curve Loop(1) = {{1, 2}};
            Plane Surface(1) = {{1}};"""
        on_root(COMM, (folder / "a.geo").write_text, text)
        found.append(on_root(COMM, content_of, folder / "a.geo"))
    assert found[0] != found[1]


@pytest.mark.slow
def test_a_study_reads_a_mesh_once(folder, monkeypatch):
    """The rows of a study are of one mesh, even if its file changes meanwhile."""
    runs, run = [], meshing.subprocess.run
    monkeypatch.setattr(meshing.subprocess, "run", lambda *given, **more: runs.append(given) or run(*given, **more))
    on_root(COMM, (folder / "a.geo").write_text, UNIT)
    scene = Scene(mesh={"file": str(folder / "a.geo")}, tension=1, load=-1, lower=-0.05)
    rows = study(scene, {"refine": [0, 1, 2]})
    assert len(rows) == 3 and COMM.bcast(len(runs)) == 1
    solve(scene)
    assert COMM.bcast(len(runs)) == 2


PROGRAMS = {
    "a command": "SystemCall 'touch {}';",
    "a process of a field": "Field[1] = ExternalProcess; Field[1].CommandLine = 'touch {}'; Background Field = 1;",
    "a picture": "Mesh 2; Print '{}.msh';",
    "a line": "Printf('text') > '{}';",
    "a folder": "CreateDir '{}';",
    "a file that is read": "Include 'part.txt';",
}


@pytest.mark.parametrize(("what", "suffix"), [*((what, ".geo") for what in PROGRAMS), ("a command", ".msh")])
def test_a_mesh_file_starts_no_program_and_writes_no_file(folder, what, suffix):
    """One message, and nothing has happened. What ends in .msh and is none is not read at all."""
    target = folder / "target"

    on_root(COMM, (folder / "part.txt").write_text, f"SystemCall 'touch {target}';\n")
    on_root(COMM, (folder / f"a{suffix}").write_text, UNIT + PROGRAMS[what].format(target) + "\n")
    before = on_root(COMM, lambda: sorted(folder.iterdir()))
    wanted = "starts a program or writes a file" if suffix == ".geo" else r"begins with \$MeshFormat"
    with pytest.raises(InputError, match=wanted):
        level_of(folder / f"a{suffix}")
    assert on_root(COMM, lambda: sorted(folder.iterdir())) == before


@pytest.mark.parametrize("suffix", [".geo", ".msh", ".step"])
def test_options_beside_a_mesh_are_not_taken(folder, suffix):
    if suffix == ".geo":
        on_root(COMM, (folder / "a.geo").write_text, UNIT)
    else:
        file_of(folder, square, f"a{suffix}")
    level_of(folder / f"a{suffix}")
    on_root(COMM, (folder / f"a{suffix}.opt").write_text, "Mesh.MeshSizeMax = 0.1;\n")
    with pytest.raises(InputError, match=rf"a\{suffix}\.opt: options beside a mesh file"):
        level_of(folder / f"a{suffix}")


def test_without_confinement_no_geo_is_read(folder, monkeypatch, capsys):
    """Where the kernel cannot do it, a .geo is not run; a .msh is read."""
    monkeypatch.setattr(meshing, "confine", lambda: False)
    if COMM.rank == 0:
        (folder / "a.geo").write_text(UNIT)
        saved(folder / "a.msh", square)
        assert meshing._run(str(folder / "a.geo"), str(folder / "1.npz")) == 2
        assert "libseccomp2" in capsys.readouterr().out
        assert meshing._run(str(folder / "a.msh"), str(folder / "2.npz")) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("text", "whole", "part"), [
    ("Box(1) = {0, 0, 0, 1, 1, 1}; Physical Surface('top') = {6};", "volume", "surface"),
    ("Rectangle(1) = {0, 0, 0, 1, 1}; Physical Curve('rim') = {1};", "surface", "curve"),
])  # fmt: skip
def test_a_geo_without_a_group_of_cells(folder, text, whole, part):
    """The mesh is all of it, with a remark, since others take the groups alone; with a group there is no remark."""
    lines = [OCC + text.replace("'", '"'), f"Physical {whole.capitalize()}(9) = {{1}};"]
    on_root(COMM, (folder / "some.geo").write_text, lines[0] + "\n")
    on_root(COMM, (folder / "all.geo").write_text, "\n".join(lines) + "\n")
    level = level_of(folder / "some.geo")
    (remark,) = level.remarks
    assert remark.startswith(f"no {whole} is in a physical group: all {whole}s are the mesh.")
    assert f"only the {part}s in groups" in remark and remark.endswith(f"add a Physical {whole.capitalize()}")
    other = level_of(folder / "all.geo")
    assert other.remarks == () and other.cells == level.cells
    assert level.mesh.topology.dim == (3 if whole == "volume" else 2)


def test_a_mesh_says_nothing_of_its_geometry(folder):
    """Of a .msh, and of the caller's own mesh, it is unknown whether the domain is the polygon."""
    assert level_of(file_of(folder, square)).polygonal is False
    assert build(Scene(mesh=mesh_of(*grid(2, 2)), tension=1), COMM).polygonal is False
