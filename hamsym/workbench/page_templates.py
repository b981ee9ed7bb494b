"""Templates of pages of HTML, in which every text is escaped."""

from __future__ import annotations

import functools
import importlib.resources
import re

import jinja2
from markupsafe import Markup

_EXPONENT = re.compile(r"\d[\d.]*e[+-]\d+")


@functools.cache
def page_template(name: str) -> jinja2.Template:
    """Return the template ``name.html.jinja`` of the package; it refuses names without a value."""
    file = importlib.resources.files("hamsym.templates").joinpath(f"{name}.html.jinja")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["unbroken"] = unbroken
    return environment.from_string(file.read_text("utf-8"))


def unbroken(text: str) -> Markup:
    """Return a text, escaped, in which no line ends inside a number such as 1e-9.

    Examples
    --------
    >>> unbroken("a < 1e-9")
    Markup('a &lt; <span class="one">1e-9</span>')
    """
    return Markup(_EXPONENT.sub(r'<span class="one">\g<0></span>', str(Markup.escape(text))))
