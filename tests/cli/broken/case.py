"""One command that must be rejected, and the check of its message."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

LIMIT = 5.0  # seconds a refusal may take on a machine that does nothing else
LONGEST = 700  # characters of a message: what is wrong is to be seen at a glance
SCENE = "scene.toml"

Content = bytes | Callable[[Path], object]


@dataclass(frozen=True)
class Broken:
    """A command line with something wrong in it.

    Attributes:
        name: What is wrong.
        names: Words that the message must hold: the file, the key, the option.
        arguments: The command line.
        files: Content of each file in the folder where it runs, or what makes it.
        petsc: PETSc's options, which follow --.
    """

    name: str
    names: Sequence[str]
    arguments: Sequence[str] = ("solve", SCENE)
    files: Mapping[str, Content] = field(default_factory=dict)
    petsc: Sequence[str] = ()

    def lay_out(self, folder: Path) -> None:
        """Write the files into a new folder."""
        folder.mkdir(parents=True)
        for name, content in self.files.items():
            if isinstance(content, bytes):
                (folder / name).write_bytes(content)
            else:
                content(folder / name)

    def command(self) -> list[str]:
        """The command line, PETSc's options included."""
        return [*self.arguments, *(["--", *self.petsc] if self.petsc else [])]


def time_limit(processes: int) -> float:
    """The seconds a refusal may take now, if the suite runs so many processes: more where others use the cores too."""
    return LIMIT * max(1.0, os.getloadavg()[0] / max(os.cpu_count() or 1, processes))


def complaint(
    case: Broken, status: int | None, message: str, seconds: float, folder: Path, limit: float = LIMIT
) -> str | None:
    """What is wrong with a refusal; None if nothing is.

    Args:
        case: The case.
        status: Exit status, None if it had to be stopped.
        message: All that was said to the user.
        seconds: Time it took.
        folder: Where it ran.
        limit: Seconds it may take.
    """
    if status is None or seconds > limit:
        return f"took {seconds:.1f} s"
    if status != 2:
        return f"exit status {status}"
    if "Traceback" in message:
        return "a traceback"
    if len(re.findall(r"^(?:obstacle|Error): ", message, re.MULTILINE)) != 1:
        return "not one message"
    if len(message) > LONGEST:
        return f"a message of {len(message)} characters"
    missing = [word for word in case.names if word not in message]
    if missing:
        return f"does not name {' and '.join(map(repr, missing))}"
    if left := sorted({path.name for path in folder.iterdir()} - set(case.files)):
        return f"left {', '.join(left)} behind"
    return None
