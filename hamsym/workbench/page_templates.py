"""Templates of pages of HTML, in which every text is escaped."""

from __future__ import annotations

import functools
import importlib.resources
import re

import jinja2
from markupsafe import Markup

_WHOLE = re.compile(r"[-−]?[\d,]+(?![\d,])")
_EXPONENT = re.compile(r"\d[\d.]*e[+-]\d+")


@functools.cache
def page_template(name: str) -> jinja2.Template:
    """Return the template ``name.html.jinja`` of the package; it refuses names without a value."""
    file = importlib.resources.files("hamsym.templates").joinpath(f"{name}.html.jinja")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["unbroken"] = unbroken
    environment.filters["at_point"] = at_point
    return environment.from_string(file.read_text("utf-8"))


def at_point(rows: list[list[str]]) -> list[list[str]]:
    """Return rows of texts in which the points of the numbers of a column are in one place.

    The columns are flush right in a font of one width; spaces that do not break follow numbers.

    Examples
    --------
    >>> [row[1].replace("\\xa0", "_") for row in at_point([["x", "1.25"], ["p", "10"], ["q", ""]])]
    ['1.25', '10___', '']
    """
    columns = []
    for column in zip(*rows, strict=True):
        found = [_WHOLE.match(text) for text in column]
        tails = [
            len(text) - each.end() if each else 0 for text, each in zip(column, found, strict=True)
        ]
        most = max(tails)
        columns.append(
            [
                text + "\xa0" * (most - tail) if each else text
                for text, tail, each in zip(column, tails, found, strict=True)
            ]
        )
    return [list(row) for row in zip(*columns, strict=True)]


def unbroken(text: str) -> Markup:
    """Return a text, escaped, in which no line ends inside a number such as 1e-9.

    Examples
    --------
    >>> unbroken("a < 1e-9")
    Markup('a &lt; <span class="one">1e-9</span>')
    """
    return Markup(_EXPONENT.sub(r'<span class="one">\g<0></span>', str(Markup.escape(text))))
