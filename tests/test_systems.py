"""Obstacle problems given as matrices, with truths of dense linear algebra."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from petsc4py import PETSc
from scipy.optimize import lsq_linear

from fenicsx_obstacle import InputError, solve_system
from fenicsx_obstacle.algebra.data_scales import determined, stiffness_of
from fenicsx_obstacle.algebra.linear_solvers import Collapsed, attempt, check_diagonal
from fenicsx_obstacle.algebra.solve_system import MatrixSystem
from tests.conftest import COMM
from tests.helpers import run_python

MANY = {1: 1000, 2: 40}.get(COMM.size, 20)  # ranks wait for each other
WITHOUT_DOLFINX = """
import sys
sys.modules["dolfinx"] = sys.modules["ufl"] = None
import numpy as np
from fenicsx_obstacle import solve_system
A = 3 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
found = solve_system(A, np.ones(4), upper=0.4, method="vi")
assert np.allclose(A @ found.u + found.pressure * -1, 1), found
"""


def owned(n):
    """The first and the last owned row of n; ranks may own none."""
    share = PETSc.Vec().createMPI(n, comm=COMM)
    rows = share.getOwnershipRange()
    share.destroy()
    return rows


def distributed(A):
    """A matrix of NumPy or SciPy as one of PETSc whose rows are distributed (collective)."""
    first, last = owned(A.shape[0])
    rows = scipy.sparse.csr_matrix(A)[first:last]
    csr = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data
    return PETSc.Mat().createAIJ(2 * ((last - first, A.shape[0]),), csr=csr, comm=COMM)


def gathered(values):
    return np.concatenate(COMM.allgather(values))


def m_matrix(random, n, singular=False):
    """A random symmetric M-matrix: a graph's Laplacian with conductances over six decades, and supports."""
    graph = np.zeros((n, n))
    for i in range(1, n):
        graph[i, random.integers(i)] = 10 ** random.uniform(-3, 3)  # connected
    more = random.random((n, n)) < 2 / n
    graph += np.triu(more * 10 ** random.uniform(-3, 3, (n, n)), 1)
    graph += graph.T
    support = np.zeros(n) if singular else (random.random(n) < 0.3) * random.random(n) * graph.max()
    support[0] += 0 if singular else graph.max()
    return np.diag(graph.sum(axis=1) + support) - graph


def truth(A, f, lower, upper, given):
    """The minimiser between the bounds by SciPy's bounded least squares; `given` is not-a-number where u is free."""
    u = np.where(lower == upper, lower, given)
    free = np.isnan(u)
    if free.any():
        rest = f[free] - A[np.ix_(free, ~free)] @ u[~free]
        L = np.linalg.cholesky(A[np.ix_(free, free)])
        u[free] = lsq_linear(L.T, np.linalg.solve(L, rest), (lower[free], upper[free]), method="bvls", tol=1e-15).x
    return u


@st.composite
def problems(draw):
    """M-matrices with bounds of one or both sides, nodes whose bounds meet, and given values."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = draw(st.integers(2, 25))
    A = m_matrix(random, n)
    f = random.normal(size=n) * np.diag(A).mean()
    width = 10.0 ** draw(st.integers(-3, 1))
    lower, upper = -width * random.random(n), width * random.random(n)
    sides = draw(st.sampled_from(["both", "lower", "upper", "none", "equal somewhere"]))
    lower = np.full(n, -np.inf) if sides in ("upper", "none") else lower
    upper = np.full(n, np.inf) if sides in ("lower", "none") else upper
    if sides == "equal somewhere":
        upper[::3] = lower[::3] = 0.0
    fixed = random.random(n) < draw(st.sampled_from([0, 0.2]))
    return A, f, lower, upper, fixed, 10 ** random.uniform(-2, 2, n)


def check(found, A, f, lower, upper, fixed, weights, eps):
    """Equilibrium, signs of the pressure, and distance from the truth."""
    u, p = gathered(found.u), gathered(found.pressure)
    free, size = ~fixed, np.abs(f).sum() + np.abs(A).max()
    assert np.abs(A @ u - f - weights * p)[free].sum() <= 1e-8 * size
    exact = truth(A, f, lower, upper, np.where(fixed, u, np.nan))
    # 0 <= |u_eps - u| <= eps max |p| on an M-matrix
    off = (0.0 if eps is None else eps * np.abs(p).max()) + 1e-7 * max(np.ptp(exact), np.abs(exact).max(), 1e-300)
    assert np.abs(u - exact).max() <= off
    held = np.where(p > 0, u - lower, np.where(p < 0, upper - u, 0.0))
    assert np.all(held <= off) and np.array_equal(np.sign(p), -gathered(found.contact))


def solved(A, f, lower, upper, fixed, weights, **how):
    """`solve_system` on this rank's rows."""
    first, last = owned(len(f))
    mine = slice(first, last)
    return solve_system(distributed(A), f[mine], lower=lower[mine], upper=upper[mine], fixed=fixed[mine],
                        weights=weights[mine], **how)  # fmt: skip


