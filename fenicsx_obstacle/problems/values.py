"""The parts of a solution that have types of their own: forces, times, errors, adaptive meshes, profiles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Force:
    """The resultant of the contact pressure on each obstacle, >= 0, in units of pressure times area.

    Attributes:
        lower: On the lower obstacle; None where there is none.
        upper: On the upper obstacle; None where there is none.
    """

    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class Seconds:
    """Wall-clock time.

    Attributes:
        total: From the mesh to the solution; of the command `solve` all of it, its files and pictures included.
        mesh: To make the mesh; 0 for the caller's own.
        solve: Set-up, assembly and iteration.
    """

    total: float
    mesh: float
    solve: float


@dataclass(frozen=True)
class Errors:
    """Norms of the difference to the exact solution of a scene.

    Attributes:
        energy: Of u: L2 norm of tension^(1/2) grad, in the unit of the square root of the energy.
        h1: Of u: H1 norm.
        l2: Of u: L2 norm.
        max: Of u: largest difference at a node.
        pressure_l2: Of p: L2 norm; None where the scene has no exact pressure.
    """

    energy: float
    h1: float
    l2: float
    max: float
    pressure_l2: float | None = None


@dataclass(frozen=True)
class AdaptiveMesh:
    """One mesh of an adaptive solve.

    Attributes:
        dofs: Unknowns.
        total: Bound of the energy error.
        relative: The bound over the energy norm of u; None where that is 0.
        eps: Penalty parameter, in units of u/p; None for the variational inequality.
        seconds: Wall-clock time from the start of the solve.
        memory_mb: Peak memory of all ranks until then, in MB.
        sampled: Whether total is an estimate from samples of the obstacles, as far from the tolerance no bound is
            needed.
    """

    dofs: int
    total: float
    relative: float | None
    eps: float | None
    seconds: float
    memory_mb: float
    sampled: bool = False


@dataclass(frozen=True)
class Quantity:
    """An output quantity that had a tolerance.

    Attributes:
        name: energy, force, force.lower, force.upper, or a name of [report].
        value: In its own unit; of the energy with a guaranteed error the middle of its bounds.
        error: Guaranteed or estimated error of the value.
        relative: The same over the absolute value; None where that is 0.
        words: 'estimated'; or 'guaranteed', as far as the words of the bound say.
        mesh: Part of the error due to the mesh, which is all of a guaranteed one.
        penalty: Part due to eps.
        dofs: Unknowns of the finest mesh that was solved for the estimate.
    """

    name: str
    value: float
    error: float
    relative: float | None
    words: str
    mesh: float
    penalty: float
    dofs: int


@dataclass(frozen=True)
class Adaptive:
    """How a tolerance was reached, or why it was not.

    Attributes:
        tolerance: Of the energy error, or of the error of a quantity.
        relative: Whether the tolerance is relative to the energy norm of u, or to the quantity.
        reached: Whether the bound, or the estimate, of the error is below the tolerance.
        stopped: What ended the refinement otherwise; "" if the tolerance is reached.
        path: The meshes, the coarsest first.
        of: The quantity; "" for the energy error.
    """

    tolerance: float
    relative: bool
    reached: bool
    stopped: str
    path: tuple[AdaptiveMesh, ...]
    of: str = ""


@dataclass(frozen=True, eq=False)
class Profile:
    """Values along a line; not-a-number outside the mesh, and gaps outside the contact boundary.

    Attributes:
        points: Shape (n, gdim).
        s: Distance from the first point, along the points, shape (n,).
        u: Solution, shape (n,), or displacement, shape (n, gdim).
        pressure: Contact pressure, shape (n,).
        gap: Distance to the nearest obstacle, negative where u penetrates it, shape (n,); infinite without one.
        slope: Gradient of u, shape (n, gdim); None if u is vector-valued.
        flux: Tension times slope, in force per length, shape (n, gdim); None where the tension is not known.
        von_mises: Von Mises stress of the cell, shape (n,); None if no stress was given.
        formulas: Values of formulas of comparison, shape (n,) each, by the column over which they are drawn.
    """

    points: np.ndarray
    s: np.ndarray
    u: np.ndarray
    pressure: np.ndarray
    gap: np.ndarray
    slope: np.ndarray | None = None
    flux: np.ndarray | None = None
    von_mises: np.ndarray | None = None
    formulas: Mapping[str, np.ndarray] = field(default_factory=dict)
