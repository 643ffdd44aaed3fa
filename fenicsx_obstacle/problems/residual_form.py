"""The caller's own residual as an effect, and checks of what callers pass with it."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from petsc4py import PETSc
from ufl.algorithms import extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes
from ufl.classes import Abs, Condition, MaxValue, MinValue
from ufl.corealg.traversal import unique_pre_traversal

from fenicsx_obstacle import releases
from fenicsx_obstacle.discrete.fields import field, foreign, is_complex
from fenicsx_obstacle.discrete.mesh_tags import check_tags
from fenicsx_obstacle.effects.effect import Effect
from fenicsx_obstacle.effects.field import Field
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.parallel import total
from fenicsx_obstacle.text import shown

_NOT_SMOOTH = (Abs, Condition, MaxValue, MinValue)  # their derivative may hide that u decides
ROUND_OFF = 1e-12


@dataclass(frozen=True, eq=False)
class ResidualForm(Effect):
    """The residual F(u; v) of the caller as an effect.

    Attributes:
        F: Residual.
        u: Its unknown.
        functional: Whose derivative F is, or None.
        J: The derivative of F, or None for UFL's own.
    """

    value: Any = None
    F: ufl.Form = None
    u: fem.Function = None
    functional: ufl.Form | None = None
    J: ufl.Form | None = None

    key = "F"
    elastic = True

    @cached_property
    def affine(self) -> bool:  # type: ignore[override]
        """Whether F is linear in u plus what does not depend on u: its derivative is free of u, and no condition has
        u in it."""
        for integral in _plain(self.F).integrals():
            for node in unique_pre_traversal(integral.integrand()):
                if isinstance(node, _NOT_SMOOTH) and self.u in extract_coefficients(node):
                    return False
        return self.u not in _plain(self.slope).coefficients()

    @property
    def quadratic(self) -> bool:
        return self.affine and self.functional is None  # a given one may have another quadrature

    @property
    def slope(self) -> ufl.Form:
        """The derivative of F."""
        return ufl.derivative(self.F, self.u)

    @cached_property
    def symmetric(self) -> bool:  # type: ignore[override]
        """Whether the derivative of F is: read off an affine F as it is written, or else found on its matrix (first
        use is collective)."""
        if not self.affine:
            return self.functional is not None
        plain = _plain(self.slope)
        if plain.signature() == _plain(ufl.adjoint(plain)).signature():
            return True
        A = fem.petsc.assemble_matrix(releases.form(self.slope))
        A.assemble()
        found = is_symmetric(A)
        A.destroy()
        return found

    def look_again(self, A: PETSc.Mat) -> None:
        """Check again whether an affine F is symmetric, after its coefficients have changed (collective)."""
        self.__dict__["symmetric"] = is_symmetric(A)

    @property
    def convex(self) -> bool:  # type: ignore[override]
        return self.functional is not None or (self.affine and self.symmetric)

    def terms(self, u: Any, v: Any, data: Any) -> ufl.Form:
        return ufl.replace(self.F, {self.u: u, self.F.arguments()[0]: v})

    def derivative(self, u: Any, v: Any, data: Any) -> ufl.Form | None:
        if self.J is None or self.affine:
            return None
        return ufl.replace(self.J, {self.u: u, self.J.arguments()[0]: v})

    def u_values(self, data: Any) -> list[Any]:
        return [0.0]

    def energy(self, u: Any, data: Any) -> ufl.Form | None:
        if self.functional is not None:
            return ufl.replace(self.functional, {self.u: u})
        if not (self.affine and self.symmetric):
            return None
        # F(u; v) = a(u, v) - f(v), so that a(u, u)/2 - f(u) = (F(u; u) + F(0; u))/2
        zero = fem.Constant(data.level.mesh, np.zeros(self.u.ufl_shape, dtype=PETSc.ScalarType))
        return 0.5 * (self.terms(u, u, data) + self.terms(zero, u, data))


def _plain(form: ufl.Form) -> ufl.Form:
    """The form with derivatives carried out, in terms of components; factors of products are in UFL's order."""
    return remove_complex_nodes(apply_derivatives(apply_algebra_lowering(form)))