@pytest.mark.filterwarnings("ignore::fenicsx_obstacle.PenetrationWarning")
@settings(max_examples=MANY, deadline=None, derandomize=True, database=None)
@given(problems(), st.sampled_from(["vi", 1e-3, 1e-8]))
def test_random_matrices(problem, how):
    """vi is the truth; the penalty is eps max |p| off, at most."""
    A, weights = problem[0], problem[5]
    if how == "vi":
        check(solved(*problem, method="vi"), *problem, None)
    else:
        compliance = weights / np.diag(A)
        eps = max(how * float(np.min(compliance)), 1e-14 * float(np.max(compliance)))
        check(solved(*problem, eps=eps), *problem, eps)


@settings(max_examples=MANY // 2, deadline=None, derandomize=True, database=None)
@given(problems())
def test_auto(problem):
    """eps = "auto" penetrates by 1 % of the range of u, at most, and says which eps it took."""
    found = solved(*problem)
    check(found, *problem, found.eps)
    lower, upper, fixed = problem[2:5]
    u = gathered(found.u)
    beyond = np.maximum(np.maximum(lower - u, u - upper), 0)[~fixed].max(initial=0)
    height = np.ptp(np.clip(u, lower, upper))  # 0 where bounds hold all of u at one value: no scale
    assert beyond <= 0.01 * height + 1e-12 * np.abs(u).max() or height < 1e-8 * beyond


@settings(max_examples=MANY // 2, deadline=None, derandomize=True, database=None)
@given(st.integers(0, 2**32), st.integers(2, 20), st.sampled_from(["vi", "penalty"]))
def test_contact_alone(seed, n, method):
    """A maps constants to 0: the load presses against bounds, which alone hold u."""
    random = np.random.default_rng(seed)
    A, upper = m_matrix(random, n, singular=True), random.random(n)
    f = np.diag(A).mean() * (0.2 + random.random(n))
    weights, none, nowhere = np.ones(n) / np.diag(A).max(), np.full(n, -np.inf), np.zeros(n, dtype=bool)
    found = solved(A, f, none, upper, nowhere, weights, method=method)
    u, p = gathered(found.u), gathered(found.pressure)
    assert np.abs(A @ u - f - weights * p).sum() <= 1e-6 * f.sum()
    assert np.all(p <= 0) and -weights @ p == pytest.approx(f.sum(), rel=1e-6)
    assert np.all(u <= upper + (0 if found.eps is None else found.eps * np.abs(p).max()) + 1e-9)


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_a_part_that_nothing_holds(method, fixed):
    """Of two chains of springs without a common row a bound, or a given value, of one holds the other no more."""
    n = 20
    chain = np.diag(np.r_[1.0, np.full(n - 2, 2.0), 1.0]) - np.eye(n, k=1) - np.eye(n, k=-1)
    A, none = scipy.linalg.block_diag(chain, chain), np.full(n, np.inf)
    flags, lower = np.arange(2 * n) < int(fixed), np.r_[np.full(n, -1.0), -none]

    def solution(of_second, upper):
        f = np.r_[np.full(n, -0.05), of_second]
        return gathered(solved(A, f, lower, np.r_[none, upper], flags, np.ones(2 * n), method=method).u)

    for load in (np.r_[0.1, np.zeros(n - 2), -0.1], np.full(n, 0.03)):  # balanced, and where there is no bound
        with pytest.raises(InputError, match=r"A maps constants to 0.*presses against no bound"):
            solution(load, none)
    u = solution(np.full(n, 0.03), np.full(n, 2.0))
    assert np.abs(u[n:] - 2).max() < 1e-3 and (abs(u[0]) if fixed else np.abs(u[:n] + 1).max()) < 1e-3


def laplacian(n):
    """Five points on a square of n x n cells: A, coordinates, rows on the edge."""
    line, one = scipy.sparse.diags([-1, 2, -1], [-1, 0, 1], shape=(n + 1, n + 1)), scipy.sparse.identity(n + 1)
    A = scipy.sparse.kron(line, one) + scipy.sparse.kron(one, line)
    x = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, n + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    return A, x, np.any((x == 0) | (x == 1), axis=1)


@pytest.mark.parametrize("far", [1e20, 1e30, PETSc.INFINITY, np.inf])
@pytest.mark.parametrize("method", ["penalty", "vi"])
def test_far_bounds_are_none(far, method):
    """What means that there is no bound changes nothing, also where it stands beside a bound."""
    A, x, edge = laplacian(16)
    mine = slice(*owned(len(x)))
    given = {"fixed": edge[mine], "weights": 1 / 256, "method": method}
    lower = np.where(x[mine, 0] < 0.5, -0.1, -far)
    one, other = (
        solve_system(distributed(A), -8 / 256, lower=low, upper=high, **given)
        for low, high in ((lower, far), (np.where(np.isclose(lower, -0.1), lower, -np.inf), None))
    )
    assert np.array_equal(one.u, other.u) and one.iterations == other.iterations and one.eps == other.eps


@pytest.mark.parametrize("how", [{}, {"eps": 1e-8}, {"method": "vi"}])
def test_steps_do_not_depend_on_the_size(how):
    """With coordinates coarse levels give the start."""
    steps = []
    for n in (40, 80, 160):
        A, x, edge = laplacian(n)
        mine = slice(*owned(len(x)))
        found = solve_system(distributed(A), -8.0 / n**2, lower=-0.3, fixed=edge[mine], weights=1.0 / n**2,
                             points=x[mine], **how)  # fmt: skip
        assert len(found.levels) > 1
        steps.append(found.iterations)
    assert max(steps) <= 4


@pytest.mark.ranks
@pytest.mark.parametrize(("given", "words"), [
    ({"lower": 1.0, "upper": 0.0}, "lower is above upper at 3 rows"),
    ({"lower": np.inf, "upper": np.inf}, "lower is inf at 3 rows"),
    ({"upper": -1e20}, "upper is -inf at 3 rows"),
    ({"weights": [1.0, 0.0, 1.0]}, "weights: must be positive at 1 row"),
    ({"f": [1.0, np.nan, 1.0]}, "f: holds values that are not finite"),
    ({"f": np.ma.masked_equal([1.0, 2.0, 1.0], 2.0)}, "f: holds values that are not finite"),
    ({"f": [1.0, 2.0]}, "f: expected a number, or an array of 3 numbers"),
    ({"fixed": [3], "given": 2.0}, "fixed: expected 3 flags, or numbers of owned rows from 0 to 2"),
    ({"fixed": [0], "given": 2.0, "upper": 1.0}, "given values are not between the bounds at 1 row"),
    ({"A": -np.eye(3)}, "A: must be positive definite, but the diagonal is not positive at 3 rows"),
    ({"A": np.ones((3, 2))}, "A: expected a square matrix, it has 3 rows and 2 columns"),
    ({"A": 3 * np.eye(3) - np.ones((3, 3))}, "presses against no bound"),
    ({"points": np.zeros((3, 4))}, "points: expected finite coordinates of the shape"),
    ({"points": np.zeros(3), "method": "successive"}, "points: expected finite coordinates of the shape"),
    ({"A": scipy.sparse.csr_matrix(np.diag([2.0, 2.0, 0.0])), "fixed": [2]}, "A: no diagonal entry .* at 1 row"),
    ({"A": 2j * np.eye(3)}, "A: expected real numbers, not complex ones"),
    ({"f": np.array([1.0, 1j, 0.0])}, "f: expected real numbers, not complex ones"),
    ({"A": PETSc.Mat().createAIJ(3, nnz=1, comm=MPI.COMM_SELF)}, "A: the matrix is not assembled"),
    ({"fixed": [1, 0, 0]}, "fixed: zeros and ones for all 3 rows"),
    ({"method": "newton"}, "method = 'newton'"),
    ({"eps": -1.0}, "eps = -1"),
])  # fmt: skip
def test_wrong_arguments(given, words):
    arguments = {"A": 2 * np.eye(3), "f": 1.0, **given}
    with pytest.raises(InputError, match=words):
        solve_system(arguments.pop("A"), arguments.pop("f"), comm=MPI.COMM_SELF, **arguments)


@pytest.mark.serial
@pytest.mark.parametrize("kind", ["csr", "csc", "coo"])
def test_entries_in_any_order_and_in_pieces(kind):
    """Entries of a matrix may stand in pieces, which add up, and share their arrays with another matrix."""
    rows = np.tile(np.arange(6), 4)
    columns = rows + np.repeat([0, 0, -1, 1], 6)
    values = np.repeat([1.0, 1.0, -1.0, -1.0], 6)
    inside = (columns >= 0) & (columns < 6)
    order = np.argsort(rows[inside], kind="stable")
    rows, columns, values = (array[inside][order] for array in (rows, columns, values))
    starts = np.searchsorted(rows, np.arange(7))
    A = scipy.sparse.csr_matrix((values, columns, starts)).asformat(kind)
    indices = columns.copy()
    found = solve_system(A, -1.0, lower=-2.0, method="vi", comm=MPI.COMM_SELF)
    assert found.u == pytest.approx([-1.5, -2, -2, -2, -2, -1.5])
    assert np.array_equal(columns, indices) and values[0] == 1.0


def test_an_error_on_one_rank_is_one_on_all():
    A = distributed(3 * np.eye(9))
    first, last = owned(9)
    f = np.where(np.arange(first, last) == 0, np.nan, 1.0)
    with pytest.raises(InputError, match="f: holds values"):
        solve_system(A, f)


@pytest.mark.ranks
@pytest.mark.parametrize("bad", [0.0, np.inf, np.nan])
def test_a_diagonal_that_has_collapsed_is_seen_on_all_ranks(bad):
    """The row of one rank ends the linear solver on all: BoomerAMG would end it on that rank alone."""
    A = distributed(np.eye(9))
    check_diagonal(A, COMM)
    if A.getOwnershipRange()[0] == 0:
        A.setValue(0, 0, bad)
    A.assemble()
    with pytest.raises(Collapsed):
        check_diagonal(A, COMM)
    assert not attempt(lambda: check_diagonal(A, COMM))


@pytest.mark.serial
def test_without_dolfinx():
    """petsc4py, mpi4py and NumPy are enough."""
    done = run_python(WITHOUT_DOLFINX)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("support", "so"), [(1.0, True), (1e-10, True), (1e-14, False)])
def test_the_data_determine_u_where_its_round_off_is_small_against_their_forces(support, so):
    """A chain of springs on a soft one: epsilon times 2 u, u = 20/support, is above 1 % of the load below 9e-13."""
    n = 21
    A = np.diag(np.r_[1.0, np.full(n - 2, 2.0), 1.0]) - np.eye(n, k=1) - np.eye(n, k=-1)
    A[:2, :2] += (support - 1) * np.array([[1, -1], [-1, 1]])
    u = np.r_[0.0, np.linalg.solve(A[1:, 1:], np.ones(n - 1))]
    first, last = owned(n)
    fixed = np.arange(first, last) == 0
    system = MatrixSystem(distributed(A), np.ones(last - first), weights=np.ones(last - first), fixed=fixed,
                          given=np.zeros(last - first), lower=None, upper=None)  # fmt: skip
    system.set_reference(u[first:last])
    nowhere = np.zeros(last - first, dtype=np.int8)
    assert determined(system, nowhere, stiffness_of(system, exact_bounds=True), 0.0) is so


def test_a_constant_in_u_takes_no_digit_from_the_energy():
    """A chain of springs and u = 1e6 plus a wave of size 1: the energy is that of the differences and the support."""
    n, c = 64, 1e6
    wave, springs, (first, last) = np.sin(np.arange(n)), np.random.default_rng(1).uniform(0.1, 10, n - 1), owned(n)
    ends = np.zeros((n - 1, n))
    ends[np.arange(n - 1), np.arange(n - 1)], ends[np.arange(n - 1), np.arange(1, n)] = -1.0, 1.0
    A = ends.T @ (springs[:, None] * ends)
    A[0, 0] += 1e-9
    own = last - first
    system = MatrixSystem(distributed(A), np.zeros(own), weights=np.ones(own), fixed=np.zeros(own, dtype=bool),
                          given=np.zeros(own), lower=np.full(own, -2 * c), upper=None)  # fmt: skip
    system.set_reference((wave + c)[first:last])
    true = (springs @ np.diff(wave) ** 2 + (A[0, 0] - springs[0]) * (wave[0] + c) ** 2) / 2
    assert system.matrices.work() == pytest.approx(true, rel=1e-8)
