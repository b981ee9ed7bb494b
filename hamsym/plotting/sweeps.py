"""Figures of sweeps over settings and seeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import label, legend
from hamsym.plotting.names import escaped, number, shortened
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.style import MAX_LINES, WARNING, line_styles
from hamsym.study.sweep import Sweep

_WIDE = 30.0  # ratio of the largest to the smallest value from which an axis is logarithmic
_RED: dict[str, Any] = {"color": WARNING, "marker": "x", "linestyle": "none", "zorder": 4}
_NAMES = 30  # settings of a figure
# What is drawn: an attribute of the runs, title, words for the axis and unit.
_ERROR = ("relative_error", "Error", "largest estimated error / size")
_TIME = ("seconds", "Time", "computing time", "s")


def _is_wide(values: np.ndarray) -> bool:
    """Whether values are best drawn on a logarithmic axis."""
    known = values[np.isfinite(values)]
    return len(known) > 0 and bool(known.min() > 0 and known.max() > _WIDE * known.min())


def _mark_failed(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Draw failed points in red, those without a value on the lower edge of the axes."""
    there = np.isfinite(y) & ((y > 0) | (axes.get_yscale() == "linear"))
    style = {**_RED, "markersize": 6, "label": "failed"}
    if there.any():
        axes.plot(x[there], y[there], **style)
    if not there.all():
        style["label"] = "_" if there.any() else "failed"
        edge = axes.get_xaxis_transform()
        axes.plot(x[~there], np.full((~there).sum(), 0.03), transform=edge, **style)


@dataclass(frozen=True)
class _Layout:
    """Where the settings are drawn: their places, and the lines that join them."""

    x: np.ndarray
    title: str
    ticks: tuple[str, ...]  # names at the places 0, 1, ..., or none
    series: dict[str, list[int]]
    said: str = ""


def _layout(sweep: Sweep) -> _Layout:
    names, swept = [str(name) for name in sweep.solutions], sweep.swept
    numbers = [name for name, values in swept.items() if all(map(_is_number, values))]
    if len(swept) > 2 or not numbers:
        said = ""
        if len(swept) > 2:
            listed = ", ".join(swept)
            said = f"The settings differ in {len(swept)} options, {listed}, and are drawn by name"
        ticks = tuple(escaped(shortened(name)) for name in names)
        return _Layout(np.arange(len(names)), "", ticks, {"": [*range(len(names))]}, said)
    along = max(numbers, key=lambda name: len({*swept[name]}))
    series: dict[str, list[int]] = {}
    for place in range(len(names)):
        others = [f"{name} = {_text(swept[name][place])}" for name in swept if name != along]
        series.setdefault(", ".join(others), []).append(place)
    return _Layout(np.array(swept[along], dtype=float), along, (), series)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool)


def _text(value: Any) -> str:
    if value is None:
        return "none"
    return number(float(value)) if _is_number(value) else escaped(shortened(str(value)))


def draw_sweep(sweep: Sweep, *names: Any, ax: Any = None) -> Any:
    """Draw errors and times over settings; see :meth:`hamsym.Sweep.plot`."""
    layout, runs = _layout(sweep), [*sweep.solutions.values()]
    seeds = len(sweep.seeds)
    sentences = [f"{len(runs)} settings, {seeds} seed{'s' if seeds > 1 else ''}"]
    if seeds > 1 and not layout.ticks:
        sentences.append("Dots are runs, and lines join the medians of the seeds")
    if layout.said:
        sentences.append(layout.said)
    if len(layout.ticks) > _NAMES:
        sentences.append(f"Names are those of {_NAMES} settings at most")
    sentences.append("Errors are the largest estimated ones, relative to the size of the motion")
    panels = {
        "error": Panel(lambda axes: _draw_runs(axes, sweep, layout, *_ERROR), 7.0),
        "time": Panel(lambda axes: _draw_runs(axes, sweep, layout, *_TIME), 7.0),
    }
    caption = caption_words(runs[0][0].H, *sentences)
    return draw_panels(panels, list(panels), names, ax, caption, sweep.facts.warning)


def _draw_runs(
    axes: Axes, sweep: Sweep, layout: _Layout, name: str, title: str, *words: str
) -> None:
    """Draw an attribute of each run, with a title and words for its axis."""
    values = np.array([[getattr(run, name) for run in own] for own in sweep.solutions.values()])
    good = np.array([[bool(run.success) for run in own] for own in sweep.solutions.values()])
    if (values[np.isfinite(values)] > 0).any():
        axes.set_yscale("log")
    if not layout.ticks and _is_wide(layout.x):
        axes.set_xscale("log")
    styles = line_styles(len(layout.series))
    for style, (text, places) in zip(styles, layout.series.items(), strict=True):
        own = np.array(places)[np.argsort(layout.x[places], kind="stable")]
        shown = np.where(np.isfinite(values[own]), values[own], np.nan)
        own_label = text if len(layout.series) <= MAX_LINES else ""
        if not layout.ticks:
            middle = np.full(len(own), np.nan)
            known = np.isfinite(shown).any(axis=1)
            middle[known] = np.nanmedian(shown[known], axis=1)
            axes.plot(layout.x[own], middle, **style, label=own_label or None)
        dots = np.where(good[own], shown, np.nan)
        x = np.repeat(layout.x[own], good.shape[1])
        axes.plot(x, dots.ravel(), "o", color=style["color"], markersize=3.5)
    if not good.all():
        x = np.broadcast_to(layout.x[:, None], good.shape)[~good]
        _mark_failed(axes, x, values[~good])
    if layout.ticks:
        every = -(-len(layout.ticks) // _NAMES)
        shown_ticks = layout.ticks[::every]
        upright = sum(map(len, shown_ticks)) > 30
        axes.set_xticks(layout.x[::every], shown_ticks, rotation=90 if upright else 0)
        axes.set_xlim(-0.6, len(layout.x) - 0.4)
    else:
        label(axes.xaxis, escaped(layout.title))
    axes.set_title(title)
    label(axes.yaxis, *words)
    legend(axes)
