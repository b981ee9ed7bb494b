"""Values of the texts that options take: numbers, lists, states, files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

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


def assignments(text: str) -> dict[str, float]:
    """Return the values of NAME=VALUE parts between commas."""
    return {name: number(value) for name, value in texts_by_name(text).items()}


def texts_by_name(text: str, form: str = "NAME=VALUE; write e.g. m=1.0") -> dict[str, str]:
    """Return the texts of NAME=VALUE parts between commas."""
    found: dict[str, str] = {}
    for part in listed(text):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not name or not value:
            raise InputError(f"'{part}' is not {form}")
        if name in found:
            raise InputError(f"'{name}' occurs twice; give it once")
        found[name] = value
    return found


def formulas(text: str) -> dict[str, str]:
    """Return the formulas of NAME=FORMULA parts between commas."""
    return texts_by_name(text, "NAME=FORMULA; write e.g. p=-c*p")


def ranges(text: str) -> dict[str, tuple[float | None, float | None]]:
    """Return the ends of NAME=LOW:HIGH parts between commas, None where one is left out."""
    form = "NAME=LOW:HIGH; write e.g. x=-2:2"
    found: dict[str, tuple[float | None, float | None]] = {}
    for name, ends in texts_by_name(text, form).items():
        low, colon, high = (piece.strip() for piece in ends.partition(":"))
        if not colon:
            raise InputError(f"'{name}={ends}' is not {form}")
        found[name] = number(low) if low else None, number(high) if high else None
    return found


def intervals(text: str) -> dict[str, tuple[float | None, float | None]]:
    """Return the ends of NAME=LOW:HIGH parts between commas, none of which is left out."""
    found = ranges(text)
    for name, ends in found.items():
        if None in ends:
            raise InputError(f"'{name}' lacks an end; write e.g. {name}=-2:2")
    return found


def state(text: str) -> dict[str, float] | list[float]:
    """Return a state, by name if the text has names."""
    return assignments(text) if "=" in text else numbers(text)


class Parsed(click.ParamType):
    """A type of values that a function reads from text; its errors name the option."""

    def __init__(self, name: str, read: Callable[[str], Any]) -> None:
        self.name, self.read = name, read

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str) or (ctx is not None and ctx.resilient_parsing):
            return value  # words are completed without reading them
        try:
            return self.read(value)
        except InputError as error:
            raise InputError(f"{param.opts[0] if param else self.name}: {error}") from None


NAMES = Parsed("names", listed)
NUMBER = Parsed("number", number)
NUMBERS = Parsed("numbers", numbers)
SECONDS = Parsed("seconds", number)
STATE = Parsed("state", state)
TIME = Parsed("time", number)
VALUES = Parsed("values", assignments)


def joined(read: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a callback that reads all texts of a repeated option at once, None without one."""

    def together(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> Any:
        return Parsed("text", read).convert(",".join(texts), param, ctx) if texts else None

    return together
