"""Representations of results as HTML, for Jupyter.

Input:  any result of the package.
Output: HTML of a few kilobytes with a small figure, all texts escaped.
"""

from __future__ import annotations

import base64
import io
import warnings
from typing import Any

from markupsafe import Markup

import hamsym
from hamsym.facts.describe import describe
from hamsym.facts.facts import Facts
from hamsym.workbench.notebooks.cards import card_of
from hamsym.workbench.page_templates import page_template

_MOST_DRAWN = 2_000_000  # numbers that the figure of a result may evaluate
_WIDTH = 960  # pixels of a figure, shown at half the size for sharp lines
_LONGEST = 2_000  # characters of the text of a result that has no card


def representation(result: Any) -> str:
    """Return a result as HTML: verdict, largest error, formulas, a table and a small figure.

    Notebooks show it for a result on the last line of a cell. It is made from what the result
    contains, and solves or proves nothing; a figure that takes more than a moment is left out.
    Formulas are MathML, which browsers display by themselves.

    Parameters
    ----------
    result : object
        A Hamiltonian, its equations, generated code, or any result of the package; of another
        object its text.

    Returns
    -------
    str

    Examples
    --------
    >>> import hamsym
    >>> text = representation(hamsym.Hamiltonian("p**2/2 + x**2/2"))
    >>> "1 degree of freedom, separable, energy conserved" in text, "<math" in text
    (True, True)
    """
    try:
        facts = describe(result)
        figure, width = _figure(result, facts), _WIDTH // 2
        template = page_template("notebook")
        return template.render(facts=facts, card=card_of(facts), figure=figure, width=width)
    except Exception:  # an object that cannot be described must not stop a notebook
        return str(Markup("<pre>{}</pre>").format(_text(result)))


def _figure(result: Any, facts: Facts) -> str:
    """The figure of a result as PNG in base64; empty if it has none, or it would take long."""
    if not facts.drawn <= _MOST_DRAWN:
        return ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a display is no place for advice
            figure = result.plot() if hasattr(result, "plot") else hamsym.plot(result)
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=_WIDTH / figure.get_figwidth())
            content = _few_colours(buffer)
    except Exception:  # failed results may have nothing that can be drawn
        return ""
    return base64.b64encode(content).decode()


def _few_colours(buffer: io.BytesIO) -> bytes:
    """A picture with 64 colours, a quarter of its size: a notebook keeps it in its file."""
    from PIL import Image

    smaller = io.BytesIO()
    Image.open(buffer).convert("RGB").quantize(64).save(smaller, "png", optimize=True)
    return smaller.getvalue()


def _text(result: Any) -> str:
    try:
        text = repr(result)
    except Exception:
        text = type(result).__name__
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
