"""The drawings in contributing.md: layers, their modules and imports, read from the code; the calls of its table."""

import ast
import re
import tomllib
from itertools import pairwise
from pathlib import Path
from textwrap import fill

import grimp
import matplotlib
from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent.parent
PACKAGE = "fenicsx_obstacle"
WIDTH = 14.0  # of the rows, in their own unit


def draw(file: Path) -> None:
    """Write the drawing as SVG: a row for each package of the import contract, the lowest layer at the bottom."""
    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    contract = next(one for one in contracts if one["type"] == "layers")
    rows = [layer.strip() for row in contract["layers"] for layer in row.split(":")]
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True)
    texts = [fill(", ".join(_modules(layer)), 92) for layer in rows]
    heights = [1.0 + 0.42 * (text.count("\n") + 1) for text in texts]
    figure, axes = plt.subplots(figsize=(13, 0.36 * sum(heights) + 1.3))
    top = 0.0
    for row, (layer, text, height) in enumerate(zip(rows, texts, heights, strict=True)):
        axes.add_patch(plt.Rectangle((0, -top - height), WIDTH, height * 0.94, facecolor="#eef3f8", edgecolor="#345"))
        axes.text(0.1, -top - 0.2, layer, va="top", weight="bold", fontsize=10)
        axes.text(2.05, -top - 0.22, _purpose(layer), va="top", fontsize=7.6)
        axes.text(2.05, -top - 0.68, text, va="top", fontsize=7, color="#456")
        for column, other in enumerate(rows):
            x, y = WIDTH + 0.4 + 0.36 * column, -top - height / 2
            if row == column:
                axes.plot(x, y, "s", color="#345", markersize=5)
            elif _imports(graph, layer, other):
                axes.plot(x, y, "o", color="#c60", markersize=5)
        top += height
    for column, other in enumerate(rows):
        axes.text(WIDTH + 0.4 + 0.36 * column, 0.15, other, rotation=60, fontsize=8, ha="left", va="bottom")
    axes.set(xlim=(0, WIDTH + 0.6 + 0.36 * len(rows)), ylim=(-top - 0.1, 1.9))
    axes.axis("off")
    figure.savefig(file, bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)


def draw_calls(file: Path) -> None:
    """Write the calls from `solve()` to the penalty as SVG: a column for each layer, a row for each call."""
    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    calls = re.findall(r"^\| `([\w.]+)` \|", (ROOT / "docs" / "contributing.md").read_text(), re.MULTILINE)
    layers = list(dict.fromkeys(call.partition(".")[0] for call in calls))
    figure, axes = plt.subplots(figsize=(9, 0.5 * len(calls) + 0.4))
    places = [(layers.index(call.partition(".")[0]), -row) for row, call in enumerate(calls)]
    for (x, y), call in zip(places, calls, strict=True):
        axes.text(x, y, call, va="center", fontsize=9, bbox={"facecolor": "#eef3f8", "edgecolor": "#345", "pad": 4})
    for (x0, y0), (x1, y1) in pairwise(places):
        axes.annotate("", (x1 + 0.1, y1 + 0.3), (x0 + 0.1, y0 - 0.3), arrowprops={"arrowstyle": "->", "color": "#c60"})
    axes.set(xlim=(-0.05, len(layers)), ylim=(-len(calls) + 0.3, 0.6))
    axes.axis("off")
    figure.savefig(file, bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)


def _source(layer: str) -> Path:
    """Its __init__.py, or the module itself."""
    folder = ROOT / PACKAGE / layer
    return folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")


def _purpose(layer: str) -> str:
    return (ast.get_docstring(ast.parse(_source(layer).read_text())) or "").splitlines()[0]


def _modules(layer: str) -> list[str]:
    folder = _source(layer).parent
    files = sorted(folder.rglob("*.py")) if _source(layer).name == "__init__.py" else []
    return ["/".join(path.relative_to(folder).with_suffix("").parts) for path in files if path.name != "__init__.py"]


def _imports(graph: grimp.ImportGraph, layer: str, other: str) -> bool:
    return graph.direct_import_exists(
        importer=f"{PACKAGE}.{layer}", imported=f"{PACKAGE}.{other}", as_packages=_is_package(layer, other)
    )


def _is_package(*layers: str) -> bool:
    return any(_source(layer).name == "__init__.py" for layer in layers)


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw before pages are read."""
    file = Path(app.srcdir) / "generated" / "packages.svg"
    file.parent.mkdir(exist_ok=True)
    draw(file)
    draw_calls(file.with_name("calls.svg"))
    return {"parallel_read_safe": True}
