"""What Python callers pass: obstacles of every kind in `ObstacleProblem`, and helpful errors for what is wrong."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

from fenicsx_obstacle import (
    Answer,
    Elasticity,
    InputError,
    ObstacleProblem,
    Scene,
    Solution,
    ball_gap,
    compare,
    contact_pressure,
    penalty,
    solve,
    study,
)
from fenicsx_obstacle.algebra.options import EpsFormula, SolverOptions
from fenicsx_obstacle.algebra.penalty_parameter import penalty_parameter
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.parallel import largest, total
from fenicsx_obstacle.releases import functionspace
from tests.conftest import COMM, membrane
from tests.helpers import Membrane, mixed_space
from tests.random.own_forms import OwnForm, judged


def bowl(x):
    return 0.1 + 0.4 * (x[0] - 0.5) ** 2 + 0.2 * x[1]


def square(cells=12, kind=dmesh.CellType.triangle, low=0.0, high=1.0):
    return dmesh.create_rectangle(COMM, [np.full(2, low), np.full(2, high)], [cells, cells], kind)


class Own(Membrane):
    """A residual of the caller's own: Poisson with load 8, u = 0 around."""

    def __init__(self, mesh=None, load=8.0):
        super().__init__(square() if mesh is None else mesh, load=load)

    def solve(self, eps=1e-6, method="penalty", **given):
        self.u.x.array[:] = 0.0
        return self.problem(**given).solve(eps=eps, method=method)

    def values(self, **given):
        """Of u with these arguments."""
        return self.solve(**given).u.x.array


def function(mesh, values, family="Lagrange", degree=1):
    found = fem.Function(functionspace(mesh, family, degree))
    found.interpolate(values)
    return found


@pytest.mark.parametrize(
    "made",
    [
        lambda own: lambda x: bowl(x),
        lambda own: bowl(ufl.SpatialCoordinate(own.V.mesh)),
        lambda own: function(own.V.mesh, bowl, degree=2),
        lambda own: function(square(24), bowl),
        lambda own: function(square(5), bowl, degree=2),
        lambda own: function(square(7, dmesh.CellType.quadrilateral), bowl, degree=2),
        lambda own: function(square(9, low=-0.3, high=1.2), bowl, degree=2),
    ],
    ids=["callable", "UFL", "P2", "finer mesh", "P2 on another mesh", "quadrilaterals", "larger mesh"],
)
def test_an_obstacle_of_any_kind_is_the_same_obstacle(made):
    """A callable, UFL, a Function of another space or on another mesh: taken at the nodes, each gives the same u."""
    own = Own()
    expected = own.values(upper=function(own.V.mesh, bowl))
    exact = not isinstance(made(own), fem.Function) or made(own).function_space.mesh is own.V.mesh
    coarse_p1 = 0.4 / 4 / 24**2  # the interpolation error of the bowl on the finer mesh
    assert largest(COMM, np.abs(own.values(upper=made(own)) - expected)) < (1e-12 if exact else coarse_p1 + 1e-12)


@pytest.mark.slow
def test_constants_for_numbers():
    """eps and an obstacle as Constants; a single Dirichlet condition without a list, and none."""
    own = Own()
    mesh = own.V.mesh
    expected = own.values(upper=0.3)
    for given in (
        {"upper": fem.Constant(mesh, 0.3)}, {"upper": np.float64(0.3), "eps": fem.Constant(mesh, 1e-6)},
        {"upper": 0.3, "eps": np.float32(1e-6)}, {"upper": 0.3, "bcs": own.bc}, {"upper": 0.3, "bcs": (own.bc,)},
        {"upper": lambda x: 0.3},
    ):  # fmt: skip
        assert largest(COMM, np.abs(own.values(**given) - expected)) < 1e-9
    own.F += 100 * own.u * ufl.TestFunction(own.V) * ufl.dx
    without = [own.values(upper=0.05, bcs=bcs) for bcs in (None, [])]
    assert largest(COMM, np.abs(without[0] - without[1])) < 1e-15 and largest(COMM, without[0]) > 0.05


