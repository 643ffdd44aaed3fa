"""Hard scenes of all effects: what is claimed of which operator, and that claims can be violated."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from fenicsx_obstacle import solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.check.finding import violated
from fenicsx_obstacle.effects.effect import find, known
from tests.conftest import COMM, ON_SEVERAL_RANKS, membrane, slow_except
from tests.hard.cases import case, cases
from tests.hard.invariants import beside_inequality, of_one, same
from tests.hard.judge import judge, take
from tests.hard.ranks import agree_on, fields_of
from tests.hard.row import RIGHT
from tests.hard.solved import ReferenceProblem
from tests.hard.units import Units, all_units

FEW = (1e-2, 1e-6, 1e-12)


def test_every_effect_has_a_hard_scene():
    """All that scenes with a scalar u can name, a matrix for a tension, all kinds of time, obstacles on the boundary
    and on curves."""
    scenes = [one.base for one in cases() if not one.refuse]
    named = {effect.key for scene in scenes for effect in scene.effects}
    scalar = {key for key in known() | known("boundary") if find(key).vector_valued is not True}
    assert named >= scalar >= {"tension", "flux", "axial_symmetry"}
    assert {scene.time.order for scene in scenes if scene.time is not None} == {0, 1, 2}
    assert any(isinstance(scene.tables.effects.get("tension"), list) for scene in scenes)
    thin = [scene for scene in scenes if scene.model.thin]
    assert any(scene.tables.mesh.file for scene in thin) and any(scene.tables.mesh.shape for scene in thin)


# whether the maximum principle holds; the symmetric part is definite in all of them
SCENES = {
    "storm": False, "woven": False, "tower": False, "power_3.8": False, "axle_string": True, "bed_8": True,
    "mattress": True, "cords_-8": True, "cords_8": True, "nail": True, "stop": True, "valves": True,
}  # fmt: skip


@pytest.mark.parametrize("name", slow_except(SCENES, "storm", "tower", "nail", "valves"))
def test_scene(name):
    """Every answer keeps what is claimed for its operator."""
    rows = list(judge(case(name).on(0), COMM, FEW, starts=name in ("storm", "nail")))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), [row["message"] for row in rows]
    assert all(row["monotone"] is SCENES[name] for row in rows)
    claims = {finding["name"]: finding["claimed"] for row in rows for finding in row["findings"]}
    assert claims["penalty and inequality: energy norm"] and claims["penetration"] is SCENES[name]
    assert ("energy rises as eps falls" in claims) is (name != "storm")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["american_put", "melting", "wall", "drum_on_peg", "press"])
def test_scene_with_time(name):
    """Each step keeps what a problem at rest keeps; all together keep within the penetration, or lose energy."""
    rows = list(judge(case(name).on(0), COMM, FEW))
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), [row["message"] for row in rows]
    assert len(rows) == 1 + 2 * len(FEW) and all(row["monotone"] for row in rows)
    claims = {finding["name"] for row in rows for finding in row["findings"] if finding["claimed"]}
    moving = "energy never grows", "all steps: no farther from the inequality's u than the penetration"
    assert moving[name not in ("wall", "drum_on_peg")] in claims


@pytest.mark.parametrize("name", ["storm", "tower", "power_1.2", "mattress", "nail", "cords_8", "stop"])
@pytest.mark.slow
def test_units(name):
    """All quantities of an effect in other units are the same scene: u, p, and as many steps."""
    rows = [row for row in judge(case(name).on(0), MPI.COMM_SELF, (1e-6,), ("penalty",), units=True) if row["trial"]]
    assert [row["verdict"] for row in rows] == [RIGHT] * len(rows), [row["message"] for row in rows]
    assert len(rows) >= 8


def test_units_of_slopes_and_of_heights_from_0():
    """A film of large slopes scales with all its lengths alone; beds and springs know where 0 is."""
    names = {name: [units.name for units in all_units(case(name).on(0), 1.0)] for name in ("tower", "bed_8", "storm")}
    assert names["tower"] == ["lengths and heights x 2^-30", "lengths and heights x 2^30", "forces x 2^-30",
                              "forces x 2^30", "heights + 2^20 sizes"]  # fmt: skip
    assert len(names["bed_8"]) == 6 and len(names["storm"]) == 7
    there = Units("there", length=4.0, height=8.0, force=2.0).of(case("power_1.2").on(0)).tables.effects
    assert there["power_law"]["regularisation"] == 2e-3
    assert np.isclose(there["power_law"]["coefficient"], 2.0 * 2.0**0.8)
    nail = Units("there", length=4.0, height=8.0, force=2.0).of(case("nail").on(0)).tables.effects["point_load"]
    assert nail[0] == {"at": [0.405 * 4, 0.013 * 4], "force": "(force)*16.0"}


def answers(scene, *epsilons):
    """Answers of a scene, the inequality's first."""
    context = SolverContext(scene, COMM)
    ground = ReferenceProblem(context.problem)
    found = []
    for eps in (None, *epsilons):
        context.answer(scene.options_with(method="vi") if eps is None else scene.options_with(eps=eps))
        found.append(take(context, ground, eps))
    return found


