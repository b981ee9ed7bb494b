"""plot(): the figure of a result, found by its type.

The figure of a type is the function ``draw_...`` of a module of this room whose first argument is
annotated with it. Results without one are drawn by the first table of their facts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hamsym.errors import InputError
from hamsym.facts.facts import Column
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, legend, one_panel
from hamsym.plotting.names import words_of
from hamsym.plotting.style import color_of
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


def draw_table(result: Any, *, ax: Any = None) -> Any:
    """Draw the columns of numbers of the first table that has some, over its rows."""
    facts = result.facts
    drawn = ((table, [*filter(_is_drawn, table.columns)]) for table in facts.tables)
    table, shown = next((pair for pair in drawn if pair[1]), (None, []))
    if table is None:
        raise InputError(f"{type(result).__name__} has no table of numbers to draw")
    words = words_of(". ".join(facts.opening))
    if hasattr(result, "H"):
        words = caption_words(result.H, *facts.opening)
    with one_panel(ax, words, facts.warning) as axes:
        rows = [str(name) for name in table.names]
        try:
            places, named = np.array([float(row) for row in rows]), False
        except ValueError:
            places, named = np.arange(len(rows), dtype=float), True
        for k, column in enumerate(shown):
            axes.plot(places, column.values, color=color_of(k), label=column.label)
        label(axes.xaxis, table.head or table.what)
        if named:
            axes.set_xticks(places, rows)
        if len(shown) == 1:
            label(axes.yaxis, shown[0].label)
        else:
            legend(axes)
        axes.set_title(table.title)
        return figure_of(axes)


def _is_drawn(column: Column) -> bool:
    """Whether a column has one real number in each row."""
    values = np.asarray(column.values)
    return values.ndim == 1 and values.size > 0 and values.dtype.kind in "fiu"
