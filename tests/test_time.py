"""Scenes with [time]: orders in the length of a step, energies, data that move within steps, states to go on from."""

import math
from contextlib import closing

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq

from fenicsx_obstacle import Answer, InputError, NotConverged, Scene, solve
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.answers.data_within_steps import _Search
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.answers.time_history import TimeHistory, from_arrays
from tests.conftest import COMM, DEMOS, MORE_ON_SEVERAL_RANKS, slow_except

INTERVAL = {"shape": "interval", "cells": 16}
METHODS = ["penalty", "vi"]


def orders(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "order"), slow_except([("euler", 1), ("bdf2", 2)], ("bdf2", 2)))
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_order_of_rate(scheme, order, method):
    """u = x sin 3t, linear in x, so that all of the error is that of the steps; load and edge move."""
    errors = []
    for steps in (40, 80, 160):
        scene = Scene(mesh=INTERVAL, rate=2, tension=0.1, load="6*cos(3*t)*x", lower=-9,
                      boundary=[{"value": "x*sin(3*t)"}], time={"end": 1, "steps": steps, "start": 0, "scheme": scheme},
                      report={"error": "sup(abs(u - x*sin(3*t)))"})  # fmt: skip
        errors.append(solve(scene, method=method).report["error"])
    assert np.allclose(orders(errors), order, atol=0.15)


