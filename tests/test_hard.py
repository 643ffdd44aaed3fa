"""Hard scenes in short: right or rejected on 1, 2 and 3 ranks, and every invariant can be violated."""

import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import InputError, solve
from fenicsx_obstacle.algebra.linear import defaults
from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import violated
from tests.conftest import CLEAN, COMM, DEMOS, ON_SEVERAL_RANKS, membrane, slow_except
from tests.hard.cases import FOLDER, Case, case, cases, named
from tests.hard.invariants import beside_inequality, falling, of_one, same
from tests.hard.judge import METHODS, judge, take
from tests.hard.ranks import agree_on, fields_of
from tests.hard.row import FAILED, FLOOR, REJECTED, RIGHT
from tests.hard.solved import ReferenceProblem
from tests.hard.suite import rows_of
from tests.hard.units import Units, all_units

FEW = (1e-2, 1e-8, 1e-14)


def messages(rows):
    return [row["message"] for row in rows if row["verdict"] == FAILED]


def test_the_list():
    """At least 40 scenes; each file is one of them; what cannot be solved yet says why; each says what is hard."""
    names = [one.name for one in cases()]
    assert len(set(names)) == len(names)
    assert len(cases()) >= 40
    assert {path.stem for path in FOLDER.glob("*.toml")} - {"suite"} <= {one.scene or one.name for one in cases()}
    assert all(one.hard for one in cases())
    told = (DEMOS.parent / "docs" / "tables" / "hard_scenes.md").read_text()
    assert all(f"| {one.name} |" in told for one in cases())
    assert named("drift") == tuple(one for one in cases() if one.family == "drift")
    with pytest.raises(InputError, match="did you mean 'ridge'"):
        case("rigde")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    slow_except(
        ["string_wedge", "ridge", "biactive_power", "floating", "gap_6", "cross_8", "needle_cube", "stretched"],
        "string_wedge",
        "ridge",
        "floating",
    ),
)
def test_scene(name):
    """Every answer keeps every invariant, from any start."""
    rows = list(judge(case(name).on(0), COMM, FEW, starts=True))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), messages(rows)
    assert len(rows) == 1 + len(FEW) * len(METHODS) + 2
    assert all(row["monotone"] is (name != "floating") for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["perturbed", "obtuse"])
def test_scene_without_maximum_principle(name):
    """The program knows that its matrix is no M-matrix, claims less, and what it claims holds."""
    rows = list(judge(case(name).on(0), COMM, (1e-2, 1e-10)))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), messages(rows)
    assert not any(row["monotone"] for row in rows)
    claims = {finding["name"]: finding["claimed"] for row in rows for finding in row["findings"]}
    assert not claims["penetration"] and claims["penalty and inequality: energy norm"]


BODIES = [one.name for one in cases() if one.known]


@pytest.mark.slow
@pytest.mark.serial  # as the suite, which judges on one rank and compares pressures on more of them
@pytest.mark.parametrize("name", slow_except(BODIES, "in_a_corner"))
def test_elastic_body(name):
    """Penalty and inequality differ by the bound of eps, resultants and moments are those of equilibrium to 1e-8, and
    forces scale with the unit."""
    rows = list(judge(case(name).on(0), COMM, FEW, known=case(name).known, units=True))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), messages(rows)
    assert len(rows) == 2 + len(FEW)
    wrong = list(judge(case(name).on(0), COMM, (), known=dict.fromkeys(case(name).known, -1.0)))
    assert [row["verdict"] for row in wrong] == [FAILED]


@pytest.mark.parametrize("name", [one.name for one in cases() if one.refuse])
def test_scene_without_solution(name):
    """Refused at once, in words, on all ranks."""
    rows = list(judge(case(name).on(0), COMM, FEW, refuse=case(name).refuse))
    assert [row["verdict"] for row in rows] == [REJECTED]


@pytest.mark.slow
def test_floating_membranes():
    """(3.4) with v = 1: contact forces and load add up to 0, so that the load must press; any load between two."""
    for data in ({"load": 1, "lower": 0}, {"load": 0, "upper": "x"}):
        with pytest.raises(InputError, match=f"does not press against the {list(data)[1]} obstacle"):
            SolverContext(membrane(**data, boundary=[]))
    for data, force in (({"load": "x - 0.6", "lower": 0}, -0.1), ({"load": 1, "lower": -1, "upper": 1}, 1.0),
                        ({"load": "x", "lower": -1, "upper": "y"}, 0.5)):  # fmt: skip
        for method in ("penalty", "successive", "vi"):
            contact = solve(membrane(**data, boundary=[]), eps=1e-6, method=method).record["contact"]
            forces = {side: contact.get(side, {}).get("force", 0.0) for side in ("lower", "upper")}
            assert forces["upper"] - forces["lower"] == pytest.approx(force, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_except(["ball", "gap_6"], "gap_6"))
