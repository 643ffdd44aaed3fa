"""ObstacleProblem on the caller's own mesh, form, tags and Functions: the same solution as every other way in."""

import gc
import weakref
from contextlib import nullcontext

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc

from fenicsx_obstacle import InputError, NotConverged, ObstacleProblem, Scene, compare, penalty, solve
from fenicsx_obstacle.parallel import largest
from fenicsx_obstacle.problems.residual_form import ResidualForm
from tests import helpers
from tests.conftest import COMM, membrane

TRIANGLE, QUADRILATERAL = dmesh.CellType.triangle, dmesh.CellType.quadrilateral
ELEMENTS = [(TRIANGLE, 1, "P1"), (TRIANGLE, 2, "P2"), (QUADRILATERAL, 1, "Q1"), (QUADRILATERAL, 2, "Q2")]


class Membrane(helpers.Membrane):
    """tension = mu, load f = 8 below g = 0.3 on a unit square."""

    def __init__(self, cells=16, cell=TRIANGLE, degree=1):
        super().__init__(cells=cells, cell=cell, degree=degree)
        self.g = fem.Constant(self.mesh, PETSc.ScalarType(0.3))

    def problem(self, **more):
        return super().problem(**{"upper": self.g, **more})

    def of(self, F, **more):
        """Another form, with the same conditions and the same obstacle."""
        return ObstacleProblem(F, self.u, bcs=self.bc, upper=self.g, **more)


def same(one, other):
    """Whether two values agree to 1e-9."""
    return np.isclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("cell", "degree", "element"), ELEMENTS)
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_the_same_as_the_scene(cell, degree, element, method):
    """A cold start with the same eps: u, pressure, forces and Newton counts are those of a scene."""
    own = Membrane(cell=cell, degree=degree)
    found = own.problem().solve(eps=1e-6, method=method)
    scene = membrane(load=8, upper=0.3)
    answer = solve(scene, element=element, eps=1e-6, method=method, start="cold")
    assert found.iterations == answer.iterations
    assert same(found.force.upper, answer.force.upper) and found.force.lower is None
    assert same(found.area, answer.area) and same(found.energy, answer.energy)
    assert largest(COMM, found.pressure.x.array) <= 0
    points = np.random.default_rng(1).uniform(0.01, 0.99, (40, 2))
    for of in ("u", "pressure", "gap"):
        assert np.allclose(found.at(points, of), answer.at(points, of), rtol=1e-9, atol=1e-9), of


def at(*places):
    """Where x is one of these."""
    return lambda x: np.isclose(x[0][:, None], places).any(axis=1)


def held(own, place):
    """u = 0 there."""
    return fem.dirichletbc(PETSc.ScalarType(0), fem.locate_dofs_geometrical(own.V, at(place)), own.V)


def tagged(mesh, dim, where=lambda x: x[0] < 0.26, inside=False):
    """Cells, or facets of the boundary or also those inside, with the tag 3."""
    find = dmesh.locate_entities if inside or dim == mesh.topology.dim else dmesh.locate_entities_boundary
    there = np.sort(find(mesh, dim, where)).astype(np.int32)
    return dmesh.meshtags(mesh, dim, there, np.full(len(there), 3, np.int32))


@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_the_solver_can_be_looked_at(method):
    """`solver` has the counts, the reason and the options of the last SNES, and keeps no problem alive."""
    problem = helpers.Membrane(cells=48, load=30.0).problem(upper=0.3)
    assert problem.solver is None
    found = problem.solve(method=method)
    assert problem.solver.getConvergedReason() > 0 and problem.solver.ksp.getType() == "cg"
    assert problem.solver.getIterationNumber() == found.iterations
    inner = weakref.ref(problem._problem)
    del problem
    gc.collect()
    assert inner() is None


