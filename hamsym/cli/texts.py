"""Values of the texts that options take: numbers, lists, states, files."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from hamsym.errors import InputError
from hamsym.formula.separation import separated

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution


def listed(text: str) -> list[str]:
    """Return the parts of a text between its commas that are not inside parentheses."""
    return [part for part in separated(text) if part]


def number(text: str) -> float:
    """Return the value of a formula without variables."""
    from hamsym.formula.parser import parse_number  # sympy is slow to import

    return parse_number(text)


def numbers(text: str) -> list[float]:
    """Return the values of formulas between commas."""
    return [number(part) for part in listed(text)]


def whole_numbers(text: str) -> tuple[int, ...]:
    """Return the whole numbers between commas."""
    for part in listed(text):
        if not (part.isascii() and part.isdigit()):
            raise InputError(f"'{part}' is not a whole number; write e.g. 50,50")
    return tuple(map(int, listed(text)))


def saved_solution(path: str) -> Solution:
    """Return the solution in a file."""
    from hamsym.archive import load_solution

    return load_solution(path)


def assignments(text: str, option: str) -> dict[str, float]:
    """Return the values of NAME=VALUE parts between commas."""
    return {name: number(value) for name, value in texts_by_name(text, option).items()}


def texts_by_name(text: str, option: str) -> dict[str, str]:
    """Return the texts of NAME=VALUE parts between commas."""
    return formulas(listed(text), option, "NAME=VALUE; write e.g. m=1.0")


def ranges(texts: Iterable[str], option: str) -> dict[str, tuple[str, str]]:
    """Return the ends of NAME=LOW:HIGH parts, "" where one is left out."""
    found: dict[str, tuple[str, str]] = {}
    for name, ends in formulas(texts, option, "NAME=LOW:HIGH; write e.g. x=-2:2").items():
        low, colon, high = (piece.strip() for piece in ends.partition(":"))
        if not colon:
            raise InputError(f"'{name}={ends}' in {option} is not NAME=LOW:HIGH; write e.g. x=-2:2")
        found[name] = low, high
    return found


def state(text: str) -> dict[str, float] | list[float]:
    """Return a state, by name if the text has names."""
    return assignments(text, "--z0") if "=" in text else numbers(text)


def formulas(
    texts: Iterable[str], option: str, form: str = "NAME=FORMULA; write e.g. p=-c*p"
) -> dict[str, str]:
    """Return the formulas of NAME=FORMULA texts."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, formula = (piece.strip() for piece in text.partition("="))
        if not equals or not name or not formula:
            raise InputError(f"'{text}' in {option} is not {form}")
        if name in found:
            raise InputError(f"'{name}' occurs twice in {option}; give it once")
        found[name] = formula
    return found
