"""Draws the pictures of the pages into docs/generated, by benchmarks/pictures.py."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent.parent
DRAWN = ("tarpaulin", "newton", "known", "map", "steps")


def draw(folder: Path) -> None:
    """Measure on small meshes, then draw; takes about half a minute.

    Args:
        folder: Where pictures go.
    """
    with tempfile.TemporaryDirectory() as place:
        here = Path(place)
        _run("-m", "fenicsx_obstacle", "theory", "digits", "--output", str(here), "--quiet")
        (folder / "digits.png").write_bytes((here / "digits.png").read_bytes())
        _run(
            "benchmarks/ladder.py", "demos/ball.toml", "--cells", "8..128", "--eps", "h^2,1e-12", "--amg",
            "--times", "1", "--json", str(here / "ladder.jsonl"),
        )  # fmt: skip
        ladder = str(here / "ladder.jsonl")
        _run("benchmarks/pictures.py", *DRAWN, "--folder", str(folder), "--ladder", ladder)


def _run(*arguments: str) -> None:
    subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw before pages are read, unless all pictures are there."""
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    done = folder / "pictures.json"
    if not done.exists():
        draw(folder)
        done.write_text(json.dumps([*DRAWN, "digits"]))
    return {"parallel_read_safe": True}
