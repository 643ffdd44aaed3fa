"""Random scenes: invariants hold for every answer, certificates hold, and what has no solution is rejected."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from fenicsx_obstacle.answers.solve import solve
from fenicsx_obstacle.errors import InputError, NotConverged
from tests.conftest import COMM
from tests.hard.row import FAILED, REJECTED, RIGHT
from tests.random import draw
from tests.random.draw import SEED, judged, shares, try_all
from tests.random.families.all_families import TRUTHS
from tests.random.families.drifts import Strip
from tests.random.families.family import ANSWER, EITHER, INPUT_ERROR, REJECTION, Family, Judgement
from tests.random.families.films import Film
from tests.random.own_forms import OwnForm, not_in_balance
from tests.random.own_forms import judged as judged_form
from tests.random.show import HEADS, show_random, table

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


def test_shares():
    """Half of the scenes are admissible ones, no family is forgotten."""
    counts = shares(1000)
    assert sum(counts.values()) == 1000
    assert counts["admissible"] == 500
    assert min(counts.values()) >= 500 // len(counts)
    assert sum(shares(1).values()) == 1
    truths = shares(1000, truths=True)
    assert set(truths) == set(TRUTHS) and sum(truths.values()) == 1000
    assert min(truths.values()) >= 1000 // len(truths)


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


@pytest.mark.serial
@pytest.mark.parametrize("file", ["fenicsx_obstacle/forms/penalty.py", "fenicsx_obstacle/a.c", "tests/hard/judge.py"])
def test_rows_of_other_code(file, tmp_path, monkeypatch):
    """A row that other code has found or judged is not taken for one of this code; the same code elsewhere keeps it."""
    keys = []
    for folder, text in (("old", "a"), ("new", "b"), ("same", "b")):
        path = tmp_path / folder / file
        path.parent.mkdir(parents=True)
        path.write_text(text)
        monkeypatch.setattr(draw, "ROOT", tmp_path / folder)
        keys.append(draw.key_of(Told(ANSWER)))
    assert keys[0] != keys[1] == keys[2]


def test_table_of_bounds():
    """Each kind of words has its column; errors of round-off have no effectivity."""
    kinds = ("certified", "certified on the polygon of the mesh", "certified for the sampled load", "an indicator: x")
    bounds = [{"words": words, "total": 2.0, "error": 1.0, "norm": 1.0, "claimed": k < 2, "below": False}
              for k, words in enumerate(kinds)]  # fmt: skip
    bounds[1] |= {"total": 0.5, "below": True}
    bounds[2] |= {"total": 0.7, "below": True}
    bounds[3] |= {"error": 1e-15}
    rows = [{"family": "layers", "bounds": [bound]} for bound in bounds] + [{"family": "pole", "bounds": []}]
    heads, layers, pole, every, *_ = table(rows).splitlines()
    assert heads.split() == [*" ".join(HEADS).split()]
    assert layers.split()[1:] == ["4", "1", "1", "1", "1", "0", "1", "1", "0.70", "2"]
    assert pole.split()[1:] == ["1", "0", "0", "0", "0", "1", "0", "0"]
    assert every.split()[1:] == ["5", "1", "1", "1", "1", "1", "1", "1", "0.70", "2"]


@dataclass(frozen=True)
class Told(Family):
    """A scene whose judge is told what the program did."""

    outcome: str

    name = "told"

    def judge(self, judgement):
        actions = {"answer": lambda: 1, "input": self._input, "lost": self._lost}
        judgement.attempt(
            actions[self.outcome[2:]], {"a": ANSWER, "r": REJECTION, "i": INPUT_ERROR, "e": EITHER}[self.outcome[0]]
        )

    def text(self):
        return self.outcome

    def _input(self):
        raise InputError("wrong")

    def _lost(self):
        raise NotConverged("penalty", "words", 3, eps=1.0, h=0.1)


@pytest.mark.parametrize(
    ("outcome", "verdict"),
    [("a answer", RIGHT), ("a input", FAILED), ("a lost", FAILED), ("r answer", FAILED), ("r input", REJECTED),
     ("r lost", REJECTED), ("i answer", FAILED), ("i input", REJECTED), ("i lost", FAILED), ("e answer", RIGHT),
     ("e lost", REJECTED)],
)  # fmt: skip
def test_expectations(outcome, verdict):
    """Answers where there must be none are FAILED, and so are rejections where there must be an answer."""
    row = judged(Told(outcome), COMM)
    assert row["verdict"] == verdict
    assert (row["message"] == "") == (verdict != FAILED)


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
    own = form.V.dofmap.index_map.size_local
    free = np.ones(own, dtype=bool)
    for bc in form.bcs:
        dofs = bc.dof_indices()[0]
        free[dofs[dofs < own]] = False
    solution.u.x.array[:own][free] *= 1.01
    solution.u.x.scatter_forward()
    assert not_in_balance(form, solution, penetrates=False)
