"""Templates of pages of HTML, in which every text is escaped."""

from __future__ import annotations

import importlib.resources
from typing import Any

import jinja2


def page_environment(**layout: Any) -> jinja2.Environment:
    """Return an environment that escapes texts and refuses names without a value.

    - **layout: Further arguments of :class:`jinja2.Environment`.

    Examples
    --------
    >>> page_environment().from_string("<pre>{{ text }}</pre>").render(text="a < b")
    '<pre>a &lt; b</pre>'
    """
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, **layout)


def page_template(name: str, environment: jinja2.Environment | None = None) -> jinja2.Template:
    """Return the template ``name.html.jinja`` of the package."""
    file = importlib.resources.files("hamsym.templates").joinpath(f"{name}.html.jinja")
    return (environment or page_environment()).from_string(file.read_text("utf-8"))