def test_obstacles_that_cannot_be_taken():
    """Each message names the argument and the remedy, on all ranks together; nothing ends the process."""
    own, other = Own(), square(5)
    V, mesh = own.V, own.V.mesh
    x = ufl.SpatialCoordinate(mesh)
    cases = [
        (function(square(6, low=0.1), bowl), r"upper is a Function on another mesh, .* at \(0, 0\): is this point out"),
        (function(square(6, dmesh.CellType.quadrilateral, high=0.9), bowl), r"on another mesh, .* at \(0, 0\.9167\)"),
        (
            fem.Function(functionspace(mesh, "Lagrange", 1, 2)),
            "a Function with 2 components: expected a scalar",
        ),
        (function(mesh, bowl, "DG", 0), "not continuous"),
        (own.u, r"upper is u itself.*u\.copy\(\)"),
        (0.3 + own.u**2, "upper depends on u"),
        (ufl.SpatialCoordinate(other)[0], "defined on its own mesh only"),
        (x, r"an expression of shape \(2,\)"),
        (ufl.TestFunction(V) + 1, "holds a test or trial function"),
        (np.full(13**2, 0.3), r"upper = array\(.*expected a number, a Constant"),
        (True, "upper = True: expected a number, a Constant"),
        (lambda: 0.3, r"the callable takes x of shape \(3, n\).*TypeError"),
        (lambda x: x, "the callable takes x of shape"),
        (lambda x, y: 0.3 + y, "upper: the callable takes two arguments"),
        (fem.Constant(mesh, 0.3 + 0.1j), "upper is complex: expected real values"),
        (fem.Function(V, dtype=np.complex128), "upper is complex: expected real values"),
        (ufl.as_ufl(1j) * x[0], "upper is complex: expected real values"),
        (lambda x: np.nan * x[0], "upper = <lambda>: is not a finite number"),
        (lambda x: np.ma.masked_greater(x[0], 0.5), "upper = <lambda>: is not a finite number"),
        (float("nan"), "upper = nan: is not a finite number"),
    ]
    for g, message in cases:
        with pytest.raises(InputError, match=message):
            own.solve(upper=g)
    if COMM.size > 1:
        alone = dmesh.create_unit_square(MPI.COMM_SELF, 5, 5)
        with pytest.raises(InputError, match="on a mesh with another communicator"):
            own.solve(upper=fem.Function(functionspace(alone, "Lagrange", 1)))


def test_a_callable_that_fails_on_one_rank_fails_on_all():
    """An error on the rank that owns a corner reaches the others."""

    def steep(x):
        if np.any(x[0] + x[1] > 1.99):
            raise ZeroDivisionError("corner")
        return bowl(x)

    with pytest.raises(InputError, match="ZeroDivisionError: corner"):
        Own().solve(upper=steep)


@pytest.mark.parametrize(
    "eps, message",
    [("1e-6", "eps = '1e-6': expected a number, a Constant or 'auto'"), (-1.0, "eps = -1: must be positive"),
     (0, "eps = 0: must be positive"), (float("nan"), "eps = nan: must be positive"), (np.inf, "must be positive"),
     (True, "eps = True: expected"), ([1e-6], "expected a number"), ("Auto", "expected a number"),
     (1e-40, "below the limit of round-off")],
)  # fmt: skip
def test_eps_that_is_none(eps, message):
    """What eps may be, and what it is not."""
    with pytest.raises(InputError, match=message):
        Own().solve(upper=0.3, eps=eps)