@pytest.mark.slow
def test_a_loop_over_loads_is_a_loop():
    """Constants, Functions, boundary values and obstacles that change are taken anew: the same as new problems."""
    own = Membrane()
    g = fem.Function(own.V)
    g.x.array[:] = 0.3
    problem = own.problem(upper=g, lower=lambda x: -0.1 + 0 * x[0])
    solutions = []
    for load, height, edge, mu in ((8, 0.3, 0, 1), (20, 0.2, 0, 1), (-9, 0.2, 0.05, 1), (-9, 0.2, 0.05, 3)):
        own.f.value, g.x.array[:], own.edge.x.array[:], own.mu.value = load, height, edge, mu
        found = problem.solve(eps=1e-7)
        u = found.u.x.array.copy()
        own.u.x.array[:] = 0
        alone = own.problem(upper=height, lower=-0.1).solve(eps=1e-7)
        assert largest(COMM, np.abs(alone.u.x.array - u)) < 1e-8
        assert np.isclose(found.force.upper, alone.force.upper, rtol=1e-7)
        assert np.isclose(found.force.lower, alone.force.lower, rtol=1e-7)
        assert np.array_equal(found.u.x.array, u)  # the next solve changes the caller's u alone
        solutions.append((found, found.force))
    assert all(found.force == force for found, force in solutions)  # an older solution keeps its figures
    assert largest(COMM, np.abs(solutions[0][0].upper.x.array - 0.3)) == 0  # and its obstacle


def test_the_matrix_is_kept(monkeypatch):
    """It is assembled anew only where coefficients in it have other values; starts are warm."""
    own, count = Membrane(), []
    problem = own.problem()
    first = problem.solve(eps=1e-7).iterations
    plain = fem.petsc.assemble_matrix
    monkeypatch.setattr(fem.petsc, "assemble_matrix", lambda *a, **k: (count.append(1), plain(*a, **k))[1])
    assert first > 2 and problem.solve(eps=1e-7).iterations <= 1 and not count
    own.f.value = 9.0
    problem.solve(eps=1e-7)
    assert not count
    own.mu.value = 2.0
    problem.solve(eps=1e-7)
    assert len(count) == 1
    problem.solve(eps=1e-7)
    assert len(count) == 1
    own.mu.value = 1.0  # as it was first
    problem.solve(eps=1e-7)
    assert len(count) == 2


def test_drift_that_begins_later():
    """An equation that stops being symmetric is solved as such."""
    own = Membrane()
    drift = fem.Constant(own.mesh, PETSc.ScalarType(0.0))
    own.F += drift * own.u.dx(0) * own.v * ufl.dx
    problem = own.problem()
    at_rest = problem.solve(eps=1e-7)
    assert at_rest.energy is not None
    drift.value = 10.0
    moved = problem.solve(eps=1e-7)
    assert moved.energy is None and problem.solver.ksp.getType() == "gmres"
    own.u.x.array[:] = 0
    assert np.isclose(own.problem().solve(eps=1e-7).force.upper, moved.force.upper, rtol=1e-7)


@pytest.mark.parametrize("method", ["penalty", "vi", "successive"])
def test_strong_drift_without_contact_is_one_linear_system(method):
    """The linear solver judges by the residual, which a preconditioner that strong drift spoils does not show."""
    own = Membrane(6)
    x = ufl.SpatialCoordinate(own.mesh)
    own.mu.value = 1e-3
    own.F += (3 * own.u.dx(0) - ufl.sin(7 * x[0])) * own.v * ufl.dx
    problem = own.problem(bcs=[held(own, 0)], upper=100.0)
    found = problem.solve(method=method)
    assert found.iterations == 1 and found.force.upper == 0 and found.verify()


def test_what_is_linear_is_found_out():
    """Derivatives free of u, and no condition with u in it; symmetric where the matrix is."""
    own = Membrane(4)
    u, v, grad, inner, dx = own.u, own.v, ufl.grad, ufl.inner, ufl.dx
    w = fem.Function(own.V)
    w.x.array[:] = np.arange(len(w.x.array))
    a = inner(grad(u), grad(v)) * dx
    linear = [a, a + w**2 * u * v * dx, a - ufl.conditional(ufl.gt(w, 1), 1.0, 2.0) * v * dx, (1 + abs(w)) * u * v * dx]
    bent = [
        a + u**3 * v * dx, ufl.sqrt(1 + inner(grad(u), grad(u))) * v * dx, a + abs(u) * v * dx,
        a + ufl.sign(u) * v * dx, a + ufl.conditional(ufl.gt(u, 0), 1.0, 0.0) * v * dx,
        a + ufl.max_value(u, 0) * v * dx,
    ]  # fmt: skip
    assert all(ResidualForm(F=F, u=u).affine and ResidualForm(F=F, u=u).symmetric for F in linear)
    assert not any(ResidualForm(F=F, u=u).affine for F in bent)
    skew = ResidualForm(F=a + u.dx(0) * v * dx, u=u)
    assert skew.affine and not skew.symmetric
    for tensor, symmetric in (([[2, 1], [1, 3]], True), ([[2, 1], [0, 3]], False)):  # only their matrices tell
        F = inner(ufl.as_matrix(tensor) * grad(u), grad(v)) * dx
        assert ResidualForm(F=F, u=u).symmetric == symmetric


