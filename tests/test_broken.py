"""Input that is wrong in every way: one message that names the place, exit status 2, and nothing left behind.

A share of what `./obstacle hard --broken` tries, on the ranks of this session.
"""

import re

import pytest

from fenicsx_obstacle import solve
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes import catalogue
from tests.cli.broken.case import complaint, time_limit
from tests.cli.broken.collection import RIGHT, collect, make_meshes
from tests.cli.broken.files import contradictions
from tests.cli.broken.inside import attempt
from tests.cli.broken.options import RESULT
from tests.conftest import COMM

FILES = re.compile(r"(scene|mesh) file: |.* torn at ")  # that no message describes further, and that take long to read


def kinds(case):
    """What a case is the first of: the words that its message must hold, its place, and what is wrong there."""
    words = (tuple(case.names), *case.arguments[:1])
    return {words} if FILES.match(case.name) else {words, *case.name.split(": ")}


def of_each_kind(cases):
    """The cases that are the first of some kind."""
    seen, found = set(), []
    for case in cases:
        if kinds(case) - seen:
            found.append(case)
        seen |= kinds(case)
    return found


def complaints(cases, folder):
    """What is wrong with the refusals of the ranks of this session (collective)."""
    found = []
    for number, case in enumerate(cases):
        place = folder / str(number)
        on_root(COMM, case.lay_out, place)
        wrong = on_root(COMM, complaint, case, *attempt(case, place), place, time_limit(COMM.size))
        found += [] if wrong is None else [f"{case.name}: {wrong}"]
    return found


def test_contradictions(folder):
    """Lines of a scene that are misspelt, or do not fit together: the place, what is wrong, and the remedy."""
    assert not complaints(contradictions(), folder)


@pytest.mark.slow
def test_cases_of_each_kind(folder):
    """Each message, each place, and each wrong value at one place at least; of torn mesh files some."""
    on_root(COMM, make_meshes, folder)
    solve(catalogue.scene("disk_flat"), cells=8).save(folder / RIGHT / RESULT)
    known = {case.name for case in contradictions()}
    everything = [case for case in collect(folder) if not case.petsc]
    cases = [case for case in of_each_kind(everything) if case.name not in known]
    assert len(everything) > 900 and len(cases) > 250
    assert not complaints(cases, folder)
