"""Figures of results without one of their own: the first table of their facts."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.facts.facts import Column
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, legend, one_panel
from hamsym.plotting.names import words_of
from hamsym.plotting.style import color_of


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
