"""Scenes on the caller's own mesh: MeshTags, names, and data that are Functions, Constants, UFL or callables."""

from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from fenicsx_obstacle import Answer, InputError, Scene, releases, solve
from fenicsx_obstacle.mesh.cells import corners, facet_corners, sides
from fenicsx_obstacle.parallel import largest, smallest, total
from tests.conftest import COMM, membrane

STIFF = 3.0


class Own:
    """A unit square: sides left and right tagged 1 and 2, the line x = 1/2 3, cells left and right of it 5 and 6."""

    def __init__(self, cells=16, cell="triangle", ghosts=dmesh.GhostMode.shared_facet):
        kind = getattr(dmesh.CellType, cell)
        self.mesh = mesh = dmesh.create_unit_square(COMM, cells, cells, kind, ghost_mode=ghosts)
        mesh.topology.create_connectivity(1, 2)
        mesh.topology.create_entities(1)
        lines = [dmesh.locate_entities(mesh, 1, lambda x, at=at: np.isclose(x[0], at)) for at in (0, 1, 0.5)]
        facets, order = np.concatenate(lines), np.argsort(np.concatenate(lines))
        values = np.repeat([1, 2, 3], [len(line) for line in lines])[order]
        self.facet_tags = dmesh.meshtags(mesh, 1, facets[order].astype(np.int32), values.astype(np.int32))
        left = dmesh.locate_entities(mesh, 2, lambda x: x[0] <= 0.5 + 1e-12)
        local = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
        tags = np.full(local, 6, dtype=np.int32)
        tags[left] = 5
        self.cell_tags = dmesh.meshtags(mesh, 2, np.arange(local, dtype=np.int32), tags)
        W = releases.functionspace(mesh, "DG", 0)
        self.mu = fem.Function(W, name="mu")
        self.mu.x.array[releases.cell_dofs(W)[:, 0]] = np.where(tags == 5, 1.0, STIFF)

    def scene(self, **more):
        given = {
            "mesh": self.mesh, "facet_tags": self.facet_tags, "cell_tags": self.cell_tags, "tension": 1, "load": -8,
            "facet_names": {"rim": 1, "far": 2}, "cell_names": {"soft": 5, "hard": 6}, "lower": -0.2,
            "boundary": [{"on": "rim", "value": 0}],
        }  # fmt: skip
        return Scene(**{**given, **more})


def numbers(scene, **options):
    """Values that show whether two solutions are the same."""
    record = solve(scene, eps=1e-6, **options).record
    return [record["energy"], record["contact"]["area"], record["contact"]["lower"]["force"]]


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_the_same_by_names_and_by_functions(element):
    """A tension by materials, by a Function in cells, by UFL and by a formula; parts by names: the same figures."""
    own = Own()
    x = ufl.SpatialCoordinate(own.mesh)
    other = dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [5, 7])
    elsewhere = fem.Function(releases.functionspace(other, "Lagrange", 1))
    elsewhere.interpolate(lambda x: -8 + 0 * x[0])
    ways = [
        own.scene(tension={"soft": 1, "hard": STIFF}),
        own.scene(tension=own.mu, load=elsewhere),
        own.scene(tension={"soft": fem.Constant(own.mesh, PETSc.ScalarType(1.0)), "hard": lambda x: STIFF + 0 * x[0]}),
        own.scene(tension=ufl.conditional(ufl.lt(x[0], 0.5), 1.0, STIFF)),
        own.scene(tension=f"where(x < 1/2, 1, {STIFF})", load=lambda x: -8 + 0 * x[0], lower=lambda x: -0.2 + 0 * x[0]),
        membrane(tension=f"where(x < 1/2, 1, {STIFF})", load=-8, lower=-0.2, boundary=[{"on": "left", "value": 0}]),
    ]
    first, *others = (numbers(scene, element=element, start="cold") for scene in ways)
    for found in others:
        assert np.allclose(found, first, rtol=1e-9)


@pytest.mark.slow
def test_names_are_the_tags_by_default():
    own = Own(8)
    by_name = numbers(own.scene(tension={"soft": 1, "hard": 2}))
    for tension in ({"5": 1, "6": 2}, {5: 1, 6: 2}):
        by_number = own.scene(facet_names=None, cell_names=None, tension=tension, boundary=[{"on": "1", "value": 0}])
        assert np.allclose(numbers(by_number), by_name, rtol=1e-12)
    both = own.scene(facet_names={"sides": [1, 2]}, boundary=[{"on": "sides", "value": 0}])
    apart = own.scene(boundary=[{"on": ["rim", "far"], "value": 0}])
    assert np.allclose(numbers(both), numbers(apart), rtol=1e-12)


