"""Formulas as MathML, which browsers draw without a script."""

from typing import Any

import latex2mathml.converter
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

# Letters whose names latex2mathml lacks.
_SPELLINGS = {r"\operatorname*": r"\operatorname", r"\lVert": r"\|", r"\rVert": r"\|"}


def converted(latex: str, display: str) -> str:
    """Return a formula as MathML; an unknown command is an error."""
    for old, new in _SPELLINGS.items():
        latex = latex.replace(old, new)
    return latex2mathml.converter.convert(latex, display=display)


def _visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(converted(node.astext(), "inline"))
    raise nodes.SkipNode


def _visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{converted(node.astext(), "block")}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
