"""Text about the time steps of a scene."""

from __future__ import annotations

from fenicsx_obstacle.discrete.time_discretization import EQUILIBRIA
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.text import counted


def steps_of(scene: Scene) -> list[str]:
    """The time steps, the initial values, and what is saved."""
    time = scene.time
    if time is None:
        return []
    how = {
        "equilibria": f"equilibria at t = 0 and {counted(time.steps, 'moment')} more, to t = {time.end:g}",
        "euler": "implicit Euler, order 1, monotone",
        "bdf2": "BDF2, order 2, first step by implicit Euler",
        "midpoint": "elastic forces averaged over a step, order 2, contact at its end: the energy never increases",
    }[time.scheme]
    lines = [how if time.order == EQUILIBRIA else f"{counted(time.steps, 'step')} to t = {time.end:g}: {how}"]
    if time.tolerance is not None:
        lines[0] = f"to t = {time.end:g}: {how}"
        lines.append(f"steps chosen so that each adds at most {time.tolerance:g} to u; the first {time.step:g}")
    start = [] if time.start is None else [f"u = {time.start.text}"]
    start += [] if time.velocity is None else [f"u_t = {time.velocity.text}"]
    lines += [f"at t = 0 {', '.join(start)}"] if start else []
    if time.order > EQUILIBRIA:
        lines.append("a step is the problem above with an additional foundation and load; it starts from the last step")
    frames = f"fields at {counted(time.frames + 1, 'moment')}" if time.frames else "only the last fields"
    return [*lines, f"saved: output quantities of all times, {frames}, and the state, from which --restart goes on"]
