"""Figures of frequencies: lines of signals, and frequency maps of ensembles."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from hamsym.dynamics.frequencies import Frequencies
from hamsym.errors import InputError
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, legend, one_panel
from hamsym.plotting.names import number
from hamsym.plotting.style import SEQUENTIAL, color_of


def draw_frequencies(found: Frequencies, *, ax: Any = None) -> Any:
    """Draw amplitudes over frequencies, or a frequency map; see :class:`hamsym.Frequencies`."""
    if not np.isfinite(found.frequency).any():
        raise InputError("no frequency was found; there is nothing to draw")
    caption = caption_words(found.H, f"Signals {', '.join(found.signals)}")
    with one_panel(ax, caption, height=8.0) as axes:
        if found.frequency.ndim == 2:
            _draw_lines(axes, found)
        else:
            _draw_map(axes, found)
        return figure_of(axes)


def _draw_lines(axes: Axes, found: Frequencies) -> None:
    for k, signal in enumerate(found.signals):
        good = np.isfinite(found.frequency[k]) & (found.amplitude[k] > 0)
        place, size = found.frequency[k][good], found.amplitude[k][good]
        low = size.min(initial=np.inf) / 10
        axes.vlines(place, low, size, color=color_of(k), linewidth=1.2)
        axes.plot(place, size, "o", color=color_of(k), markersize=4, label=signal)
    axes.set_yscale("log")
    axes.set_title("Frequencies")
    label(axes.xaxis, r"angular frequency $\omega$")
    label(axes.yaxis, "amplitude")
    legend(axes)


def _draw_map(axes: Axes, found: Frequencies) -> None:
    """The first frequencies of two signals, or of one over the number of the trajectory."""
    first = np.abs(found.frequency[..., 0]).reshape(-1, len(found.signals))
    drift = np.abs(found.drift[..., 0]).reshape(-1, len(found.signals)).max(axis=1)
    several = len(found.signals) > 1
    x = first[:, 0] if several else np.arange(len(first))
    y = first[:, 1] if several else first[:, 0]
    floor = max(float(np.nanmin(drift)), 1e-16)
    colors = np.maximum(drift, floor)
    top = max(float(np.nanmax(colors)), 10 * floor)
    points = axes.scatter(x, y, c=colors, s=9, cmap=SEQUENTIAL, norm=LogNorm(floor, top))
    bar = axes.figure.colorbar(points, ax=axes)
    label(bar.ax.yaxis, "drift")
    axes.set_title(f"Frequency map, drift at most {number(top, 2)}")
    label(axes.xaxis, f"frequency of {found.signals[0]}" if several else "trajectory")
    label(axes.yaxis, f"frequency of {found.signals[1 if several else 0]}")
