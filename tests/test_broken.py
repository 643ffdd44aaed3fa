"""Input that is wrong in every way: one message that names the place, exit status 2, and nothing left behind.

A share of what `./obstacle hard --broken` tries, on the ranks of this session.
"""

import shutil
from pathlib import Path

import pytest

from fenicsx_obstacle import solve
from fenicsx_obstacle.parallel import on_root
from fenicsx_obstacle.scenes import catalogue
from tests.cli.broken.case import Broken, complaint
from tests.cli.broken.collection import RIGHT, collect, make_meshes
from tests.cli.broken.inside import attempt
from tests.cli.broken.options import RESULT
from tests.cli.broken.run import _alone
from tests.conftest import CLEAN, COMM

EVERY = 12


@pytest.mark.slow
def test_a_share_of_all_cases(folder):
    """Each twelfth, and all kinds are among them."""
    on_root(COMM, make_meshes, folder)
    solve(catalogue.scene("disk_flat"), cells=8).save(folder / RIGHT / RESULT)
    cases = [case for case in collect(folder) if not case.petsc]
    assert len(cases) > 900
    wrong = []
    for number, case in enumerate(cases[::EVERY]):
        place = folder / str(number)
        on_root(COMM, case.lay_out, place)
        status, said, seconds = attempt(case, place)
        wrong.append(on_root(COMM, complaint, case, status, said, seconds, place))
    assert not [f"{case.name}: {what}" for case, what in zip(cases[::EVERY], wrong, strict=True) if what is not None]


@pytest.mark.serial
@pytest.mark.parametrize("ranks", [1, 3])
def test_a_process_of_its_own(ranks, tmp_path):
    """PETSc's options are read once a process."""
    case = Broken("a type that is not there", ["nonsense", "--"], ("solve", "string_wedge", "--output", "."),
                  petsc=("-penalty_ksp_type", "nonsense"))  # fmt: skip
    tried = _alone(tmp_path, case, 0, ranks, CLEAN)
    assert "nonsense" in tried.said
    assert tried.complaint is None or tried.complaint.startswith("took")  # on a busy machine


def test_complaints(tmp_path):
    """What a refusal must not be."""
    case = Broken("none", ["scene.toml"])
    place = tmp_path / "case"
    case.lay_out(place)
    good = "Error: scene.toml: no"
    assert complaint(case, 2, good, 0.1, place) is None
    for status, said, seconds in [(0, good, 0.1), (None, good, 0.1), (2, "Error: no", 0.1), (2, good, 6.0),
                                  (2, good + "\nTraceback", 0.1), (2, good + "\n" + good, 0.1), (2, "", 0.1),
                                  (2, good + "x" * 1000, 0.1)]:  # fmt: skip
        assert complaint(case, status, said, seconds, place) is not None
    Path(place / "out").mkdir()
    assert complaint(case, 2, good, 0.1, place) == "left out behind"
    shutil.rmtree(place)