def is_symmetric(A: PETSc.Mat) -> bool:
    """Whether A x = A^T x up to round-off for a random x (collective)."""
    x, random = A.createVecRight(), PETSc.Random().create(A.comm)
    random.setInterval((-1.0, 1.0))
    x.setRandom(random)
    direct, transposed = A.createVecLeft(), A.createVecLeft()
    A.mult(x, direct)
    A.multTranspose(x, transposed)
    size = direct.norm(PETSc.NormType.INFINITY)
    direct.axpy(-1.0, transposed)
    found = direct.norm(PETSc.NormType.INFINITY) <= ROUND_OFF * max(size, transposed.norm(PETSc.NormType.INFINITY))
    for owner in (x, random, direct, transposed):
        owner.destroy()
    return bool(found)


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
    kinds = ("a functional of u", "a linear form in one test function", "a bilinear form in trial and test function")
    if not isinstance(form, ufl.Form):
        raise InputError(f"{place} = {shown(form)}: expected a UFL form, {kinds[arguments]}")
    found = form.arguments()
    if len(found) != arguments:
        words = (
            "must be a functional of u",
            "must be linear in one test function, and hold no trial function",
            "must be bilinear, in a trial and a test function",
        )[arguments]
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
    tagged = {one.integral_type() for one in form.integrals() if one.subdomain_data() is not None}
    for one in form.integrals():
        tags = [tag for tag in _ids(one) if isinstance(tag, numbers.Integral)]
        if tags and one.integral_type() not in tagged:
            raise InputError(f"{place}: a measure has the tag {tags[0]} without MeshTags: give it subdomain_data=")


def check_integrals(form: ResidualForm, place: str) -> None:
    """Reject a form whose derivative has no integral over the cells of some nodes: its matrix has no entries there
    (collective).

    Args:
        form: The residual.
        place: What messages call it.

    Raises:
        InputError: With the remedy.
    """
    V = form.u.function_space
    given = form.J is not None and not form.affine
    integrals = _plain(form.J if given else form.slope).integrals()
    if any(one.integral_type() == "cell" and "everywhere" in _ids(one) for one in integrals):
        return
    place = f"{place}: J" if given else f"{place}: the derivative of F"
    if not integrals:
        raise InputError(f"{place} with respect to u is zero: F must depend on u, as a(u, v) - f(v) does")
    reached = fem.Function(V)
    cells = _cells_of(integrals, V.mesh)
    nodes = reached.x.array.reshape(-1, V.dofmap.index_map_bs)
    nodes[releases.cell_dofs(V)[cells]] = 1.0
    releases.add_ghosts(reached)
    lost = np.flatnonzero(nodes[: V.dofmap.index_map.size_local, 0] == 0)
    comm, every = V.mesh.comm, V.dofmap.index_map.size_global
    count = total(comm, len(lost))
    if count == every:
        raise InputError(f"{place} has integrals over no cell: does a measure have a tag that no cell has?")
    if count > 0:
        points = V.tabulate_dof_coordinates()[lost[:1], : V.mesh.geometry.dim].tolist()
        where = ", ".join(f"{x:.4g}" for x in min(point for part in comm.allgather(points) for point in part))
        raise InputError(
            f"{place} has no integral over the cells at {count:.0f} of {every} nodes, such as ({where}): integrate "
            "over the whole domain, or solve on a mesh of the other cells alone, made by dolfinx.mesh.create_submesh"
        )


def _ids(integral: ufl.Integral) -> tuple[Any, ...]:
    """The tags of an integral, or 'everywhere'."""
    found = integral.subdomain_id()
    return found if isinstance(found, tuple) else (found,)


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
    sizes = fem.petsc.assemble_vector(releases.form(ufl.Form(measured)))
    sizes.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    own = mesh.topology.index_map(mesh.topology.dim).size_local
    found = np.flatnonzero(sizes.array_r[releases.cell_dofs(W)[:own, 0]] > 0)
    sizes.destroy()
    return found


