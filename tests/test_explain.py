"""What `explain` says, held against what a solve does; and that what a scene does not name costs nothing."""

from contextlib import closing

import pytest

from fenicsx_obstacle import Scene, solve
from fenicsx_obstacle.answers.solver_context import SolverContext
from fenicsx_obstacle.discrete.hierarchy import nested
from fenicsx_obstacle.effects.effect import known
from fenicsx_obstacle.scenes import tables
from fenicsx_obstacle.show.explain import explain, explained, integrals
from tests.conftest import COMM, DEMOS, membrane, slow_except

OF_BODIES = {"elasticity", *tables.OF_BODIES}  # which scalar scenes cannot name
SCENES = {
    "pollutant": ("GMRES", "the norm of the residual"),
    "soap": ("algebraic multigrid", "a line search on the energy, full steps where round-off hides descent"),
    "wall": ("truncated multigrid", "full steps; a line search on the energy if sets repeat"),
    "tent": ("truncated multigrid", "one linear solve without contact"),
    "foam": ("algebraic multigrid", "Newton steps"),
}


@pytest.mark.parametrize("name", SCENES)
def test_explained_and_done(name):
    """Effects with their terms, those left out, unknowns, integrals and the solver, of five scenes."""
    scene = Scene.read(DEMOS / f"{name}.toml")
    parts, text = dict(explained(scene)), " ".join(explain(scene).split())
    named = {effect.key for effect in scene.effects}
    assert {line.partition(":")[0] for line in parts["effects"][:-1]} == named
    left_out = set(parts["not included"][0].split("; "))
    assert left_out - {"lower obstacle", "upper obstacle"} == (known() | known("boundary")) - named - OF_BODIES
    assert all(words in text for words in SCENES[name])
    with closing(SolverContext(scene, COMM)) as context:
        told = next(line for line in parts["mesh"] if "unknowns" in line)
        assert float(told.split()[1]) == pytest.approx(context.problem.level.dofs, rel=0.03)
        formed = len(context.problem.law._a_minus_f.integrals())
        assert integrals(scene) == formed + context.problem.constrained
        assert nested(scene.effects, scene.pair, scene.options) == ("truncated multigrid" in text)
        assert context.problem.symmetric == ("GMRES" not in text)


@pytest.mark.slow
def test_explained_unknowns_of_all_elements():
    """Before any mesh is made: within 10 % of what there is."""
    for changes in ({"solve.element": "P2"}, {"solve.element": "Q2"}, {"mesh.diagonal": "crossed"},
                    {"mesh.shape": "l-shape"}, {"mesh.shape": "disk"}, {"mesh.shape": "box", "mesh.cells": 8},
                    {"mesh.cells": 8, "mesh.refine": 2}):  # fmt: skip
        scene = membrane(lower=-1).change({"mesh.cells": 32, **changes})
        told = next(line for line in dict(explained(scene))["mesh"] if "unknowns" in line)
        with closing(SolverContext(scene, COMM)) as context:
            assert float(told.split()[1]) == pytest.approx(context.problem.level.dofs, rel=0.1), changes


@pytest.mark.parametrize(
    ("scene", "line"),
    [
        ({"soft_obstacle": {"lower": 0, "stiffness": 5}, "load": -1},
         "-div(tension grad u) + stiffness ((u - upper)^+ - (lower - u)^+) = load"),
        ({"lower": -1, "upper": 1}, "p = (lower - u)^+ / eps - (u - upper)^+ / eps at the points of I (3.7), (3.8)"),
        ({"upper": 1, "drift": [1, 0]}, "-div(tension grad u) + drift . grad u = p"),
    ],
)  # fmt: skip
def test_signs(scene, line):
    assert line in " ".join(explain(membrane(**scene)).split())


@pytest.mark.parametrize("method", slow_except(["penalty", "vi"], "vi"))
def test_lake_costs_one_linear_solve(method):
    """No contact in reach, with whatever is linear: one Newton step on the finest level; `explain` says so."""
    parts = [{"on": "left", "value": 0}, {"on": "right", "spring": 1, "flux": 0.1}, {"on": "top", "upper": 9}]
    for more in ({"lower": -1, "foundation": 3}, {"lower": -1, "tension": [[2, 1], [1, 2]]},
                 {"lower": -1, "drift": [2, 1]}, {"lower": -1, "axial_symmetry": True},
                 {"lower": -1, "point_load": [{"at": [0.3, 0.4], "force": 1}]}, {"boundary": parts}):  # fmt: skip
        scene = membrane(load=1, **more)
        assert solve(scene, cells=32, method=method).record["newton_iterations"] == 1, more
        assert "one linear solve without contact" in explain(scene)