@pytest.mark.slow
def test_a_certified_tolerance():
    """A Function as tension, a formula as obstacle, named parts: 1 % on adaptive meshes, certified, for P1 and P2."""
    own = Own(8)
    scene = own.scene(tension=own.mu, lower="-0.2 - 0.1*x^2", boundary=[{"on": ["rim", "far"], "value": 0}])
    for element, tolerance in (("P1", 0.05), ("P2", 0.01)):
        answer = solve(scene, tol=tolerance, element=element)
        bound = answer.record["bound"]
        assert bound["words"] == "certified on the polygon of the mesh" and bound["relative"] <= tolerance
        assert answer.record["cells_total"] > 128
    # what is no polynomial of the mesh stays sampled
    curved = own.scene(tension=own.mu, lower=lambda x: -0.2 - 0.1 * np.sin(x[0]))
    assert solve(curved, bound=True).record["bound"]["words"].endswith("for the sampled obstacle")


@pytest.mark.slow
def test_changed_and_saved(folder):
    """`change` keeps objects and tags; a saved answer is read, and says what its file has not."""
    own = Own(8)
    scene = own.scene(tension=own.mu).change({"solve.eps": 1e-6, "obstacle.lower": -0.1})
    answer = solve(scene)
    same = solve(own.scene(tension=f"where(x < 1/2, 1, {STIFF})", lower=-0.1), eps=1e-6)
    assert np.isclose(answer.energy, same.energy, rtol=1e-9)
    answer.save(folder)
    read = Answer.read(folder)
    assert read.force == answer.force
    with pytest.raises(InputError, match="tension was given in Python and is not in the file"):
        solve(read.scene.change({"boundary": [{"value": 0}]}))
    assert np.isclose(solve(read.scene.change({"boundary": [{"value": 0}], "effects.tension": 1})).area, 0.5, atol=0.5)


