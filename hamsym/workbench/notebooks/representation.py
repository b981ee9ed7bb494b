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
_DPI = 96  # pixels of a screen in an inch
_SHARP = 144  # of a picture that is small
_LARGEST = 58_000  # characters of a card with its figure
_LEAST = 20_000  # for the figure, whatever else the card says
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
        template, card = page_template("notebook"), card_of(facts)
        text = template.render(facts=facts, card=card, figure="", width=0)
        figure, width = _figure(result, facts, max(_LARGEST - len(text), _LEAST))
        return template.render(facts=facts, card=card, figure=figure, width=width)
    except Exception:  # an object that cannot be described must not stop a notebook
        return str(Markup("<pre>{}</pre>").format(_text(result)))


def _figure(result: Any, facts: Facts, room: int) -> tuple[str, int]:
    """Return the figure of a result as PNG in base64, and its width in pixels of a screen.

    It is empty if it has none, or it would take long.

    - room: Most characters; a picture that is larger gets fewer pixels.
    """
    if not facts.drawn <= _MOST_DRAWN:
        return "", 0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a display is no place for advice
            figure = result.plot() if hasattr(result, "plot") else hamsym.plot(result)
            content = _picture(figure, _SHARP)
            if len(content) > room:
                content = _picture(figure, max(_DPI * 0.7, 0.97 * _SHARP * room / len(content)))
    except Exception:  # failed results may have nothing that can be drawn
        return "", 0
    return content, round(_DPI * figure.get_figwidth())


def _picture(figure: Any, dpi: float) -> str:
    """A picture with 32 colours on no ground, for light and dark pages, a quarter of its size."""
    from PIL import Image

    drawn, smaller = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi, transparent=True)
    coloured = Image.open(drawn).quantize(32, method=Image.Quantize.FASTOCTREE)
    coloured.save(smaller, "png", optimize=True)
    return base64.b64encode(smaller.getvalue()).decode()


def _text(result: Any) -> str:
    try:
        text = repr(result)
    except Exception:
        text = type(result).__name__
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
