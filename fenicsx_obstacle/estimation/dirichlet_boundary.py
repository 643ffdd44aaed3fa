"""The part of the boundary where u is given, and the reach of a load: how far it can move u."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest, total


@dataclass(frozen=True)
class DirichletBoundary:
    """The part of the boundary where u is given, and the box around the domain.

    Attributes:
        sides: Of the box.
        area: Length, area or volume of the domain.
        everywhere: Whether u is given on the whole boundary.
        faces: If the domain is the box, on how many of its two faces across each axis u is given; otherwise 0.
        radii: Least and largest distance from the axis where that is the weight of integrals, otherwise None.
    """

    sides: np.ndarray
    area: float
    everywhere: bool
    faces: np.ndarray
    radii: tuple[float, float] | None = None

    def reach(self, load: float, least_tension: float) -> float:
        """A bound of w >= 0, w = 0 where u is given, free elsewhere, -div(mu grad w) = f with 0 <= f <= load, (E15).

        In the plane V(t) is the area of {w > t} and P(t) the length of its boundary in the domain and where w = 0 is
        given. With the coarea formula and Cauchy's inequality P^2 <= -V' int_{w = t} |grad w| <= -V' load V/mu. So
        P^2 >= c V gives -V' >= c mu/load, and max w <= load area/(c mu). Held all around, c = 4 pi is the isoperimetric
        inequality (Talenti 1976). In a box L x H with w = 0 on a face of length H, c = min(1, H/L): each line across it
        that meets {w > t} has an end of it, so that P >= H if all of them do; otherwise no line along the face lies in
        the set, P is at least the length of both its shadows, and V at most their product. On intervals P is at least
        the number of ends where w = 0 is given, V' V <= -P^2 mu/load, and max w <= load length^2/(2 P^2 mu). In solids,
        held all around, it is that of the ball of the same volume, load radius^2/(6 mu) (Talenti). Infinite where no
        such constant is known.
        """
        dim = len(self.sides)
        if dim == 1:
            ends = 2.0 if self.everywhere else self.faces[0]
            return load * self.area**2 / (2 * ends**2 * least_tension) if ends > 0 else np.inf
        if dim == 3:
            radius = (3 * self.area / (4 * pi)) ** (1 / 3)
            return load * radius**2 / (6 * least_tension) if self.everywhere else np.inf
        constants = [0.0]
        if self.everywhere:
            constants.append(4 * pi)
        constants += [min(1.0, self.sides[1 - axis] / self.sides[axis]) for axis in range(2) if self.faces[axis]]
        c = max(constants)
        return load * self.area / (c * least_tension) if c > 0 else np.inf


def dirichlet_boundary(simplices: Simplices) -> DirichletBoundary:
    """Where u is given (collective).

    Args:
        simplices: The owned cells.
    """
    level, x = simplices.data.level, simplices.x
    comm = level.comm
    dim = simplices.dim
    lower = np.array([smallest(comm, x[..., axis]) for axis in range(dim)])
    upper = np.array([largest(comm, x[..., axis]) for axis in range(dim)])
    sides = upper - lower
    radius = simplices.radius
    cells, opposite = np.nonzero(simplices.on_sides(level.boundary_facets))
    held = simplices.held[cells, opposite]
    ends = np.stack([x[cells, (opposite + k) % (dim + 1)] for k in range(1, dim + 1)], axis=1)
    size = np.linalg.norm(simplices.normal[:, cells, opposite], axis=0)
    if radius is not None:  # the axis is no boundary
        size = np.where(radius[cells].sum(axis=1) > radius[cells, opposite], size, 0.0)
    around, area = total(comm, size), total(comm, simplices.area)
    everywhere = total(comm, size[held]) >= around * (1 - 1e-9)
    on_faces = [
        [np.all(np.abs(ends[..., axis] - at) < 1e-9 * sides[axis], axis=1) for at in (lower[axis], upper[axis])]
        for axis in range(dim)
    ]
    # a box that slits cut has facets of the boundary inside
    inside = size[~np.any([on for pair in on_faces for on in pair], axis=0)]
    is_box = area >= np.prod(sides) * (1 - 1e-9) and total(comm, inside) <= around * 1e-9
    faces = np.zeros(dim)
    for axis, pair in enumerate(on_faces):
        for on in pair:
            faces[axis] += is_box and total(comm, size[held & on]) >= np.prod(np.delete(sides, axis)) * (1 - 1e-9)
    radii = None
    if radius is not None:
        radii = smallest(comm, radius), largest(comm, radius)
    return DirichletBoundary(sides, area, bool(everywhere), faces, radii)