@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
@pytest.mark.slow
def test_order_of_inertia(method):
    """A standing wave: with lumped masses the nodes of sin(pi x) swing with 2/h sin(pi h/2); midpoint rule, order 2.
    So does the reaction at an end, which a step has in its middle."""
    frequency, slope = 2 * 16 * math.sin(math.pi / 32), 16 * math.sin(math.pi / 16)
    errors, of_reactions = [], []
    for steps in (40, 80, 160):
        scene = Scene(mesh=INTERVAL, inertia=1, tension=1, lower=-3,
                      time={"end": 1.3, "steps": steps, "start": "sin(pi*x)"},
                      report={"middle": "at(u, 0.5)", "reaction": "integral(normal_flux, 'left')"})  # fmt: skip
        answer = solve(scene, method=method)
        errors.append(abs(answer.report["middle"] - math.cos(frequency * 1.3)))
        of_reactions.append(abs(answer.report["reaction"] + slope * math.cos(frequency * 1.3)))
        energy = answer.time_history.column("energy")
        assert np.allclose(energy, energy[0], rtol=1e-8)  # kept, whatever the step
    assert np.allclose(orders(errors), 2, atol=0.1) and np.allclose(orders(of_reactions), 2, atol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
def test_a_wall_takes_energy(method):
    """A string that hits a wall, first at cos(pi t) = -1/2: its energy never grows, and falls where it hits."""
    scene = Scene.read(DEMOS / "bounce.toml").change({"mesh.cells": 40, "time.steps": 90, "time.end": 0.9})
    time_history = solve(scene, method=method).time_history
    energy, area = time_history.column("energy"), time_history.column("contact_area")
    assert np.all(np.diff(energy) <= 1e-8 * energy[0]) and energy[-1] < 0.95 * energy[0]
    first = time_history.column("t")[np.argmax(np.nan_to_num(area) > 0)]
    assert first == pytest.approx(2 / 3, abs=0.02)
    before = time_history.column("t") < 0.66
    assert np.allclose(energy[before], energy[0], rtol=1e-8)


@pytest.mark.slow
def test_friction_takes_energy():
    """rate beside inertia is friction: u = exp(-ct/2) cos(w t) sin(pi x), w^2 = frequency^2 - c^2/4."""
    c, frequency = 1.0, 2 * 16 * math.sin(math.pi / 32)
    w = math.sqrt(frequency**2 - c**2 / 4)
    scene = Scene(mesh=INTERVAL, inertia=1, rate=c, tension=1, upper=3, report={"middle": "at(u, 0.5)"},
                  time={"end": 1, "steps": 200, "start": "sin(pi*x)", "velocity": "-0.5*sin(pi*x)"})  # fmt: skip
    answer = solve(scene)
    assert answer.report["middle"] == pytest.approx(math.exp(-c / 2) * math.cos(w), abs=5e-4)
    assert np.all(np.diff(answer.time_history.column("energy")) < 0)


def test_twice_on_one_bench():
    """Data go back to t = 0 before another march: edge, obstacle and start depend on t here."""
    scene = Scene(mesh=INTERVAL, rate=1, tension=1, load=-1, lower="-0.1*t", boundary=[{"value": "t"}],
                  time={"end": 1, "steps": 4, "start": "t + x*(1 - x)", "scheme": "bdf2"})  # fmt: skip
    with closing(SolverContext(scene)) as context:
        first, second = context.answer(), context.answer()
    assert np.allclose(first.u.x.array, second.u.x.array, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("data", "moving", "still"),
    [({"point_load": [{"at": [0.5, 0.5], "force": -1}], "tension": 1}, {"lower": "-0.2 + 0.1*t"}, {"lower": -0.1}),
     ({"load": -8, "lower": -0.2}, {"tension": "1 + 3*t*x"}, {"tension": "1 + 3*x"}),
     # pressed in, and half drawn back
     ({"tension": 1}, {"load": "-t", "lower": "0.4*(1 - abs(2*t - 1)/2) - 4*((x - 0.5)^2 + (y - 0.5)^2)"},
      {"load": -1, "lower": "0.2 - 4*((x - 0.5)^2 + (y - 0.5)^2)"})],
    ids=["point load", "stiffness", "indenter"],
)  # fmt: skip
def test_a_moment_is_the_problem_at_rest_of_its_data(data, moving, still):
    """A force stays what it is beside a moving obstacle, and matrices of all levels follow a tension that grows."""
    given = {"mesh": {"shape": "rectangle", "cells": 8, "refine": 2}, **data}
    row = solve(Scene(**given, **moving, time={"end": 1, "steps": 4}), eps=1e-6).time_history.rows[-1]
    record = solve(Scene(**given, **still), eps=1e-6).record
    assert row["energy"] == pytest.approx(record["energy"], rel=1e-9)
    assert row["force_lower"] == pytest.approx(record["contact"]["lower"]["force"], rel=1e-8)
    assert row["krylov"] <= record["krylov_iterations"] + 1 + MORE_ON_SEVERAL_RANKS


def test_frames_after_a_restart(folder):
    """Frames that another number of ranks has left are in the order of nodes of the run that goes on."""
    scene = Scene(mesh={"shape": "rectangle", "cells": 6}, tension=1, lower="t*x - 1 + y",
                  boundary=[{"value": "t*x + y"}], time={"end": 0.5, "steps": 2, "frames": 2})  # fmt: skip
    solve(scene, keep=folder)
    answer = solve(scene.change({"time.end": 1, "time.steps": 4}), comm=MPI.COMM_SELF, restart=folder)
    x = answer.level.points
    for frame in answer.time_history.frames:
        assert np.allclose(frame.fields["u"], frame.t * x[0] + x[1], atol=1e-6)
    assert [frame.t for frame in answer.time_history.frames] == pytest.approx([0, 0.25, 0.5, 1.0])


@pytest.mark.parametrize(("zero", "size"), [(3e7, 1.0), (0.0, 1e-60), (0.0, 1e60)])
def test_frames_in_any_unit(zero, size):
    """The last frame is the solution, also far from the zero of u, and in tiny and huge units."""
    scene = Scene(
        mesh=INTERVAL, tension=1, load=-size, lower=zero - size, boundary=[{"value": zero}],
        time={"end": 1, "steps": 1, "frames": 1},
    )  # fmt: skip
    answer = solve(scene, comm=MPI.COMM_SELF)
    u = answer.time_history.frames[-1].fields["u"] - zero
    x = answer.level.points[0]
    assert u == pytest.approx(size * x * (x - 1) / 2, abs=1e-6 * size)


@pytest.mark.slow
def test_levels_serve_steps():
    """Steps are preconditioned by multigrid on all levels: few linear iterations in a Newton step, however fine."""
    each = []
    for refine in (1, 3):
        scene = Scene(mesh={"shape": "rectangle", "cells": 8, "refine": refine}, rate=1, tension=1, load=-10,
                      lower=-0.3, time={"end": 0.2, "steps": 4, "start": 0})  # fmt: skip
        record = solve(scene).record
        each.append(record["krylov_total"] / record["newton_total"])
    assert max(each) <= 4 + MORE_ON_SEVERAL_RANKS


def _tree(steps, strike=100.0, interest=0.05, sigma=0.2):
    """Price of the put at S = K (Cox, Ross and Rubinstein 1979)."""
    up = math.exp(sigma / math.sqrt(steps))
    rise, discount = (math.exp(interest / steps) - 1 / up) / (up - 1 / up), math.exp(-interest / steps)
    value = np.maximum(strike - strike * up ** np.arange(-steps, steps + 1, 2.0), 0)
    for step in range(steps - 1, -1, -1):
        value = discount * (rise * value[1:] + (1 - rise) * value[:-1])
        value = np.maximum(value, strike - strike * up ** np.arange(-step, step + 1, 2.0))
    return value[0]


@pytest.mark.parametrize("method", slow_except(METHODS, "penalty"))
@pytest.mark.slow
def test_put(method):
    """American put, one year: the price by a binomial tree; BDF2 with 200 steps is within 0.05 % of it."""
    answer = solve(Scene.read(DEMOS / "put.toml"), method=method)
    assert answer.report["price"] == pytest.approx(_tree(4000), rel=5e-4)
    exercise = answer.time_history.column("exercise")
    assert np.all(np.diff(exercise[1:]) <= 0)  # the longer to go, the later it pays to exercise


@pytest.mark.slow
def test_press():
    """A ball pressed into a round membrane: force 2 pi a^2/R where the travel is a^2/R (1/2 + ln(1/a))."""
    time_history = solve(Scene.read(DEMOS / "press.toml").change({"time.steps": 5})).time_history
    for travel, force in zip(time_history.column("t")[1:], time_history.column("force")[1:], strict=True):
        a = brentq(lambda a, depth=travel: a**2 * (0.5 - math.log(a)) - depth, 1e-6, 0.9)
        assert force == pytest.approx(2 * math.pi * a**2, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", slow_except(["rate", "inertia", "equilibria"], "rate"))
def test_restart(kind, folder):
    """Half the way, then on from its state on one rank each: the same table as in one go."""
    data = {"mesh": {"shape": "rectangle", "cells": 8}, "tension": 1, "load": "-20*t", "lower": -0.1}
    time = {"end": 1, "steps": 10, "frames": 5}
    if kind != "equilibria":
        data[kind], time["start"] = 1, "0.3*sin(pi*x)*sin(pi*y)"
    if kind == "rate":
        time["scheme"] = "bdf2"
    whole = solve(Scene(**data, time=time)).time_history
    half = {**time, "end": 0.5, "steps": 5, "frames": 3}
    solve(Scene(**data, time=half), keep=folder)
    rest = solve(Scene(**data, time=time), comm=MPI.COMM_SELF, restart=folder).time_history
    assert len(rest.rows) == len(whole.rows) == 11
    for name in ("t", "energy", "contact_area", "force_lower", "penetration"):
        ours, theirs = rest.column(name), whole.column(name)
        assert np.allclose(ours, theirs, rtol=1e-7, atol=1e-9 * np.nanmax(np.abs(theirs)), equal_nan=True), name


@pytest.mark.slow
def test_what_is_left_of_a_failure(folder):
    """A step that does not converge is named; the state before it is there to go on from."""
    scene = Scene(mesh=INTERVAL, rate=1, tension=1, load="where(t > 0.5, -50, 0)", lower=-0.1,
                  time={"end": 1, "steps": 10, "start": 0})  # fmt: skip
    with defaults("penalty_", {"snes_max_it": 0}), pytest.raises(NotConverged, match=r"at t = 0\.6"):
        solve(scene, keep=folder)
    answer = solve(scene, restart=folder)
    assert answer.record["time"]["steps"] == 10
    assert answer.time_history.column("t") == pytest.approx(np.linspace(0, 1, 11))


def test_saved(folder):
    """history.csv has a line per step, frames the fields; both are read back, on any number of ranks."""
    scene = Scene.read(DEMOS / "put.toml").change({"mesh.cells": 40, "time.steps": 10, "time.frames": 4})
    answer = solve(scene)
    answer.save(folder)
    again = Answer.read(folder)
    assert list(again.time_history.rows[-1]) == list(answer.time_history.rows[-1])
    for name in answer.time_history.rows[-1]:
        assert np.array_equal(again.time_history.column(name), answer.time_history.column(name), equal_nan=True)
    times = COMM.bcast([frame.t for frame in again.time_history.frames])
    assert times == pytest.approx([0, 0.3, 0.5, 0.8, 1.0])
    if COMM.rank == 0:
        last = again.time_history.frames[-1].fields
        assert set(last) >= {"u", "pressure", "contact", "lower"} and len(last["u"]) == 41
        assert 'CollectionType="Temporal"' in (folder / "frames.xdmf").read_text()
    solve(Scene(mesh=INTERVAL, tension=1, lower=0)).save(folder)  # a scene at rest leaves nothing of it
    assert Answer.read(folder).time_history is None
    assert not (folder / "frames.h5").exists()


REJECTED = {
    "needs a table [time]": {"rate": 1},
    "the key 'start' is missing": {"rate": 1, "time": {"end": 1, "steps": 1}},
    "an equilibrium is computed at each time": {"time": {"end": 1, "steps": 1, "start": 0}},
    "it needs inertia": {"rate": 1, "time": {"end": 1, "steps": 1, "start": 0, "velocity": 1}},
    "euler and bdf2 are for rate": {"inertia": 1, "time": {"end": 1, "steps": 1, "start": 0, "scheme": "bdf2"}},
    "it needs rate without inertia": {"inertia": 1, "time": {"end": 1, "steps": 1, "start": 0, "tolerance": 1.0}},
    "must be positive": {"time": {"end": "1 - 2", "steps": 1}},
    "unknown name 't'": {"load": "t"},
    "parts of the boundary cannot depend on time": {
        "boundary": [{"value": 0, "where": "x < t"}], "time": {"end": 1, "steps": 1},
    },
    "inertia cannot be combined with soft_obstacle": {
        "inertia": 1, "soft_obstacle": {"upper": 0, "stiffness": 1}, "time": {"end": 1, "steps": 1, "start": 0},
    },
    "= -x: lies below the lower obstacle: -0.9375 against 0 at .0.9375.; take a start .*max.a, b. of both formulas": {
        "rate": 1, "lower": 0, "time": {"end": 1, "steps": 1, "start": "-x"},
    },
    "= x: lies above the upper obstacle: 0.9375 against 0 at .0.9375.; take a start .*min.a, b. of both formulas": {
        "rate": 1, "upper": 0, "time": {"end": 1, "steps": 1, "start": "x"},
    },
    "has a column of this name": {"report": {"energy": "integral(u)"}, "time": {"end": 1, "steps": 1}},
    "is needed if boundary values depend on t": {
        "inertia": 1, "boundary": [{"value": "t"}], "time": {"end": 1, "steps": 1, "start": 0},
    },
    "[time] start = 0: is 0 at .0., where [[boundary]] .no. 2. value = 0.2 gives 0.2; with inertia": {
        "inertia": 1, "boundary": [{"on": "right", "value": 0}, {"on": "left", "value": 0.2}],
        "time": {"end": 1, "steps": 1, "start": 0},
    },
    "is 0.1 at .1., where .* 1. value = t gives 0; .*: both must agree at t = 0": {
        "inertia": 1, "boundary": [{"value": "t"}],
        "time": {"end": 1, "steps": 1, "start": "0.1*x", "velocity": 1},
    },
    "must be positive; it is": {"inertia": 0, "time": {"end": 1, "steps": 1, "start": 0}},
    "lies below the lower obstacle": {"lower": "t - 0.5", "time": {"end": 1, "steps": 4}},
    "is not a finite number": {"load": "1/(t - 0.5)", "time": {"end": 1, "steps": 4}},
}  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize("words", REJECTED)
def test_refused(words):
    """What contradicts itself is told, on all ranks, also where only a later moment shows it."""
    with pytest.raises(InputError, match=words.replace("[", r"\[")):
        solve(Scene(**{"mesh": INTERVAL, "tension": 1, **REJECTED[words]}))


def test_a_start_beside_the_boundary_value():
    """With rate alone the jump is smoothed; with inertia it is the boundary value up to round-off."""
    data = {"mesh": INTERVAL, "tension": 1, "lower": -9, "boundary": [{"value": 0.2}]}
    moments = {"end": 2, "steps": 4}
    answer = solve(Scene(**data, rate=1, time={**moments, "start": 0}, report={"middle": "at(u, 0.5)"}))
    assert answer.report["middle"] == pytest.approx(0.2, abs=1e-3)
    answer = solve(Scene(**data, inertia=1, time={**moments, "start": "0.2 + 1e-14*x"}))
    assert np.all(np.abs(answer.time_history.column("energy")) < 1e-20)


def test_round_off_of_earlier_steps():
    """Data that are all zero: u of size 1e-80, left by an earlier step, is no load that round-off exceeds."""
    scene = Scene(mesh={"shape": "interval", "cells": 12}, rate=1, tension=1, load=0, lower=-1,
                  boundary=[{"on": "left", "value": 0}], time={"end": 0.2, "steps": 10, "start": 0})  # fmt: skip
    assert np.abs(solve(scene).u.x.array).max() < 1e-30


@pytest.mark.slow
def test_no_bound_and_no_restart(folder):
    """The bound is for one equilibrium; a scene at rest has no state to go on from; a state is of one mesh, and
    there must be time left."""
    scene = Scene(mesh=INTERVAL, tension=1, lower=-1, time={"end": 1, "steps": 2})
    later = scene.change({"time.end": 2, "time.steps": 4})
    solve(scene, keep=folder)
    for one, how, words in (
        (scene, {"tol": 0.1}, "one equilibrium"),
        (Scene(mesh=INTERVAL, tension=1, lower=-1), {"restart": "nowhere"}, "no state to continue from"),
        (scene, {"restart": "nowhere"}, "no state to continue from"),
        (scene, {"restart": folder}, "set a later"),
        (later.change({"mesh.cells": 17}), {"restart": folder}, "belongs to another mesh"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            solve(one, **how)
    assert solve(later, restart=folder).record["time"]["steps"] == 4


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"obstacle.lower": -2}, r"\[obstacle\] lower was -1, now -2; only \[time\] steps"),
        ({"define.f": 4}, r"\[effects\] load was f\*t with f = -4, now f\*t with f = 4"),
        ({"boundary": [{"on": "right", "value": 0}]}, r"\[\[boundary\]\] \(no. 1\) on was left, now right"),
        ({"effects.axial_symmetry": True}, r"\[effects\] axial_symmetry was not there, now given"),
    ],
)
def test_states_are_of_the_same_data(other, words, folder):
    """Other data are rejected, also where the formula that uses them is the same."""
    scene = Scene(
        mesh=INTERVAL, define={"f": -4}, tension=1, load="f*t", lower=-1, boundary=[{"on": "left", "value": 0}],
        time={"end": 1, "steps": 2},
    )  # fmt: skip
    solve(scene, keep=folder)
    with pytest.raises(InputError, match=f"other data: {words}"):
        solve(scene.change({**other, "time.end": 2}), restart=folder)