def test_forms_and_conditions_of_another_kind():
    """Spaces, forms, conditions that are not those of u: named, with what is expected."""
    own, other = Own(), Own(square(5))
    V, u, F, mesh = own.V, own.u, own.F, own.V.mesh
    two = functionspace(mesh, "Lagrange", 2)
    v = ufl.TestFunction(V)
    cases = [
        ((F, V), {}, "u = .*expected the Function"),
        ((None, u), {}, "F = None: expected a UFL form, a linear form in one test function"),
        ((u * v * ufl.dx(domain=mesh) == 8 * v * ufl.dx(domain=mesh), u), {}, "F is an equation: give the residual"),
        ((ufl.inner(ufl.grad(ufl.TrialFunction(V)), ufl.grad(v)) * ufl.dx, u), {}, "no trial function"),
        ((8 * v * ufl.dx, u), {}, "F does not depend on u"),
        ((other.F, u), {}, "its test function is of another space"),
        ((F + other.u * v * ufl.dx(domain=mesh), u), {}, "F holds a Function or a measure of another mesh"),
        ((F + fem.Constant(mesh, 1j) * v * ufl.dx, u), {}, "F holds complex numbers"),
        ((F, u), {"energy": own.energy + ufl.imag(u) * ufl.dx}, "energy holds complex numbers"),
        ((F, u), {"energy": F}, "energy must be a functional of u"),
        ((F, u), {"J": 1}, "ObstacleProblem: J = 1: expected a UFL form, a bilinear form"),
        ((F, u), {"J": (u * v * ufl.TrialFunction(V) + v) * ufl.dx}, "J must be bilinear.* each of them exactly once"),
        *(
            ((form, u), {}, r"F must be linear in one test function.*must hold it exactly once")
            for form in (u * v * v * ufl.dx, u * ufl.sin(v) * ufl.dx, u / v * ufl.dx, F + (u * v + u) * ufl.dx)
        ),
        ((F, u), {"upper": None}, "ObstacleProblem: give an obstacle, lower= or upper="),
        ((F, u), {"lower": 0.4}, "lower is above upper"),
        ((F, u), {"lower": 0.1}, "ObstacleProblem: a value of bcs lies below the lower obstacle: 0 against"),
        ((F, u), {"bcs": 3}, "bcs = 3: expected a list"),
        ((F, u), {"bcs": [own.bc, None]}, r"bcs\[1\] = None: expected what dolfinx"),
        ((F, u), {"bcs": other.bc}, r"bcs\[0\] is of another space than u"),
        ((F, u), {"bcs": [fem.dirichletbc(fem.Function(two), np.zeros(0, np.int32))]}, "another space than u"),
    ]
    for (form, unknown), given, message in cases:
        with pytest.raises(InputError, match=message):
            ObstacleProblem(form, unknown, **{"bcs": [own.bc], "upper": 0.3, **given})


def test_warnings_of_tags_and_conditions_without_effect():
    """Some of the tags of a term that no facet of the boundary has, and a condition without dofs: a warning names each,
    on rank 0."""
    own = Own()
    mesh, v = own.V.mesh, ufl.TestFunction(own.V)
    left, middle = (dmesh.locate_entities(mesh, 1, lambda x, at=at: np.isclose(x[0], at)) for at in (0, 0.5))
    facets, numbers = np.concatenate([left, middle]), np.repeat([3, 5], [len(left), len(middle)]).astype(np.int32)
    order = np.argsort(facets)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=dmesh.meshtags(mesh, 1, facets[order], numbers[order]))
    none = fem.dirichletbc(fem.Function(own.V), np.zeros(0, dtype=np.int32))
    with warnings.catch_warnings(record=True, action="always") as caught:
        ObstacleProblem(own.F + v * ds(3), own.u, bcs=own.bc, upper=0.3)
    assert not [one for one in caught if "ObstacleProblem:" in str(one.message)]
    with warnings.catch_warnings(record=True, action="always") as caught:
        ObstacleProblem(own.F + v * ds(3) + v * ds(5) + v * ds(7), own.u, bcs=[own.bc, none], upper=0.3)
    found = [one for one in caught if "ObstacleProblem:" in str(one.message)]
    assert [str(one.message) for one in found] == ([] if COMM.rank else [
        "ObstacleProblem: F: no facet of the boundary has the tag 5 or 7; ds is for facets of the boundary, and dS for "
        "those inside",
        "ObstacleProblem: bcs[1] has no dofs, so that it has no effect",
    ])  # fmt: skip
    assert all(one.filename == __file__ for one in found)


def test_names_of_the_functions_of_a_solution(folder):
    """Each Function has a name of its own, which XDMFFile and ParaView need; u keeps the name of the unknown."""
    own = Own()
    own.u.name = "deflection"
    solution = ObstacleProblem(own.F, own.u, bcs=own.bc, upper=0.3).solve()
    names = [one.name for one in (solution.u, solution.pressure, solution.contact, solution.upper)]
    assert names == ["deflection", "pressure", "contact", "upper"]
    solution.save(folder)
    assert Solution.read(folder).u.name == "u"