@pytest.mark.slow
def test_jacobian_of_ones_own():
    """A derivative that leaves out a small term: more steps, the same solution."""
    own = Membrane()
    own.F += 0.5 * own.u**3 * own.v * ufl.dx
    exact = own.problem().solve(eps=1e-6)
    u, steps = own.u.x.array.copy(), exact.iterations
    own.u.x.array[:] = 0
    J = ufl.inner(ufl.grad(ufl.TrialFunction(own.V)), ufl.grad(own.v)) * ufl.dx
    found = own.problem(J=J).solve(eps=1e-6)
    assert found.iterations > steps
    assert largest(COMM, np.abs(found.u.x.array - u)) < 1e-7


def test_contact_on_a_part_of_the_boundary():
    """measure = ds(3): Signorini's obstacle, as in a scene with an obstacle in [[boundary]]."""
    own = Membrane()
    ds = ufl.Measure("ds", domain=own.mesh, subdomain_data=tagged(own.mesh, 1, at(1)))
    found = own.problem(bcs=[held(own, 0)], upper=0.5, measure=ds(3)).solve(eps=1e-8)
    sides = [{"on": "left", "value": 0}, {"on": "right", "upper": 0.5}]
    answer = solve(membrane(load=8, boundary=sides), eps=1e-8, start="cold")
    assert same(found.force.upper, answer.force.upper) and same(found.area, answer.area)
    for of in ("u", "pressure"):
        assert np.allclose(found.at((1, 0.5), of), answer.at((1, 0.5), of), rtol=1e-9)
    for measure, words in ((ds(7), "no facet is tagged 7"), (ufl.dx, "expected ds or dS")):
        with pytest.raises(InputError, match=words):
            own.problem(measure=measure)


@pytest.mark.parametrize(("kind", "place"), [("ds", 1.0), ("dS", 0.5)])
def test_a_measure_has_the_facets_of_its_kind(kind, place):
    """Tags on a side and on a line inside: ds has the side, dS the line; without a tag dS has all facets inside."""
    own = Membrane()
    measure = ufl.Measure(kind, domain=own.mesh, subdomain_data=tagged(own.mesh, 1, at(1.0, 0.5), inside=True))
    found = own.problem(bcs=[held(own, 0)], upper=0.01, measure=measure(3)).solve(method="vi")
    own_nodes = own.V.dofmap.index_map.size_local
    x, touching = own.V.tabulate_dof_coordinates()[:own_nodes, 0], found.contact.x.array[:own_nodes] > 0.5
    assert np.array_equal(touching, np.isclose(x, place)) and same(found.area, 1.0)
    if kind == "dS":
        everywhere = own.problem(upper=1e-6, measure=ufl.Measure(kind, domain=own.mesh)).solve(method="vi")
        assert largest(COMM, everywhere.u.x.array) < 1.1e-6


@pytest.mark.parametrize(("kind", "place"), [("ds", 1.0), ("dS", 0.5)])
def test_a_nonlinear_form_on_the_facets_of_the_contact(kind, place):
    """The tags of the caller in the form and in the measure of the contact: penalty and VI agree."""
    own, forces = Membrane(8), []
    measure = ufl.Measure(kind, domain=own.mesh, subdomain_data=tagged(own.mesh, 1, at(1.0, 0.5), inside=True))
    own.F += own.u**3 * own.v * ufl.dx - (ufl.avg(own.v) if kind == "dS" else own.v) * measure(3)
    for options in ({"eps": 1e-9}, {"method": "vi"}):
        own.u.x.array[:] = 0.0
        found = own.problem(bcs=[held(own, 0)], upper=0.01, measure=measure(3)).solve(**options)
        forces.append(found.force.upper)
    assert forces[0] == pytest.approx(forces[1], rel=1e-6) and forces[1] > 1


