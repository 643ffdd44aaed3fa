"""Texts by Jinja2, from the files in `show/templates`."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from typing import Any

from fenicsx_obstacle.problems import summary
from fenicsx_obstacle.text import counted, patches_in_words, vector_in_words, with_error

FOLDER = Path(__file__).with_name("templates")


def filled(name: str, **values: Any) -> str:
    """A template with its values, which its first lines name; texts in pages are escaped.

    Args:
        name: Its file.
        **values: What it needs.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape  # only where a text is written

    templates = Environment(loader=FileSystemLoader(FOLDER), autoescape=select_autoescape(), undefined=StrictUndefined,
                            trim_blocks=True, lstrip_blocks=True)  # fmt: skip
    functions = (counted, patches_in_words, vector_in_words, with_error, summary.report_in_words,
                 summary.with_uncertainty, data_uri)  # fmt: skip
    templates.globals.update({function.__name__: function for function in functions})
    return templates.get_template(name).render(values)


def data_uri(picture: Path) -> str:
    """A picture within a page."""
    return f"data:image/{picture.suffix.removeprefix('.')};base64,{b64encode(picture.read_bytes()).decode()}"
