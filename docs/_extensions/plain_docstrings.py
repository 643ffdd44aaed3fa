"""Docstrings are plain text: the signs of mathematics in them, |u - g| or (3.4)*, are no markup for Sphinx."""

import re
from typing import Any

from sphinx.application import Sphinx

CODE = re.compile(r"(`+[^`]*`+)")
ARGUMENTS = re.compile(r"^\s*\*{1,2}\w+:")  # **options: as Google's style writes them


def escape(*event: Any) -> None:
    """Escape stars and bars outside of code in the lines of a docstring, the last argument of the event, in place."""
    lines: list[str] = event[-1]
    for number, line in enumerate(lines):
        if not ARGUMENTS.match(line):
            parts = CODE.split(line)
            parts[::2] = [re.sub(r"([*|])", r"\\\1", part) for part in parts[::2]]
            lines[number] = "".join(parts)


def setup(app: Sphinx) -> dict[str, bool]:
    """Escape before napoleon reads Google's sections."""
    app.connect("autodoc-process-docstring", escape, priority=400)
    return {"parallel_read_safe": True}
