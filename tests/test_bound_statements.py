"""The statements of docs/bound_proofs.md, compared with what each bounds."""

from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import Scene, polynomials
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.contact_set import touching
from fenicsx_obstacle.estimation.dirichlet_boundary import DirichletBoundary
from fenicsx_obstacle.estimation.friedrichs import of_box
from fenicsx_obstacle.estimation.quadrature import rule
from fenicsx_obstacle.estimation.rt1 import quadratics
from fenicsx_obstacle.estimation.triangle_lattice import POINTS, SMALL
from fenicsx_obstacle.parallel import largest, total
from tests.conftest import COMM


def energy_of_polynomials(data, cells):
    """||grad w||^2 of the polynomials of continued boundary values in each cell, from their values."""
    simplices, corners = data.simplices, data.simplices.dim + 1
    coefficients = polynomials.coefficients(data.values(cells, polynomials.inner_points(corners, 4)), corners, 4)
    along = polynomials.slopes(coefficients, corners, 4)
    points, weights = rule(corners - 1, 6)
    there = np.stack([polynomials.evaluate(along[:, k], points, 3) for k in range(corners)], axis=2)
    gradients = np.moveaxis(simplices.normal[:, cells], 0, 2) / (simplices.dim * simplices.area[cells])[:, None, None]
    squares = np.sum((there @ gradients) ** 2, axis=2)
    return simplices.area[cells] * (squares @ weights)


@pytest.mark.parametrize(
    ("shape", "element", "value"),
    [
        ("rectangle", "P1", "x^4 - x*y + y^2"),
        ("rectangle", "P2", "x^4 - x^3*y + y^2"),
        ("box", "P1", "x^4 - y*z + z^2"),
    ],
)
def test_continued_boundary_values(shape, element, value):
    """(E3): of polynomials of degree 4 they are polynomials, which are right on the boundary and whose energy and
    volume are exact."""
    scene = Scene(mesh={"shape": shape, "cells": 2, "perturb": 0.2}, tension=1, load=0, boundary=[{"value": value}])
    with closing(SolverContext(scene.change({"solve.element": element}))) as context:
        data = context.estimator.element.dirichlet
        simplices, given = data.simplices, context.problem.data.fixed[1].x.array
    cells, dim = np.arange(len(simplices.area)), simplices.dim
    found = data.energy(np.ones(len(cells)))
    assert largest(COMM, np.abs(found - energy_of_polynomials(data, cells))) <= 1e-8 * total(COMM, found)
    points, weights = rule(dim, 4)
    volume = simplices.area * (data.values(cells, points) @ weights)
    assert largest(COMM, np.abs(data.volume - volume)) <= 1e-12 and largest(COMM, data.volume_rest) <= 1e-10
    assert largest(COMM, np.abs(data.values(cells, points)).max(axis=1) - data.deviation) <= 1e-12
    rows, opposite = np.nonzero(simplices.held)
    for k in range(dim + 1):
        there = rows[opposite == k]
        on = np.insert(rule(dim - 1, 4)[0], k, 0.0, axis=1)
        x = on @ simplices.x[there]
        exact = simplices.values(scene.field(value, "value"), on, there)
        assert x.shape[:2] == exact.shape
        if element == "P1":
            of_u = given[simplices.dofs[there]] @ on.T
            assert largest(COMM, np.abs(of_u + data.values(there, on) - exact)) <= 1e-10


