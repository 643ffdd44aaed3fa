"""Linear elasticity in UFL: in space, in plane strain, plane stress, with axial symmetry; gaps to rigid bodies."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fenicsx_obstacle import releases
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.forms.pairs import SIMPLICES
from fenicsx_obstacle.parallel import largest, smallest, warn
from fenicsx_obstacle.signatures import names_checked
from fenicsx_obstacle.text import nearest, shown

PLANES = ("strain", "stress", "axial")
UNKNOWN = (0.25, 0.25)  # of UFL nothing is known here: what passes every check
NO_OBSTACLE = 1e20  # a gap beyond which there is none
LOCKS, USELESS = 0.45, 0.49  # Poisson's ratios beyond which elements of degree 1 lock visibly, and give nothing


class Elasticity:
    """Hooke's law in UFL, for small displacements u.

    With plane="axial" the mesh is one half of a section through the axis of symmetry. x[0] >= 0 is the radius and u is
    (u_r, u_z). Integrals have the factor x[0], so that forces are per radian.

    Attributes:
        u: Displacement, a vector-valued Function.
        young: Young's modulus E, force per area.
        poisson: Poisson's ratio, dimensionless.
        plane: `strain`, `stress` or `axial` on plane meshes; None in space.
        remarks: Warnings about the data, in words.
    """

    @names_checked
    def __init__(
        self, u: fem.Function, *, young: Any, poisson: Any, plane: str | None = None, name: str = "Elasticity"
    ):
        """Check the data (collective).

        Args:
            u: Displacement, a vector-valued Function.
            young: Young's modulus: a number, a Constant, a Function or a UFL expression.
            poisson: Poisson's ratio: a number, a Constant, a Function or a UFL expression.
            plane: "strain", "stress" or "axial"; required if u has two components, None in space.
            name: The name of this object in messages.

        Raises:
            InputError: If `plane` is missing or another word; if Young's modulus is not positive; if Poisson's ratio is
                not between -1 and 1/2; or if it is above 0.49 with elements of degree 1. Because of volumetric locking
                these elements then give no accurate pressure.
        """
        self._name, gdim = name, u.function_space.mesh.geometry.dim
        if u.function_space.dofmap.index_map_bs != gdim or gdim < 2:
            raise InputError(f"{name}: u must have {max(gdim, 2)} components, one for each coordinate of the mesh")
        if gdim == 2 and plane not in PLANES:
            hint = nearest(str(plane), PLANES) if plane is not None else ""
            raise InputError(
                f"{name}: plane = {shown(plane)}{hint}: a plane body needs {' or '.join(map(repr, PLANES))}"
            )
        if gdim == 3 and plane is not None:
            raise InputError(f"{name}: plane = {shown(plane)}: u has three components, so that there is no plane")
        self.u, self.young, self.poisson, self.plane = u, young, poisson, plane
        self.remarks: tuple[str, ...] = ()
        low, _ = self._range(young)
        if not low > 0:
            raise InputError(f"{name}: young = {low:g}: must be positive")
        self._check_ratio(*self._range(poisson))

    def _check_ratio(self, low: float, high: float) -> None:
        if not -1 < low <= high < 0.5:
            bad = low if not -1 < low < 0.5 else high
            raise InputError(f"{self._name}: poisson = {bad:g}: must be above -1 and below 1/2")
        if self.plane == "stress" or high <= LOCKS or self._degree != 1:
            return
        if high > USELESS:
            raise InputError(
                f"{self._name}: poisson = {high:g} with elements of degree 1: they lock, and the pressure is wrong by "
                "a fifth or more; take degree 2"
            )
        self.remarks = (
            f"poisson = {high:g} with elements of degree 1: they begin to lock, which shows as noise in the "
            "pressure; degree 2 is better",
        )
        warn(self.u.function_space.mesh.comm, self.remarks[0], stacklevel=4)

    @property
    def _degree(self) -> int:
        """1 without nodes on edges, else 2."""
        return 2 if self.u.function_space.dofmap.dof_layout.entity_dofs(1, 0) else 1

    def _range(self, value: Any) -> tuple[float, float]:
        """Least and greatest value of a datum, as far as it has any (collective)."""
        if isinstance(value, fem.Function):
            comm = self.u.function_space.mesh.comm
            return smallest(comm, value.x.array), largest(comm, value.x.array)
        if isinstance(value, ufl.core.expr.Expr) and not isinstance(value, fem.Constant):
            return UNKNOWN
        try:
            number = float(np.asarray(value.value if isinstance(value, fem.Constant) else value))
        except (TypeError, ValueError):
            raise InputError(
                f"{self._name}: {shown(value)}: expected a number, a Constant, a Function or UFL"
            ) from None
        return number, number

    @property
    def radius(self) -> Any:
        """The factor of all integrals: x[0] with plane="axial", otherwise 1."""
        return ufl.SpatialCoordinate(self.u.function_space.mesh)[0] if self.plane == "axial" else 1

    def over(self, measure: ufl.Measure) -> Any:
        """The measure with the factor `radius`, for the argument `measure` of `ObstacleProblem`."""
        return self.radius * measure if self.plane == "axial" else measure

    def strain_of(self, w: Any) -> Any:
        """The strain of a displacement w, shape (3, 3); in plane stress without the component out of the plane."""
        e = ufl.sym(ufl.grad(w))
        if self.plane is None:
            return e
        across = w[0] / self.radius if self.plane == "axial" else 0
        return ufl.as_matrix([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, across]])

    def stress_of(self, w: Any) -> Any:
        """The stress of a displacement w, shape (3, 3)."""
        mu = self.young / (2 * (1 + self.poisson))
        lam = self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))
        e = self.strain_of(w)
        if self.plane == "stress":  # no stress across: e_zz = -lam/(lam + 2 mu) (e_xx + e_yy)
            flat = ufl.as_matrix([[1, 0, 0], [0, 1, 0], [0, 0, 0]])
            return 2 * mu * e + 2 * lam * mu / (lam + 2 * mu) * ufl.tr(e) * flat
        return 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(3)

    @cached_property
    def stress(self) -> Any:
        """The stress of u, shape (3, 3), for the argument `stress` of `ObstacleProblem`."""
        return self.stress_of(self.u)

    def residual(self, v: Any) -> ufl.Form:
        """The residual without loads, the integral of stress(u) : strain(v)."""
        return self.radius * ufl.inner(self.stress, self.strain_of(v)) * self._dx

    @property
    def energy(self) -> ufl.Form:
        """The elastic energy, the integral of stress(u) : strain(u)/2."""
        return self.radius * ufl.inner(self.stress, self.strain_of(self.u)) / 2 * self._dx

    @property
    def _dx(self) -> ufl.Measure:
        mesh = self.u.function_space.mesh
        dx = ufl.Measure("dx", domain=mesh)
        # of the quotient u_r/r, which is no polynomial, UFL would overestimate the degree
        degree = 2 * self._degree + (releases.cell_name(mesh) not in SIMPLICES)
        return dx(metadata={"quadrature_degree": degree}) if self.plane == "axial" else dx


@names_checked
def plane_gap(x: Any, n: Any, point: Sequence[Any], outward: Sequence[Any]) -> Any:
    """The gap to a rigid half-space, as a UFL expression: the distance along n from x to its surface.

    Args:
        x: Points of the body's surface, `ufl.SpatialCoordinate(mesh)`.
        n: Unit vector along which the gap is measured, from the body to the obstacle; a list or UFL.
        point: A point on the surface: numbers, Constants or UFL. With a Constant the half-space can move.
        outward: Normal of the half-space, towards the body; its length has no effect.
    """
    n, point, outward = (ufl.as_vector(list(one)) for one in (n, point, outward))
    return ufl.dot(point - x, outward) / ufl.dot(n, outward)


@names_checked
def ball_gap(x: Any, n: Any, centre: Sequence[Any], radius: Any, axis: Sequence[Any] | None = None) -> Any:
    """The gap to a rigid ball, in the plane a cylinder, in UFL: the distance along n from x to its surface.

    If the line through x misses the ball there is no obstacle: the gap is `NO_OBSTACLE`.

    Example: `ObstacleProblem(..., of=ufl.dot(u, n), upper=ball_gap(x, n, centre, radius), measure=ds(3))`.

    Args:
        x: Points of the body's surface, `ufl.SpatialCoordinate(mesh)`.
        n: Unit vector along which the gap is measured, from the body to the obstacle; a list or UFL.
        centre: Centre of the ball: numbers, Constants or UFL. With a Constant the ball can move.
        radius: Radius of the ball, in the unit of x.
        axis: In space, the direction of the axis of a cylinder through `centre`, in place of the ball.
    """
    n, centre = ufl.as_vector(list(n)), ufl.as_vector(list(centre))
    there = centre - x
    if axis is not None:
        along = ufl.as_vector(list(axis))
        along = along / ufl.sqrt(ufl.dot(along, along))
        n, there = n - ufl.dot(n, along) * along, there - ufl.dot(there, along) * along
    square, middle = ufl.dot(n, n), ufl.dot(there, n)
    reach = middle**2 - square * (ufl.dot(there, there) - radius**2)
    meets = ufl.gt(reach, 0)
    return ufl.conditional(meets, (middle - ufl.sqrt(ufl.conditional(meets, reach, 0.0))) / square, NO_OBSTACLE)
