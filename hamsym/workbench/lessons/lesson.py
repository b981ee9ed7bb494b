"""A lesson: one file of HTML with the motion of a system, computed in the reader's browser.

The file fetches nothing: its scripts and styles are inline, and a content security policy allows
these alone, by their hashes.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import importlib.resources
import math
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

import hamsym
from hamsym.codegen.generate import generate
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.solution.solution import Solution
from hamsym.solving.recipe import python_lines
from hamsym.support.suggestions import unknown
from hamsym.workbench.lessons.problem import problem
from hamsym.workbench.mathml import equations
from hamsym.workbench.page_templates import page_template

_LARGEST = 300_000  # bytes
_PLAYER = ("trajectory", "plots", "views", "player")
_START = """
const problem = JSON.parse(document.getElementById("problem").textContent);
const player = new Player(document.querySelector(".player"), keepInAddress);
player.load({ energy, vector_field }, problem, fromAddress());
"""


def lesson(
    solution: Solution, parameters: Mapping[str, Any] | None, title: str | None, text: str
) -> bytes:
    """Return the page of a solution, whose start and span are those that the page begins with.

    Raise InputError if a range is none, JavaScript lacks a function of H, or the page would be too
    large.
    """
    if not isinstance(title, str | None) or not isinstance(text, str):
        raise InputError("title and text of a lesson are texts; give each as a str")
    H = solution.H
    script = "\n".join([system_code(H), player_script(), _START])
    style = _template("lesson.css") + player_style()
    if "</" in style or "</script" in script.lower() or "<!--" in script:
        raise InputError("the code of this H cannot be part of a page; rename its symbols")
    page = page_template("lesson").render(
        title=title or f"H = {shortened(H.formula)}",
        paragraphs=[part.strip() for part in text.split("\n\n") if part.strip()],
        equations=equations(H),
        problem=problem(solution, _slider_ranges(H, parameters)),
        player=player_elements(),
        script=Markup(script),
        script_hash=_hash(script),
        style=Markup(style),
        style_hash=_hash(style),
        accuracy="Integrated in this page by DOP853, a Runge-Kutta method of order 8 that adapts "
        "its steps to an error of 1e-11.",
        python=python_lines(solution) if solution.settings is not None else "",
        version=hamsym.__version__,
    )
    content = page.encode(errors="backslashreplace")
    if not len(content) <= _LARGEST:
        raise InputError(
            f"the page would have {len(content) / 1e3:,.0f} kB, more than {_LARGEST / 1e3:.0f}: H "
            "has too many terms; export a smaller system"
        )
    return content


def system_code(H: Hamiltonian) -> str:
    """Return the module in JavaScript with what the player needs of H.

    Raise CodeGenerationError if JavaScript lacks a function of H.
    """
    source = generate(H.real_equations, "javascript")
    return "\n\n".join([source.module("energy"), source.function("vector_field") + "\n"])


def player_elements() -> Markup:
    """Return the elements of the player."""
    return Markup(page_template("player/player").render())


@functools.cache
def player_script() -> str:
    """Return the script of the player: its files one after the other, as one module."""
    return "\n".join(map(_template, [f"player/{name}.js" for name in _PLAYER]))


@functools.cache
def player_style() -> str:
    """Return the style sheet of the player."""
    return _template("player/player.css")


def _template(name: str) -> str:
    return importlib.resources.files("hamsym.templates").joinpath(name).read_text("utf-8")


def shortened(formula: str) -> str:
    """Return a formula of at most 80 characters."""
    return formula if len(formula) <= 80 else f"{formula[:76]} ..."


def _hash(text: str) -> str:
    """What a content security policy calls an inline element."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def with_values(H: Hamiltonian, ranges: Mapping[str, Any] | None) -> Hamiltonian:
    """Return H with a value for the parameters that have none: the middle of their ranges."""
    missing = [name for name in ranges or {} if name in set(H.parameter_names) - set(H.parameters)]
    ends = {name: _range(name, (ranges or {})[name]) for name in missing}
    return H.with_parameters(**{name: (low + high) / 2 for name, (low, high) in ends.items()})


def _slider_ranges(
    H: Hamiltonian, given: Mapping[str, Any] | None
) -> dict[str, tuple[float, float]]:
    """Return the range of each parameter that has a slider: those given, or a usual one of each.

    Raise InputError if a name is no parameter, a range is none, or does not contain the value.
    """
    if given is None:
        return {name: usual_range(float(value)) for name, value in H.parameters.items()}
    found = {}
    for name, ends in given.items():
        if name not in H.parameters:
            raise InputError(unknown(name, H.parameters, "a parameter of H"))
        low, high = found[name] = _range(name, ends)
        if not low <= H.parameters[name] <= high:
            raise InputError(
                f"parameters: {name} = {H.parameters[name]:g} is not between {low:g} and {high:g}; "
                "give a range that contains it"
            )
    return found


def _range(name: str, ends: Any) -> tuple[float, float]:
    try:
        low, high = (float(end) for end in ends)
    except (TypeError, ValueError, OverflowError):
        low = high = math.nan
    if not -math.inf < low < high < math.inf:
        raise InputError(
            f"parameters: {name}={ends!r} is no range; give two numbers, the smaller one first"
        )
    return low, high


def usual_range(value: float) -> tuple[float, float]:
    """Return a range around a value, on its side of zero.

    Examples
    --------
    >>> usual_range(2.0), usual_range(-1.0), usual_range(0.0)
    ((0.2, 4.0), (-2.0, -0.1), (-1.0, 1.0))
    """
    if value == 0:
        return -1.0, 1.0
    low, high = sorted((float(f"{value / 10:.3g}"), float(f"{2 * value:.3g}")))
    return low, high
