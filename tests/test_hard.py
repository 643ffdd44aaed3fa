"""Hard scenes in short: right or rejected on 1, 2 and 3 ranks, and every invariant can be violated."""

import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import InputError, solve
from fenicsx_obstacle.algebra.linear_solvers import defaults
from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import violated
from fenicsx_obstacle.effects.effect import find, known
from tests.conftest import CLEAN, COMM, ON_SEVERAL_RANKS, membrane, slow_except
from tests.hard.cases import FOLDER, Case, case, cases, named
from tests.hard.invariants import beside_inequality, falling, of_one, same
from tests.hard.judge import METHODS, judge, take
from tests.hard.ranks import agree_on, fields_of
from tests.hard.row import FAILED, FLOOR, REJECTED, RIGHT
from tests.hard.solved import ReferenceProblem
from tests.hard.suite import rows_of
from tests.helpers import run_python

FEW, OF_EFFECTS = (1e-2, 1e-8, 1e-14), (1e-2, 1e-6, 1e-12)


def messages(rows):
    return [row["message"] for row in rows if row["verdict"] == FAILED]


def test_the_list():
    """At least 40 scenes; each file is one of them; what cannot be solved yet says why; each says what is hard."""
    names = [one.name for one in cases()]
    assert len(set(names)) == len(names)
    assert len(cases()) >= 40
    assert {path.stem for path in FOLDER.glob("*.toml")} - {"suite"} <= {one.scene or one.name for one in cases()}
    assert all(one.hard for one in cases())
    assert named("drift") == tuple(one for one in cases() if one.family == "drift")
    with pytest.raises(InputError, match="did you mean 'ridge'"):
        case("rigde")


def test_every_effect_has_a_hard_scene():
    """All that a scalar u can have, matrices for tensions, all kinds of time, obstacles on the boundary and curves."""
    scenes = [one.base for one in cases() if not one.refuse]
    named = {effect.key for scene in scenes for effect in scene.effects}
    scalar = {key for key in known() | known("boundary") if find(key).vector_valued is not True}
    assert named >= scalar >= {"tension", "flux", "axial_symmetry"}
    assert {scene.time.order for scene in scenes if scene.time is not None} == {0, 1, 2}
    assert any(isinstance(scene.tables.effects.get("tension"), list) for scene in scenes)
    thin = [scene for scene in scenes if scene.model.thin]
    assert any(scene.tables.mesh.file for scene in thin) and any(scene.tables.mesh.shape for scene in thin)


# of each kind of operator one; the suite has all scenes. Whether the matrix is an M-matrix
SCENES = {"ridge": True, "storm": False, "tower": False, "nail": True, "valves": True}


@pytest.mark.parametrize("name", slow_except(SCENES, "storm", "tower", "nail", "valves"))
def test_scene(name):
    """Invariants that are claimed hold, from any start; less is claimed where the matrix is no M-matrix."""
    rows = list(judge(case(name).on(0), COMM, OF_EFFECTS, starts=name in ("ridge", "storm", "nail")))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), messages(rows)
    assert all(row["monotone"] is SCENES[name] for row in rows)
    claims = {finding["name"]: finding["claimed"] for row in rows for finding in row["findings"]}
    assert claims["penalty and inequality: energy norm"] and claims["penetration"] is SCENES[name]
    assert ("energy rises as eps falls" in claims) is (name != "storm")


@pytest.mark.serial  # as the suite, which judges on one rank and compares pressures on more of them
def test_elastic_body():
    """The bound of eps holds, resultants and moments are in equilibrium to 1e-8, and forces scale with the unit."""
    name = "in_a_corner"
    rows = list(judge(case(name).on(0), COMM, FEW, known=case(name).known, units=True))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), messages(rows)
    assert len(rows) == 2 + len(FEW)
    wrong = list(judge(case(name).on(0), COMM, (), known=dict.fromkeys(case(name).known, -1.0)))
    assert [row["verdict"] for row in wrong] == [FAILED]


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


ENERGY_NORM = "ranks: the same u in the energy norm"


@ON_SEVERAL_RANKS
@pytest.mark.parametrize(
    ("name", "methods", "told"),
    [("ridge", ("vi", *METHODS), {ENERGY_NORM, "ranks: the same u at every node", "ranks: the same energy"}),
     ("pollutant", ("penalty",), {ENERGY_NORM})],
)  # fmt: skip
def test_ranks(name, methods, told):
    """The same fields on all numbers of ranks, as far as their accuracy is known; another field is found out."""
    one, method = case(name).on(0), methods[0]
    here, alone = fields_of(one, COMM), fields_of(one, MPI.COMM_SELF)
    if COMM.rank == 0:
        assert all(violated(agree_on(alone, here, other)) == [] for other in methods)
        moved = {**here, f"{method}.u": here[f"{method}.u"] + 1e-6}
        if name == "ridge":
            moved["vi.energy"] = here["vi.energy"] + [1e-6, 0]
        assert {finding.name for finding in violated(agree_on(alone, moved, method))} == told


