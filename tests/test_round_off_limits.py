"""Limits of `hard` follow from the data and the operations: they hold for each arithmetic, and see what is wrong."""

from contextlib import closing
from pathlib import Path

import pytest

from fenicsx_obstacle.algebra.options import SolverOptions
from fenicsx_obstacle.algebra.stopping import TOLERANCE
from fenicsx_obstacle.answers.solver_context import SolverContext
from tests.conftest import CLEAN
from tests.hard.cases import case
from tests.hard.judge import judge
from tests.helpers import run_python

JUDGED = """
from tests.hard.cases import case
from tests.hard.judge import judge
rows = judge(case("string_mu_jump").on(1), epsilons=(1e-12, 1e-14), methods=("penalty",))
print([finding for row in rows for finding in row["findings"] if not finding["held"]])
"""


def test_energies_of_a_fine_string():
    """Where the energies of penalty and inequality differ by less than round-off, none is called wrong."""
    rows = list(judge(case("string_mu_jump").on(1), epsilons=(1e-12, 1e-14), methods=("penalty",)))
    assert len(rows) == 3 and all(row["verdict"] == "right" for row in rows)
    limits = [one["limit"] for row in rows for one in row["findings"] if one["name"].startswith("energy below")]
    assert limits and max(limits) < 1e-10 * abs(rows[0]["energy"])


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