@pytest.mark.parametrize("value", ["max(0, 0.3 - abs(x - 0.47))*y", "abs(x - 0.3)*(1 - y)"])
def test_continued_kinks(value):
    """(E3): the bound of the energy of a cone over an edge with kinks is above that of samples, by no more than 2.5."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 3}, tension=1, load=0, boundary=[{"value": value}])
    with closing(SolverContext(scene)) as context:
        data, given = context.estimator.element.dirichlet, context.problem.data.fixed[1].x.array
        simplices, field = data.simplices, scene.field(value, "value")
    energy, t = data.energy(np.ones(len(simplices.area))), (np.arange(4000) + 0.5) / 4000
    for cell, tip in zip(*np.nonzero(simplices.held), strict=True):
        i, j = (tip + 1) % 3, (tip + 2) % 3
        on, step = np.zeros((len(t), 3)), 1e-6

        def d(t, cell=cell, i=i, j=j, on=on):
            on[:, i], on[:, j] = 1 - t, t
            g = simplices.values(field, on, np.array([cell]))[0]
            return g - on @ given[simplices.dofs[cell]]

        x = simplices.x[cell]
        length = np.linalg.norm(x[j] - x[i])
        height, foot = 2 * simplices.area[cell] / length, (x[tip] - x[i]) @ (x[j] - x[i]) / length
        slope = (d(t + step) - d(t - step)) / (2 * step * length)
        squares = slope**2 + ((d(t) - (t * length - foot) * slope) / height) ** 2
        sampled = length * height / 2 * squares.mean()
        if np.count_nonzero(simplices.held[cell]) == 1:
            assert sampled * (1 - 1e-3) <= energy[cell] + 1e-12 <= 2.5 * sampled + 2e-12


def boundary(sides, faces, *, everywhere=False, radii=None):
    sides = np.array(sides)
    return DirichletBoundary(sides, float(np.prod(sides)), everywhere, np.array(faces), radii)


@pytest.mark.serial
def test_friedrichs_constants_of_boxes():
    """(E8): the eigenvalues of boxes are known; of a cylinder that of the disk and that of its height add up."""
    assert of_box(boundary([1, 1], [2, 2], everywhere=True)) == pytest.approx(1 / (np.pi * np.sqrt(2)))
    assert of_box(boundary([2, 1], [1, 0])) == pytest.approx(4 / np.pi)
    assert of_box(boundary([2, 3, 1], [1, 2, 0])) == pytest.approx(1 / np.hypot(np.pi / 4, np.pi / 3))
    assert of_box(boundary([2, 1], [1, 0], radii=(0.0, 2.0))) == pytest.approx(2 / 2.404825557695773)
    assert of_box(boundary([1, 1], [1, 0], radii=(1.0, 2.0))) == pytest.approx(2 * np.sqrt(2) / np.pi)
    assert of_box(boundary([1, 1], [0, 0])) == np.inf


@pytest.mark.serial
def test_reach_of_a_load():
    """(E15): -w'' = 1 between one or two ends, -div grad w = 1 in a square (max w = 0.07367) and in a strip beside a
    face have solutions that are no larger; those of intervals and strips are reached."""
    assert boundary([2], [2], everywhere=True).reach(1.0, 1.0) == pytest.approx(1 / 2)
    assert boundary([2], [1]).reach(3.0, 1.0) == pytest.approx(3 * 2**2 / 2)
    assert 0.07367 <= boundary([1, 1], [2, 2], everywhere=True).reach(1.0, 1.0) <= 0.09
    assert 1 / 2 <= boundary([1, 1], [1, 0]).reach(1.0, 1.0) <= 1
    assert 0.0562 <= boundary([1, 1, 1], [2, 2, 2], everywhere=True).reach(1.0, 1.0) <= 0.07
    assert boundary([1, 1], [2, 2], everywhere=True).reach(6.0, 3.0) == pytest.approx(2 / (4 * np.pi))


def largest_work(gram, work):
    """sup work . e / (e . gram e)^(1/2) over e with which the work is known."""
    return np.sqrt(max(work @ np.linalg.lstsq(gram, work, rcond=1e-12)[0], 0.0))


@pytest.mark.serial
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_on_facets(dim):
    """(E6): a force with mean 0 on a facet of a cell, and one with any mean with ||e||_T beside it, against all
    polynomials of degree 3; the bounds are at most 6 times the supremum."""
    mesh = {"shape": "rectangle" if dim == 2 else "box", "cells": 1, "perturb": 0.2 if dim == 2 else 0.0}
    sides = ["left", "bottom"] if dim == 2 else ["left", "bottom", "front"]
    for flux in ("y - 0.37*y^2", "1 + y"):
        scene = Scene(mesh=mesh, tension=1, foundation="1 + x" if flux == "1 + y" else 0,
                      boundary=[{"on": sides, "value": 0}, {"on": "right", "flux": flux}])  # fmt: skip
        with closing(SolverContext(scene, MPI.COMM_SELF)) as context:
            element = context.estimator.element
            parts, simplices, u = element.equilibration.parts, element.simplices, np.zeros(context.problem.level.dofs)
        force = parts.forces(u)
        for row, (cell, side) in enumerate(zip(parts.cells, parts.sides, strict=True)):
            # the flux has the mean of the force, or none of it
            has = np.zeros_like(force) if flux == "1 + y" else force
            inside, outside = parts.lacking(u, has, np.ones(len(simplices.area)), 1.0)
            nodes = polynomials.inner_points(dim + 1, 3)
            basis = np.eye(len(nodes))
            points, weights = rule(dim, 6)
            gradients = simplices.normal[:, cell].T / (dim * simplices.area[cell])
            along = polynomials.slopes(basis, dim + 1, 3)
            slopes = sum(polynomials.evaluate(along[:, k], points, 2)[..., None] * gradients[k] for k in range(dim + 1))
            area = simplices.area[cell]
            gram = area * np.einsum("ipx,jpx,p->ij", slopes, slopes, weights)
            there = polynomials.evaluate(basis, points, 3)
            mass = area * np.einsum("ip,jp,p->ij", there, there, weights)
            on, of_facet = rule(dim - 1, 8)
            on = np.insert(on, side, 0.0, axis=1)
            g = simplices.values(scene.field(flux, "flux"), on, np.array([cell]))[0]
            if flux != "1 + y":
                g = g - force[row].sum() / parts.size[row]
            work = parts.size[row] * parts.share[row] * (polynomials.evaluate(basis, on, 3) * g) @ of_facet
            if flux == "1 + y":  # (r, e) <= inside ||grad e|| + outside ||e||
                bound, gram = np.hypot(inside[cell], outside[cell]), gram + mass
            else:
                bound = inside[cell] + outside[cell]
            assert largest_work(gram, work) <= bound * (1 + 1e-9)
            assert bound <= 6 * largest_work(gram, work)


class State:
    """v_h of a scene with one lower obstacle: linear on 64 parts of each cell, but for u_h with P2.

    Attributes:
        found: The element of the bound.
        side: The obstacle in it.
        words: Of the bound.
    """

    def __init__(self, scene, obstacle, element):
        """Solve (collective)."""
        with closing(SolverContext(scene.change({"solve.element": element, "solve.eps": 1e-8}))) as context:
            answer, self.found, self.element = context.answer(bound=True), context.estimator.element, element
            (self.side,), self._field, self.words = self.found.obstacles, scene.field(obstacle, "lower"), answer.bound
            u, simplices = answer.u.x.array, self.found.simplices
            terms = self.found.terms(u, *touching(context.problem))
            if element == "P1":
                self.parts = polynomials.halvings(3, 3)
                self._linear = (terms.admissible[simplices.dofs] @ self.parts.reshape(-1, 3).T).reshape(-1, 64, 3)
            else:
                self._nodes, self.parts = u[self.found.equilibration.nodes], POINTS[SMALL]
                self._linear = self.found._lifted(self._nodes, terms.flux)[0][:, SMALL]

    def excess(self, cells, places):
        """Obstacle less state at the same places in each part of cells, shape (cells, parts, places)."""
        where = (places @ self.parts).reshape(-1, 3)
        values = self.found.simplices.values(self._field, where, cells)
        if self.element == "P2":
            values = values - self._nodes[cells] @ quadratics(where)
        return values.reshape(len(cells), 64, len(places)) - self._linear[cells] @ places.T

    def covered(self, cells):
        """Whether v_h need not be above the obstacle in each part of cells, shape (cells, 64)."""
        simplices = self.found.simplices
        if self.element == "P2":
            return self.side._at_boundary(cells)
        return np.repeat(simplices.given[simplices.dofs[cells]].any(axis=1)[:, None], 64, axis=1)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_covers_beside_the_boundary(element):
    """(E4): what lifts v_h above an obstacle beside nodes where u is given has no more energy and volume than bounded,
    and bounds are at most 3 times that."""
    obstacle = "1.5*x*(1 - x)*y*(1 - y)*(1 + x)"
    scene = Scene(mesh={"shape": "rectangle", "cells": 4}, tension=1, load=-3, lower=obstacle, boundary=[{"value": 0}])
    state = State(scene, obstacle, element)
    side, simplices, parts = state.side, state.found.simplices, state.parts
    cells = np.flatnonzero(side.cover_energy)
    assert total(COMM, len(cells)) > 0 and state.words.certified
    places, h = polynomials.halvings(3, 2).mean(axis=1), 1e-5
    middle = state.excess(cells, places)
    steps = [(state.excess(cells, places + h * np.array(d)) - middle) / h for d in ((-1, 1, 0), (-1, 0, 1))]
    corners = parts @ simplices.x[cells][:, None]
    edges = (corners[..., 1:, :] - corners[..., :1, :])[:, :, None]
    squares = np.sum(np.linalg.solve(edges, np.stack(steps, axis=3)[..., None])[..., 0] ** 2, axis=3)
    positive = (middle > 1e-12) & state.covered(cells)[:, :, None]
    energy, volume = (
        simplices.area[cells] * np.where(positive, one, 0.0).mean(axis=(1, 2)) for one in (squares, middle)
    )
    sums = [total(COMM, one) for one in (energy, volume, side.cover_energy, side.cover_volume)]
    assert sums[0] <= sums[2] * 1.01 <= 3 * sums[0] and sums[1] <= sums[3] * 1.01
    assert np.all(energy <= 1.05 * side.cover_energy[cells] + 1e-12)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_the_state_is_above_the_obstacle(element):
    """(E13), (E19): v_h is nowhere below an obstacle with waves between the nodes, but where it is covered."""
    obstacle = "0.3 - 2*((x - 0.5)^2 + (y - 0.5)^2) + 0.03*sin(23*x)*sin(19*y + 1)"
    scene = Scene(mesh={"shape": "rectangle", "cells": 6}, tension=1, load=-1, lower=obstacle, boundary=[{"value": 0}])
    state = State(scene, obstacle, element)
    cells = np.arange(len(state.found.simplices.area))
    beyond = state.excess(cells, np.vstack([polynomials.halvings(3, 2).mean(axis=1), np.eye(3)]))
    assert state.words.certified
    assert largest(COMM, np.where(state.covered(cells)[:, :, None], -1.0, beyond)) <= 1e-12


def test_the_distance_from_an_obstacle_counts_kinks_of_boundary_values():
    """(E3): where the boundary value is above its interpolant, the integral of v - g over a cell is larger by that of
    the cone, two thirds of the area times the mean of the difference on the edge."""
    value = "-abs(x - 0.3) - abs(y - 0.7)"
    scene = Scene(mesh={"shape": "rectangle", "cells": 3}, tension=1, load=-1, lower=-9, boundary=[{"value": value}])
    with closing(SolverContext(scene)) as context:
        u, element = context.answer(bound=True).u.x.array, context.estimator.element
        obstacle, simplices = element.obstacles[0], element.simplices
        gap = element._gap(u, obstacle)
    cells, opposite = np.nonzero(simplices.part_of == 0)
    ends, s = simplices.x[cells[:, None], (opposite[:, None] + [1, 2]) % 3], (np.arange(1000)[:, None] + 0.5) / 1000
    x = np.concatenate([ends[:, :1] + s * (ends[:, 1:] - ends[:, :1]), ends], axis=1)
    along = -np.abs(x[..., 0] - 0.3) - np.abs(x[..., 1] - 0.7)
    along = along[:, :-2] - (along[:, -2:-1] * (1 - s.T) + along[:, -1:] * s.T)
    exact = simplices.area * (u - obstacle.nodal)[simplices.dofs].mean(axis=1)
    np.add.at(exact, cells, 2 / 3 * simplices.area[cells] * along.mean(axis=1))
    assert largest(COMM, along) > 0.05 and np.all(gap >= exact - 1e-8)


@pytest.mark.serial
def test_multipliers_of_p2_are_positive():
    """(E18): lambda = 1 at one midpoint of each cell, 0 at the others, is -1 at a vertex. lambda_+ is the mean 1/3 and
    a fourth of the rest, whose norm is (2 |T|)^(1/2)/3."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 2}, tension=1, load=-1, lower=-1, boundary=[{"value": 0}])
    with closing(SolverContext(scene.change({"solve.element": "P2"}))) as context:
        context.answer(bound=True)
        element = context.estimator.element
        pressure = np.zeros((len(element.simplices.area), 3))
        pressure[:, 1] = 1.0
        nodal = np.zeros((len(pressure), 6))
        reduced = element._lifted(nodal, SimpleNamespace(lower=pressure, upper=np.zeros_like(pressure)))[2]
    np.testing.assert_allclose(reduced, 0.75 * np.sqrt(2 * element.simplices.area) / 3)


