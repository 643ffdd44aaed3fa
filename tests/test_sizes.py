"""More than 46 341 nodes: products of their numbers exceed 32 bits."""

import numpy as np
import pytest
from dolfinx import mesh as dmesh

from fenicsx_obstacle import Scene, Solution, Table, solve
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show.free_boundary import free_boundary, patch_of
from tests.conftest import COMM

NODES = 46_341


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
    assert answer.u.function_space.dofmap.index_map.size_global > NODES
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
