"""More than 46 341 and more than 65 536 nodes: products of their numbers exceed 32 bits."""

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, Solution, Table, solve
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show.free_boundary import Patch, free_boundary, patch_of, rim, with_levels, zero
from tests.conftest import COMM

NODES = [46_342, 65_537, 100_000]


@pytest.mark.parametrize("count", NODES)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_cuts_of_cells_with_large_numbers(dim, count):
    """Cells of 32-bit numbers are cut, and have levels, as cells of small numbers."""
    small = np.vander(np.linspace(0.1, 0.9, dim + 3), 3, increasing=True) * [1, 1, 2]
    cells = np.array([[*range(dim), last] for last in range(dim, dim + 3)], dtype=np.int32)
    points, position = np.zeros((count, 3)), count - len(small)
    points[position:] = small
    fields = {"u": small[:, 0], "lower": np.full(len(small), 0.1), "contact": np.eye(len(small))[0]}
    fields["pressure"] = fields["contact"]
    whole = {name: np.concatenate([np.ones(position, values.dtype), values]) for name, values in fields.items()}
    expected = with_levels(Patch(small, cells, fields))
    found = with_levels(Patch(points, cells + np.int32(position), whole))
    assert found.cells.dtype == np.int32
    assert np.array_equal(found.fields["level lower"][position:], expected.fields["level lower"])
    assert np.array_equal(rim(found.cells) - position, rim(expected.cells))
    level = expected.fields["level lower"]
    cut, other = zero(expected, level), zero(found, np.concatenate([np.ones(position), level]))
    assert len(cut.cells)
    assert np.array_equal(cut.points[cut.cells], other.points[other.cells])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "element", "bound"), [("triangles", "P1", True), ("P2", "P2", False), ("quadrilaterals", "Q1", False),
                                   ("tetrahedra", "P1", False), ("intervals", "P1", False)]
)  # fmt: skip
def test_more_nodes_than_32_bits_multiply(kind, element, bound, folder):
    """Solve, bound, save, read and draw; the picture has a free boundary."""
    if kind == "intervals":
        mesh = dmesh.create_interval(COMM, 70_000, [0.0, 1.0])
    elif kind == "tetrahedra":
        mesh = dmesh.create_box(COMM, [np.zeros(3), np.array([1.0, 1.0, 0.2])], [70, 70, 12])
    else:
        cells, cell = 130 if kind == "P2" else 256, dmesh.CellType.triangle
        cell = dmesh.CellType.quadrilateral if element == "Q1" else cell
        mesh = dmesh.create_rectangle(COMM, [np.zeros(2), np.ones(2)], [cells, cells], cell)
    lower = -0.05
    if kind == "quadrilaterals":  # over as many scattered points
        x, y = np.random.default_rng(0).random((2, 70_000)) * 1.2 - 0.1
        lower = Table(x=x, y=y, z=0.01 * x * y - 0.05)
    scene = Scene(mesh=mesh, tension=1, load=-20 if kind == "tetrahedra" else -8, lower=lower)
    answer = solve(scene, element=element, bound=bound)
    assert answer.u.function_space.dofmap.index_map.size_global > NODES[0]
    if bound:
        assert answer.record["bound"]["relative"] < 0.1
    answer.save(folder / "saved")
    again = Solution.read(folder / "saved")
    assert again.force.lower == answer.force.lower
    arrays = gather(again.fields)
    if COMM.rank == 0:
        lines = free_boundary(patch_of(arrays))
        assert len(lines) == 1
        closed = np.bincount(lines[0].cells.ravel())
        assert np.all(closed == 2) if kind not in ("tetrahedra", "intervals") else len(closed) > 1
    assert "drawn by" in again.plot(folder / "picture.png").said