@pytest.mark.parametrize("eps", [1e-6, "auto"])
def test_forms_whose_derivative_is_zero(eps):
    """Terms that cancel and a coefficient that is zero: the message says that F does not depend on u. FFCx of some
    releases compiles no form with a term that cancels: the message says so, and what to do, on all ranks alike."""
    own = Own()
    u, v, zero = own.u, ufl.TestFunction(own.V), fem.Constant(own.V.mesh, 0.0)
    dx = ufl.dx(domain=own.V.mesh)
    is_zero = "the derivative of F with respect to u is zero: F must depend on u"
    for F, message in (
        ((u.dx(0) - u.dx(0)) * v * dx - v * dx, is_zero),
        (zero * ufl.inner(ufl.grad(u), ufl.grad(v)) * dx - v * dx, is_zero),
        ((u - u) * v * dx, rf"{is_zero}|does a term vanish, as \(u - u\)\*v does\? leave it out; .*LiteralFloat"),
    ):
        u.x.array[:] = 0.0
        with pytest.raises(InputError, match=f"ObstacleProblem: .*({message})") as raised:
            ObstacleProblem(F, u, bcs=own.bc, upper=0.3).solve(eps=eps)
        assert len(set(COMM.allgather(str(raised.value)))) == 1


SPACES = {"P3": ("Lagrange", 3), "DG": ("DG", 1), "CR": ("CR", 1), "vector": ("Lagrange", 1, 2), "mixed": None}


