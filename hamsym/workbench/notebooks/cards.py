"""Cards: what a notebook says about a result, first what a physicist asks.

Input:  a result of any kind.
Output: a :class:`Card` of plain texts, with formulas as MathML.

A card is made from what the result contains; nothing is solved, proven or searched for it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

if TYPE_CHECKING:
    import sympy

    from hamsym import Hamiltonian, Invariant, Invariants, System
    from hamsym.symbolic.equations import Equations, Formulas

ROWS = 12  # of a table
_FORMULAS = 12  # lines
_SIZE = 400  # operations of a formula that is typeset; larger ones are text
_DERIVED = 2_000  # operations of an H whose equations of motion are derived for a card
_TEXT = 2_000  # characters of a text
_CODE = 20_000  # characters of generated code
_PLAIN_NAME = re.compile(r"\w+\Z")


@dataclass
class Card:
    """Contents of the representation of a result."""

    #: Type of the result.
    kind: str
    #: What is asked first.
    headline: str = ""
    #: None if nothing can fail.
    success: bool | None = None
    #: The same as a word.
    verdict: str = ""
    #: As MathML or text.
    formulas: list[Markup] = field(default_factory=list)
    #: How many were left out.
    more_formulas: str = ""
    #: Names and values.
    facts: list[tuple[str, str]] = field(default_factory=list)
    #: header, rows: A table; the first ``left`` columns are texts.
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = field(default_factory=list)
    left: int = 1
    #: How many rows were left out.
    left_out: str = ""
    #: Sentences below.
    notes: list[str] = field(default_factory=list)
    #: details_title, details: What unfolds on a click.
    details_title: str = ""
    details: Markup | None = None
    #: Numbers that a figure of the result evaluates, about; infinite if there is no figure.
    numbers_drawn: float = math.inf


#: Functions that make the card of a result, by the name of its type: importing all types would
#: import most of the package.
CARDS: dict[str, Callable[[Any], Card]] = {}


def card_of(result: Any) -> Card:
    """Return the card of a result.

    Raise TypeError if there is none for results of this type.
    """
    for kind in type(result).__mro__:
        if kind.__module__.startswith("hamsym.") and kind.__name__ in CARDS:
            return CARDS[kind.__name__](result)
    raise TypeError(f"{type(result).__name__} has no card")


def of_type(name: str) -> Callable[[Callable[[Any], Card]], Callable[[Any], Card]]:
    """Register a function as that of the cards of a type of this package, by its name."""

    def register(make: Callable[[Any], Card]) -> Callable[[Any], Card]:
        CARDS[name] = make
        return make

    return register


# -- texts -----------------------------------------------------------------------------------------


def number(value: Any, digits: int = 6) -> str:
    """A number with some digits."""
    return f"{float(value):.{digits}g}"


def error_text(value: Any) -> str:
    """An error with two digits."""
    value = float(value)
    return (f"{value:.1e}" if value else "0") if math.isfinite(value) else "unknown"


def counted(number: int, one: str, many: str = "") -> str:
    """A number of things, in the singular or the plural."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def cut(text: Any) -> str:
    """A text on one line, without what is beyond its largest length."""
    whole = " ".join(str(text).split())
    return whole if len(whole) <= _TEXT else f"{whole[:_TEXT]} ..."


def interval(ends: tuple[float, float]) -> str:
    """The ends of an interval."""
    return f"{number(ends[0])} to {number(ends[1])}"


def seconds_text(value: float) -> str:
    """A time in seconds."""
    return f"{value:.2g} s" if value < 100 else f"{value:,.0f} s"


def judged(card: Card, success: bool, yes: str = "success", no: str = "no success") -> Card:
    """Give a card a verdict, in words for both cases."""
    card.success, card.verdict = bool(success), yes if success else no
    return card


def with_table(card: Card, header: Sequence[str], rows: Iterable[Sequence[str]], what: str) -> Card:
    """Give a card a table of at most twelve rows, and say how many more there are."""
    every = list(rows)
    card.header, card.rows = header, every[:ROWS]
    if len(every) > ROWS:
        card.left_out = f"... and {counted(len(every) - ROWS, what)}"
    return card


def with_details(card: Card, title: str, text: Any) -> Card:
    """Give a card a text that unfolds."""
    card.details_title, card.details = title, Markup("<p>{}</p>").format(cut(text))
    return card


# -- formulas --------------------------------------------------------------------------------------


def typeset(expr: sympy.Basic) -> Markup | None:
    """MathML of an expression; None if it is large, or has names that are not plain."""
    import sympy

    from hamsym.workbench.mathml import mathml

    names = {str(symbol) for symbol in expr.free_symbols}
    names |= {str(function.func) for function in expr.atoms(sympy.Function)}
    if not all(map(_PLAIN_NAME.match, names)) or sympy.count_ops(expr) > _SIZE:
        return None  # the printer does not escape names
    return Markup(mathml(expr))


def formula(left: str, expr: sympy.Expr, text: str) -> Markup:
    """An equation as MathML, or as text; ``left`` is the name on its left side."""
    found = typeset(expr)
    if found is None:
        return Markup("<code>{}</code>").format(cut(f"{left} = {text}" if left else text))
    start = Markup("<mi>{}</mi><mo>=</mo>").format(left) if left else Markup("")
    return Markup('<math displaystyle="true">{}{}</math>').format(start, found)


