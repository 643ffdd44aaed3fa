"""The clone around the package: the folder demos/, and the suites in tests/, which an installed wheel does not have."""

from __future__ import annotations

import sys
from pathlib import Path

from fenicsx_obstacle.errors import InputError

ROOT = Path(__file__).parent.parent
DEMOS = ROOT / "demos"


def is_clone() -> bool:
    """Whether the package is in a clone of the project."""
    return (ROOT / "obstacle").is_file()


def require(command: str) -> None:
    """Check that the package runs in a clone.

    Args:
        command: What needs it, for the message.

    Raises:
        InputError: In an installed wheel.
    """
    if not is_clone():
        raise InputError(
            f"{command} runs in a clone of the project, where demos/ and tests/ are; call ./obstacle there"
        )


def add_tests(command: str) -> None:
    """Make the suites of the clone importable, as `tests.hard` and the like.

    Args:
        command: What needs them, for the message.

    Raises:
        InputError: In an installed wheel.
    """
    require(command)
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