@pytest.mark.parametrize("cells", [2, 4, 16])
def test_measures_of_another_mesh(cells):
    """A measure or MeshTags of another mesh, for the contact or within a form: an error on all ranks."""
    own, other = Membrane(4), Membrane(cells)
    facets, inside = tagged(other.mesh, 1), tagged(other.mesh, 2)
    for measure, words in (
        (ufl.Measure("ds", domain=other.mesh, subdomain_data=facets)(3), "measure is of another mesh than u"),
        (ufl.Measure("ds", domain=other.mesh), "measure is of another mesh than u"),
        (ufl.Measure("ds", domain=own.mesh, subdomain_data=facets)(3), "measure: subdomain_data: these MeshTags"),
        (ufl.Measure("dS", subdomain_data=facets)(3), "measure: subdomain_data: these MeshTags belong to another mesh"),
        (ufl.Measure("ds", subdomain_data=facets), "measure: subdomain_data: these MeshTags belong to another mesh"),
        (ufl.Measure("ds", subdomain_data=tagged(own.mesh, 2))(3), "measure: subdomain_data = .*: expected MeshTags"),
    ):
        with pytest.raises(InputError, match=f"ObstacleProblem: {words}"):
            own.problem(measure=measure)
    for kind, tags in (("dx", inside), ("ds", facets)):
        loaded = own.F - own.v * ufl.Measure(kind, domain=own.mesh, subdomain_data=tags)(3)
        with pytest.raises(InputError, match="F: a measure: subdomain_data: these MeshTags belong to another mesh"):
            own.of(loaded)


@pytest.mark.parametrize("way", ["form", "scene"])
def test_a_mesh_that_was_moved(way):
    """A vertex of one rank is moved between two solves: an error on all ranks; a new problem has the new mesh."""
    own = Membrane(8)
    scene = Scene(mesh=own.mesh, tension=1, load=8, upper=0.3)

    def made():
        return own.problem() if way == "form" else scene.problem()

    problem = made()
    before = problem.solve().force.upper
    assert same(problem.solve().force.upper, before)
    if COMM.rank == COMM.size - 1:
        own.mesh.geometry.x[0] *= 1.01
    with pytest.raises(InputError, match="ObstacleProblem: the mesh was moved since this problem was created: create"):
        problem.solve()
    own.mesh.geometry.x[:] *= 2.0
    assert not same(made().solve().force.upper, before)


def test_a_scene_on_a_mesh_that_was_moved():
    """Each solve of a scene takes the mesh as it then is."""
    own = Membrane(8)
    given = {"mesh": own.mesh, "tension": 1, "load": lambda x: 8 + x[0], "upper": lambda x: 0.3 + 0.1 * x[1]}
    scene = Scene(**given)
    before = solve(scene, bound=True)
    own.mesh.geometry.x[:, 0] = 1 + 2 * own.mesh.geometry.x[:, 0]
    after, new = solve(scene, bound=True), solve(Scene(**given), bound=True)
    assert same(after.force.upper, new.force.upper) and same(after.bound.total, new.bound.total)
    assert same(after.area, new.area) and after.area > before.area


