"""Curves over time: axes of time, fewer points, and logarithmic axes of errors and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator

from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.figure import label
from hamsym.plotting.names import energy_unit, math_name, quantity, time_name
from hamsym.plotting.style import MAX_LINES, color_of, line_style, positive

# Pieces of a logarithmic curve: as many as a column of a page shows apart.
_PIECES = 200
#: Sentence of the caption of logarithmic curves of many times.
LARGEST = f"Errors and residuals: the largest of each {_PIECES}th of the span"
# Part of the height of a low panel that a text above a line needs.
_TEXT = 0.16


def label_time(axes: Axes, H: Hamiltonian) -> None:
    label(axes.xaxis, *quantity(H, time_name(H)))


def name_curves(axes: Axes, H: Hamiltonian, title: str, text: str, unit: str = "") -> None:
    """Set the title of curves over time, and the labels of both axes."""
    axes.set_title(title)
    label(axes.yaxis, text, unit)
    label_time(axes, H)


def name_energy_error(axes: Axes, H: Hamiltonian) -> None:
    """Name curves of the change of H, less the work W of forces and explicit time."""
    work = "" if H.conserves_energy else " - W"
    name_curves(axes, H, "Energy error", f"$|H - H_0{work}|$", energy_unit(H))


def fill_time(axes: Axes, t: np.ndarray) -> None:
    """Let a time axis end where the times do."""
    axes.set_xlim(min(t[0], t[-1]), max(t[0], t[-1]))


def envelope(t: np.ndarray, values: np.ndarray, bins: int = 2_000) -> tuple[np.ndarray, np.ndarray]:
    """Return fewer points of a curve: the smallest and the largest value of each piece of time."""
    if len(t) <= 4 * bins:
        return t, values
    edges = np.linspace(0, len(t), bins + 1).astype(int)
    places = [0]
    for start, end in pairwise(edges.tolist()):
        part = np.nan_to_num(values[start:end], nan=0.0)
        places += sorted((start + int(part.argmin()), start + int(part.argmax())))
    places.append(len(t) - 1)
    return t[places], values[places]


def largest_of_pieces(
    t: np.ndarray, values: np.ndarray, pieces: int = _PIECES
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest value of each piece of many times; nan is left out."""
    if len(t) <= 2 * pieces or t[0] == t[-1]:
        return t, values
    edges = np.linspace(0, len(t), pieces + 1).astype(int)
    times = [t[start:end].mean() for start, end in pairwise(edges.tolist())]
    filled = np.nan_to_num(values, nan=-np.inf)
    largest = np.maximum.reduceat(filled, edges[:-1])
    return np.array(times), np.where(np.isfinite(largest), largest, np.nan)


def component_curves(H: Hamiltonian, values: np.ndarray) -> list[tuple[np.ndarray, dict[str, Any]]]:
    """Return a curve for each component, or of many the largest of all."""
    if values.shape[1] > MAX_LINES // 2:
        text = f"largest of {values.shape[1]} components"
        return [(values.max(axis=1), {"color": color_of(0), "label": text})]
    return [
        (values[:, i], {**line_style(i), "label": math_name(name)})
        for i, name in enumerate(H.names)
    ]


def relative(values: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return sizes of errors relative to those of components; nan where these are zero."""
    with np.errstate(all="ignore"):
        return np.where(values == 0, 0.0, np.abs(values) / np.where(sizes > 0, sizes, np.nan))


def log_lines(
    axes: Axes,
    t: np.ndarray,
    curves: Sequence[tuple[np.ndarray, dict[str, Any]]],
    *,
    lines: Sequence[tuple[float, dict[str, Any]]] = (),
    unknown: str = "unknown",
) -> None:
    """Draw positive quantities over time on a logarithmic axis, with horizontal lines.

    Of many times the largest value of each piece is drawn, as :data:`LARGEST` says. The axis covers
    whole decades. Curves without a positive value are reported in words.
    """
    drawn, infinite = [], False
    for values, style in curves:
        infinite = infinite or not np.isfinite(values).all()
        shown = positive(np.abs(values))
        if np.isfinite(shown).any():
            times, shown = largest_of_pieces(t, shown)
            axes.plot(times, shown, **style)
            drawn.append((times, shown))
    low = min((_usual_low(*part) for part in drawn), default=np.inf)
    top = max((np.nanmax(shown) for _, shown in drawn), default=0.0)
    drawn_lines = decades_and_lines(axes, max(low, 1e-100 * top), top, lines)
    fill_time(axes, t)
    if not drawn and not drawn_lines:
        axes.set_yticks([])
    found = [values for values, _ in curves]
    zero = bool(found) and all(np.all(values == 0) for values in found)
    if zero or infinite:
        text = "zero at all times" if zero else unknown
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="0.4")


def _usual_low(t: np.ndarray, values: np.ndarray) -> float:
    """Return a value below which a curve is for a twentieth of the time."""
    known = np.isfinite(values)
    order = np.argsort(t[known])
    even = np.linspace(t[known].min(), t[known].max(), 200)
    return float(np.quantile(np.interp(even, t[known][order], values[known][order]), 0.05))


def decades_and_lines(
    axes: Axes, low: float, top: float, lines: Sequence[tuple[float, dict[str, Any]]] = ()
) -> bool:
    """Make the vertical axis logarithmic, of whole decades, and draw up to two horizontal lines.

    Return whether it has any.
    """
    known = [(value, style) for value, style in lines if np.isfinite(value) and value > 0]
    above = {"xycoords": axes.get_yaxis_transform(), "textcoords": "offset points", "va": "bottom"}
    for (side, x), (value, style) in zip((("left", 0.01), ("right", 0.99)), known, strict=False):
        axes.axhline(value, **{key: entry for key, entry in style.items() if key != "label"})
        own = {"fontsize": 6, "color": style["color"], "ha": side, **above}
        axes.annotate(style["label"], (x, value), (0, 1.5), **own)
    axes.set_yscale("log")
    heights = [value for value in (low, top) if np.isfinite(value) and value > 0]
    heights += [value for value, _ in known]
    if heights:
        bottom, ceiling = np.floor(np.log10(min(heights))), np.ceil(np.log10(4 * max(heights)))
        if known:  # room for the texts above lines
            highest = np.log10(max(value for value, _ in known))
            ceiling = max(ceiling, np.ceil((highest - _TEXT * bottom) / (1 - _TEXT)))
        axes.set_ylim(*10.0 ** np.array((bottom, ceiling)))
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())
    return bool(known)
