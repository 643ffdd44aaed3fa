"""Notebooks in jupytext's percent format as pages, with the output of their cells, and as .ipynb files."""

import base64
import contextlib
import io
import os
import shutil
import tempfile
from pathlib import Path

import jupytext
import matplotlib
import matplotlib.pyplot as plt
from nbformat import NotebookNode
from nbformat.v4 import new_output
from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent.parent
CELL = "# %% [markdown]"


def notebooks() -> list[Path]:
    """The seminar, and all demos in the percent format."""
    demos = sorted((ROOT / "demos").glob("*.py"))
    return [ROOT / "docs" / "kikuchi_in_an_hour.py", *(file for file in demos if CELL in file.read_text())]


def run(notebook: NotebookNode, folder: Path) -> None:
    """Execute all code cells in this folder; what they print and the pictures they write become their outputs."""
    matplotlib.use("agg")
    (folder / "demos").symlink_to(ROOT / "demos")
    names = {"__name__": "__main__"}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for cell in notebook.cells:
            if cell.cell_type != "code":
                continue
            known = set(folder.rglob("*.png"))
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(cell.source, "cell", "exec"), names)
            plt.close("all")
            if printed.getvalue():
                cell.outputs.append(new_output("stream", name="stdout", text=printed.getvalue()))
            for picture in sorted(set(folder.rglob("*.png")) - known):
                data = {"image/png": base64.b64encode(picture.read_bytes()).decode()}
                cell.outputs.append(new_output("display_data", data=data, metadata={"file": str(picture)}))
    finally:
        os.chdir(before)


def page_of(notebook: NotebookNode, name: str, folder: Path) -> str:
    """Its cells as MyST Markdown; pictures are copied to the folder of the page."""
    parts = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        if cell.cell_type != "code":
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            if output.output_type == "stream":
                parts.append(f"```text\n{output.text}```")
            else:
                picture = Path(output.metadata.pop("file"))
                shutil.copyfile(picture, folder / picture.name)
                parts.append(f"![{picture.stem}]({picture.name})")
    parts.insert(1, f"{{download}}`This page as a notebook <{name}.ipynb>`.")
    return "\n\n".join(parts) + "\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Write page and notebook before pages are read, unless they are newer than their source."""
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    for source in notebooks():
        name, page = source.stem, folder / f"{source.stem}.md"
        if page.exists() and page.stat().st_mtime > source.stat().st_mtime:
            continue
        notebook = jupytext.read(source)
        with tempfile.TemporaryDirectory() as place, matplotlib.rc_context():
            run(notebook, Path(place))
            text = page_of(notebook, name, folder)
        jupytext.write(notebook, folder / f"{name}.ipynb", fmt="ipynb")
        page.write_text(text)
    return {"parallel_read_safe": True}