def test_more_frames_than_four_digits_count():
    """Frames come back in their order in time, whatever the order of the names of their groups."""
    arrays = {f"{number:04d}/t": np.array(float(number)) for number in (1000, 10000, 1001)}
    assert [frame.t for frame in from_arrays(arrays, 1)] == [1000, 1001, 10000]


def test_a_column_that_is_not_there():
    """A name that is no column of the time history is rejected, with a similar one."""
    history = TimeHistory(({"step": 0, "t": 0.0}, {"step": 1, "t": 0.5, "force_lower": 2.0}), ())
    assert np.isnan(history.column("force_lower")[0]) and history.column("force_lower")[1] == 2
    with pytest.raises(InputError, match="time_history has no column 'force_lowr'; did you mean 'force_lower'"):
        history.column("force_lowr")


CELLS = 16
TOLERANCE = 2e-3


def stepped(end, steps, scheme="euler", start=0, **data):
    """u_t - u'' = f on (0, 1) with an obstacle at -1; `end/steps` is the length of the first step."""
    time = {"end": end, "steps": steps, "start": start, "tolerance": TOLERANCE, "scheme": scheme}
    given = {"tension": 1, "rate": 1, "load": 0, "lower": -1, "boundary": [{"value": 0}], **data}
    return Scene(mesh={"shape": "interval", "cells": CELLS}, time=time, report={"middle": "at(u, 0.5)"}, **given)


