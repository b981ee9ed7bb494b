"""Representations of results as HTML, for Jupyter.

Input:  any result of the package.
Output: HTML of a few kilobytes with a small figure, all texts escaped.

A card is what it says, first what a physicist asks: the facts that a result contains; those that
take a computation are left out.
"""

from __future__ import annotations

import base64
import io
import re
import warnings
from dataclasses import dataclass
from typing import Any

import sympy
from markupsafe import Markup

import hamsym
from hamsym.facts.describe import describe
from hamsym.facts.facts import Cells, Fact, Facts, Formula, Table
from hamsym.support.text_tables import ROWS
from hamsym.workbench.mathml import mathml
from hamsym.workbench.page_templates import page_template

_MOST_DRAWN = 2_000_000  # numbers that the figure of a result may evaluate
_DPI = 96  # pixels of a screen in an inch
_SHARP = 144  # of a picture that is small
_LARGEST = 58_000  # characters of a card with its figure
_LEAST = 20_000  # for the figure, whatever else the card says
_LONGEST = 2_000  # characters of the text of a result that has no card
_SIZE = 400  # operations of a formula that is typeset; larger ones are text
_TEXT = 2_000  # characters of a text
_LONG = 400  # characters of a sentence that unfolds on a click
_CODE = 20_000  # characters of generated code
_PLAIN_NAME = re.compile(r"\w+\Z")


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


# -- cards -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Card:
    """Contents of the representation of a result."""

    facts: Facts
    #: As MathML or text, and how many were left out.
    formulas: list[Markup]
    more_formulas: str
    #: Labels and texts.
    rows: list[tuple[str, str]]
    tables: list[Cells]
    #: Sentences below.
    notes: list[str]
    #: What unfolds on a click.
    details: list[Markup]

    @property
    def headline(self) -> str:
        """What is read first."""
        return cut(self.facts.headline or self.facts.message)


def card_of(facts: Facts) -> Card:
    """Return the card of a result."""
    known = [*facts.given, *facts.contained]
    shown = [f for f in known if isinstance(f, Fact) and f.text and f.brief]
    rows = [(fact.label.rstrip(":"), cut(fact.text)) for fact in shown if fact.label]
    if facts.headline and facts.message:
        rows.insert(0, ("outcome", cut(facts.message)))
    sentences = [cut(fact.text) for fact in shown if not fact.label]
    more = len(facts.formulas) - ROWS
    return Card(
        facts,
        [typeset(formula) for formula in facts.formulas[:ROWS]],
        f"... and {more:,} equations" if more > 0 else "",
        rows,
        [each.cells() for each in known if isinstance(each, Table) and len(each.names)],
        [text for text in sentences if len(text) <= _LONG],
        [
            *(Markup("<p>{}</p>").format(text) for text in sentences if len(text) > _LONG),
            *(_code(f.value) for f in known if isinstance(f, Fact) and f.name == "source"),
        ],
    )


def cut(text: str) -> str:
    """A text on one line, without what is beyond its largest length."""
    whole = " ".join(text.split())
    return whole if len(whole) <= _TEXT else f"{whole[:_TEXT]} ..."


def typeset(formula: Formula) -> Markup:
    """An equation as MathML; as text if it is large, or has names that are not plain."""
    names = {str(symbol) for symbol in formula.expr.free_symbols}
    names |= {str(function.func) for function in formula.expr.atoms(sympy.Function)}
    # The printer does not escape names.
    if not all(map(_PLAIN_NAME.match, names)) or sympy.count_ops(formula.expr) > _SIZE:
        text = f"{formula.left} = {formula.text}" if formula.left else formula.text
        return Markup("<code>{}</code>").format(cut(text))
    start = Markup("<mi>{}</mi><mo>=</mo>").format(formula.left) if formula.left else Markup("")
    return Markup('<math displaystyle="true">{}{}</math>').format(
        start, Markup(mathml(formula.expr, formula.notation))
    )


def _code(source: str) -> Markup:
    """Generated code with colours."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import guess_lexer

    shown = source if len(source) <= _CODE else source[:_CODE] + "\n..."
    formatter = HtmlFormatter(noclasses=True, nobackground=True)
    return Markup(highlight(shown, guess_lexer(shown), formatter))
