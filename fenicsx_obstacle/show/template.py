"""Texts by Jinja2, from the files in `show/templates`."""

from __future__ import annotations

from base64 import b64encode
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fenicsx_obstacle.problems import summary
from fenicsx_obstacle.text import counted, patches_in_words, plain, vector_in_words, with_error

if TYPE_CHECKING:
    from jinja2 import Environment

FOLDER = Path(__file__).with_name("templates")
FUNCTIONS = (counted, patches_in_words, plain, vector_in_words, with_error, summary.peclet_in_words,
             summary.remarks_in_words, summary.report_in_words, summary.steps_in_words, summary.time_in_words,
             summary.tolerance_in_words, summary.with_uncertainty)  # fmt: skip


def filled(name: str, **values: Any) -> str:
    """A template with its values, which its first lines name. In pages texts are escaped, in others they have one line.

    Args:
        name: Its file.
        **values: What it needs.
    """
    return _templates(name.endswith(".html")).get_template(name).render(values)


@cache
def _templates(pages: bool) -> Environment:
    """The templates of pages, or those of other texts; compiled ones are kept, as Python keeps its modules."""
    import jinja2  # only where a text is written

    class Compiled(jinja2.FileSystemBytecodeCache):
        def dump_bytecode(self, bucket: Any) -> None:
            with suppress(OSError):  # a folder of somebody else, or a full disk
                (FOLDER / "__pycache__").mkdir(exist_ok=True)
                super().dump_bytecode(bucket)

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER), autoescape=pages, undefined=jinja2.StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=None if pages else lambda text: str(text).replace("\n", " "),
        bytecode_cache=Compiled(str(FOLDER / "__pycache__")),
    )  # fmt: skip
    environment.globals.update({function.__name__: function for function in (*FUNCTIONS, data_uri)})
    return environment


def data_uri(picture: Path) -> str:
    """A picture within a page."""
    return f"data:image/{picture.suffix.removeprefix('.')};base64,{b64encode(picture.read_bytes()).decode()}"
