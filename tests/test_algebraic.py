"""Algebraic coarse levels: an obstacle problem on a mesh without a hierarchy takes as few steps as on one with it."""

import numpy as np
import pytest
from conftest import COMM, slow_except
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, releases, solve
from fenicsx_obstacle.parallel import largest, on_root

R = 0.6979651482233736  # of the contact set of the ball
BALL = {
    "tension": 1, "lower": "where(r < 0.9, sqrt(1 - r^2), sqrt(0.19) - 0.9/sqrt(0.19)*(r - 0.9))",
    "boundary": [{"value": f"{R}^2/sqrt(1 - {R}^2)*ln({R}*exp(1/{R}^2 - 1)/r)"}],
}  # fmt: skip


def shaken(mesh, share, width):
    """Interior vertices moved by a share of the width of a cell, the same on all ranks."""
    x, dim = mesh.geometry.x, mesh.geometry.dim
    inside = np.all((x[:, :dim] > x_low(mesh) + 1e-9) & (x[:, :dim] < x_high(mesh) - 1e-9), axis=1)
    waves = np.stack([np.sin(1e4 * (k + 1) * (x @ [1.0, 1.7, 2.3]) + k) for k in range(dim)], axis=1)
    x[inside, :dim] += share * width * waves[inside]
    return mesh


def x_low(mesh):
    return np.array([-largest(mesh.comm, -axis) for axis in mesh.geometry.x.T])[: mesh.geometry.dim]


def x_high(mesh):
    return np.array([largest(mesh.comm, axis) for axis in mesh.geometry.x.T])[: mesh.geometry.dim]


def square(cells, comm=COMM, low=-2.0, high=2.0):
    corners = [np.full(2, low), np.full(2, high)]
    return shaken(dmesh.create_rectangle(comm, corners, [cells, cells]), 0.25, (high - low) / cells)


def cube(cells, comm=COMM):
    mesh = dmesh.create_box(comm, [np.full(3, -1.0), np.full(3, 1.0)], [cells] * 3)
    return shaken(mesh, 0.2, 2 / cells)


def interval(cells):
    return shaken(dmesh.create_interval(COMM, cells, [-1.0, 1.0]), 0.25, 2 / cells)


def quadrilaterals(cells):
    kind = dmesh.CellType.quadrilateral
    mesh = dmesh.create_rectangle(COMM, [np.full(2, -2.0), np.full(2, 2.0)], [cells, cells], cell_type=kind)
    return shaken(mesh, 0.15, 4 / cells)


def sphere(cells):
    """Part of a sphere around the north pole, whose rim is four arcs."""
    flat = square(cells, low=-1.0, high=1.0)
    cut, nodes = releases.geometry_dofs(flat), flat.geometry.x
    own = flat.topology.index_map(2).size_local
    points = nodes / np.sqrt(1 + (nodes**2).sum(axis=1, keepdims=True))
    points[:, 2] = 1 / np.sqrt(1 + (nodes**2).sum(axis=1))
    numbers = flat.geometry.input_global_indices
    everywhere = np.concatenate(COMM.allgather(np.column_stack([numbers, points])))
    _, first = np.unique(everywhere[:, 0], return_index=True)
    table = everywhere[first, 1:]
    mine = np.array_split(np.arange(len(table)), COMM.size)[COMM.rank]
    return releases.create_mesh(COMM, np.asarray(numbers)[cut[:own]], table[mine], "triangle")


def counts(answer):
    return answer.record["newton_iterations"], answer.record["krylov_iterations"]


def difference(one, other):
    """Of two solutions on one mesh, over the range of values."""
    u, v = one.u.x.array, other.u.x.array
    return largest(COMM, np.abs(u - v)) / (largest(COMM, u) + largest(COMM, -u))


@pytest.mark.parametrize(("method", "eps"), [("penalty", "auto"), ("penalty", 1e-12), ("vi", "auto")])
def test_counts_do_not_grow_when_h_halves(method, eps):
    """O(1) Newton steps on a mesh that has no coarser one, from 1.7e3 to 2.6e4 unknowns."""
    found = [counts(solve(Scene(mesh=square(cells), **BALL), method=method, eps=eps)) for cells in (40, 80, 160)]
    newton, krylov = zip(*found, strict=True)
    assert max(newton) <= 6 and max(krylov) <= 20
    assert newton[-1] - newton[0] <= 2


def test_a_mesh_from_gmsh(folder):
    """Delaunay triangles: few steps, and the error of the exact solution halves with h."""

    def draw(size):
        import gmsh

        gmsh.initialize([], False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(-2, -2, 0, 4, 4)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(folder / f"{size}.msh"))
        gmsh.finalize()

    errors = []
    for size in (0.1, 0.05):
        on_root(COMM, draw, size)
        answer = solve(Scene(mesh={"file": str(folder / f"{size}.msh")}, **BALL,
                             exact=f"where(r < {R}, sqrt(1 - r^2), {BALL['boundary'][0]['value']})"))  # fmt: skip
        assert counts(answer)[0] <= 6 and counts(answer)[1] <= 20
        errors.append(answer.record["errors"]["energy"])
    assert 1.7 < errors[0] / errors[1] < 2.4


SCENES = {
    "ball": lambda: Scene(mesh=square(48), **BALL),
    "upper": lambda: Scene(mesh=square(48), tension=2, load=8, upper="0.5 + 0.2*x"),
    "both": lambda: Scene(mesh=square(48), tension=1, load="20*sin(2*x)", lower=-0.3, upper="0.4 - 0.05*x^2"),
    "foundation": lambda: Scene(mesh=square(48), tension=1, foundation=3, load=-4, lower="-0.5 - 0.1*y"),
    "spring and free boundary": lambda: Scene(
        mesh=square(48), tension=1, load=-1, lower="-0.4 - 0.1*x",
        boundary=[{"where": "x == -2", "value": 0}, {"where": "x == 2", "spring": 2}],
    ),
    "anisotropic": lambda: Scene(mesh=square(48), tension=[[4, 1], [1, 1]], load=-3, lower=-0.4),
    "boundary obstacle": lambda: Scene(
        mesh=square(48), tension=1, load=-0.3,
        boundary=[{"where": "x == -2", "value": 0}, {"where": "x == 2", "lower": "-2 + 0.5*y"}],
    ),
    "held by contact alone": lambda: Scene(mesh=square(48), tension=1, load=-1, lower="0.2*cos(2*x) + 0.1*y", boundary=[]),
    "interval": lambda: Scene(mesh=interval(2000), tension=1, load=-8, lower="-1 - 0.2*x"),
    "cube": lambda: Scene(mesh=cube(13), tension=1, load=-8, lower="-0.4 + 0.1*x*y"),
    "quadrilaterals": lambda: Scene(mesh=quadrilaterals(48), **BALL),
    "surface": lambda: Scene(mesh=sphere(48), tension=1, load=-1, lower="0.9*z - 1.3", boundary=[{"value": "-x^2"}]),
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(list(SCENES), "ball", "upper", "boundary obstacle", "cube"))
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_the_solution_is_that_of_a_cold_start(name, method):
    """To the tolerance of the solver, whatever the data, in fewer steps."""
    scene = SCENES[name]()
    ours, cold = solve(scene, method=method), solve(scene, method=method, start="cold")
    assert difference(ours, cold) <= 1e-8
    assert ours.record["newton_total"] > ours.record["newton_iterations"]
    assert counts(ours)[0] <= max(6, 0) and counts(ours)[1] <= 20
