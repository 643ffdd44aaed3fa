"""The parts of a solution that have types of their own: times, errors, adaptive meshes, profiles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Seconds:
    """Wall-clock time.

    Attributes:
        total: Time in s from making the mesh to the solution. For the command `solve` it includes files and pictures.
        mesh: Time in s to make the mesh; 0 for a mesh of your own.
        solve: Time in s of set-up, assembly and iteration.
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
        dofs: Number of unknowns.
        total: Bound of the energy error.
        relative: The bound divided by the energy norm of u; None if this norm is 0.
        eps: Penalty parameter, in units of u/p; None for the variational inequality.
        seconds: Wall-clock time from the start of the solve.
        memory_mb: Peak memory of all ranks until then, in MB.
        sampled: Whether `total` is only an estimate from samples of the obstacles. Far from the tolerance no bound is
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
    """An output quantity for which a tolerance was given.

    Attributes:
        name: energy, force, force.lower, force.upper, or a name of [report].
        value: Its value, in its own unit. If the error of the energy is guaranteed, the middle of its bounds.
        error: Guaranteed or estimated error of the value.
        relative: The error divided by the absolute value; None if the value is 0.
        words: 'estimated', or 'guaranteed' (perhaps 'on the polygon of the mesh'). The energy with sampled data has
            'estimated for the sampled load', or with other data. Where a datum jumps inside cells it begins with
            'estimated, not settled': the estimate is then no measure of the error.
        mesh: Part of the error due to the mesh. A guaranteed error consists of this part only.
        penalty: Part of the error due to eps.
        dofs: Number of unknowns of the finest mesh that was solved for the estimate.
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
        tolerance: The tolerance of the energy error, or of the error of a quantity.
        relative: Whether the tolerance is relative to the energy norm of u, or to the quantity.
        reached: Whether the bound, or the estimate, of the error is below the tolerance.
        stopped: Why the refinement stopped without reaching the tolerance; "" if the tolerance is reached.
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
    """Values at the points of a line or curve; not-a-number at points outside the mesh.

    If contact is possible on a part of the boundary only, the gap is not-a-number at points off this part.

    Attributes:
        points: Shape (n, gdim).
        s: Distance from the first point, along the points, shape (n,).
        u: Solution, shape (n,), or displacement, shape (n, gdim).
        pressure: Contact pressure, shape (n,).
        gap: Distance to the nearest obstacle, shape (n,); negative where u penetrates it, infinite without an obstacle.
        slope: Gradient of u, shape (n, gdim); None if u is vector-valued.
        flux: Tension times gradient of u, in force per length, shape (n, gdim); None if the tension is not known, as
            for an ObstacleProblem with a form.
        von_mises: Von Mises stress of the cell, shape (n,); None if no stress was given.
        formulas: Values of formulas given for comparison, each of shape (n,), by the name of the quantity.
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