def on_a_part(own, tags, factor):
    """F on the tagged cells or facets alone, with a load on all cells."""
    kind = "dx" if tags.dim == own.mesh.topology.dim else "ds"
    some = ufl.Measure(kind, domain=own.mesh, subdomain_data=tags)(3)
    return factor * ufl.inner(ufl.grad(own.u), ufl.grad(own.v)) * some - own.f * own.v * ufl.dx


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("nonlinear", [False, True])
def test_forms_on_a_part_of_the_mesh(degree, nonlinear):
    """Nodes at which the derivative of F has no integral: named with the remedy, in place of an error of PETSc."""
    own = Membrane(4, degree=degree)
    factor = 1 + own.u**2 if nonlinear else 1
    nothing = dmesh.meshtags(own.mesh, 2, np.empty(0, np.int32), np.empty(0, np.int32))
    nodes = (4 * degree + 1) ** 2
    for tags, lost in ((tagged(own.mesh, 2), 15 if degree == 1 else 9 * 6), (tagged(own.mesh, 1), None)):
        words = rf"the derivative of F has no integral over the cells at {lost or '.*'} of {nodes} nodes, such as \("
        with pytest.raises(InputError, match=words):
            own.of(on_a_part(own, tags, factor))
    with pytest.raises(InputError, match="F: no cell has the tag 3, so that a term is zero"):
        own.of(on_a_part(own, nothing, factor))
    mass = factor * own.u * own.v * ufl.ds - own.f * own.v * ufl.dx
    inside = 1 if degree == 1 else 17
    with pytest.raises(InputError, match=rf"over the cells at {inside} of {nodes} .*: integrate over the whole domain"):
        ObstacleProblem(mass, own.u, upper=own.g)


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "degree", "cells"), [("quadrilateral", 1, 2), ("triangle", 2, 1)])
@pytest.mark.parametrize("eps", [1e-3, "auto"])
def test_forms_on_facets_do_not_reach_the_inside(cell, degree, cells, eps):
    """The middle node is on no facet: it is named, unless u is given there or normal derivatives reach it."""
    own = Membrane(cells, getattr(dmesh.CellType, cell), degree)
    u, v, n = own.u, own.v, ufl.FacetNormal(own.mesh)
    load = v * ufl.dx
    words = r"the derivative of F is zero at 1 of 9 nodes, such as \(0\.5, 0\.5\), .*: add an integral over the cells"
    for stiff in (u, u**3, ufl.inner(ufl.grad(u), n)):
        with pytest.raises(InputError, match=words):
            ObstacleProblem(stiff * v * ufl.ds - load, u, upper=0.1).solve(eps=eps)
    middle = fem.locate_dofs_geometrical(own.V, lambda x: np.isclose(x[0], 0.5) & np.isclose(x[1], 0.5))
    given = fem.dirichletbc(PETSc.ScalarType(0), middle, own.V)
    for F, bcs in ((u * v * ufl.ds - load, given), (ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.ds - load, [])):
        u.x.array[:] = 0.0
        assert ObstacleProblem(F, u, bcs=bcs, upper=0.1).solve(eps=eps).force.upper > 0


def test_terms_over_tags_that_nothing_has():
    """A load whose tag is misspelt, or ds in place of dS, would be left out without a word."""
    own = Membrane(8)
    tags = {"dx": tagged(own.mesh, 2, lambda x: x[0] < 0.5 + 1e-9), "ds": tagged(own.mesh, 1, at(0.5), inside=True),
            "dS": tagged(own.mesh, 1, at(0))}  # fmt: skip
    for kind, number, words in (
        ("dx", 5, "no cell has the tag 5"),
        ("dx", (5, 6), "no cell has the tag 5 or 6"),
        ("ds", 3, "no facet of the boundary has the tag 3, .*; ds is for facets of the boundary"),
        ("dS", 3, "no facet inside the domain has the tag 3"),
    ):
        v = ufl.avg(own.v) if kind == "dS" else own.v
        measure = ufl.Measure(kind, domain=own.mesh, subdomain_data=tags[kind])
        with pytest.raises(InputError, match=f"F: {words}"):
            own.of(own.F - own.f * v * measure(number))


@pytest.mark.slow
def test_forms_on_all_parts_of_the_mesh():
    """Integrals over all materials, one by one, are those over the mesh; so are those over all facets."""
    own = Membrane(8)
    expected = own.problem().solve(eps=1e-6).u.x.array.copy()
    count = own.mesh.topology.index_map(2)
    cells = np.arange(count.size_local + count.num_ghosts, dtype=np.int32)
    tags = dmesh.meshtags(own.mesh, 2, cells, cells % 2)
    dx = ufl.Measure("dx", domain=own.mesh, subdomain_data=tags)
    stiff = own.mu * ufl.inner(ufl.grad(own.u), ufl.grad(own.v))
    for F in (stiff * dx(0) + stiff * dx(1) - own.f * own.v * dx, stiff * dx((0, 1)) - own.f * own.v * dx):
        own.u.x.array[:] = 0
        found = own.of(F).solve(eps=1e-6)
        assert np.allclose(found.u.x.array, expected, atol=1e-9)
    jumps = ufl.avg(own.u) * ufl.avg(own.v) * ufl.dS - own.f * own.v * ufl.dx
    assert own.of(jumps).solve().force.upper > 0


