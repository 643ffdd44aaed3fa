"""The page of a result: scene, equation, output quantities, tables, pictures, versions, command.

The page is one file: it fetches nothing, needs no JavaScript, and prints.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fenicsx_obstacle.parallel import write_text
from fenicsx_obstacle.scenes.scene import Scene
from fenicsx_obstacle.show.explain import explained
from fenicsx_obstacle.show.template import filled
from fenicsx_obstacle.text import title_of

NAME = "report.html"


def write_page(path: Path, kind: str, scene: Scene, versions: Mapping[str, str], command: str, **values: Any) -> None:
    """Write a page (one rank).

    Args:
        path: The file.
        kind: `answer`, `study` or `cost`: its template.
        scene: What was solved.
        versions: Of the program and its libraries.
        command: What made it.
        **values: Further ones, which the template names.
    """
    title = title_of(scene.tables.title, scene.name)
    write_text(path, filled(f"{kind}.html", title=title, scene=scene, explained=explained(scene), versions=versions,
                            command=command, **values))  # fmt: skip