def truth(
    end, load=lambda t: 0.0, lower=lambda x, t: -1.0, edge=lambda t: 0.0, tension=lambda t: 1.0,
    start=lambda x: 0 * x, steps=8000,
):  # fmt: skip
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


# each begins and ends within one of the first steps, whose lengths only grow as long as u = 0, or is 0 at their ends
PULSES = {
    "load": (0.6, 6, {"load": "where(abs(t - 0.525) < 0.02, -40, 0)"},
             {"load": lambda t: -40.0 * (abs(t - 0.525) < 0.02)}),
    "oscillation": (0.35, 7, {"load": "-100*sin(40*pi*t)"}, {"load": lambda t: -100 * np.sin(40 * np.pi * t)}),
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
    answer = solve(stepped(end, steps, scheme, **data))
    assert answer.report["middle"] == pytest.approx(truth(end, **known), abs=10 * TOLERANCE)
    assert answer.record["time"]["shortened"] > 0
    assert "remarks" not in answer.record


@pytest.mark.slow
def test_chosen_steps():
    """A smaller tolerance gives a smaller error; steps are short only where u changes quickly."""
    errors, true = [], truth(0.6, load=lambda t: 20.0 * (t > 0.5))
    scene = stepped(0.6, 3, "bdf2", load="where(t > 0.5, 20, 0)")
    for tolerance in (1e-2, 1e-3):
        answer = solve(scene.change({"time.tolerance": tolerance}))
        lengths = np.diff(answer.time_history.column("t"))
        errors.append(abs(answer.report["middle"] - true))
        assert lengths[-1] < 0.2 * lengths.max() and len(lengths) < 0.6 / lengths.min() / 3
    assert errors[1] < 0.4 * errors[0] < 0.04


@pytest.mark.variant
@pytest.mark.slow
def test_data_that_cause_no_shorter_steps():
    """Data that do not depend on t, or are monotone in a step: the steps are those of the error estimate alone. Where
    this has chosen the steps, other smooth data shorten few of them."""
    for data in ({"load": -20}, {"load": "where(t > 0.2, -20, 0)"}, {"load": "-20*t"}, {"lower": "-1 + 2*t^2"}):
        record = solve(stepped(0.4, 8, **data)).record
        assert record["time"]["shortened"] == 0 and "remarks" not in record
    time = solve(stepped(1, 100, load="-50*sin(2*pi*t)", lower="-0.3 + 0.2*sin(2*pi*t)*sin(pi*x)")).record["time"]
    assert time["shortened"] <= 0.05 * time["steps"]


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize(("sign", "place"), [(-1, ""), (1, " + 0*x")])  # the same number, or one at each node
def test_obstacles_that_u_does_not_reach(sign, place):
    """They cause no shorter steps, on either side of u; those that touch u do."""
    for nearest, touches in ((0.15, False), (0.05, True)):  # u is 0.1 in the middle
        height = f"{sign}*({nearest} + where(abs(t - 0.33) < 0.02, 0, 1){place})"
        obstacles = {"lower": -9, "lower" if sign < 0 else "upper": height}
        record = solve(stepped(0.4, 4, load=0.8 * sign, start=f"{0.4 * sign}*x*(1 - x)", **obstacles)).record
        assert (record["time"]["shortened"] > 0) == touches


@pytest.mark.variant
@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.1, 0.005])
def test_callables_are_sampled(dt):
    """Data without bounds are sampled 8 times in a step, and 4 times in a time of end/steps; a remark says so."""
    end, pulse = 0.6, lambda t: -40.0 * (abs(t - 0.525) < 0.02)
    answer = solve(stepped(end, round(end / dt), load=lambda x, t: pulse(t) + 0 * x[0]))
    assert answer.report["middle"] == pytest.approx(truth(end, load=pulse), abs=6 * TOLERANCE)
    (remark,) = answer.record["remarks"]
    assert "load" in remark and "sampled within the time steps" in remark and remark in answer.summary()


@pytest.mark.parametrize("data", slow_except([
    {"boundary": [{"value": "0.1*sin(1e12*t)"}]},
    {"lower": "-0.2 + 0.1*sin(1e12*t)", "load": -9, "start": "-0.4*x*(1 - x)"},
], {"boundary": [{"value": "0.1*sin(1e12*t)"}]}))  # fmt: skip
def test_a_change_that_is_too_short(data):
    """What no step can follow is told, with the time."""
    with pytest.raises(InputError, match=r"at t = .* beyond its values at both ends of the smallest time step, "):
        solve(stepped(0.4, 4, **data))


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
    field = next(effect.value for effect in stepped(1, 1, load=text).effects if effect.key == "load")
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
