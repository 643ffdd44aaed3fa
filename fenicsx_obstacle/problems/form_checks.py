"""Checks of the form F of an ObstacleProblem, of its derivative and of its energy."""

from __future__ import annotations

import numbers
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch, check_form_arity

from fenicsx_obstacle import releases
from fenicsx_obstacle.algebra.newton import diagonal_of
from fenicsx_obstacle.algebra.system import System
from fenicsx_obstacle.data.fields import foreign, is_complex
from fenicsx_obstacle.discrete.assembly import assembled
from fenicsx_obstacle.discrete.problem import Problem
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.mesh.around_nodes import AroundNodes
from fenicsx_obstacle.mesh.cells import own_cells
from fenicsx_obstacle.mesh.shared_dofs import points_of_nodes
from fenicsx_obstacle.parallel import first_given, largest, smallest, total, warn
from fenicsx_obstacle.problems.input_checks import ids_of
from fenicsx_obstacle.problems.residual_form import ResidualForm, expanded
from fenicsx_obstacle.text import one_line, shown

NEARBY = 0.01  # of u: so far from the start an energy is compared with F
ROUND_OFF = 1e-12  # of the largest entry of a matrix
CURVATURE = 1e-10  # of the sum of A_ii s_i^2: less is round-off
OTHER = 0.1  # of F: no quadrature of the same functional is so far off


def check_form(form: Any, u: fem.Function, place: str, arguments: int) -> None:
    """Reject arguments that are not forms of u with so many arguments, on the mesh and in the space of u.

    Args:
        form: What was given.
        u: The unknown.
        place: What messages call the form.
        arguments: 0 for a functional, 1 for a residual, 2 for its derivative.

    Raises:
        InputError: Naming what came, and what is expected.
    """
    kind, words, which = (
        ("a functional of u", "must be a functional of u", "not at all"),
        ("a linear form in one test function", "must be linear in one test function, and contain no trial function",
         "it exactly once"),
        ("a bilinear form in trial and test function", "must be bilinear, in a trial and a test function",
         "each of them exactly once"),
    )[arguments]  # fmt: skip
    if isinstance(form, ufl.equation.Equation):
        raise InputError(f"{place} is an equation: give the residual, a(u, v) - L(v), in place of a(u, v) == L(v)")
    if not isinstance(form, ufl.Form):
        raise InputError(f"{place} = {shown(form)}: expected a UFL form, {kind}")
    found = form.arguments()
    if len(found) != arguments:
        raise InputError(f"{place} {words}")
    if any(argument.ufl_function_space() != u.function_space for argument in found):
        raise InputError(f"{place}: its test function is of another space than u")
    if arguments < 2 and u not in form.coefficients():
        raise InputError(f"{place} does not depend on u: write it with the Function u, not a trial function")
    domain = u.function_space.mesh.ufl_domain()
    elsewhere = [integral for integral in form.integrals() if foreign(integral.integrand(), domain)]
    if elsewhere or any(one != domain for one in form.ufl_domains()):
        raise InputError(f"{place} holds a Function or a measure of another mesh than that of u")
    if any(is_complex(integral.integrand()) for integral in form.integrals()):
        raise InputError(f"{place} holds complex numbers: expected real ones; take the real part of its data")
    try:
        check_form_arity(expanded(form), found)
    except (Exception, ArityMismatch) as error:  # of UFL 2024 on, ArityMismatch is no Exception
        raise InputError(f"{place} {words}; every term must hold {which}") from error
    tagged = {one.integral_type() for one in form.integrals() if one.subdomain_data() is not None}
    for one in form.integrals():
        tags = [tag for tag in ids_of(one) if isinstance(tag, numbers.Integral)]
        if tags and one.integral_type() not in tagged:
            raise InputError(f"{place}: a measure has the tag {tags[0]} without MeshTags: give it subdomain_data=")


def check_integrals(form: ResidualForm, bcs: Sequence[Any], place: str) -> None:
    """Reject a form whose derivative has no integral over the cells of some nodes, or whose integrals over facets do
    not reach nodes inside the cells: its matrix has no entries there (collective).

    Args:
        form: The residual.
        bcs: Dirichlet conditions; where they hold, no integral over facets need reach.
        place: What messages call it.

    Raises:
        InputError: With the remedy.
    """
    V = form.u.function_space
    slope = form.slope if form.J is None else form.J
    integrals = expanded(slope).integrals()
    if any(one.integral_type() == "cell" and "everywhere" in ids_of(one) for one in integrals):
        return
    place = f"{place}: the derivative of F" if form.J is None else f"{place}: J"
    if not integrals:
        raise _zero(place)
    lost = ~_reached(integrals, V)
    comm, every = V.mesh.comm, V.dofmap.index_map.size_global
    count = total(comm, lost)
    if count == every:
        raise InputError(f"{place} has integrals over no cell: does a measure have a tag that no cell has?")
    if count > 0:
        raise InputError(
            f"{place} has no integral over the cells at {_some_of(lost, V)}: integrate over the whole domain, or solve "
            "on a mesh of the other cells alone, made by dolfinx.mesh.create_submesh"
        )
    by_facets = ~_reached([one for one in integrals if one.integral_type() == "cell"], V)
    if total(comm, by_facets) > 0:
        lost = by_facets & _has_zero_row(slope, form.u, bcs)
        if total(comm, lost) > 0:
            raise InputError(
                f"{place} is zero at {_some_of(lost, V)}, which its integrals over facets do not reach: add an "
                "integral over the cells, such as inner(grad(u), grad(v))*dx"
            )


