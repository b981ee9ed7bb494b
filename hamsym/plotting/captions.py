"""Captions of figures: H, its parameters, and sentences about a result."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence

import sympy
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

from hamsym.codegen.observable import Observable
from hamsym.formula.notation import Notation
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.figure import CAPTION_SIZE
from hamsym.plotting.names import (
    amount,
    enumerated,
    escaped,
    latex_of,
    math_name,
    math_unit,
    sentence_words,
    shortened,
    words_of,
)
from hamsym.plotting.style import COLUMN

_MAX_TERMS, _MAX_PARAMETERS = 12, 10
# Of a formula beside an axis: its width in centimetres, and operations.
_AXIS, _MOST_ON_AXIS = 4.0, 60


def formula_words(H: Hamiltonian) -> list[str]:
    """Return H = ... for a caption, broken between terms; of a long sum the first terms."""
    found = _terms_of(H.expr, H.notation)
    words = ["$H\\,=\\," + found[0][1:], *found[1:]] if found else []
    words = words or words_of(_limited(f"H = {H.notation.text(H.expr)}"))
    for name, force in H.forces.items():
        own = _terms_of(force, H.notation)
        head = ["force", "of", math_name(name), "="]
        words[-1] += ";"
        words += [*head, *own] if own else [*head, *words_of(_limited(H.notation.text(force)))]
    return words


def _limited(text: str) -> str:
    return text if len(text) <= 300 else f"{text[:280]} ... ({len(text):,} characters)"


def _terms_of(expr: sympy.Expr, notation: Notation) -> list[str]:
    """Return the terms of a sum as mathematics, [] if matplotlib cannot draw them."""
    if expr.count_ops() > 2_000:
        return []
    terms = notation.terms(expr)
    symbols = sympy.Add(*terms[:_MAX_TERMS]).free_symbols
    names = {symbol: math_name(symbol.name).strip("$") for symbol in symbols}
    if any(latex_of(symbol.name) is None for symbol in symbols):
        return []
    found = []
    for place, term in enumerate(terms[:_MAX_TERMS]):
        text = notation.latex(term, symbol_names=names, fold_short_frac=True)
        if place:
            negative = text.startswith("-")
            text = (r"-\," if negative else r"+\,") + text.removeprefix("-").strip()
        large = text.replace(r"\frac", r"\dfrac")
        drawable = next(filter(_drawable, (f"${large}$", f"${text}$")), None)
        if drawable is None:
            return []
        found.append(drawable)
    if len(terms) > _MAX_TERMS:
        found += ["+", "…", f"({len(terms) - _MAX_TERMS:,}", "more", "terms)"]
    return found


def axis_words(found: Observable) -> tuple[str, str]:
    """Return a component or a formula for an axis, and its unit; of a long formula the beginning.

    Examples
    --------
    >>> H = Hamiltonian("p_x**2/2 + x**2/2")
    >>> axis_words(H.observable("p_x**2/2 - x")), axis_words(H.observable("x"))
    (('$p_{x}^{2} / 2 - x$', ''), ('$x$', ''))
    """
    unit = math_unit(found.unit)
    if found.expr.is_Symbol:
        return math_name(found.text), unit
    names = {symbol: latex_of(symbol.name) for symbol in found.expr.free_symbols}
    if None not in names.values() and found.expr.count_ops() < _MOST_ON_AXIS:
        text = f"${found.notation.latex(found.expr, symbol_names=names, fold_short_frac=True)}$"
        if _drawable(text, _AXIS):
            return text, unit
    return escaped(shortened(found.text)), unit


def formula_of(found: Observable) -> list[str]:
    """Return the words of a formula that an axis has no room for; [] if it has."""
    short = escaped(shortened(found.text))
    whole = found.expr.is_Symbol or axis_words(found)[0] != short or short == found.text
    return [] if whole else words_of(f"Drawn is {found.text}")


@functools.lru_cache(maxsize=4096)  # matplotlib parses mathematics for hundredths of a second
def _drawable(text: str, width_cm: float = 0.8 * COLUMN) -> bool:
    """Whether matplotlib can draw this mathematics, and it fits into a width."""
    if len(text) > 800:
        return False
    try:
        width = MathTextParser("path").parse(text, 72, FontProperties(size=CAPTION_SIZE)).width
    except ValueError:
        return False
    return bool(width / 72 < width_cm / 2.54)


def parameter_words(H: Hamiltonian, values: Mapping[str, float]) -> list[str]:
    """Return parameters with values and units for a caption; of many the first and a count."""
    shown = list(values)[:_MAX_PARAMETERS]
    parts = [[f"{math_name(name)} = {amount(H, name, values[name])}"] for name in shown]
    if more := len(values) - len(shown):
        parts.append(["and", f"{more:,}", "more", f"parameter{'s' if more > 1 else ''}"])
    return enumerated(parts)


def caption_words(
    H: Hamiltonian, *sentences: str | Sequence[str], parameters: Mapping[str, float] | None = None
) -> list[str]:
    """Return the caption of a figure as words: H, its parameters, then sentences.

    - *sentences: Plain text, or words.
    - parameters: Values to show instead of those of H.
    """
    values = dict(H.parameters) if parameters is None else parameters
    return sentence_words([formula_words(H), parameter_words(H, values), *sentences])
