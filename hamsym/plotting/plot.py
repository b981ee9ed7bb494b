"""plot(): the figure of a result, found by its type.

The figure of a type is the function ``draw_...`` of a module of this room whose first argument is
annotated with it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

from matplotlib.figure import Figure

from hamsym.errors import InputError
from hamsym.plotting.tables import draw_table
from hamsym.support.shown import Shown, by_type, function_of
from hamsym.support.suggestions import checked_keywords


def plot(result: Any, *args: Any, **options: Any) -> Figure:
    """Draw a result: an overview, or the panel that names choose.

    Every figure has one style, names as mathematics, and a caption with H, its parameters and the
    method. It belongs to no window: a notebook shows it, ``savefig`` writes it. Settings of
    matplotlib are not changed.

    Parameters
    ----------
    result : Solution, Solutions, Trajectory, Fit, FlowMap, Section, Comparison, LyapunovExponents
        Or another result with a method ``plot``.
    *args, **options
        As in the method ``plot`` of the result; most take names of what to draw, and ``ax``, axes
        of matplotlib for one panel.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with ``.savefig(path)``, as .png, .svg or .pdf.

    Raises
    ------
    InputError
        If the result is of another type.

    Examples
    --------
    >>> import hamsym
    >>> figure = plot(hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 10)))
    >>> [axis.get_ylabel() for axis in figure.axes]
    ['$x$', '$p$', '$p$', '$|H - H_0|$', 'energy']
    """
    draw = function_of(result, _figures())
    if draw is not None:
        return checked_keywords(draw, "plot")(result, *args, **options)
    if isinstance(result, Shown) and math.isfinite(result.facts.drawn):
        return checked_keywords(draw_table, "plot")(result, *args, **options)
    raise InputError(
        f"{type(result).__name__} cannot be plotted; give a solution or many, a trajectory, a fit, "
        "a flow map, a section, a comparison, Lyapunov exponents or chaos indicators"
    )


@functools.cache
def _figures() -> dict[str, Callable[..., Any]]:
    """Return the functions that draw results, by the names of their types."""
    return by_type("hamsym.plotting", lambda name, _: name.startswith("draw_"))