def equation(equation: Any) -> Markup:
    found = typeset(equation)
    if found is None:
        return Markup("<code>{}</code>").format(cut(f"{equation.lhs} = {equation.rhs}"))
    return Markup('<math displaystyle="true">{}</math>').format(found)


def energy_formulas(H: Hamiltonian) -> list[Markup]:
    """H and the forces."""
    found = [formula("H", H.expr, H.formula)]
    for name, force in H.forces.items():
        found.append(formula(f"force of {name}", force, H.force_texts[name]))
    return found


def parameter_facts(H: Hamiltonian, without: Sequence[str] = ()) -> list[tuple[str, str]]:
    """The parameters with their values and units, but for some."""
    names = [name for name in H.parameter_names if name not in without]
    shown = [
        f"{name} = {number(H.parameters[name], 8) if name in H.parameters else '?'}"
        + ("" if H.units.get(name, "1") == "1" else f" {H.units[name]}")
        for name in names[:ROWS]
    ]
    if len(names) > ROWS:
        shown.append(f"and {counted(len(names) - ROWS, 'parameter')} more")
    return [("parameters", ", ".join(shown))] if shown else []


@of_type("Hamiltonian")
def _hamiltonian(H: Hamiltonian) -> Card:
    import sympy

    card = Card("Hamiltonian", formulas=energy_formulas(H))
    words = [counted(H.dof, "degree of freedom", "degrees of freedom")]
    if sum(sympy.count_ops(formula) for formula in (H.expr, *H.forces.values())) <= _DERIVED:
        words.append("separable" if H.is_separable else "not separable")
        equations = H.equations
        card.formulas += [equation(entry) for entry in equations[:_FORMULAS]]
        if len(equations) > _FORMULAS:
            card.more_formulas = f"... and {counted(len(equations) - _FORMULAS, 'equation')}"
    words.append("energy conserved" if H.conserves_energy else "energy not conserved")
    card.headline = ", ".join(words)
    pairs = [f"({q}, {p})" for q, p in zip(H.q, H.p, strict=True)]
    more = f" and {len(pairs) - ROWS} more" if len(pairs) > ROWS else ""
    card.facts = [("pairs", ", ".join(pairs[:ROWS]) + more), *parameter_facts(H)]
    units = [f"{name}: {H.units[name]}" for name in (*H.names, "t") if name in H.units]
    if units:
        card.facts.append(("units", ", ".join(units[: ROWS + 1])))
    return card


@of_type("Formulas")
def _formulas(equations: Formulas) -> Card:
    card = Card("Equations of motion", formulas=[equation(each) for each in equations[:_FORMULAS]])
    if len(equations) > _FORMULAS:
        card.more_formulas = f"... and {counted(len(equations) - _FORMULAS, 'equation')}"
    return card


@of_type("Equations")
def _equations(equations: Equations) -> Card:
    card = Card("Equations", formulas=[formula("H", equations.expr, str(equations.expr))])
    rates = equations.vector_field
    for symbol, rate in list(zip(equations.z, rates, strict=True))[:_FORMULAS]:
        card.formulas.append(formula(f"d{symbol}/dt", rate, str(rate)))
    if len(rates) > _FORMULAS:
        card.more_formulas = f"... and {counted(len(rates) - _FORMULAS, 'equation')}"
    return card


@of_type("Invariant")
def _invariant(found: Invariant) -> Card:
    card = Card("Invariant", formulas=[formula("", found.expr, found.formula)])
    card.headline = f"conserved, of degree {found.degree}"
    if not found.independent:
        card.headline += ", a function of H and the invariants before it"
    if found.holds_for:
        values = ", ".join(f"{name} = {value!r}" for name, value in found.holds_for.items())
        card.facts = [("holds for", values)]
    return card


@of_type("Invariants")
def _invariants(found: Invariants) -> Card:
    count = counted(len(found), "invariant")
    card = Card("Invariants", headline=f"{count} of degree at most {found.degree}")
    card.formulas = [
        formula(f"I_{k}", one.expr, one.formula) for k, one in enumerate(found[:_FORMULAS], 1)
    ]
    if len(found) > _FORMULAS:
        card.more_formulas = f"... and {counted(len(found) - _FORMULAS, 'formula')}"
    rows = [
        [
            f"I_{k}",
            f"{one.degree}",
            "yes" if one.independent else "no",
            ", ".join(f"{name} = {value!r}" for name, value in one.holds_for.items()) or "all",
        ]
        for k, one in enumerate(found, 1)
    ]
    card.notes = [found.message]
    if rows:
        with_table(card, ["invariant", "degree", "independent", "parameters"], rows, "invariant")
    return card


@of_type("System")
def _system(system: System) -> Card:
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import TextLexer, get_lexer_by_name
    from pygments.util import ClassNotFound

    text = system.source
    card = Card("System", headline=f"generated functions for {system.backend}")
    card.facts = [("state", ", ".join(system.names[:ROWS])), ("lines", f"{text.count(chr(10)):,}")]
    shown = text if len(text) <= _CODE else text[:_CODE] + "\n..."
    language = {"c": "c", "julia": "julia"}.get(system.backend, "python")
    try:
        lexer = get_lexer_by_name(language)
    except ClassNotFound:
        lexer = TextLexer()
    code = highlight(shown, lexer, HtmlFormatter(noclasses=True, nobackground=True))
    card.details_title, card.details = "code", Markup(code)
    return card
