"""P1 with the vertex rule: v_h is the nodal maximum of u_h and the obstacle, raised by what nodes do not see of it."""

from __future__ import annotations

import numpy as np

from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.estimation.cell_data import obstacles_of
from fenicsx_obstacle.estimation.element import Element, Terms
from fenicsx_obstacle.estimation.flux_p1 import EquilibrationP1, FluxP1
from fenicsx_obstacle.estimation.peaks import Peaks
from fenicsx_obstacle.estimation.triangles import Triangles
from fenicsx_obstacle.parallel import largest

ROUND_OFF = 1e-9  # of the heights


class ElementP1(Element):
    """P1 on one mesh: what depends on mesh and data alone is made once."""

    equilibration: EquilibrationP1
    obstacles: list[Peaks]

    def __init__(self, problem: Problem):
        """Sample the data, sort the corners around the vertices (collective)."""
        super().__init__(EquilibrationP1(Triangles(problem.data)))
        fans, triangles = self.equilibration.fans, self.triangles
        self.obstacles = [Peaks(triangles, fans, self.rim, *obstacle) for obstacle in obstacles_of(problem.data)]
        x = triangles.x
        self._from_middle = np.ascontiguousarray(np.moveaxis(x - x.mean(axis=1, keepdims=True), 2, 0))
        self._spread = np.einsum("xci,xci->c", self._from_middle, self._from_middle) / 12

    def terms(self, u: np.ndarray, touches_lower: np.ndarray, touches_upper: np.ndarray) -> Terms:
        """See `Element.terms` (collective)."""
        flux = self.equilibration.flux(u, touches_lower, touches_upper)
        nodal, v, crossing = self._admissible(u)
        cover = sum((peaks.cover_energy for peaks in self.obstacles), np.zeros(len(self.triangles.area)))
        return Terms(
            flux=flux, distance=self._distance(u, flux), admissible_distance=self._distance(v, flux),
            oscillation=self.equilibration.load.oscillation, contact=self._contact(v, flux),
            moved=self._energy(v - u), cover=self.tension.most * cover, raised=self._energy(v - nodal),
            penetration=self._energy(nodal - u),
            rest=self._means_squared(flux.rest), solver_rest=self._means_squared(flux.solver_rest),
            energy=self._energy(u), admissible=v, crossing=crossing,
        )  # fmt: skip

    def _admissible(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """The nodal maximum of u and the obstacles, the same of the obstacles raised, and by how much these then cross
        each other or what is given (collective)."""
        data, nodal, v = self.triangles.data, u.copy(), u.copy()
        given = data.fixed[0]
        lifted = []
        for peaks in self.obstacles:
            lifted.append(peaks.lift(peaks.sign * v))
            for state, obstacle in ((nodal, peaks.nodal), (v, lifted[-1])):
                inside = peaks.sign * np.maximum(peaks.sign * state, obstacle)
                inside[given] = state[given]
                state[:] = inside
        comm, crossing = data.level.comm, 0.0
        for peaks, lift in zip(self.obstacles, lifted, strict=True):
            beyond = largest(comm, lift - peaks.sign * v)
            if beyond > ROUND_OFF * largest(comm, np.abs(lift)):
                crossing = max(crossing, beyond)
        return nodal, v, crossing

    def _contact(self, v: np.ndarray, flux: FluxP1) -> np.ndarray:
        """int lambda (v - lower) + int nu (upper - v), lambda and nu being their means in each cell."""
        triangles, found = self.triangles, np.zeros(len(self.triangles.area))
        for peaks in self.obstacles:
            pressure = (flux.lower if peaks.sign > 0 else flux.upper)[triangles.dofs].mean(axis=1)
            gap = (peaks.sign * v - peaks.nodal)[triangles.dofs].mean(axis=1) - peaks.mean
            gap = gap * triangles.area + peaks.sign * self.rim.volume + peaks.cover_volume
            found += pressure * np.maximum(gap, 0.0)
        return found

    def _distance(self, v: np.ndarray, flux: FluxP1) -> np.ndarray:
        """||mu^(1/2) grad v - mu^(-1/2) sigma||_T^2: mu grad v is in RT0 too, of normal fluxes -mu grad v . normal."""
        triangles, mu = self.triangles, self.equilibration.mu
        gradient = triangles.gradient(v)
        outward = flux.normal + triangles.along_normals(gradient * mu)
        across = np.einsum("ci,xci->xc", outward, self._from_middle)
        squares = outward.sum(axis=1) ** 2 * self._spread + across[0] ** 2 + across[1] ** 2
        squares /= 4 * triangles.area * mu

        def fields(cells: np.ndarray | slice, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            x, normal = triangles.x[cells], flux.normal[cells]
            sigma = np.einsum("ci,cpx->cpx", normal, points @ x) - np.einsum("ci,cix->cx", normal, x)[:, None]
            return gradient[:, cells].T[:, None], sigma / (2 * triangles.area[cells])[:, None, None]

        self.tension.integrate_distances(squares, fields)
        return squares

    def _energy(self, e: np.ndarray) -> np.ndarray:
        """||mu^(1/2) grad e||_T^2."""
        triangles, squares = self.triangles, np.zeros(len(self.triangles.area))
        cells = np.flatnonzero((e != 0)[triangles.dofs].any(axis=1))
        gradient = triangles.gradient(e, cells)
        squares[cells] = (self.tension.mean * triangles.area)[cells] * (gradient[0] ** 2 + gradient[1] ** 2)
        return squares

    def _means_squared(self, rest: np.ndarray) -> np.ndarray:
        """||.||_T^2 of the means in cells of nodal values."""
        return self.triangles.area * rest[self.triangles.dofs].mean(axis=1) ** 2
