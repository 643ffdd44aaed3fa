"""An obstacle between the nodes of cells, and what v_h lacks of it where u is given.

v_h is raised at nodes (P1) or on a lattice (P2), but not where u is given. In the cells beside such points v is v_h and
w = (obstacle - v_h - continued boundary values)^+, which is 0 on the boundary. Its gradient is bounded on those parts
of the cells where it may be positive: with the largest slope of the boundary values there, or with their energy in the
whole cell, whichever is less.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fenicsx_obstacle import polynomials
from fenicsx_obstacle.data.data import Data
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.estimation.boundary_data import BoundaryData
from fenicsx_obstacle.estimation.boundary_values import ROUND_OFF
from fenicsx_obstacle.estimation.clipped import Clipped
from fenicsx_obstacle.estimation.enclosed_data import Division, pieces_of
from fenicsx_obstacle.estimation.pieces import Pieces
from fenicsx_obstacle.estimation.rt1 import nodes_of, quadratics
from fenicsx_obstacle.estimation.simplices import Simplices
from fenicsx_obstacle.parallel import largest, smallest, total

CROSSING = 1e-9  # relative to the range of u: obstacles that cross each other by less do so by what their bounds lack,
ROUNDED = 1e-12  # relative to its values: by round-off,
UNDERFLOW = 1e-290  # or where all are 0: intervals are rounded outward by 1e-300
FEW = 20_000  # parts: more are not divided, as on fine meshes they matter less


class CoveredObstacle:
    """One obstacle, times -1 for an upper obstacle, and what covers it beside the boundary, (E4).

    Attributes:
        sign: 1 for a lower obstacle, -1 for an upper one.
        cover_energy: ||grad w||^2 in each cell.
        cover_volume: Integral of w.
        cover_height: A bound of w.
        sampled: Whether the bound rests on samples of it, on any rank: no bounds of it are known; or it is above the
            state beside the boundary, and may jump or be steep without limit; or, with P2, u may touch it and it may
            have two values at a point.
        unbounded: Whether it may be infinite in each cell, on the side of the state.
    """

    def __init__(self, simplices: Simplices, dirichlet: BoundaryData, sign: float, field: Field, known: Pieces):
        """Store the obstacle and its bounds (collective).

        Args:
            simplices: The cells.
            dirichlet: Boundary values between the nodes.
            sign: See the attributes.
            field: The obstacle.
            known: Bounds of it in the cells.
        """
        self.simplices, self.dirichlet, self.sign, self._field = simplices, dirichlet, sign, field
        self._top = known.upper.copy() if sign > 0 else -known.lower
        self.unbounded = ~np.isfinite(self._top)
        self.cover_energy, self.cover_volume, self.cover_height = (np.zeros(len(self._top)) for _ in range(3))
        self.sampled = self._of_samples = total(simplices.data.level.comm, int(known.sampled)) > 0

    def heights(self, data: Data) -> np.ndarray:
        """Its values at the local nodes of the solver's elements (collective on first use)."""
        heights = data.heights(self.sign)
        return self._field.clip(heights) if isinstance(self._field, Clipped) else heights

    def _cover(
        self, owner: np.ndarray, inside: np.ndarray, linear: np.ndarray, depth: int,
        u: np.ndarray | None = None, size: float = 0.0,
    ) -> bool:  # fmt: skip
        """Bound w on parts of cells, and set it to 0 elsewhere (local, but collective where the obstacle needs the
        distance).

        Args:
            owner: The cell of each part; all parts have the same share of their cells.
            inside: Barycentric coordinates of the corners of the parts, shape (parts, d + 1, d + 1).
            linear: sign times v_h at these corners, shape (parts, d + 1); less u with P2.
            depth: How often the edges of parts are halved.
            u: Values of P2 at the nodes of all cells; None with P1.
            size: Of the state.

        Returns:
            Whether w may be positive on this rank where no bound of its slope is known.
        """
        simplices, count, times = self.simplices, self.simplices.dim + 1, 2**self.simplices.dim
        known = self._field.continuous
        self.cover_volume[:] = self.cover_energy[:] = self.cover_height[:] = 0.0
        without, share = np.zeros(len(simplices.area)), np.abs(np.linalg.det(inside))  # without the boundary values
        for split in range(depth + 1):
            corners = inside @ simplices.x[owner]
            state = linear if u is None else _with_quadratics(linear, self.sign * u[owner], inside)
            beside, steep = self.dirichlet.on_parts(owner, inside, self.sign)
            above, last = np.zeros(len(owner), dtype=bool), split == depth or len(owner) > FEW
            for whole in pieces_of(simplices.data, self._field, corners, owner, Division(0)).groups:
                group = whole.no_less(self.sign)
                degree, coefficient, margin = group.above(state[group.rows], self.sign)
                beyond, margin = group.rest - beside[group.rows], margin + ROUND_OFF * size
                open_ = np.flatnonzero(polynomials.largest(coefficient, count, degree) + beyond > margin)
                rows = group.rows[open_]
                above[rows] = True
                if last:
                    known &= bool(np.isfinite(group.steep[open_]).all())
                    measure = simplices.area[owner[rows]] * group.share[open_] * share[rows]
                    height = np.maximum(coefficient[open_] + beyond[open_, None], 0.0)
                    np.add.at(self.cover_volume, owner[rows], measure * height.mean(axis=1))
                    np.maximum.at(self.cover_height, owner[rows], height.max(axis=1, initial=0.0))
                    for energy, more in ((self.cover_energy, steep[rows]), (without, np.zeros(len(rows)))):
                        steepness = group[open_].steepness(coefficient[open_], corners, more)
                        np.add.at(energy, owner[rows], measure * steepness)
            if last:
                break
            owner, share = np.repeat(owner[above], times), np.repeat(share[above] / times, times)
            inside, linear = polynomials.halved(inside[above]), polynomials.halved(linear[above])
        of_boundary = self.dirichlet.energy(np.ones(len(without)))
        self.cover_energy[:] = np.minimum(self.cover_energy, (np.sqrt(without) + np.sqrt(of_boundary)) ** 2)
        return bool(above.any()) and not known


def negligible(comm: MPI.Comm, v: np.ndarray) -> tuple[float, float]:
    """A height beyond an obstacle that is round-off, and one that may be (collective).

    Args:
        comm: Of the mesh.
        v: Values of the state.
    """
    high, low = largest(comm, v), smallest(comm, v)
    rounded = ROUNDED * max(high, -low) + UNDERFLOW
    return rounded, CROSSING * (high - low) + rounded


def _with_quadratics(linear: np.ndarray, u: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Linear functions plus functions of P2 at the nodes of parts of triangles, shape (parts, 6).

    Args:
        linear: At the corners of the parts, shape (parts, 3).
        u: At the nodes of the triangles, shape (parts, 6).
        inside: Barycentric coordinates of the corners.
    """
    nodes = nodes_of(np.eye(3))
    at_nodes = quadratics((nodes @ inside).reshape(-1, 3)).T.reshape(-1, 6, 6)
    return np.matmul(at_nodes, u[..., None])[..., 0] + linear @ nodes.T