def test_floor_of_eps(name):
    """Just above the floor answers are right; below it they are rejected, with the floor in the message."""
    scene = case(name).on(0)
    with closing(SolverContext(scene, COMM)) as context:
        floor = smallest_eps(context.problem)
    above, below = list(judge(scene, COMM, (1.01 * floor,))), list(judge(scene, COMM, (0.5 * floor, 1e-300)))
    assert [row["verdict"] for row in above] == [RIGHT] * 3, messages(above)
    assert [row["verdict"] for row in below] == [RIGHT] + [REJECTED] * 4
    assert all(FLOOR in row["message"] and f"{floor:.2g}" in row["message"] for row in below[1:])


def test_contact_without_pressure_keeps_its_balance():
    """SNES VI with multigrid: the springs that stand for bounds are no round-off, and no reason to stop early."""
    rows = list(judge(case("biactive_half").on(1), COMM, ()))
    assert [row["verdict"] for row in rows] == [RIGHT], messages(rows)


@pytest.mark.slow
def test_units():
    """Lengths, heights, forces x 2^30 and 2^-30: the same bits; shifted heights: the digits that are left."""
    ball = case("ball").on(0)
    rows = [row for row in judge(ball, MPI.COMM_SELF, (1e-6,), ("penalty",), units=True) if row["trial"]]
    assert len(rows) == 2 * len(all_units(ball, 1.0)) == 14
    assert [row["verdict"] for row in rows] == [RIGHT] * 14, messages(rows)
    for row in rows:
        shifted = "heights +" in row["trial"]
        assert row["digits"]["moved"] <= (4 * row["digits"]["left"] if shifted else 1e-12)
    assert max(row["digits"]["moved"] for row in rows) > 1e-10


def test_other_units_are_the_same_scene():
    """A scene in other units, and back: the same fields; the names of its own are left alone."""
    scene = case("dam").on(0)
    there = Units("there", length=4.0, height=8.0, force=2.0).of(scene)
    assert there.tables.mesh.x == (0, "(width)*4.0")
    assert there.tables.effects == {"tension": 2.0, "load": -1.0}
    assert there.tables.boundary[0].value == "((high - (y/4.0))^2/2)*8.0"


def test_digits_of_the_pressure():
    """Pressure from heights loses machine epsilon |g|/(eps |p|), as theory says; that of the answer nothing at all."""
    rows = [row for row in judge(case("ball").on(0), COMM, (1e-10, 1e-12, 1e-14), ("penalty",)) if row["eps"]]
    for row in rows:
        digits = row["digits"]
        assert 0.1 * digits["line"] < digits["from_heights"] <= digits["line"]
        assert digits["off"] <= max(1e3 * row["eps"], 1e-9)
    assert rows[2]["digits"]["from_heights"] > 50 * rows[1]["digits"]["from_heights"] > 1e-5


@ON_SEVERAL_RANKS
def test_ranks():
    """The same fields on all numbers of ranks, within what is known of their accuracy; another field is found out."""
    one = case("ridge").on(0)
    here, alone = fields_of(one, COMM), fields_of(one, MPI.COMM_SELF)
    if COMM.rank == 0:
        for method in ("vi", *METHODS):
            assert violated(agree_on(alone, here, method)) == []
        moved = {**here, "vi.u": here["vi.u"] + 1e-6, "vi.energy": here["vi.energy"] + [1e-6, 0]}
        assert {finding.name for finding in violated(agree_on(alone, moved, "vi"))} == {
            "ranks: the same u in the energy norm",
            "ranks: the same u at every node",
            "ranks: the same energy",
        }


@pytest.fixture(scope="module")
def answers():
    """The ball by SNES VI and at three eps, to be falsified."""
    scene = case("ball").on(0).change({"mesh.cells": 16})
    found = {}
    context = SolverContext(scene, COMM)
    ground = ReferenceProblem(context.problem)
    for eps in (None, 1e-2, 1e-4, 1e-8):
        context.answer(scene.options_with(method="vi") if eps is None else scene.options_with(eps=eps))
        found[eps] = take(context, ground, eps)
    return found


def at_some_node(s, value):
    """An array with a value at one node of one rank that is free and not in contact."""
    g = s.ground
    mine = np.flatnonzero(g.free & (s.below > 0.1))
    first = COMM.allgather(len(mine) > 0).index(True)
    array = np.zeros(len(s.p))
    if COMM.rank == first:
        array[mine[0]] = value
    return array


def pressed(s, factor):
    """An answer in balance with another pressure."""
    return replace(s, p=factor * s.p, elastic=np.where(s.p != 0, factor * s.elastic, s.elastic))


