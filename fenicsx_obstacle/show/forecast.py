"""Text of a forecast."""

from __future__ import annotations

from textwrap import fill

from fenicsx_obstacle.answers.adapt import Adaptation
from fenicsx_obstacle.show.tables import duration
from fenicsx_obstacle.studies.forecast import Forecast, forecast

BUSY = 1.2  # elapsed over processor time of a machine that does something else
BOUND, ESTIMATE = ("bound", 2), ("error", 3)  # what falls, and the factor within which forecasts are, measured


def forecast_text(run: Adaptation) -> str:
    """Lines for `explain --tol` of a refinement before its first mesh (collective): a few seconds of calibration.

    Raises:
        InputError: As `forecast`.
        NotConverged: As `forecast`.
    """
    asked = f"{run.tolerance:g}" if run.goal is None else f"{run.tolerance:g} --of {run.goal}"
    option = "--tol" if run.relative else "--tol-absolute"
    text = f"{asked}: {_words(forecast(run), *(BOUND if run.goal is None else ESTIMATE))}"
    return fill(text, 110, initial_indent=f"  {option:13} ", subsequent_indent=" " * 16, break_on_hyphens=False)


def _words(found: Forecast, error: str, factor: int) -> str:
    """What is expected, and how certain it is.

    Args:
        found: The forecast.
        error: What has a tolerance.
        factor: Within which the forecast is.
    """
    if found.stopped:
        return f"cannot be reached: {found.stopped}"
    parts = [f"about {found.dofs:.3g} unknowns on mesh {found.meshes}", f"{duration(found.seconds)} of processor time",
             f"{found.memory_mb:.0f} MB"]  # fmt: skip
    expected = "expect " + ", ".join(parts)
    if found.stopped is not None:
        return f"{expected} (measured: the calibration has reached the tolerance)"
    sure = found.agrees and found.busy <= BUSY
    certain = f"{'' if sure else 'unknowns and memory '}within a factor of {factor}"
    lines = [f"{expected} (from {duration(found.calibration)} of calibration; the {error} is taken as proportional to "
             f"unknowns^-{found.order:.2f}; {certain})."]  # fmt: skip
    if not found.agrees:
        lines.append(f"The time is uncertain: measured times per unknown differ by a factor of {found.spread:.1f}.")
    if found.busy > BUSY:
        lines.append(f"The machine is busy: elapsed time is {found.busy:.1f} times processor time now, and both may be "
                     "longer than without other programs.")  # fmt: skip
    if not found.fits:
        lines.append("This is more memory than is free.")
    return " ".join(lines)
