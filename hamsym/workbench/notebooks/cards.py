"""Cards: what a notebook says about a result, first what a physicist asks.

Input:  the facts of a result.
Output: a :class:`Card` of texts, with formulas as MathML.

A card has the facts that a result contains; those that take a computation are left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import sympy
from markupsafe import Markup

from hamsym.facts.facts import Cells, Fact, Facts, Formula, Table
from hamsym.support.text_tables import ROWS
from hamsym.workbench.mathml import mathml

_SIZE = 400  # operations of a formula that is typeset; larger ones are text
_TEXT = 2_000  # characters of a text
_LONG = 400  # characters of a sentence that unfolds on a click
_CODE = 20_000  # characters of generated code
_PLAIN_NAME = re.compile(r"\w+\Z")


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
