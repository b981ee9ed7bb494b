"""Figures of named panels: all of them, or one of them in axes of the user."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes

from hamsym.errors import InputError
from hamsym.plotting.figure import Figure, figure_of, one_panel
from hamsym.plotting.names import known_name
from hamsym.plotting.style import GREY, PAGE, styled

#: Draws into axes, and returns sentences for the caption, or None.
Draw: TypeAlias = Callable[[Axes], Sequence[Any] | None]


@dataclass(frozen=True)
class Panel:
    """A panel of a figure."""

    draw: Draw
    #: Of the panel, in centimetres.
    height: float = 6.5
    #: Of its axes: "3d" for space.
    projection: str | None = None


def log_scales(axes: Axes, empty: str) -> None:
    """Make both axes logarithmic if lines have positive values, else say so in words."""
    values = [np.asarray(line.get_ydata(), dtype=float) for line in axes.lines]
    if any((np.isfinite(part) & (part > 0)).any() for part in values):
        axes.set(xscale="log", yscale="log")
        return
    axes.set_yticks([])
    axes.text(0.5, 0.5, empty, transform=axes.transAxes, ha="center", color=GREY)


def draw_panels(
    panels: Mapping[str, Panel],
    shown: Sequence[str],
    names: Sequence[Any],
    ax: Any,
    caption: Sequence[str],
    warning: str = "",
    *,
    columns: int = 2,
) -> Any:
    """Draw the panels of an overview side by side, or the one that is named.

    Raise InputError if a name is unknown, there is more than one, or ``ax`` is given for several
    panels.

    - panels: All panels, by name.
    - shown: Those of the overview.
    - names: The panel that was asked for, or none.
    - ax: The axes of the user for one panel.
    - columns: Of the overview; of two columns, the last of an odd number of panels fills both.
    """
    if len(names) > 1:
        raise InputError(f"{len(names)} panels cannot be drawn in one; give one name, or none")
    chosen = [known_name(names[0], list(panels), "a panel of this figure")] if names else shown
    if len(chosen) == 1:
        panel = panels[chosen[0]]
        size: dict[str, Any] = {"height": panel.height, "projection": panel.projection}
        with one_panel(ax, caption, warning, **size) as axes:
            notes = panel.draw(axes) or ()
            if ax is None:
                figure_of(axes).add_to_caption(notes)
            return figure_of(axes)
    if ax is not None:
        listed = ", ".join(f"'{name}'" for name in chosen)
        raise InputError(
            f"the overview has {len(chosen)} panels and makes its own figure; with ax= give the "
            f"name of one: {listed}"
        )
    with styled():
        rows = -(-len(chosen) // columns)
        heights = [
            max(panels[name].height for name in chosen[columns * k : columns * k + columns])
            for k in range(rows)
        ]
        figure = Figure.of_size(PAGE, sum(heights), caption, warning)
        grid = figure.add_gridspec(rows, columns, height_ratios=heights)
        sentences: list[Any] = []
        for k, name in enumerate(chosen):
            alone = columns == 2 and k == len(chosen) - 1 and not k % columns
            place = grid[k // columns, :] if alone else grid[k // columns, k % columns]
            axes = figure.add_subplot(place, projection=panels[name].projection)
            sentences += panels[name].draw(axes) or ()
        figure.add_to_caption(sentences)
        return figure
