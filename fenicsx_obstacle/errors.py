"""The errors a user can meet; each knows the exit status of the command line."""

from fenicsx_obstacle.words import counted


class ObstacleError(Exception):
    """Base of all errors of this package."""

    exit_status = 1


class InputError(ObstacleError):
    """The user's scene, file or option is wrong. The message names the place and the remedy."""

    exit_status = 2


class NotConverged(ObstacleError):
    """A solver stopped short of its tolerance: there is no answer to return.

    Attributes:
        solver: Name of the solver.
        reason: PETSc's reason, in words.
        iterations: Newton steps taken.
    """

    exit_status = 3

    def __init__(self, solver: str, reason: str, iterations: int, *, eps: float | None, h: float):
        self.solver, self.reason, self.iterations, self.eps, self.h = solver, reason, iterations, eps, h
        super().__init__(solver, reason, iterations)

    def __str__(self) -> str:
        where = f"h = {self.h:.3g}" if self.eps is None else f"eps = {self.eps:.3g}, h = {self.h:.3g}"
        remedy = "; a larger eps, or --method vi, may do" if self.solver == "penalty" and self.eps is not None else ""
        return (
            f"{self.solver} did not converge: {self.reason} after {counted(self.iterations, 'step')} ({where}){remedy}"
        )

    def __reduce__(self):
        # exceptions travel between ranks by pickle, which knows nothing of keyword arguments
        return (_rebuild, (self.solver, self.reason, self.iterations, self.eps, self.h))


def _rebuild(solver: str, reason: str, iterations: int, eps: float | None, h: float) -> NotConverged:
    return NotConverged(solver, reason, iterations, eps=eps, h=h)
