"""The drawing of the packages in contributing.md: rooms, their modules, and who imports whom, read from the code."""

import ast
import tomllib
from pathlib import Path
from textwrap import fill

import grimp
import matplotlib
from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent.parent
PACKAGE = "fenicsx_obstacle"
WIDTH = 11.2  # of the floors, in their own unit


def draw(file: Path) -> None:
    """Write the drawing as SVG: a floor for each package of the import contract, the lowest layer at the bottom."""
    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    floors = [room.strip() for layer in contract["layers"] for room in layer.split(":")]
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True)
    texts = [fill(", ".join(_modules(room)), 92) for room in floors]
    heights = [1.0 + 0.42 * (text.count("\n") + 1) for text in texts]
    figure, axes = plt.subplots(figsize=(12, 0.36 * sum(heights) + 1.3))
    top = 0.0
    for row, (room, text, height) in enumerate(zip(floors, texts, heights, strict=True)):
        axes.add_patch(plt.Rectangle((0, -top - height), WIDTH, height * 0.94, facecolor="#eef3f8", edgecolor="#345"))
        axes.text(0.1, -top - 0.2, room, va="top", weight="bold", fontsize=10)
        axes.text(1.75, -top - 0.22, _purpose(room), va="top", fontsize=8)
        axes.text(1.75, -top - 0.68, text, va="top", fontsize=7, color="#456")
        for column, other in enumerate(floors):
            x, y = WIDTH + 0.4 + 0.36 * column, -top - height / 2
            if row == column:
                axes.plot(x, y, "s", color="#345", markersize=5)
            elif _imports(graph, room, other):
                axes.plot(x, y, "o", color="#c60", markersize=5)
        top += height
    for column, other in enumerate(floors):
        axes.text(WIDTH + 0.4 + 0.36 * column, 0.15, other, rotation=60, fontsize=8, ha="left", va="bottom")
    axes.set(xlim=(0, WIDTH + 0.6 + 0.36 * len(floors)), ylim=(-top, 1.9))
    axes.axis("off")
    figure.savefig(file, bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)


def _source(room: str) -> Path:
    """Its __init__.py, or the module itself."""
    folder = ROOT / PACKAGE / room
    return folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")


def _purpose(room: str) -> str:
    return (ast.get_docstring(ast.parse(_source(room).read_text())) or "").splitlines()[0]


def _modules(room: str) -> list[str]:
    folder = _source(room).parent
    files = sorted(folder.rglob("*.py")) if _source(room).name == "__init__.py" else []
    return ["/".join(path.relative_to(folder).with_suffix("").parts) for path in files if path.name != "__init__.py"]


def _imports(graph: grimp.ImportGraph, room: str, other: str) -> bool:
    return graph.direct_import_exists(
        importer=f"{PACKAGE}.{room}", imported=f"{PACKAGE}.{other}", as_packages=_has_rooms(room, other)
    )


def _has_rooms(*rooms: str) -> bool:
    return any(_source(room).name == "__init__.py" for room in rooms)


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw before pages are read."""
    file = Path(app.srcdir) / "generated" / "house.svg"
    file.parent.mkdir(exist_ok=True)
    draw(file)
    return {"parallel_read_safe": True}