def _reached(integrals: Sequence[ufl.Integral], V: fem.FunctionSpace) -> np.ndarray:
    """Whether an owned node is one of a cell that is in, or at a facet of, the domain of an integral (collective)."""
    dofs = releases.cell_dofs(V)[_cells_of(integrals, V.mesh)]
    return AroundNodes(V, dofs).sums(np.ones(dofs.shape))[: V.dofmap.index_map.size_local] > 0


def _has_zero_row(slope: ufl.Form, u: fem.Function, bcs: Sequence[Any]) -> np.ndarray:
    """Whether a row of an owned node is zero up to round-off for a random u, where u is not given (collective)."""
    V = u.function_space
    some, own, size = fem.Function(V), V.dofmap.index_map.size_local, V.dofmap.index_map_bs
    some.x.array[:] = np.random.default_rng(1).uniform(0.5, 1.5, len(some.x.array))
    some.x.scatter_forward()
    A = fem.petsc.assemble_matrix(releases.form(ufl.replace(slope, {u: some})))
    A.assemble()
    starts, _, values = A.getValuesCSR()
    A.destroy()
    most = np.zeros(own * size)
    np.maximum.at(most, np.repeat(np.arange(len(most)), np.diff(starts)), np.abs(values))
    for bc in bcs:
        dofs = np.asarray(bc.dof_indices()[0])
        most[dofs[dofs < len(most)]] = np.inf
    finite = np.where(np.isfinite(most), most, 0.0)
    return np.asarray((most <= ROUND_OFF * largest(V.mesh.comm, finite)).reshape(-1, size).any(axis=1))


def _some_of(lost: np.ndarray, V: fem.FunctionSpace) -> str:
    """The number of marked owned nodes, and one of them, in words (collective)."""
    points = points_of_nodes(V)[np.flatnonzero(lost)[:1], : V.mesh.geometry.dim].tolist()
    first = min(point for part in V.mesh.comm.allgather(points) for point in part)
    count, every = total(V.mesh.comm, lost), V.dofmap.index_map.size_global
    return f"{count:.0f} of {every} nodes, such as ({', '.join(f'{x:.4g}' for x in first)})"


def check_stiffness(problem: Problem, form: ResidualForm, place: str) -> None:
    """Reject an affine F whose derivative is not finite, is zero, or has negative entries on its diagonal (collective).

    It is zero if its terms cancel, or a coefficient is zero. With a negative diagonal entry the energy has no minimum,
    and where there is none, the obstacle problem may have several solutions.

    Args:
        problem: With the matrix of F.
        form: The form of the caller.
        place: What messages call the problem.

    Raises:
        InputError: With the remedy.
    """
    if not problem.affine:
        return
    comm, diagonal = problem.level.comm, problem.matrices.diagonal
    if total(comm, np.count_nonzero(~np.isfinite(diagonal))) > 0:
        refuse_not_finite(problem, form, place)
        raise InputError(f"{place}: the derivative of F is not finite, through a coefficient in it")
    size, free = problem.matrices.stiffness.norm(PETSc.NormType.INFINITY), ~problem.fixed
    if size == 0:
        raise _zero(f"{place}: the derivative of F")
    if 0 <= largest(comm, np.abs(diagonal[free])) <= ROUND_OFF * size:
        raise InputError(
            f"{place}: the diagonal of the derivative of F is zero: add a term with a(v, v) > 0, such as "
            "inner(grad(u), grad(v))*dx"
        )
    negative = free & (diagonal < -ROUND_OFF * size)
    count, every = total(comm, negative), total(comm, free)
    if 0 < count == every:
        raise _wrong_sign(f"{place}: every diagonal entry of the derivative of F is negative")
    if count > 0:
        drift = "" if problem.symmetric else " Where drift enters at a free side, give u there or take smaller cells."
        nodes = negative.reshape(-1, form.u.function_space.dofmap.index_map_bs).any(axis=1)
        raise InputError(
            f"{place}: the derivative of F has negative entries on its diagonal, at "
            f"{_some_of(nodes, form.u.function_space)}: has a term or a coefficient the wrong sign there? "
            f"a(v, v) must be positive.{drift}"
        )