@pytest.fixture(scope="module")
def answers():
    """The ball by SNES VI and at three eps, to be falsified."""
    return answers_of(case("ball").on(0).change({"mesh.cells": 16}), 1e-2, 1e-4, 1e-8)


def answers_of(scene, *epsilons):
    """Answers of a scene by eps, that of the inequality by None."""
    found, context = {}, SolverContext(scene, COMM)
    ground = ReferenceProblem(context.problem)
    for eps in (None, *epsilons):
        context.answer(scene.options_with(method="vi") if eps is None else scene.options_with(eps=eps))
        found[eps] = take(context, ground, eps)
    return found


def pressed(s, factor):
    """An answer in balance with another pressure."""
    return replace(s, p=factor * s.p, elastic=np.where(s.p != 0, factor * s.elastic, s.elastic))


# the others of one answer are those of `verify`, whose test falsifies them
WRONG_ALONE = {
    "loads, contact and edges balance": lambda s: replace(
        s[1e-4], elastic=s[1e-4].elastic + np.where(s[1e-4].ground.free, 0, 1e-6)
    ),
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


@pytest.mark.parametrize("name", [*WRONG_ALONE, *WRONG_BESIDE])
def test_wrong_answer_is_found_out(name, answers):
    alone = name in WRONG_ALONE

    def found(s):
        return [finding.name for finding in violated(of_one(s) if alone else beside_inequality(s, answers[None]))]

    assert not any(found(s) for eps, s in answers.items() if alone or eps is not None)
    assert name in found((WRONG_ALONE | WRONG_BESIDE)[name](answers))


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
    wrong = replace(answers[1e-4], p=answers[1e-4].p * np.nan, q=answers[1e-4].q * np.nan)
    assert len(violated(of_one(wrong))) >= 3
    assert len(violated(beside_inequality(wrong, answers[None]))) >= 2


def test_energy_of_rules_that_differ():
    """Tension, load and foundation (nodal rule) of u = x: 1/2 - 2/2 + (3/2)/2; load and foundation differ in rule."""
    scene = membrane(foundation=3, load=2, boundary=[{"value": "x"}], mesh={"shape": "rectangle", "cells": 1})
    assert np.isclose(solve(scene).record["energy"], 0.25)


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
    """One scene in its processes on 1, 2 and 3 ranks: table and lines; a process that dies has failed."""
    command = [sys.executable, "-m", "fenicsx_obstacle", "hard", "torsion_3", "--output", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=CLEAN, timeout=180, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 scene, 62 answers: 62 right, 0 rejected, 0 FAILED" in done.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"hard.jsonl", "tables.md"}
    assert (tmp_path / "hard.jsonl").read_text().count('"3 ranks"') == 3
    lost = rows_of(Case(name="nonsense", family="none", hard="not there"))
    assert [row["verdict"] for row in lost] == [FAILED]
    assert "no such scene" in lost[0]["message"]


JUDGED = """
from tests.hard.cases import case
from tests.hard.judge import judge
rows = judge(case("string_mu_jump").on(1), epsilons=(1e-12, 1e-14), methods=("penalty",))
print([finding for row in rows for finding in row["findings"] if not finding["held"]])
"""


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize(("kind", "needs"), [("Nehalem", "sse4_2"), ("Haswell", "fma"), ("SkylakeX", "avx512f")])
def test_kinds_of_arithmetic(kind, needs):
    """With and without fused operations and wide registers in the linear algebra, as far as the processor has them."""
    known = Path("/proc/cpuinfo")
    if not known.exists() or needs not in known.read_text().split():
        pytest.skip(f"this processor has no {needs}: OpenBLAS would end the process")
    said = run_python(JUDGED, env={**CLEAN, "OPENBLAS_CORETYPE": kind})
    assert said.stdout.strip() == "[]", said.stderr


@pytest.mark.parametrize(("name", "mesh", "eps"), [("gap_2", 0, 1e-12), ("steep", 1, 1e-10)])
def test_what_round_off_limits_is_solved_again_from_the_obstacle_in_contact(name, mesh, eps):
    """A state in balance to the round-off of a w that counts from another obstacle is no end."""
    with closing(SolverContext(case(name).on(mesh))) as context:
        last = context.answer(SolverOptions("penalty", eps)).history[-1]
    assert last.unbalanced <= TOLERANCE * last.forces