WITHOUT_SOLUTION = {
    "the coarsest matrix of BoomerAMG is singular at some step: of three ranks two waited for the third": 120369,
    "loads that add up to 0: contact forces of 1e-16 held u, and the round-off of the load was taken for a support":
        140008,
    "the same where A depends on u": 140227,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.ranks
@pytest.mark.parametrize("seed", WITHOUT_SOLUTION.values(), ids=WITHOUT_SOLUTION)
def test_what_has_no_solution_ends_on_all_ranks(seed):
    assert judged(OwnForm(seed, COMM))[0] == "none"


@pytest.mark.parametrize("space", SPACES)
def test_unknowns_of_another_space(space):
    """Another space than Lagrange of degree 1 or 2 is named, and rejected before anything is compiled."""
    mesh, P1 = square(4), ("Lagrange", 1, None)
    u = fem.Function(mixed_space(mesh, P1, P1) if space == "mixed" else functionspace(mesh, *SPACES[space]))
    v = ufl.TestFunction(u.function_space)
    scalar = "u must be a continuous Lagrange Function of degree 1 or 2 and one"
    with pytest.raises(InputError, match="u is vector-valued: measure = None" if space == "vector" else scalar):
        ObstacleProblem(ufl.inner(u, v) * ufl.dx, u, upper=1.0)


def test_p2_on_tetrahedra_has_no_rule():
    own = Membrane(dmesh.create_unit_cube(COMM, 1, 1, 1), 2)
    with pytest.raises(InputError, match=r"no rule at the nodes of degree 2 on a tetrahedron has positive weights"):
        own.problem(upper=0.3)


@pytest.mark.slow
def test_names_of_scenes():
    """solve and study take the name of a scene in the catalogue; test_verify.py has files."""
    assert solve("ball", cells=8).record["scene"] == "ball"
    assert [row["cells"] for row in study("ball", {"cells": [4, 8]})] == [4, 8]


SCENE = membrane(load=8, upper=0.3).change({"mesh.cells": 4})
OWN = Own(square(2))
WRONG = {
    "there is no argument 'bc'; did you mean 'bcs'": lambda: OWN.problem(bc=OWN.bc, upper=0.3),
    "^ObstacleProblem: all arguments except F and u need a keyword, such as bcs=": lambda: ObstacleProblem(
        OWN.F, OWN.u, [OWN.bc], upper=0.3
    ),
    "Elasticity: there is no argument 'nu'": lambda: Elasticity(OWN.u, young=1, nu=0.3),
    "ball_gap: there is no argument 'center'; did you mean 'centre'": lambda: ball_gap(0, 0, center=0, radius=1),
    "solve: there is no argument 'methd'; did you mean 'method'": lambda: OWN.problem(upper=0.3).solve(methd="vi"),
    "solve: all arguments need a keyword, such as eps=": lambda: OWN.problem(upper=0.3).solve(1e-6),
    "penalty: there is no argument 'uper'; did you mean 'upper'": lambda: penalty(OWN.u, OWN.v, uper=0.3, eps=1e-3),
    "there is no argument 'lover'; did you mean 'lower'": lambda: contact_pressure(OWN.u, eps=1e-3, lover=0.3),
    "solve: scene = None: expected a Scene, a file": lambda: solve(None),
    "solve: tol = '0.3': expected a number": lambda: solve(SCENE, tol="0.3"),
    "--tol 5: the tolerance is relative and must be below 1": lambda: solve(SCENE, tol=5),
    "unknown effect 'bcs'; u on the boundary is given by boundary=": lambda: Scene(mesh={}, tension=1, bcs=[]),
    r"mesh = 'a\.msh': expected a DOLFINx mesh or a table such as .*file": lambda: Scene(mesh="a.msh", tension=1),
    "boundary: expected tables such as .*conditions of DOLFINx are for ObstacleProblem": lambda: Scene(
        mesh={"shape": "disk"}, tension=1, boundary=[OWN.bc]
    ),
    "--budget 5: expected limits such as": lambda: solve(SCENE, tol=0.3, budget="5"),
    "solve: cells = True: expected a whole number": lambda: solve(SCENE, cells=np.bool_(True)),
    "element = 'q1-Gauss' is not known; did you mean 'Q1-gauss'": lambda: solve(SCENE, element="q1-Gauss"),
    "method = 'VI' is not known; did you mean 'vi'": lambda: solve(SCENE, method="VI"),
    r"solve: eps = \[1\]: expected a number, a formula in h": lambda: solve(SCENE, eps=[1]),
    "solve: bound = 'no': expected True or False": lambda: solve(SCENE, bound="no"),
    r"solve: comm = None: expected mpi4py\.MPI\.Comm": lambda: solve(SCENE, comm=None),
    "study: vary = None: expected values by keys": lambda: study(SCENE, vary=None),
    "study: vary = {}: name a key": lambda: study(SCENE, vary={}),
    "unknown key 'cels'; did you mean 'cells'": lambda: study(SCENE, vary={"cels": [4]}),
    r"cells = \[\] cannot vary: expected a list of values": lambda: study(SCENE, vary={"cells": []}),
    "compare: a = None: expected a Solution, or the folder": lambda: compare(None, None),
    r"Scene\.read: path = None: expected a text or a path": lambda: Scene.read(None),
    r"Scene\.change: changes = None: expected a dict": lambda: SCENE.change(None),
    "unknown table or key '3'": lambda: SCENE.change({3: 4}),
    "mesh = None: expected a DOLFINx mesh or a table": lambda: Scene(mesh=None, tension=1),
    r"\[boundary\] = 3: expected a list": lambda: membrane(boundary=3),
    r"Answer\.read: folder = None: expected a text or a path": lambda: Answer.read(None),
    "a file, not the folder of a saved answer": lambda: Answer.read(__file__),
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
def test_wrong_arguments_are_named(message):
    """An InputError with the argument, or one that is similar, what came and what is expected."""
    with pytest.raises(InputError, match=message):
        WRONG[message]()


def test_points_of_another_kind():
    """at() says what it takes; save() and plot() take places."""
    answer = solve(SCENE)
    for points, got in ((None, "not nan|not None"), ("x", "not 'x'"), ([["x", 1]], r"not \[\['x', 1\]\]"),
                        (3, "not 3"), ([], r"not shape \(0,\)"), ([[0.1, 0.2], [0.3]], "not")):  # fmt: skip
        with pytest.raises(InputError, match=rf"at\(\) takes points, shape \(n, 2\), .*{got}"):
            answer.at(points)
    assert np.isnan(answer.at([0.5, np.nan])) and np.isfinite(answer.at(np.array([0.5, 0.5])))
    for of in (None, 3, ["u"]):
        with pytest.raises(InputError, match=r"at\(\) takes the name of a quantity, such as of='pressure', not of="):
            answer.at([0.5, 0.5], of)
    for ends, n in ((((0, 0), (1, 1)), 2.5), ((("a", 0), (1, 1)), 3), ((None, (1, 1)), 3), (((0, 0), (1, 1)), 1)):
        with pytest.raises(
            InputError, match=r"along\(\) takes two points with 2 coordinates each, and a whole number n"
        ):
            answer.along(*ends, n=n)
    with pytest.raises(InputError, match="save: folder = '': an empty name"):
        answer.save("")
    with pytest.raises(InputError, match=r"Solution\.save: folder = None: expected a text or a path"):
        answer.save(None)
    with pytest.raises(InputError, match=r"Solution\.plot: path = 3: expected a text or a path"):
        answer.plot(3)


def test_numbers_of_numpy_are_numbers():
    """Data, tolerances and numbers of cells from arrays."""
    scene = membrane(load=np.float32(8), upper=np.float64(0.3), tension=np.int64(1))
    record = solve(scene, cells=np.int32(8), tol=np.float32(0.5), eps=np.float64(1e-6)).record
    assert record["adaptive"]["reached"] and total(COMM, 1.0) == COMM.size


def test_a_single_part_of_the_boundary():
    """boundary= takes one table in place of a list of one table."""
    data = {"mesh": {"shape": "rectangle", "cells": 4}, "tension": 1, "load": -1}
    one, more = (Scene(**data, boundary=boundary) for boundary in ({"value": 0.1}, [{"value": 0.1}]))
    assert one.toml() == more.toml()


@pytest.mark.parametrize("dim", [2, 3])
def test_conditions_on_components_of_nodes(dim):
    """dirichletbc takes numbers of nodes for vector-valued u; twice unrolled they are beyond all dofs."""
    mesh = (dmesh.create_unit_square(COMM, 4, 4), dmesh.create_unit_cube(COMM, 2, 2, 2))[dim - 2]
    V = functionspace(mesh, "Lagrange", 1, dim)
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx
    nodes = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    unrolled = np.concatenate([dim * nodes + k for k in range(dim)]).astype(np.int32)
    bc = fem.dirichletbc(fem.Function(V), unrolled)
    with pytest.raises(InputError, match=r"bcs\[0\] has the dof \d+, which u does not have.* numbers of nodes"):
        ObstacleProblem(F, u, bcs=[bc], upper=0.0, of=u[0], measure=ufl.ds)


def test_eps_of_options():
    """A number is absolute; a formula in h is divided by the largest tension, alike from a scene and without one."""
    scene = membrane(upper=0.1, tension=4, define={"c": 2}).change({"mesh.cells": 8, "solve.eps": "c*h^2"})
    problem = SolverContext(scene, COMM).problem
    h = problem.level.h
    assert penalty_parameter(problem, scene.options) == pytest.approx(2 * h**2 / 4, rel=1e-14)
    own = SolverOptions(eps=EpsFormula("2*h^2", lambda h: 2 * h**2))
    assert penalty_parameter(problem, own) == penalty_parameter(problem, scene.options)
    assert penalty_parameter(problem, SolverOptions()) == penalty_parameter(problem, scene.options_with(eps="h^2/100"))
    assert penalty_parameter(problem, SolverOptions(eps=1e-3)) == 1e-3
    assert penalty_parameter(problem, scene.options_with(eps="c/1000")) == 2e-3


def test_answers_say_their_options():
    """The scene of an answer has the options of the solve in [solve], and gives the same options when read anew."""
    scene = membrane(upper=0.1, load=8, define={"c": 2}).change({"mesh.cells": 8, "solve.element": "P2"})
    context = SolverContext(scene, COMM)
    for options in (
        replace(context.scene.options, eps=1e-4),
        scene.options_with(eps="c*h", method="successive"),
        SolverOptions("vi", start="cold"),
        SolverOptions(),
    ):
        answer = context.answer(options)
        assert answer.scene.options == options and answer.record["method"] == options.method
        assert answer.scene.tables == answer.scene.change({}).tables
        assert answer.scene.change({}).options == options
        assert answer.record["element"] == "P2" == answer.scene.tables.solve.element