def warn_of_indefinite(problem: System, form: ResidualForm | None, place: str) -> None:
    """Warn if a(s, s) < 0 for the difference s between u and a cold start, where F = a(u, v) - f(v) is symmetric
    (collective).

    Args:
        problem: At a solution.
        form: The form of the caller, or None.
        place: What messages call the problem.
    """
    if form is None or not (problem.affine and problem.symmetric):
        return
    comm = problem.comm
    s = np.where(problem.fixed, 0.0, problem.u - problem.in_components(problem.cold_start()))
    load = problem.law.forces_at(0.0)
    forces = problem.law.forces_at(s) - load
    curvature, size, of_load = (total(comm, one) for one in (s * forces, diagonal_of(problem) * s**2, np.abs(s * load)))
    if curvature < -CURVATURE * size - ROUND_OFF * of_load:
        warn(
            comm,
            f"{place}: F = a(u, v) - f(v) is not positive definite: a(s, s) = {curvature:.3g} for the difference s "
            "between u and a cold start, so that u is no minimum of an energy, and other solutions may exist: has a "
            "term the wrong sign?",
            stacklevel=5,
        )


def _zero(place: str) -> InputError:
    return InputError(f"{place} with respect to u is zero: F must depend on u, as a(u, v) - f(v) does")


def _wrong_sign(what: str) -> InputError:
    return InputError(f"{what}: F has the wrong sign; write F = a(u, v) - f(v) with a(v, v) > 0")


@contextmanager
def naming_compiler_errors(comm: MPI.Comm, place: str) -> Iterator[None]:
    """Turn an error of the form compiler into one that names F, the same on all ranks (collective).

    Raises:
        InputError: With the words of the compiler.
    """
    try:
        yield
    except Exception as error:
        # DOLFINx raises on all ranks what the compiler raises on one; its class depends on the release
        if all(frame.f_globals.get("__name__") != "dolfinx.jit" for frame, _ in traceback.walk_tb(error.__traceback__)):
            raise
        why = first_given(comm, one_line(f"{type(error).__name__}: {error}"))
        raise InputError(
            f"{place}: FFCx cannot compile F or its derivative: does a term vanish, as (u - u)*v does? leave it out; "
            f"{why}"
        ) from error


def _cells_of(integrals: Sequence[ufl.Integral], mesh: dmesh.Mesh) -> np.ndarray:
    """Owned cells that are in, or at a facet of, the domain of an integral (collective)."""
    W = releases.functionspace(mesh, "DG", 0)
    q = ufl.TestFunction(W)
    kinds = {"cell": q, "exterior_facet": q, "interior_facet": q("+") + q("-")}
    measured = [
        one.reconstruct(integrand=kinds[one.integral_type()], metadata={})
        for one in integrals
        if one.integral_type() in kinds
    ]
    if not measured:
        return np.empty(0, dtype=np.int64)
    sizes = assembled(ufl.Form(measured), W).x.array
    return np.flatnonzero(sizes[releases.cell_dofs(W)[: own_cells(mesh), 0]] > 0)


def check_tagged(form: ufl.Form, mesh: dmesh.Mesh, place: str) -> None:
    """Reject a term over tags that no cell has, or no facet of its kind: it is zero (collective).

    Of a term over several tags a warning names those that none has: the mesh may be too coarse for a small part.

    Args:
        form: With measures of this mesh.
        mesh: Mesh of u.
        place: What messages call the form.

    Raises:
        InputError: With the tags.
    """
    names = {"cell": "cell", "exterior_facet": "facet of the boundary", "interior_facet": "facet inside the domain"}
    terms: dict[Any, list[ufl.Integral]] = {}
    for one in form.integrals():  # UFL makes an integral for each of several tags
        numbered = hasattr(one.subdomain_data(), "find") and all(
            isinstance(tag, numbers.Integral) for tag in ids_of(one)
        )
        if numbered and one.integral_type() in names:
            terms.setdefault((one.integral_type(), one.integrand()), []).append(one)
    if not terms:
        return
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    owned = mesh.topology.index_map(dim - 1).size_local
    boundary = np.asarray(dmesh.exterior_facet_indices(mesh.topology))
    for (kind, _), integrals in terms.items():
        counts: dict[int, float] = {}
        for one in integrals:
            for tag in ids_of(one):
                found = one.subdomain_data().find(int(tag))
                if kind != "cell":
                    found = found[found < owned]
                    found = found[np.isin(found, boundary) == (kind == "exterior_facet")]
                counts[int(tag)] = total(mesh.comm, len(found))
        missing = [tag for tag, count in counts.items() if count == 0]
        tags = " or ".join(map(str, missing))
        remedy = "" if kind == "cell" else "; ds is for facets of the boundary, and dS for those inside"
        if missing and len(missing) == len(counts):
            raise InputError(f"{place}: no {names[kind]} has the tag {tags}, so that a term is zero{remedy}")
        if missing:
            warn(mesh.comm, f"{place}: no {names[kind]} has the tag {tags}{remedy}", stacklevel=4)