WAVES = "where(sin(400*x) > -0.5, 9, 1)"  # 9 on two thirds


@pytest.mark.serial
@pytest.mark.parametrize("tension", [WAVES, [[9, 2], [2, 1]], "exp(x)*(2 + y)", [["exp(x)", 0.2], [0.2, 1]]])
def test_distances(tension):
    """(E20), (E25): ||A^(1/2) g - A^(-1/2) s||^2 of random g and s in RT0 is below its bound, which is less than twice
    as large, whether conditions are undecided or the tension is smooth."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 2}, tension=tension, load=1, boundary=[{"value": 0}])
    with closing(SolverContext(scene)) as context:
        element = context.estimator.element
    simplices, rng = element.simplices, np.random.default_rng(2)
    g, normal = rng.normal(size=(len(simplices.area), 2)), rng.normal(size=(len(simplices.area), 3)) / 9

    def fields(cells, points):
        s = simplices.flux_fields(normal[cells], points, cells)
        return np.broadcast_to(g[cells][:, None], s.shape), s

    found = np.zeros(len(g))
    element.tension.integrate_distances(found, fields, 1)
    inside = rng.dirichlet(np.ones(3), 20_000)
    every = np.arange(len(g))
    rows = tension if isinstance(tension, list) else [[tension, 0], [0, tension]]
    A = np.stack([[simplices.values(scene.field(str(one), "tension"), inside, every) for one in row] for row in rows])
    A = np.moveaxis(A, (0, 1), (2, 3))
    of_g, of_s = fields(every, inside[None])
    away = (A @ of_g[..., None])[..., 0] - of_s
    exact = simplices.area * np.sum(away * np.linalg.solve(A, away[..., None])[..., 0], axis=2).mean(axis=1)
    assert np.all(exact <= 1.02 * found) and np.all(found <= 2 * exact)


@pytest.mark.serial
def test_what_foundations_are_beyond_the_solvers():
    """(E26): ||k u - k_T mean u|| of a P1 function u, k_T being the solver's; (E5): the same against polynomials e of
    degree 3 with ||grad e||^2 + ||k^(1/2) e||^2 = 1."""
    k = "1e4*where(sin(400*x) > -0.5, 1.5, 1)"
    scene = Scene(mesh={"shape": "rectangle", "cells": 2}, tension=1, foundation=k, load=1)
    with closing(SolverContext(scene)) as context:
        answer, problem = context.answer(bound=True), context.problem
        element, u = context.estimator.element, answer.u.x.array
        terms = element.terms(u, *touching(problem))
    simplices, reaction = element.simplices, element.equilibration.reaction
    inside, every = np.random.default_rng(2).dirichlet(np.ones(3), 20_000), np.arange(len(simplices.area))
    corner = u[simplices.dofs]
    there = simplices.values(scene.field(k, "foundation"), inside, every)
    beyond = there * (corner @ inside.T) - (reaction._of_solver * corner.mean(axis=1))[:, None]
    exact, found = (
        np.sqrt(simplices.area * (beyond**2).mean(axis=1)),
        sum(reaction.beyond(u, np.zeros((len(u), 3))[:1])),
    )
    assert np.all(exact <= 1.02 * found) and np.all(found <= 4 * exact)
    basis = np.eye(10)
    values, along = polynomials.evaluate(basis, inside, 3), polynomials.slopes(basis, 3, 3)
    slopes = np.stack([polynomials.evaluate(along[:, m], inside, 2) for m in range(3)], axis=2)
    weight = element._lacking(u, terms.flux)[0]
    for cell in every:
        gradients = slopes @ (simplices.normal[:, cell].T / (2 * simplices.area[cell]))
        gram = np.einsum("ipx,jpx->ij", gradients, gradients) + (values * there[cell]) @ values.T
        gram *= simplices.area[cell] / len(inside)
        work = simplices.area[cell] * (values * beyond[cell]).mean(axis=1)
        assert largest_work(gram, work) <= 1.02 * weight[cell]
