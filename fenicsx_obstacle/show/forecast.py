"""Text of a forecast."""

from __future__ import annotations

from textwrap import fill

from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.cost_tables import duration
from fenicsx_obstacle.studies.forecast import forecast


def forecast_text(scene: Scene, tol: float) -> str:
    """Lines for `explain --tol` (collective): a few seconds of calibration.

    Raises:
        InputError: As `forecast`.
        NotConverged: As `forecast`.
    """
    found = forecast(scene, tol)
    size = (
        f"about {found.dofs:.3g} unknowns on mesh {found.meshes}, {duration(found.seconds)}, {found.memory_mb:.0f} MB"
    )
    if found.reached:
        how = "measured: the calibration has reached the tolerance"
    else:
        spent, order = duration(found.calibration), f"{found.order:.2f}"
        how = (
            f"from {spent} of calibration, in which the bound was proportional to unknowns^-{order}; within a "
            "factor of 2"
        )
    first = f"  {'--tol':10}"
    return fill(f"{tol:g}: expect {size} ({how})", 110, initial_indent=first, subsequent_indent=" " * 14)
