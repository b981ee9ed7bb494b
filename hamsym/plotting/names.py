"""Names, units and numbers as mathematics, for axes and captions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import sympy

from hamsym.errors import InputError
from hamsym.facts import wording
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.style import MAX_LINES
from hamsym.support.suggestions import did_you_mean

_LONGEST_TEXT = 1_000  # characters of a sentence in a caption
_MAX_NAME = 24
_GREEK = frozenset(
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau "
    "upsilon phi chi psi omega varphi vartheta varepsilon Gamma Delta Theta Lambda Xi Pi Sigma "
    "Upsilon Phi Psi Omega".split()
)
_AXES = frozenset("xyzruvwXYZ")
_PLAIN_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*\Z")
_PART = re.compile(r"([A-Za-z]*)([0-9]*)\Z")


def escaped(text: str) -> str:
    """Return text that is drawn as it is, dollar signs included."""
    return text.replace("$", r"\$")


def shortened(name: str) -> str:
    return name if len(name) <= _MAX_NAME else f"{name[: _MAX_NAME - 9]}…{name[-8:]}"


def latex_of(name: str) -> str | None:
    """Return the LaTeX of a name, None where it is not made of letters, digits and underscores."""
    if len(name) > _MAX_NAME or not _PLAIN_NAME.match(name):
        return None
    pieces = name.split("_")
    parts = [_latex_of_part(part) for part in pieces]
    words = [part for part in pieces if part.isalpha() and len(part) > 1 and part not in _GREEK]
    if None in parts or (len(pieces) > 2 and words):
        return r"\mathrm{" + name.replace("_", r"\_") + "}"
    first, *rest = [str(part) for part in parts]
    if not rest:
        return first
    stem, brace, digits = first.partition("_{")
    if brace:
        rest = [digits[:-1], *rest]
    return f"{stem}_{{{','.join(rest)}}}"


def _latex_of_part(part: str) -> str | None:
    match = _PART.match(part)
    if match is None:
        return None
    letters, digits = match.groups()
    if (
        letters[:1] == "p"
        and letters not in _GREEK
        and (letters[1:] in _GREEK or letters[1:] in _AXES)
    ):
        return f"p_{{{_latex_of_part(letters[1:] + digits)}}}"  # the momentum of x1 may be px1
    if letters in _GREEK:
        stem = f"\\{letters}"
    else:
        stem = letters if len(letters) <= 1 else rf"\mathrm{{{letters}}}"
    if not stem:
        return digits
    return f"{stem}_{{{digits}}}" if digits else stem


def words_of(text: str) -> list[str]:
    """Return the words of plain text for a caption."""
    if len(text) > _LONGEST_TEXT:  # of a file, which may have any
        text = f"{text[:_LONGEST_TEXT]} ... ({len(text):,} characters)"
    return escaped(text).split()


def sentence_words(sentences: Iterable[str | Sequence[str]]) -> list[str]:
    """Return sentences, plain text or words, as the words of a caption; empty ones are left out."""
    words: list[str] = []
    for given in sentences:
        part = words_of(given) if isinstance(given, str) else given
        if part:
            words += [*part[:-1], part[-1] if part[-1].endswith(".") else part[-1] + "."]
    return words


def some_of(shown: int, total: int, what: str, *other: str) -> list[str]:
    """Return the sentence that some are drawn, with names that draw another; none for all."""
    names = ", ".join(f"'{name}'" for name in other)
    text = f"{shown} of {total} {what} are drawn; plot({names}) draws others"
    return [text] if shown < total else []


def enumerated(parts: Iterable[Sequence[str]]) -> list[str]:
    """Return the words of several parts, with commas between the parts."""
    words: list[str] = []
    for part in parts:
        words += [*part[:-1], f"{part[-1]},"]
    return [*words[:-1], words[-1].removesuffix(",")] if words else []


def math_name(name: str) -> str:
    """Return a name as matplotlib draws mathematics; other names as plain, shortened text.

    Examples
    --------
    >>> math_name("p_theta"), math_name("x1"), math_name("p_x1"), math_name("length")
    ('$p_{\\\\theta}$', '$x_{1}$', '$p_{x_{1}}$', '$\\\\mathrm{length}$')
    >>> math_name("a$b")
    'a\\\\$b'
    """
    latex = latex_of(name)
    return escaped(shortened(" ".join(name.split()))) if latex is None else f"${latex}$"


def math_unit(unit: str) -> str:
    """Return a unit as it is written on axes; "" for numbers.

    Examples
    --------
    >>> math_unit("kg*m/s**2"), math_unit("1")
    ('kg·m/s$^{2}$', '')
    """
    if unit in ("", "1"):
        return ""
    text = re.sub(r"\*\*(?:\((-?[0-9./]+)\)|(-?[0-9.]+))", r"$^{\1\2}$", escaped(unit))
    return text.replace("*", "·")


def number(value: float, digits: int = 6) -> str:
    """Return a number with powers of ten as mathematics.

    Examples
    --------
    >>> number(0.25), number(1.602e-19)
    ('0.25', '$1.602\\\\times10^{-19}$')
    """
    short = f"{value:.6g}"
    text = short if float(short) == value else f"{value:.{digits}g}"
    mantissa, exponent, power = text.partition("e")
    if not exponent:
        return mantissa.replace("-", "\u2212")
    times = "" if mantissa == "1" else rf"{mantissa}\times"
    return f"${times}10^{{{int(power)}}}$"


def distinct_numbers(values: Sequence[float]) -> list[str]:
    """Return numbers with as many digits as tell different ones apart, from 4 to 15.

    Examples
    --------
    >>> distinct_numbers([0.25, 1 / 3]), distinct_numbers([1.00001, 1.00002])
    (['0.25', '0.3333'], ['1.00001', '1.00002'])
    """
    for digits in range(4, 16):
        texts = [number(value, digits) for value in values]
        if len(set(texts)) >= len(set(values)):
            break
    return texts


def quantity(H: Hamiltonian, name: str) -> tuple[str, str]:
    """Return a name as mathematics and its unit, for :func:`label`."""
    return math_name(name), math_unit(H.units.get(name, "1"))


def amount(H: Hamiltonian, name: str, value: float, digits: int = 6) -> str:
    """Return a value of a component, a parameter or the time, with its unit."""
    return f"{number(value, digits)} {math_unit(H.units.get(name, '1'))}".strip()


def with_unit(text: str, unit: str, power: str = "") -> str:
    inside = " ".join(part for part in (power, unit) if part)
    return f"{text} [{inside}]" if inside else text


def time_name(H: Hamiltonian) -> str:
    """Return the name of the time."""
    return "t" if "t" not in (*H.names, *H.parameter_names) else "time"


def energy_unit(H: Hamiltonian) -> str:
    """Return the unit of H as it is written on axes; "" without units."""
    return math_unit(wording.energy_unit(H))


def known_name(name: Any, names: Sequence[str], what: str) -> str:
    """Return a name that is one of several.

    Raise InputError if it is not; the message has the nearest name.
    """
    if isinstance(name, sympy.Symbol):
        name = name.name
    if name in names:
        return str(name)
    shown = ", ".join(names[:MAX_LINES]) + (", ..." if len(names) > MAX_LINES else "")
    raise InputError(f"'{name}' is not {what}{did_you_mean(name, names)}; choose one of {shown}")