WRONG_ALONE = {
    "forces at nodes balance": lambda s: replace(s[1e-4], p=1.001 * s[1e-4].p),
    "loads, contact and edges balance": lambda s: replace(
        s[1e-4], elastic=s[1e-4].elastic + np.where(s[1e-4].ground.free, 0, 1e-6)
    ),
    "no pressure without contact": lambda s: replace(s[None], p=s[None].p + at_some_node(s[None], 1e-3)),
    "u between the obstacles": lambda s: replace(s[None], below=s[None].below - 1e-9),
    "p = -(u - g)^+/eps": lambda s: replace(s[1e-4], p=(1 + 1e-9) * s[1e-4].p),
    "the lower obstacle never pulls": lambda s: replace(s[None], p=-s[None].p),
}
WRONG_BESIDE = {
    "penalty and inequality: energy norm": lambda s: replace(s[1e-2], eps=1e-8),
    "penalty and inequality: size of the pressure": lambda s: pressed(s[1e-8], 1.01),
    "penetration": lambda s: replace(s[1e-8], below=1.1 * s[1e-8].below),
    "the inequality's u is farther from the lower obstacle": lambda s: replace(s[1e-8], w=s[1e-8].w + 1e-9),
    "but by no more than the penetration": lambda s: replace(s[1e-8], w=s[1e-8].w - 1e-6),
    "energy below the inequality's": lambda s: replace(s[1e-8], energy=s[1e-8].energy + 1e-3),
}


@pytest.mark.parametrize("name", WRONG_ALONE)
def test_wrong_answer_alone_is_found_out(name, answers):
    assert all(violated(of_one(s)) == [] for s in answers.values())
    assert name in [finding.name for finding in violated(of_one(WRONG_ALONE[name](answers)))]


@pytest.mark.parametrize("name", WRONG_BESIDE)
def test_wrong_answer_beside_the_inequality_is_found_out(name, answers):
    assert all(violated(beside_inequality(answers[eps], answers[None])) == [] for eps in (1e-2, 1e-4, 1e-8))
    wrong = WRONG_BESIDE[name](answers)
    assert name in [finding.name for finding in violated(beside_inequality(wrong, answers[None]))]


def test_wrong_order_is_found_out(answers):
    """As eps falls u moves out of the obstacle and the energy rises: the other way round both are violated."""
    assert violated(falling(answers[1e-2], answers[1e-4])) == []
    assert [finding.name for finding in violated(falling(answers[1e-4], answers[1e-2]))] == [
        "u moves out of the obstacle as eps falls", "energy rises as eps falls"]  # fmt: skip


def test_different_answers_are_not_the_same(answers):
    s = answers[1e-4]
    assert violated(same(s, s, "itself")) == []
    assert len(violated(same(s, replace(pressed(s, 1.001), w=s.w + 1e-7 * s.ground.free), "another"))) == 3


def test_not_a_number_is_no_answer(answers):
    """Comparisons with NaN are false, and so is 'held'."""
    wrong = replace(answers[1e-4], p=answers[1e-4].p * np.nan)
    assert len(violated(of_one(wrong))) >= 3
    assert len(violated(beside_inequality(wrong, answers[None]))) >= 2


@pytest.mark.slow
def test_verdicts_of_what_goes_wrong():
    """A scene that should be rejected and is not, and a solver that gives up: FAILED, with the reason."""
    rows = list(judge(case("lake").on(0), COMM, (1e-4,), refuse="no u satisfies both"))
    assert {row["verdict"] for row in rows} == {FAILED}
    with defaults("penalty_", {"snes_max_it": 1}), defaults("vi_", {"snes_max_it": 1}):
        rows = list(judge(case("spiral").on(0), COMM, (1e-4,)))
    assert {row["verdict"] for row in rows} == {FAILED}
    assert all("did not converge" in row["message"] for row in rows)


@pytest.mark.serial
@pytest.mark.slow
def test_command(tmp_path):
    """One scene in its processes on 1, 2 and 3 ranks: table, lines, pictures; a process that dies has failed."""
    command = [sys.executable, "-m", "fenicsx_obstacle", "hard", "torsion_3", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=CLEAN, timeout=180, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 scene, 62 answers: 62 right, 0 rejected, 0 FAILED" in done.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"hard.jsonl", "tables.md", "steps.png", "digits.png"}
    assert (tmp_path / "hard.jsonl").read_text().count('"3 ranks"') == 3
    lost = rows_of(Case(name="nonsense", family="none", hard="not there"))
    assert [row["verdict"] for row in lost] == [FAILED]
    assert "no such scene" in lost[0]["message"]