def test_a_form_with_a_tag_alone():
    """dx(3) without MeshTags, which DOLFINx 0.5 takes for 0."""
    own = Membrane(4)
    for F in (own.F + own.v * ufl.dx(3), own.F + own.u * own.v * ufl.ds((1, 2))):
        with pytest.raises(InputError, match=r"F: a measure has the tag \d without MeshTags: give it subdomain_data="):
            own.of(F)


def test_options_belong_to_the_problem():
    """Two problems with a prefix each; the database is as before afterwards; a limit of steps is kept."""
    one, other = Membrane(), Membrane()
    before = PETSc.Options().getAll()
    hasty = one.problem(petsc_options_prefix="hasty_", petsc_options={"snes_max_it": 1, "ksp_rtol": 1e-2})
    with pytest.raises(NotConverged, match="in 1 step "):  # not once more for every line search
        hasty.solve(eps=1e-9)
    assert largest(COMM, np.abs(one.u.x.array)) == 0  # u is what it was
    assert other.problem(petsc_options_prefix="other_").solve(eps=1e-9).iterations > 1
    direct = other.problem(petsc_options={"ksp_type": "preonly", "pc_type": "cholesky" if COMM.size == 1 else "lu",
                                          "pc_factor_mat_solver_type": "mumps"})  # fmt: skip
    other.u.x.array[:] = 0
    found = direct.solve(eps=1e-9)
    assert found.record["krylov_iterations"] == found.iterations
    assert PETSc.Options().getAll() == before


def test_options_that_petsc_does_not_know():
    """A misspelled option is named once the solution is there; what PETSc refuses is named with the options."""
    own = Membrane()
    told = r"no solver uses: ksp_tpye$" if COMM.rank == 0 else None
    with pytest.warns(UserWarning, match=told) if told else nullcontext():
        found = own.problem(petsc_options={"ksp_tpye": "cg", "snes_max_it": 900}).solve(eps=1e-6)
    assert found.record["converged"]
    with pytest.raises(InputError, match=r"petsc_options = \{'pc_type': 'fast'\}: PETSc: .*fast"):
        own.problem(petsc_options={"pc_type": "fast"}).solve(eps=1e-6)


def test_a_mistake_on_one_rank_is_an_error_on_all():
    """The others do not wait for ever."""
    own = Membrane(cells=4)
    bcs = [3] if COMM.rank == COMM.size - 1 else own.bc
    with pytest.raises(InputError, match=r"bcs\[0\] = 3: expected what dolfinx.fem.dirichletbc returns"):
        own.problem(bcs=bcs)


def test_solutions_of_forms_are_compared(folder):
    """Two meshes, one solution saved and read: u differs by the error of the coarser one."""
    fine, coarse = (Membrane(cells=cells).problem().solve(eps=1e-8) for cells in (32, 16))
    fine.save(folder)
    found = compare(folder, coarse)
    assert found["outside"] == 0 and 0 < found["u"]["max"] < 0.1 * 0.3
    assert found["contact"]["jaccard"] > 0.5 and found["u"] == pytest.approx(compare(fine, coarse)["u"], rel=1e-12)


def test_steps_are_told():
    """The monitor sees the start as number 0 and every Newton step."""
    told = []
    found = Membrane().problem().solve(eps=1e-7, monitor=lambda number, step: told.append((number, step)))
    assert [number for number, _ in told] == list(range(len(told))) and len(told) >= found.iterations + 1
    assert told[-1][1].unbalanced <= 1e-10 * told[-1][1].forces