def refuse_not_finite(problem: Problem, form: ResidualForm, place: str) -> None:
    """Raise an error with the point at which F is not finite, if there is one (collective).

    Raises:
        InputError: With the place.
    """
    words = f"{place}: F at the start, through a coefficient or a load in it,"
    problem.data.refuse_infinite(assembled(form.F, problem.level.V), words=words)


def refuse_no_positive_diagonal(problem: Problem, diagonal: np.ndarray, form: ResidualForm | None, place: str) -> None:
    """Say why there is no eps = "auto": the derivative of F has no positive diagonal entry where an obstacle acts
    (collective).

    Args:
        problem: In its present state.
        diagonal: Of the derivative of F, at owned nodes where u is free.
        form: The form of the caller, or None.
        place: What messages call the problem.

    Raises:
        InputError: Always.
    """
    comm, weights = problem.level.comm, problem.weights[~problem.fixed]
    free, negative = (total(comm, number) for number in (len(weights), np.sum(diagonal < 0)))
    if not free:
        raise InputError(f"{place}: u is given at every node: there are no unknowns")
    if form is not None:
        refuse_not_finite(problem, form, place)
    slope = "the derivative of F" if form is None or form.J is None else "J"
    if negative == free:
        raise InputError(
            f"{place}: eps = 'auto': every diagonal entry of {slope} is negative at the start: if no sign in it is "
            "wrong, give a number, or start from another u"
        )
    if not total(comm, np.count_nonzero(weights > 0)):
        raise InputError(
            f"{place}: u is given at every node where the obstacle acts, so that the obstacle has no "
            "effect; leave it out, or give u on a smaller part of the boundary"
        )
    raise InputError(f"{place}: eps = 'auto': {slope} has no positive diagonal entry; give a number")


def check_energy(problem: Problem, diagonal: np.ndarray, form: ResidualForm, place: str) -> None:
    """Reject an energy without a minimum, or whose derivative is not F (collective).

    Args:
        problem: In its present state.
        diagonal: Of the derivative of F, at owned nodes where u is free.
        form: With F, u and the energy.
        place: What messages call the problem.

    Raises:
        InputError: If a diagonal entry is negative, as none of a convex energy is; or if F and the derivative of
            the energy differ near the start, by more than quadrature does.
    """
    u, level = form.u, problem.level
    comm, free = level.comm, ~problem.fixed
    least = smallest(comm, diagonal)
    if least < 0:
        raise InputError(
            f"{place}: the energy has no minimum: the derivative of F has {least:.3g} on its diagonal; "
            "is a sign wrong? without energy= any solution of the equation is accepted"
        )
    start, points = u.x.array.copy(), level.points_of(level.V)
    size = largest(comm, np.abs(start)) or 1.0
    u.x.array[:] += NEARBY * size * np.sin(1 + np.array([3.1, 4.7, 2.3]) @ points)
    forms = form.F, ufl.derivative(form.functional, u)
    residual, slope = (assembled(one, level.V).x.array[: level.owned] for one in forms)
    u.x.array[:] = start
    scale = max(largest(comm, np.abs(one[free])) for one in (residual, slope))
    if np.isfinite(scale) and largest(comm, np.abs(residual - slope)[free]) > OTHER * scale:
        raise InputError(
            f"{place}: energy: its derivative is not F: is a sign wrong, or a term missing in one of them?"
        )


def flat_start(problem: Problem, form: ResidualForm) -> str:
    """A clause for the message of an iteration that failed: where the derivative of F is zero at the start, Newton's
    method has no direction; empty if it is zero nowhere (collective).

    Args:
        problem: At the start.
        form: With u.
    """
    if problem.affine:
        return ""
    state = problem.vector()
    diagonal = problem.jacobian(state, penalised=False).getDiagonal()
    zero = ~problem.fixed & (np.abs(diagonal.array_r) <= ROUND_OFF * largest(problem.level.comm, diagonal.array_r))
    for owner in (state, diagonal):
        owner.destroy()
    V = form.u.function_space
    nodes = zero.reshape(-1, V.dofmap.index_map_bs).any(axis=1)
    if total(problem.level.comm, np.count_nonzero(nodes)) == 0:
        return ""
    return f"; the derivative of F is zero at the start at {_some_of(nodes, V)}: start from a u that is not flat there"