@pytest.mark.parametrize("name", ["storm", "tower", "mattress", "nail"])
def test_wrong_answers_are_found_out(name):
    """Another u, a force that nobody answers, a distance too large for its eps: for each kind of operator."""
    vi, s = answers(case(name).on(0), 1e-6)
    assert violated([*of_one(s), *of_one(vi), *beside_inequality(s, vi), *same(s, s, "itself")]) == []
    off = replace(s, w=s.w + 1e-6 * s.range * s.ground.free, elastic=s.elastic * (1 + 1e-6))
    assert any("energy norm" in finding.name for finding in violated(same(s, off, "another")))
    names = [finding.name for finding in violated(of_one(replace(s, elastic=s.elastic * 1.01)))]
    assert "forces at nodes balance" in names
    far = violated(beside_inequality(replace(s, eps=1e-8 * s.eps), vi))
    assert any("energy norm" in finding.name for finding in far)


def test_point_loads_are_part_of_the_balance():
    """Load, contact, edges and the forces at points add up to 0; without the latter they would not."""
    scene = membrane(load=-1, lower=-0.02, point_load=[{"at": [0.3, 0.6], "force": 0.5}])
    s = answers(scene)[0]
    finding = next(one for one in of_one(s) if one.name == "loads, contact and edges balance")
    assert finding.held and finding.limit < 1e-6


def test_energy_of_rules_that_differ():
    """Tension, load and foundation (nodal rule) of u = x: 1/2 - 2/2 + (3/2)/2; load and foundation differ in rule."""
    scene = membrane(foundation=3, load=2, boundary=[{"value": "x"}], mesh={"shape": "rectangle", "cells": 1})
    assert np.isclose(solve(scene).record["energy"], 0.25)
    # a derivative of the energy is the residual
    with closing(SolverContext(case("mattress").on(0))) as context:
        problem = context.problem
        x = problem.vector()
        residual, step = x.duplicate(), x.duplicate()
        problem.residual(x, residual, penalised=False)
        x.copy(step)
        rate = 1e-4
        step.axpy(-rate, residual)
        fallen = problem.energy(x, penalised=False) - problem.energy(step, penalised=False)
        assert np.isclose(fallen, rate * residual.norm() ** 2, rtol=0.05)


@ON_SEVERAL_RANKS
@pytest.mark.slow
def test_ranks():
    """No maximum principle, no energy: the energy norm of the difference tells other answers from the same."""
    one = case("pollutant").on(0)
    here, alone = fields_of(one, COMM), fields_of(one, MPI.COMM_SELF)
    if COMM.rank == 0:
        assert violated(agree_on(alone, here, "penalty")) == []
        moved = {**here, "penalty.u": here["penalty.u"] + 1e-6}
        assert [finding.name for finding in violated(agree_on(alone, moved, "penalty"))] == [
            "ranks: the same u in the energy norm"]  # fmt: skip


@pytest.mark.slow
def test_harder_and_harder_obstacles():
    """n = 3.8 with eps = 1e-12: where Newton and line searches fail, softer obstacles lead there."""
    rows = list(judge(case("power_3.8").on(0), COMM, (1e-12,), ("penalty",)))
    assert [row["verdict"] for row in rows] == [RIGHT, RIGHT], [row["message"] for row in rows]
