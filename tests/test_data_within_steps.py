"""Steps with a tolerance: what data do within a step, between its ends, is not missed."""

import numpy as np
import pytest

from fenicsx_obstacle import InputError, Scene, solve
from fenicsx_obstacle.answers.data_within_steps import _Search
from tests.conftest import slow_except

CELLS = 16
TOLERANCE = 2e-3


def scene(end, steps, scheme="euler", start=0, **data):
    """u_t - u'' = f on (0, 1) with an obstacle at -1; `end/steps` is the length of the first step."""
    time = {"end": end, "steps": steps, "start": start, "tolerance": TOLERANCE, "scheme": scheme}
    given = {"tension": 1, "rate": 1, "load": 0, "lower": -1, "boundary": [{"value": 0}], **data}
    return Scene(mesh={"shape": "interval", "cells": CELLS}, time=time, report={"middle": "at(u, 0.5)"}, **given)


def truth(
    end,
    load=lambda t: 0.0,
    lower=lambda x, t: -1.0,
    edge=lambda t: 0.0,
    tension=lambda t: 1.0,
    start=lambda x: 0 * x,
    steps=8000,
):
    """u in the middle at the end, by implicit Euler with many small steps and a semismooth Newton method in NumPy."""
    x, dt = np.linspace(0, 1, CELLS + 1), end / steps
    A = CELLS**2 * (2 * np.eye(CELLS + 1) - np.eye(CELLS + 1, k=1) - np.eye(CELLS + 1, k=-1))
    u, inverse, before = start(x), None, None
    for t in dt * np.arange(1, steps + 1):
        if tension(t) != before:
            before, M = tension(t), np.eye(CELLS + 1) / dt + tension(t) * A
            M[[0, -1]] = np.eye(CELLS + 1)[[0, -1]]
            inverse = np.linalg.inv(M)
        f = u / dt + load(t)
        f[[0, -1]] = edge(t)
        g = np.broadcast_to(lower(x, t), len(x))
        u, active = inverse @ f, np.zeros(len(x), dtype=bool)
        for _ in range(20):
            now = np.where(active, M @ u - f > 0, u < g)
            now[[0, -1]] = False
            if (now == active).all():
                break
            active, held, right = now, M.copy(), f.copy()
            held[active], right[active] = np.eye(CELLS + 1)[active], g[active]
            u = np.linalg.solve(held, right)
    return u[CELLS // 2]


# each begins and ends within one of the first steps, whose lengths only grow as long as u = 0
PULSES = {
    "load": (0.6, 6, {"load": "where(abs(t - 0.525) < 0.02, -40, 0)"},
             {"load": lambda t: -40.0 * (abs(t - 0.525) < 0.02)}),
    "obstacle": (0.4, 4, {"lower": "-1 + where(abs(t - 0.33) < 0.02, 1.5, 0)*sin(pi*x)"},
                 {"lower": lambda x, t: -1 + 1.5 * (abs(t - 0.33) < 0.02) * np.sin(np.pi * x)}),
    "boundary value": (0.4, 4, {"boundary": [{"value": "max(0, 1 - abs(t - 0.33)/0.02)"}]},
                       {"edge": lambda t: max(0.0, 1 - abs(t - 0.33) / 0.02)}),
    "tension": (0.4, 4, {"load": -8, "tension": "1 + 30*exp(-((t - 0.33)/0.005)^2)", "start": "-4*x*(1 - x)"},
                {"load": lambda t: -8.0, "tension": lambda t: 1 + 30 * np.exp(-(((t - 0.33) / 0.005) ** 2)),
                 "start": lambda x: -4 * x * (1 - x)}),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("scheme", slow_except(["euler", "bdf2"], "euler"))
@pytest.mark.parametrize("kind", PULSES)
def test_pulses(kind, scheme):
    """The end of u is that of many small steps: without the pulse it is off by 0.1 to 0.7 (tension: by 1.5)."""
    end, steps, data, known = PULSES[kind]
    answer = solve(scene(end, steps, scheme, **data))
    assert answer.report["middle"] == pytest.approx(truth(end, **known), abs=10 * TOLERANCE)
    assert answer.record["time"]["shortened"] > 0
    assert "remarks" not in answer.record


@pytest.mark.variant
@pytest.mark.slow
def test_oscillation():
    """A load that is 0 at the ends of all first steps, whose length is its period."""
    answer = solve(scene(0.35, 7, load="-100*sin(40*pi*t)"))
    assert answer.report["middle"] == pytest.approx(
        truth(0.35, load=lambda t: -100 * np.sin(40 * np.pi * t)), abs=6 * TOLERANCE
    )


@pytest.mark.variant
@pytest.mark.slow
def test_data_that_cause_no_shorter_steps():
    """Data that do not depend on t, or are monotone in a step: the steps are those of the error estimate alone."""
    for data in ({"load": -20}, {"load": "where(t > 0.2, -20, 0)"}, {"load": "-20*t"}, {"lower": "-1 + 2*t^2"}):
        record = solve(scene(0.4, 8, **data)).record
        assert record["time"]["shortened"] == 0 and "remarks" not in record


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize(("sign", "place"), [(-1, ""), (1, " + 0*x")])  # the same number, or one at each node
def test_obstacles_that_u_does_not_reach(sign, place):
    """They cause no shorter steps, on either side of u; those that touch u do."""
    for nearest, touches in ((0.15, False), (0.05, True)):  # u is 0.1 in the middle
        side, height = (
            "lower" if sign < 0 else "upper",
            f"{sign}*({nearest} + where(abs(t - 0.33) < 0.02, 0, 1){place})",
        )
        record = solve(
            scene(0.4, 4, load=0.8 * sign, start=f"{0.4 * sign}*x*(1 - x)", **{"lower": -9, side: height})
        ).record
        assert (record["time"]["shortened"] > 0) == touches


@pytest.mark.variant
@pytest.mark.slow
def test_steps_of_smooth_data():
    """Where the error estimate has chosen the steps, smooth data shorten few of them."""
    time = solve(scene(1, 100, load="-50*sin(2*pi*t)", lower="-0.3 + 0.2*sin(2*pi*t)*sin(pi*x)")).record["time"]
    assert time["shortened"] <= 0.05 * time["steps"]


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.1, 0.005])
def test_callables_are_sampled(dt):
    """Data without bounds are sampled 8 times in a step, and 4 times in a time of end/steps; a remark says so."""
    end, pulse = 0.6, lambda t: -40.0 * (abs(t - 0.525) < 0.02)
    answer = solve(scene(end, round(end / dt), load=lambda x, t: pulse(t) + 0 * x[0]))
    assert answer.report["middle"] == pytest.approx(truth(end, load=pulse), abs=6 * TOLERANCE)
    (remark,) = answer.record["remarks"]
    assert "load" in remark and "sampled within the time steps" in remark and remark in answer.summary()