def test_along_a_line():
    """u, gap, pressure and slope of a known solution in 1D: u = x(1 - x) under g = 3/16 touches (1/4, 3/4)."""
    f, a = 6.0, 0.25  # u'' = -f, tangent to g at a: f a^2/2 = g
    own = helpers.Membrane(dmesh.create_interval(COMM, 64, [0.0, 1.0]), load=f)
    line = own.problem(upper=f * a**2 / 2).solve(method="vi").along([0], [1], n=129)
    exact = np.where(line.s < a, f * line.s * (a - line.s / 2), f * a**2 / 2)
    left = line.s <= 0.5
    assert np.abs(line.u - exact)[left].max() < f / 8 / 64**2 * 1.01
    assert np.abs(line.gap - (f * a**2 / 2 - line.u)).max() < 1e-14
    inner = (line.s > 0.3) & (line.s < 0.7)
    assert np.allclose(line.pressure[inner], -f) and np.abs(line.slope[inner]).max() < 1e-10
    assert np.abs(line.slope[left, 0] - np.maximum(f * (a - line.s[left]), 0)).max() < f / 64


def test_made_of_effects():
    """`scene.problem()`: the solution of the scene from a cold start, with its bound; forms have none."""
    scene = membrane(load=8, upper=0.3)
    problem = scene.problem(COMM)
    found, answer = problem.solve(bound=True), solve(scene, bound=True, start="cold")
    assert same(found.eps, answer.eps) and found.iterations == answer.iterations
    assert same(found.energy, answer.energy) and same(found.bound.total, answer.bound.total)
    assert found.record["bound"]["words"] == "certified"
    assert problem.solve(bound=True).iterations == 0
    with pytest.raises(InputError, match="bound=True needs tension and load as data, which cannot be read from a form"):
        Membrane(4).problem().solve(bound=True)


