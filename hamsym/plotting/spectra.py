"""Panels of eigenvalues in the complex plane: multipliers and exponents."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from hamsym.dynamics.monodromy import TangentMap
from hamsym.plotting.figure import Figure, figure_of, label, one_panel
from hamsym.plotting.names import number
from hamsym.plotting.style import GREY, color_of, style_for

_LARGE = 10.0  # multipliers beyond are drawn on axes that are linear near 0 only
_MOST_NAMED = 6


def draw_multipliers(axes: Axes, values: np.ndarray, title: str) -> None:
    """Draw multipliers about the unit circle.

    Where some are large, distances from 0 are logarithmic outside the circle of radius 2.
    """
    values = np.asarray(values, dtype=complex)
    finite = values[np.isfinite(values)]
    large = bool(finite.size and np.abs(finite).max() > _LARGE)
    angle = np.linspace(0, 2 * np.pi, 400)
    axes.plot(np.cos(angle), np.sin(angle), color=GREY, linewidth=0.8, label="unit circle")
    axes.plot(finite.real, finite.imag, "x", color=color_of(1), markersize=7, label="multipliers")
    if large:
        axes.set_xscale("symlog", linthresh=2)
        axes.set_yscale("symlog", linthresh=2)
        for axis, parts in ((axes.xaxis, finite.real), (axes.yaxis, finite.imag)):
            axis.set_ticks(_ticks(float(np.abs(parts).max())))
            axis.set_major_formatter(lambda value, _: number(value, 2))
            axis.set_minor_locator(NullLocator())
        axes.margins(0.1)
    else:
        axes.margins(0.12)
        axes.set_aspect("equal", adjustable="datalim")
    if finite.size < values.size:
        note = f"{values.size - finite.size} of {values.size} are not finite"
        axes.text(0.02, 0.02, note, transform=axes.transAxes, fontsize=6)
    axes.set_title(title)
    label(axes.xaxis, "Re")
    label(axes.yaxis, "Im")


def _ticks(largest: float) -> list[float]:
    """Return ticks at 0, 1 and about three powers of ten on each side."""
    most = int(np.floor(np.log10(max(largest, 10.0))))
    powers = sorted({most, max(most * 2 // 3, 1), max(most // 3, 1)})
    outer = [10.0**power for power in powers]
    return [-value for value in reversed(outer)] + [-1.0, 0.0, 1.0, *outer]


def draw_tangent_map(found: TangentMap, *, ax: Any = None) -> Any:
    """Draw the multipliers of a tangent map; see :meth:`TangentMap.plot`."""
    largest = complex(found.multipliers[0])
    words = [f"{len(found.multipliers)}", "multipliers;", "the", "largest", "has", "the", "size"]
    caption = [*words, number(abs(largest), 6) + ".", "Start", "and", "end", "differ", "by"]
    caption.append(number(found.closure, 2) + ".")
    with one_panel(ax, caption, height=7.5) as axes, style_for(ax):
        draw_multipliers(axes, found.multipliers, "Multipliers")
        return figure_of(axes)


def draw_exponents_plane(
    axes: Axes, values: np.ndarray, marks: list[tuple[complex, str]], title: str
) -> None:
    """Draw eigenvalues of a linearised motion, with the axes that separate its kinds.

    - marks: Texts beside eigenvalues.
    """
    values = np.asarray(values, dtype=complex)
    axes.axhline(0, color=GREY, linewidth=0.7)
    axes.axvline(0, color=GREY, linewidth=0.7)
    growing = values.real > 0
    axes.plot(values[~growing].real, values[~growing].imag, "x", color=color_of(0), markersize=7)
    axes.plot(
        values[growing].real, values[growing].imag, "x", color=color_of(1), markersize=7
    )  # fmt: skip
    size = float(np.abs(values).max(initial=0.0)) or 1.0
    axes.set(xlim=(-1.25 * size, 1.25 * size), ylim=(-1.25 * size, 1.25 * size))
    axes.set_aspect("equal")
    texts = [
        axes.annotate(
            text, (place.real, place.imag), (6, 0), textcoords="offset points", va="center"
        )
        for place, text in marks
    ]
    if isinstance(figure := figure_of(axes), Figure):
        figure.thin_out(texts)
    axes.set_title(title)
    label(axes.xaxis, r"Re $\lambda$")
    label(axes.yaxis, r"Im $\lambda$")
