"""Formulas as MathML, which browsers render without network and without JavaScript."""

import re

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

LOG = logging.getLogger(__name__)
FRACTION = re.compile(r"\\frac\s*([0-9A-Za-z])\s*([0-9A-Za-z])")  # docutils takes both digits of \frac12 as one number
DELIMITER = re.compile(r'<mo(?: class="mathopen"| stretchy="false")?>([‖{}|])</mo>')


def _convert(node: nodes.Element, *, block: bool) -> str:
    formula = FRACTION.sub(r"\\frac{\1}{\2}", node.astext())
    try:
        # without attributes browsers stretch delimiters beyond their contents, and space bars as operators
        return DELIMITER.sub(r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>', tex2mathml(formula, as_block=block))
    except MathError as error:
        LOG.warning("formula %r: %s", node.astext(), error, location=node)
        return ""


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(_convert(node, block=False))
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a displayed formula, which scrolls where the page is too narrow for it."""
    translator.body.append(f'<div class="math">{_convert(node, block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Make it a renderer; conf.py chooses it by html_math_renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