def parts_of(level):
    """Number of facets or cells, and extreme coordinates x, of each named part."""
    mesh, comm = level.mesh, level.comm
    vertices, members, found = corners(mesh), np.array(facet_corners(mesh)), {}
    for name, facets in level.facets.items():
        cells, numbers, _ = sides(mesh, facets)
        x = vertices[cells[:, None], members[numbers], 0]
        found[name] = len(cells), x
    found |= {name: (len(cells), vertices[cells, :, 0]) for name, cells in level.groups.items()}
    # nodes of P2 are off in the last digit
    return {
        name: (total(comm, count), round(smallest(comm, x), 12), round(largest(comm, x), 12))
        for name, (count, x) in found.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(("element", "cell"), [("P1", "triangle"), ("P2", "triangle"), ("Q1", "quadrilateral")])
def test_named_parts_are_saved(element, cell, folder):
    """Named facets and cells are read with the answer, by all ranks or by one; it has a flux, and is solved again."""
    own = Own(8, cell)
    mu = {"soft": 1, "hard": STIFF}
    scene = own.scene(tension=mu, facet_names={"rim / left": 1, "rim": 1, "both": [1, 2]}).change({"solve.eps": 1e-6})
    answer = solve(scene, element=element)
    if cell == "quadrilateral":
        with pytest.raises(InputError, match=r"element P1 is for .* not for a quadrilateral"):
            solve(scene, element="P1")
    answer.save(folder)
    read = Answer.read(folder)
    half = 32 if cell == "quadrilateral" else 64
    known = {
        "rim / left": (8, 0, 0), "rim": (8, 0, 0), "both": (16, 0, 1), "soft": (half, 0, 0.5), "hard": (half, 0.5, 1)
    }  # fmt: skip
    assert parts_of(answer.level) == known and parts_of(read.level) == known
    assert parts_of(Answer.read(folder, MPI.COMM_SELF).level) == known
    points = np.array([[0.21, 0.13], [0.47, 0.52], [0.5, 0.37], [0.71, 0.94]])
    assert np.allclose(read.at(points, "flux"), answer.at(points, "flux"), rtol=1e-10, atol=1e-13)
    again = solve(read.scene)
    assert np.isclose(again.energy, answer.energy, rtol=1e-10) and parts_of(again.level) == known
    solve(membrane(load=8, upper=0.3)).save(folder)
    COMM.barrier()
    assert not (folder / "element.xdmf").exists()


@pytest.mark.slow
def test_named_parts_of_a_refined_mesh_are_saved(folder):
    """The parts of an adaptive mesh are those of the mesh that it was refined from, and so after reading."""
    own = Own(4)
    scene = own.scene(tension={"soft": 1, "hard": 2}, boundary=[{"on": ["rim", "far"], "value": 0}])
    answer = solve(scene, tol=0.1)
    answer.save(folder)
    known, read = parts_of(answer.level), parts_of(Answer.read(folder).level)
    assert answer.record["cells_total"] > 32 and known == read
    assert known["rim"][1:] == (0, 0) and known["far"][1:] == (1, 1) and known["soft"][1:] == (0, 0.5)


def test_time_with_callables():
    """f(x, t) and the formula in t: the same course."""
    own = Own(8)
    time = {"end": 1, "steps": 4}
    one = solve(own.scene(load=lambda x, t: -8 * t + 0 * x[0], time=time))
    other = solve(own.scene(load="-8*t", time=time))
    assert np.allclose(one.time_history.column("force_lower"), other.time_history.column("force_lower"), rtol=1e-12)


def test_exact_solution_as_ufl():
    """Errors against a UFL expression are those against the formula."""
    own, pi = Own(), np.pi
    x = ufl.SpatialCoordinate(own.mesh)
    given = {"load": "2*pi^2*sin(pi*x)*sin(pi*y)", "lower": -10, "boundary": [{"value": 0}]}
    ours = solve(own.scene(exact=ufl.sin(pi * x[0]) * ufl.sin(pi * x[1]), **given)).record["errors"]
    text = solve(own.scene(exact="sin(pi*x)*sin(pi*y)", **given)).record["errors"]
    assert np.isclose(ours["energy"], text["energy"], rtol=1e-6) and np.isclose(ours["l2"], text["l2"], rtol=1e-6)


@pytest.mark.parametrize(("given", "words"), [
    ({"facet_names": {"rim": 9}}, "facet_names: 'rim' = 9: no facet has this tag"),
    ({"facet_tags": 3}, "facet_tags = 3: expected MeshTags of dimension 1"),
    ({"facet_tags": None}, "facet_names needs facet_tags"),
    ({"cell_names": ["soft"]}, r"cell_names = \['soft'\]: expected a dict"),
    ({"mesh": {"shape": "disk"}}, "tags and names of parts go with a DOLFINx mesh"),
    ({"tension": {"soft": 1}}, "hard"),
    ({"boundary": [{"on": "edge", "value": 0}]}, "no part named 'edge'"),
    ({"lower": lambda x: x}, "lower: the callable takes x of shape"),
    ({"cell_names": {5: "soft"}}, r"cell_names = \{5: 'soft'\}: expected names with their tags"),
    ({"load": lambda x, t: -t + 0 * x[0]}, "takes x and t, and the scene has no time"),
])  # fmt: skip
def test_mistakes(given, words):
    with pytest.raises(InputError, match=words):
        solve(Own(4).scene(**given))


def test_tags_of_another_mesh():
    """MeshTags of a finer, coarser or equal mesh: an error on all ranks."""
    own = Own(8)
    for cells in (4, 8, 24):
        other = Own(cells)
        for key in ("facet_tags", "cell_tags"):
            with pytest.raises(InputError, match=f"scene: {key}: these MeshTags belong to another mesh: create"):
                own.scene(**{key: getattr(other, key)})


@pytest.mark.parametrize("index", [-1, 10**6])
def test_tags_of_no_entity(index):
    """Where MeshTags do not tell their mesh, an index that the mesh has not is an error on all ranks."""
    own = Own(8)
    tags = SimpleNamespace(dim=2, indices=np.array([0, index if COMM.rank == COMM.size - 1 else 1]),
                           values=np.array([5, 6]), find=own.cell_tags.find)  # fmt: skip
    with pytest.raises(InputError, match=r"scene: cell_tags: index .* is not on this mesh, which has"):
        own.scene(cell_tags=tags)


def square(n=16):
    return releases.settle(dmesh.create_unit_square(COMM, n, n))


def on(mesh, **given):
    """A membrane with load and obstacle on a mesh of the caller's own."""
    return membrane(**{"mesh": mesh, "load": -8, "lower": -0.1, **given})


def bound_of(scene, element="P1"):
    return solve(scene, element=element, bound=True).bound


def test_obstacles_and_boundary_values_may_be_functions():
    """A Function, a callable and UFL as obstacle and as boundary value give what the formula gives."""
    mesh = square(8)
    x = ufl.SpatialCoordinate(mesh)
    psi = fem.Function(releases.functionspace(mesh, "Lagrange", 1))
    psi.interpolate(lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5))
    formula = "0.2 - hypot(x - 0.5, y - 0.5)"
    exact, *found = (
        solve(on(mesh, load=0, lower=lower, boundary=[{"value": value}]), method="vi").u.x.array
        for lower, value in ((formula, "0.1*x"), (psi, lambda x: 0.1 * x[0]),
                             (lambda x: 0.2 - np.hypot(x[0] - 0.5, x[1] - 0.5), 0.1 * x[0]))
    )  # fmt: skip
    assert all(largest(COMM, np.abs(one - exact)) <= 1e-10 for one in found)


