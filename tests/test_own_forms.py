"""Random forms of a user's own with default options: as the variational inequality, or with a word."""

import numpy as np
import pytest

from tests.conftest import COMM
from tests.random.own_forms import Drawn, OwnForm, judged, not_in_balance

FIRST = 1000  # `python -m tests.random.own_forms COUNT FIRST` tries more
MANY = {1: 12, 2: 6}  # on three ranks 4
KNOWN = {1128}  # a start of 10 times the solution, where Newton's method fails with the penalty; the message says so


def wrong(seeds):
    found = []
    for seed in seeds:
        form = OwnForm(seed, COMM)
        verdict = judged(form)
        if verdict.word == "FAILED" or (verdict.word == "loud" and seed not in KNOWN):
            found.append(f"{verdict.word} {form.text()}: {verdict.why}")
    return found


@pytest.mark.slow
def test_many():
    count = MANY.get(COMM.size, 4)
    assert not wrong(range(FIRST + 100, FIRST + 100 + count))


def test_contact_alone_with_little_stiffness():
    """A form that was lost from a start in the unit of u, not in that of its data."""
    assert judged(OwnForm(1165, COMM)).word == "right"


def test_a_film_beyond_its_limit():
    """u = 1e96 was accepted as in balance: what is negligible grew with u."""
    verdict = judged(OwnForm(20103, COMM))
    assert verdict.word == "none" and "vi did not converge" in verdict.why


def test_the_judge_sees_what_is_wrong():
    """A solution that is moved, or pushed through its obstacle, is not in balance."""
    form = OwnForm(FIRST, COMM)
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


def test_draws_are_the_same():
    words = [Drawn(3), Drawn(3)]
    assert words[0].number(0, 1, "x") == words[1].number(0, 1, "x") and words[0].words == words[1].words