def conditions(bcs: Any, V: fem.FunctionSpace, place: str) -> list[Any]:
    """Dirichlet conditions of V, from a list of them, one, or None.

    Raises:
        InputError: For anything else.
    """
    given = [] if bcs is None else [bcs] if hasattr(bcs, "dof_indices") else bcs
    if not isinstance(given, Sequence):
        raise InputError(f"{place}: bcs = {shown(bcs)}: expected a list of what dolfinx.fem.dirichletbc returns")
    for number, bc in enumerate(given):
        if not hasattr(bc, "dof_indices"):
            wanted = "expected what dolfinx.fem.dirichletbc returns"
            raise InputError(f"{place}: bcs[{number}] = {shown(bc)}: {wanted}")
        space = bc.function_space
        if not V._cpp_object.contains(getattr(space, "_cpp_object", space)):
            raise InputError(f"{place}: bcs[{number}] is of another space than u: take u.function_space for it")
    return list(given)


def number_of(eps: Any, place: str) -> float | str:
    """The value of eps: a positive number, or "auto".

    Raises:
        InputError: For anything else.
    """
    value = float(eps.value) if isinstance(eps, fem.Constant) and eps.ufl_shape == () else eps
    if isinstance(value, str) and value == "auto":
        return value
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InputError(f"{place}: eps = {shown(eps)}: expected a number, a Constant or 'auto'")
    number = float(value)
    if not 0 < number < np.inf:
        raise InputError(f"{place}: eps = {number:g}: must be positive and finite")
    return number


def obstacle(g: Any, u: fem.Function, place: str) -> Field:
    """An obstacle as a datum.

    Args:
        g: A Function of the space of u, of another one or on another mesh; a number, a UFL expression or a callable.
        u: The unknown, which g must not hold.
        place: What messages call it.

    Raises:
        InputError: If g is none of these, or holds u.
    """
    if g is u:
        raise InputError(f"{place} is u itself, which changes during the solve: pass a copy, u.copy()")
    if isinstance(g, ufl.core.expr.Expr) and u in extract_coefficients(g):
        raise InputError(
            f"{place} depends on u: an obstacle must not depend on the solution; for a fixed-point iteration "
            "use a copy, u.copy()"
        )
    return field(g, place)


def check_measure(measure: ufl.Measure | ufl.Integral, mesh: dmesh.Mesh, place: str) -> None:
    """Reject a measure, or the measure of an integral, whose domain or MeshTags are of another mesh (collective).

    Args:
        measure: What was given; its domain may be open.
        mesh: Mesh of u.
        place: What messages call it.

    Raises:
        InputError: If it is of another mesh.
    """
    domain, tags = measure.ufl_domain(), measure.subdomain_data()
    if domain is not None and domain != mesh.ufl_domain():
        raise InputError(f"{place} is of another mesh than u: take domain=u.function_space.mesh")
    codim = {"cell": 0, "exterior_facet": 1, "interior_facet": 1}.get(measure.integral_type())
    if codim is not None and hasattr(tags, "find"):
        check_tags(tags, mesh, mesh.topology.dim - codim, f"{place}: subdomain_data")


def facets_of(measure: Any, mesh: dmesh.Mesh, name: str) -> np.ndarray:
    """Local facets of a measure (collective).

    Raises:
        InputError: If it is no measure of facets of this mesh, or has no facets.
    """
    kinds = ("exterior_facet", "interior_facet")
    if not isinstance(measure, ufl.Measure) or measure.integral_type() not in kinds:
        raise InputError(f"{name}: measure = {shown(measure)}: expected ds or dS, of facets where contact can be")
    check_measure(measure, mesh, f"{name}: measure")
    tags, ids = measure.subdomain_data(), measure.subdomain_id()
    if ids == "everywhere" or ids == ("everywhere",):
        mesh.topology.create_connectivity(mesh.topology.dim - 1, mesh.topology.dim)
        found = np.asarray(dmesh.exterior_facet_indices(mesh.topology), dtype=np.int32)
    elif not hasattr(tags, "find"):
        raise InputError(f"{name}: measure has the tag {ids} without MeshTags: give it subdomain_data=")
    else:
        wanted = ids if isinstance(ids, tuple) else (ids,)
        found = np.unique(np.concatenate([tags.find(number) for number in wanted])).astype(np.int32)
    if total(mesh.comm, len(found)) == 0:
        raise InputError(f"{name}: measure has no facets: no facet is tagged {ids}")
    return found