SAMPLED = {
    "load": lambda mesh: {"load": lambda x: -8 * (1 + x[0])},
    "tension": lambda mesh: {"tension": lambda x: 1 + x[0]},
    "obstacle": lambda mesh: {"lower": -0.1 + 0 * ufl.SpatialCoordinate(mesh)[0]},
    "boundary value": lambda mesh: {"boundary": [{"value": lambda x: 0.1 * x[0]}]},
}


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("what", SAMPLED)
def test_bounds_say_what_was_sampled(what, element):
    """Of UFL or a callable nothing is known between its samples: the bound names it."""
    mesh = square()
    bound = bound_of(on(mesh, **SAMPLED[what](mesh)), element)
    assert bound.words.startswith("certified on the polygon of the mesh for the sampled")
    assert what in bound.words and not bound.guaranteed


def test_what_has_no_value_at_nodes():
    """Values by cells, and UFL of a Function that jumps, are refused as obstacles and boundary values."""
    mesh = square(8)
    mu = fem.Function(releases.functionspace(mesh, "DG", 0))
    mu.interpolate(lambda x: np.where(x[0] < 0.5, 1.0, 10.0))
    for given, words in (
        ({"lower": {"all": 1.0}}, "lower unknown key 'all'"),
        ({"boundary": [{"value": {"all": 1.0}}]}, "value unknown key 'all'"),
        ({"lower": -1.0 * mu}, "is not continuous"),
        ({"tension": lambda x: x[0] - 2}, "must be positive"),
    ):
        with pytest.raises(InputError, match=words):
            solve(on(mesh, **given))


def test_data_outside_the_mesh_are_not_asked_for():
    """A table that ends with the domain is a tension like any other."""

    def table(x):
        if x.size and (x.min() < -1e-9 or x.max() > 1 + 1e-9):
            raise ValueError("outside the table")
        return 2 + x[0]

    assert solve(on(square(8), tension=table)).force.lower > 0


def test_data_of_some_cells_on_any_number_of_ranks():
    """UFL in a few cells, and a callable that cannot take an empty x: no rank waits for another."""
    mesh = square()
    middle = corners(mesh).mean(axis=1)
    numbers = np.where(np.linalg.norm(middle[:, :2] - 0.05, axis=1) < 0.1, 1, 2).astype(np.int32)
    tags = dmesh.meshtags(mesh, 2, np.arange(len(numbers), dtype=np.int32), numbers)
    x = ufl.SpatialCoordinate(mesh)
    found = []
    for part in (-8 * (1 + x[0]), lambda x: -8 * (1 + x[0]) + 0 * x[0].max()):
        bound = bound_of(on(mesh, cell_tags=tags, cell_names={"few": 1, "rest": 2}, load={"few": part, "rest": -1.0}))
        assert "sampled load" in bound.words
        found.append(bound.total)
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_functions_away_from_the_origin():
    """A Function as boundary value has a value at every point of its mesh, wherever that lies."""
    mesh = releases.settle(dmesh.create_rectangle(COMM, [np.array([10.1, 10.1]), np.array([10.7, 10.7])], [9, 9]))
    value = fem.Function(releases.functionspace(mesh, "Lagrange", 2))
    value.interpolate(lambda x: x[0] ** 2)
    assert np.isfinite(bound_of(on(mesh, lower=None, boundary=[{"value": value}]), "P2").total)
