"""A slider in a notebook, over eps or over the saved times of a scene with [time]. Needs ipywidgets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.answers.answer import Answer
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.errors import InputError
from fenicsx_obstacle.io.folder import gather
from fenicsx_obstacle.show.pictures import Picture
from fenicsx_obstacle.show.time_history import is_animated, moving

TENS = 4  # of eps to both sides of the answer's
SHOWN = {"auto_display": True}  # what the function returns


def slider(answer: Answer) -> Any:
    """A slider with a picture below: over the moments that were kept, or over eps, solved anew on the same mesh.

    Args:
        answer: On one rank.

    Returns:
        A widget of ipywidgets: the last line of a cell shows it.

    Raises:
        InputError: Without ipywidgets, or where there is neither eps nor a moment to choose.
    """
    try:
        import ipywidgets
    except ImportError:
        raise InputError("a slider needs ipywidgets, which is not installed: pip install ipywidgets") from None
    if answer.time_history is not None:
        return _over_moments(ipywidgets, answer)
    eps = answer.record["eps"]
    if eps is None:
        raise InputError(f"{answer.record['method']}: there is no eps")
    context = SolverContext(answer.scene, level=answer.level)
    values, floor = [eps * 10.0**k for k in range(TENS, -TENS - 1, -1)], smallest_eps(context.problem)
    options = {f"{value:.2g}": value for value in values if value >= floor}

    def draw(eps: float) -> Picture:
        return context.answer(replace(context.options, eps=eps)).plot()

    chosen = ipywidgets.SelectionSlider(options=options, value=eps, description="eps")
    return ipywidgets.interactive(draw, SHOWN, eps=chosen)


def _over_moments(ipywidgets: Any, answer: Answer) -> Any:
    arrays = gather(answer)
    if not is_animated(answer, arrays):
        raise InputError("only intervals and plane meshes are shown; open frames.xdmf in ParaView")
    assert answer.time_history is not None
    assert answer.scene.time is not None
    page, show = moving(answer, arrays)
    frames, name = answer.time_history.frames, answer.scene.time.name

    def draw(moment: int) -> Picture:
        show(frames[moment])
        return Picture(f"{name} = {frames[moment].t:.4g}", page)

    options = {f"{frame.t:.4g}": number for number, frame in enumerate(frames)}
    chosen = ipywidgets.SelectionSlider(options=options, value=len(frames) - 1, description=name)
    return ipywidgets.interactive(draw, SHOWN, moment=chosen)
