"""Distance to the boundary of the domain, exact for the polygon of the mesh."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.cells import corners, facet_corners, sides
from fenicsx_obstacle.mesh.levels import Level

FIRST = 8  # candidates of the first round
AT_ONCE = 2_000_000  # pairs of point and facet in memory


class BoundaryDistance:
    """Distances to all boundary facets of a mesh, gathered on every rank.

    The straight line to the nearest boundary point never leaves the domain, so holes and notches need no care.
    """

    def __init__(self, level: Level):
        """Gather the facets (collective).

        Raises:
            InputError: For a surface in space, or a domain without boundary.
        """
        mesh = level.mesh
        if mesh.geometry.dim != mesh.topology.dim:
            raise InputError("'distance' to the boundary is not available on curves and surfaces in space")
        cells, numbers, _ = sides(mesh, level.boundary_facets)
        vertices = np.array(facet_corners(mesh))[numbers]
        facets = corners(mesh)[cells[:, None], vertices]
        if facets.shape[1] == 4:  # a rectangle is two triangles
            facets = np.concatenate([facets[:, :3], facets[:, 1:]])
        self.facets = np.concatenate(level.comm.allgather(facets))
        if not len(self.facets):
            raise InputError("'distance': this domain has no boundary")
        centres = self.facets.mean(axis=1)
        self.reach = np.linalg.norm(self.facets - centres[:, None], axis=2).max()
        self.tree = cKDTree(centres)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Distance of each point, shape (n, 3) (local)."""
        found = np.full(len(points), np.inf)
        todo: np.ndarray = np.arange(len(points))
        count = FIRST
        while len(todo):
            count = min(count, len(self.facets))
            rest = []
            for part in np.array_split(todo, 1 + len(todo) * count // AT_ONCE):
                to_centre, which = self.tree.query(points[part], k=np.arange(1, count + 1))
                found[part] = distance_to_simplices(points[part, None], self.facets[which]).min(axis=1)
                # facets not looked at are farther than the last centre less their radius
                rest.append(part[to_centre[:, -1] - self.reach < found[part]])
            todo = np.concatenate(rest) if count < len(self.facets) else todo[:0]
            count *= 2
        return found


def distance_to_simplices(x: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Distance of points (..., 3) to points, segments or triangles given by corners (..., 1 to 3, 3)."""
    vertices = facets.shape[-2]
    if vertices == 1:
        return np.linalg.norm(x - facets[..., 0, :], axis=-1)
    if vertices == 2:
        return _to_segment(x, facets[..., 0, :], facets[..., 1, :])
    a, b, c = (facets[..., i, :] for i in range(3))
    edges = np.minimum(np.minimum(_to_segment(x, a, b), _to_segment(x, b, c)), _to_segment(x, c, a))
    normal = np.cross(b - a, c - a)
    # above the triangle where x is on the inner side of the three planes through its edges
    inside = [np.sum(np.cross(normal, q - p) * (x - p), axis=-1) >= 0 for p, q in ((a, b), (b, c), (c, a))]
    height = np.abs(np.sum(normal * (x - a), axis=-1)) / np.linalg.norm(normal, axis=-1)
    return np.where(inside[0] & inside[1] & inside[2], height, edges)


def _to_segment(x: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = b - a
    t = np.clip(np.sum((x - a) * along, axis=-1) / np.sum(along * along, axis=-1), 0.0, 1.0)
    return np.linalg.norm(x - a - t[..., None] * along, axis=-1)