def test_meshes_that_are_none():
    """A quadrilateral that is not convex, whose last corner is pushed in, is rejected with its place."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.2, 0.2]])
    own = helpers.Membrane(helpers.mesh_of(points, [[0, 1, 2, 3]], "quadrilateral"))
    words = r"the quadrilateral at \(0.3, 0.3, 0\) has no area at a corner, or is not convex"
    with pytest.raises(InputError, match=words):
        own.problem(bcs=[], upper=1)


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "degree"), [(TRIANGLE, 1), (QUADRILATERAL, 2)])
def test_obstacles_with_several_values_at_a_node(cell, degree):
    """An obstacle has one value at each node; otherwise the last cell, and so the number of ranks, would decide."""
    own = Membrane(8, cell, degree)
    bent, straight = fem.Function(own.V), fem.Function(own.V)
    bent.interpolate(lambda x: 0.1 * np.abs(x[0] - 0.5))
    straight.interpolate(lambda x: 0.3 * x[0] - x[1])
    for wrong in (bent.dx(0) + 0.3, 0.3 + ufl.inner(ufl.grad(bent), ufl.as_vector([1, 2]))):
        with pytest.raises(InputError, match=r"upper is a UFL expression that is not continuous: at \(.*\) it is"):
            own.problem(upper=wrong)
    for wrong, word in ((ufl.FacetNormal(own.mesh)[0], "FacetNormal"), (ufl.avg(bent), "a restriction to one side")):
        with pytest.raises(InputError, match=f"upper holds {word}.*, which has no value at nodes"):
            own.problem(upper=wrong)
    exact = own.problem().solve(method="vi")
    size = ufl.CellDiameter(own.mesh) * 8 / 2**0.5
    for same_one in (straight.dx(0), 0.3 * size):
        found = own.problem(upper=same_one).solve(method="vi")
        assert largest(COMM, np.abs(found.u.x.array - exact.u.x.array)) < 1e-9


def test_common_mistakes():
    """u given everywhere, and options, monitors, obstacles and eps of another kind: one sentence each."""
    own = Membrane()
    every = fem.dirichletbc(fem.Function(own.V), np.arange(len(own.u.x.array), dtype=np.int32))
    for call, given, words in (
        (lambda **more: own.problem(**more).solve(), {"bcs": every}, "u is given at every node"),
        (lambda **more: own.problem(**more).solve(), {"upper": 1.0, "measure": ufl.ds},
         "at every node where the obstacle acts, so that the obstacle has no effect; "),
        (own.problem, {"petsc_options": "-ksp_type cg"}, "petsc_options = '-ksp_type cg': expected a dict"),
        (own.problem, {"petsc_options": {3: "cg"}}, "petsc_options = {3: 'cg'}: expected a dict"),
        (own.problem, {"petsc_options_prefix": 3}, "petsc_options_prefix = 3: expected a text"),
        (own.problem, {"form_compiler_options": "-O2"}, "form_compiler_options = '-O2': expected a dict"),
        (own.problem, {"jit_options": 3}, "jit_options = 3: expected a dict"),
        (own.problem().solve, {"monitor": 3}, "monitor = 3: expected a function"),
        (own.problem().solve, {"method": "newton"}, "method = 'newton': expected penalty, successive or vi"),
        *((own.problem().solve, {"rtol": rtol}, f"rtol = {rtol!r}: expected a number between 0 and 0.01")
          for rtol in (0.02, "1e-9", None)),
        *((lambda **more: penalty(own.u, own.v, **{"eps": 1e-3, **more}), given, f"penalty: {words}.*expected a number")
          for given, words in (
              ({"lower": lambda x: 0 * x[0]}, "the obstacle = "), ({"lower": np.zeros(3)}, "the obstacle = array"),
              ({"lower": 0, "eps": "auto"}, "eps = "), ({"lower": 0, "eps": np.ones(2)}, "eps = array"))),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            call(**given)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, {"method": "vi"}, {"eps": 1e-4}])
def test_a_wrong_sign_is_found_by_every_method(how):
    """Also a coefficient that changes: a negative and an infinite one, and one that is negative in some cells."""
    own = Membrane(8)
    problem = own.problem()
    for value, words in ((-1, "F has the wrong sign"), (np.nan, "is not a finite number"), (np.inf, "is not a finite")):
        own.mu.value = value
        with pytest.raises(InputError, match=words):
            problem.solve(**how)
    own.mu.value = 1.0
    assert problem.solve(**how).area > 0
    x = ufl.SpatialCoordinate(own.mesh)
    partly = ufl.conditional(ufl.lt(x[0], 0.5), 1, -2) * ufl.inner(ufl.grad(own.u), ufl.grad(own.v)) * ufl.dx
    own.u.x.array[:] = 0.0
    with pytest.raises(InputError, match=r"negative entries on its diagonal, at 28 of 81 nodes, such as \("):
        own.of(partly - own.f * own.v * ufl.dx).solve(**how)
    inflow = own.F + 300 * own.u.dx(0) * own.v * ufl.dx  # with cells of 1/8, and u given at the other end alone
    words = r"negative entries on its diagonal, at 9 .* Where drift enters at a free side"
    with pytest.raises(InputError, match=words):
        ObstacleProblem(inflow, own.u, bcs=held(own, 1), upper=own.g).solve(**how)
    drift = own.u.dx(0) * own.v * ufl.dx - own.v * ufl.dx
    with pytest.raises(InputError, match="the diagonal of the derivative of F is zero: add a term"):
        own.of(drift).solve(**how)


def test_forms_that_are_nonlinear_may_be_concave_at_the_start():
    """The sign of the derivative at the start does not condemn F; where F is not finite, that is said."""
    own = Membrane(8)
    u, v = own.u, own.v
    small = 1e-3 * ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    problem = ObstacleProblem(small + (u**3 - u + 0.1) * v * ufl.dx, u, bcs=own.bc, upper=0.8, lower=-0.8)
    with pytest.raises(InputError, match="derivative of F is negative at the start: if no sign in it is wrong, give"):
        problem.solve()
    with pytest.raises(InputError, match="is not a finite number: it is inf at"):
        ObstacleProblem(small + v / u * ufl.dx, u, bcs=own.bc, upper=0.8).solve()


@pytest.mark.parametrize("wrong", ["sign", "load", "none"])
def test_an_energy_of_another_form(wrong):
    """A minimal surface: an energy with the load's sign turned or without the load is not that of F."""
    own = Membrane(cells=8)
    area = ufl.sqrt(1 + ufl.inner(ufl.grad(own.u), ufl.grad(own.u))) * ufl.dx
    load = own.f * own.u * ufl.dx
    F = ufl.derivative(area - load, own.u, own.v)
    energy = {"sign": area + load, "load": area, "none": area - load}[wrong]
    with nullcontext() if wrong == "none" else pytest.raises(InputError, match="energy: its derivative is not F"):
        own.of(F, energy=energy)
    assert not own.u.x.array.any()
