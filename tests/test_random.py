"""Random scenes: invariants hold for every answer, certificates hold, and what has no solution is rejected."""

from types import SimpleNamespace

import pytest

from fenicsx_obstacle import releases
from fenicsx_obstacle.answers.solve import solve
from fenicsx_obstacle.errors import InputError
from tests.conftest import COMM
from tests.hard.row import FAILED
from tests.random.draw import SEED, shares, try_all
from tests.random.families.all_families import TRUTHS
from tests.random.families.drifts import Strip
from tests.random.families.family import Judgement
from tests.random.families.films import Film
from tests.random.own_forms import OwnForm, not_in_balance
from tests.random.own_forms import judged as judged_form
from tests.random.show import show_random

OF_EACH = {1: 2}  # on more ranks 1
# families that have scenes of many kinds, or whose scenes take long, and two of which a later scene is the first with
# a bound that is near its error
OTHERS = {"admissible": 12 if COMM.size == 1 else 6, "tetrahedra": 1, "supported": 1, "touching": 1, "anisotropic": 1,
          "sectors": 3, "close obstacles": 3}  # fmt: skip
NEAR = 20  # bounds over true errors: of each family one is below
ON_RANKS = ("admissible", "layers", "touching", "obstacle alone", "drift from a point")  # run on several ranks


@pytest.mark.slow
@pytest.mark.ranks
@pytest.mark.parametrize(
    "family", [pytest.param(name, marks=[pytest.mark.variant] * (name not in ON_RANKS)) for name in shares(100)]
)
def test_families(family):
    """A short form of `./obstacle hard --random`, with scenes of its own: invariants and certificates hold, answers are
    right, what has none is rejected.

    A closed form that is wrong has errors above the bound; where errors are computed too small, no bound is near them.
    """
    rows = []
    try_all({family: OTHERS.get(family, OF_EACH.get(COMM.size, 1))}, SEED + 100, COMM, rows.append)
    scenes = COMM.allgather([row["scene"] for row in rows])
    assert rows and all(other == scenes[0] for other in scenes)
    assert not [f"{row['message']}\n{row['text']}" for row in rows if row["verdict"] == FAILED]
    if family == "admissible":
        assert sum(row["answers"] for row in rows) > 2 * len(rows)
    if family in TRUTHS and COMM.size == 1:
        bounds = [bound for row in rows for bound in row["bounds"] if bound["error"] > 1e-9 * bound["norm"]]
        assert min(bound["total"] / bound["error"] for bound in bounds) < NEAR


@pytest.mark.serial
@pytest.mark.slow
def test_a_run_continues(tmp_path):
    """Rows of one family are kept when they are finished, and are not judged again."""
    with pytest.raises(InputError, match="no family 'tetrahedron'; did you mean 'tetrahedra'"):
        shares(3, family="tetrahedron")
    said, rows = [], []
    for count in (1, 4):
        rows.append(show_random(count, tmp_path, said.append, 3, truths=True, family="layers"))
    assert [len(found) for found in rows] == [1, 4]
    first = rows[0][0]
    assert first in rows[1] and first["run"] == 1  # with its seconds
    assert {row["run"] for row in rows[1] if row["key"] != first["key"]} == {2}


@pytest.mark.parametrize(
    ("words", "guaranteed", "total", "held"),
    [("certified", True, 0.99, False), ("certified", True, 1.0, True),
     ("certified on the polygon of the mesh", False, 0.9, False),
     ("an indicator: drift", False, 0.1, True), ("certified for the sampled tension", False, 0.1, True),
     ("an indicator: drift", True, 0.1, False)],
)  # fmt: skip
def test_certificates(words, guaranteed, total, held):
    """A bound below the true error is FAILED where it is said to hold, and only there."""
    answer = SimpleNamespace(bound=SimpleNamespace(words=words, guaranteed=guaranteed, total=total))
    judgement = Judgement(COMM)
    judgement.certificate(answer, 1.0, 3.0)
    assert (not judgement.wrong) == held
    judgement = Judgement(COMM)
    judgement.not_certified(answer, "there is no solution")
    assert (not judgement.wrong) == (words != "certified" and not guaranteed)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [Strip("interval", 300, 1.0, "from a point", 4.0, 0.5),
     Film("cap", 60, 1.0, 1.0, 0.5, 1.0, {"method": "penalty"}, False)],
)  # fmt: skip
def test_false_answers(scene, monkeypatch):
    """The right answer is accepted; the same times -1 or 1.5 is FAILED."""
    for factor in (1.0, 1.5, -1.0):

        def solved(*given, factor=factor, **more):
            answer = solve(*given, **more)
            answer.u.x.array[:] *= factor
            return answer

        monkeypatch.setattr("tests.random.families.family.solve", solved)
        judgement = Judgement(COMM)
        scene.judge(judgement)
        assert bool(judgement.wrong) == (factor != 1), factor


FIRST_FORM = 1000  # `python -m tests.random.own_forms COUNT FIRST_FORM` tries more
FORMS = {1: 8, 2: 4}  # on three ranks 3
LOUD = {1128}  # a start of 10 times the solution, where Newton's method fails with the penalty; the message says so


@pytest.mark.slow
def test_own_forms():
    """Random forms of a user's own with default options: as the variational inequality, or with a word."""
    found = []
    for seed in range(FIRST_FORM + 100, FIRST_FORM + 100 + FORMS.get(COMM.size, 3)):
        form = OwnForm(seed, COMM)
        word, why = judged_form(form)
        if word == "FAILED" or (word == "loud" and seed not in LOUD):
            found.append(f"{word} {form.text()}: {why}")
    assert not found


# contact alone with little stiffness, lost from a start in the unit of u, not in that of its data; a film beyond its
# limit, for which u = 1e96 was accepted as in balance, as what is negligible grew with u
@pytest.mark.parametrize(("seed", "word", "says"), [(1165, "right", ""), (20103, "none", "vi did not converge")])
def test_forms_that_were_lost(seed, word, says):
    found, why = judged_form(OwnForm(seed, COMM))
    assert found == word and says in why


def test_the_judge_sees_what_is_wrong():
    """A solution that is moved, or pushed through its obstacle, is not in balance."""
    form = OwnForm(FIRST_FORM, COMM)
    solution = form.problem().solve(method="vi")
    assert not not_in_balance(form, solution, penetrates=False)
    solution.u.x.array[:] *= 1.01
    releases.set_values(solution.u.x.array, form.bcs)
    assert "not balanced" in not_in_balance(form, solution, penetrates=True)