@pytest.mark.parametrize(
    "data",
    [
        {"boundary": [{"value": "0.1*sin(1e12*t)"}]},
        pytest.param(
            {"lower": "-0.2 + 0.1*sin(1e12*t)", "load": -9, "start": "-0.4*x*(1 - x)"}, marks=pytest.mark.slow
        ),
    ],
)
def test_a_change_that_is_too_short(data):
    """What no step can follow is told, with the time."""
    with pytest.raises(InputError, match=r"at t = .* beyond its values at both ends of the smallest time step, "):
        solve(scene(0.4, 4, **data))


FORMULAS = [
    "where(abs(t - 0.525) < 0.02, -1, 0)", "where(abs(t - 0.525) < 1e-7, -1, 0)", "exp(-((t - 0.3)/1e-6)^2)",
    "max(0, 1 - abs(t - 0.3)/1e-4)", "t % 0.1", "floor(10*t)", "sqrt(abs(t - 0.5))", "where(abs(x - t) < 1e-3, 1, 0)",
    "sign(sin(1e4*t))", "sin(1e4*t)", "where(t > 0.5, 20, 0)", "t^3 - t", "sin(30*x*t)*exp(-x*t)/(1 + t^2)",
    "ln(abs(t - 0.37))", "cosh(t - 0.5) - 1", "tanh((t - 0.4)/1e-4)", "hypot(t - 0.5, x - 0.5)", "x^t",
    "where(x < t, sqrt(t - x), 0)", "distance*where((t - 0.5)^2 < 1e-10, 1, 0)", "r*theta*(t - 0.5)^2",
]  # fmt: skip


@pytest.mark.parametrize("text", slow_except(FORMULAS, *FORMULAS[:4]))
def test_nothing_found_is_proved(text):
    """Where a search finds nothing, no sample is beyond what is allowed; what it finds is so at its time."""
    field = next(effect.value for effect in scene(1, 1, load=text).effects if effect.key == "load")
    x = np.zeros((3, 40))
    x[0] = np.linspace(0, 1, 40)
    names = {"distance": lambda points: np.minimum(points[:, 0], 1 - points[:, 0])}
    rng, found = np.random.default_rng(1), []
    for allowed in (1e-1, 1e-3):
        for _ in range(4):
            step = np.sort(rng.uniform(0, 1, 2))
            values = [field.at(x, {**names, "t": t}) for t in (*step, *np.linspace(*step, 1001))]
            low, high = np.minimum(*values[:2]), np.maximum(*values[:2])
            search = _Search(field, x, names, tuple(step), values[:2], (low, high), allowed)
            over = np.maximum(np.max(values, axis=0) - high, low - np.min(values, axis=0)).max()
            excess = search.by_bounds(1e-9)
            assert not search.unknown
            if excess is None:
                assert over <= allowed + 1e-9
            else:
                t, size = excess
                there = field.at(x, {**names, "t": t})
                assert step[0] < t < step[1] and size > allowed
                assert size == pytest.approx(np.maximum(there - high, low - there).max(), abs=1e-9)
            found.append(excess is not None)
    pulse = "1e-7" in text or "1e-6" in text or "1e-10" in text
    assert any(found) or not pulse
