"""Hard scenes in short: right or rejected on 1, 2 and 3 ranks, and every invariant can be violated."""

import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import solve
from fenicsx_obstacle.algebra.newton import smallest_eps
from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import violated
from tests.conftest import CLEAN, COMM, ON_SEVERAL_RANKS, membrane, slow_except
from tests.hard.cases import Case, case
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
    """The ball by SNES VI (None) and at three eps, to be falsified."""
    scene, found = case("ball").on(0).change({"mesh.cells": 16}), {}
    context = SolverContext(scene, COMM)
    ground = ReferenceProblem(context.problem)
    for eps in (None, 1e-2, 1e-4, 1e-8):
        context.answer(scene.options_with(method="vi") if eps is None else scene.options_with(eps=eps))
        found[eps] = take(context, ground, eps)
    return found


def pressed(s, factor):
    """An answer in balance with another pressure."""
    return replace(s, p=factor * s.p, elastic=np.where(s.p != 0, factor * s.elastic, s.elastic))


def moved(s):
    """An answer with another u."""
    return replace(pressed(s, 1.001), w=s.w + 1e-7 * s.ground.free)


@pytest.mark.parametrize(
    ("name", "findings"),
    [("balance", lambda s: of_one(replace(s[1e-4], elastic=s[1e-4].elastic + np.where(s[1e-4].ground.free, 0, 1e-6)))),
     ("pulls", lambda s: of_one(replace(s[None], p=-s[None].p))),
     ("energy norm", lambda s: beside_inequality(replace(s[1e-2], eps=1e-8), s[None])),
     ("size of the pressure", lambda s: beside_inequality(pressed(s[1e-8], 1.01), s[None])),
     ("penetration", lambda s: beside_inequality(replace(s[1e-8], below=1.1 * s[1e-8].below), s[None])),
     ("energy rises", lambda s: falling(s[1e-4], s[1e-2])),
     ("at every node", lambda s: same(s[1e-4], moved(s[1e-4]), "another"))],
)  # fmt: skip
def test_wrong_answer_is_found_out(name, findings, answers):
    """Of each kind of invariant one; the others of one answer are those of `verify`, whose test falsifies them."""
    assert any(name in finding.name for finding in violated(findings(answers)))


def test_right_answers_violate_nothing(answers):
    """As they are; comparisons with NaN are false, and so is 'held'."""
    vi, one = answers[None], answers[1e-4]
    right = [*of_one(vi), *falling(answers[1e-2], one), *same(one, one, "itself")]
    for eps in (1e-2, 1e-4, 1e-8):
        right += [*of_one(answers[eps]), *beside_inequality(answers[eps], vi)]
    assert violated(right) == []
    wrong = replace(one, p=one.p * np.nan, q=one.q * np.nan)
    assert len(violated(of_one(wrong))) >= 3 and len(violated(beside_inequality(wrong, vi))) >= 2


def test_energy_of_rules_that_differ():
    """Tension, load and foundation (nodal rule) of u = x: 1/2 - 2/2 + (3/2)/2; load and foundation differ in rule."""
    scene = membrane(foundation=3, load=2, boundary=[{"value": "x"}], mesh={"shape": "rectangle", "cells": 1})
    assert np.isclose(solve(scene).record["energy"], 0.25)


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
