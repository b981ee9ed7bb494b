"""Figures of sweeps: of settings and seeds, and over a grid of parameters, starts and energies."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from hamsym.errors import InputError
from hamsym.plotting.captions import caption_words, parameter_words
from hamsym.plotting.figure import figure_of, label, legend
from hamsym.plotting.names import escaped, known_name, math_name, number, shortened, words_of
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.style import MAX_LINES, WARNING, color_of, line_styles
from hamsym.study.grid import StoredSweep
from hamsym.study.sweep import Sweep

_WIDE = 30.0  # ratio of the largest to the smallest value from which an axis is logarithmic
_RED: dict[str, Any] = {"color": WARNING, "marker": "x", "linestyle": "none", "zorder": 4}
_NAMES = 30  # settings of a figure


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


# -- settings and seeds ----------------------------------------------------------------------------


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
        "error": Panel(functools.partial(_draw_errors, sweep=sweep, layout=layout), 7.0),
        "time": Panel(functools.partial(_draw_times, sweep=sweep, layout=layout), 7.0),
    }
    caption = caption_words(runs[0][0].H, *sentences)
    return draw_panels(panels, list(panels), names, ax, caption, sweep.facts.warning)


def _draw_errors(axes: Axes, sweep: Sweep, layout: _Layout) -> None:
    values = [[run.relative_error for run in own] for own in sweep.solutions.values()]
    _draw_runs(axes, sweep, layout, np.array(values))
    axes.set_title("Error")
    label(axes.yaxis, "largest estimated error / size")


def _draw_times(axes: Axes, sweep: Sweep, layout: _Layout) -> None:
    values = [[run.record.seconds for run in own] for own in sweep.solutions.values()]
    _draw_runs(axes, sweep, layout, np.array(values))
    axes.set_title("Time")
    label(axes.yaxis, "computing time", "s")


def _draw_runs(axes: Axes, sweep: Sweep, layout: _Layout, values: np.ndarray) -> None:
    """Draw one value of each run, shape (settings, seeds)."""
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
    legend(axes)


# -- grids -----------------------------------------------------------------------------------------

_SHOWN = {"solve": ("excess",), "lyapunov": ("exponent_1", "energy_error"), "section": ("count",)}
_MOST = 4  # panels of what a function returned
_TITLES = {
    "excess": "error / what was asked",
    "exponent_1": r"largest exponent $\lambda$",
    "energy_error": "energy error",
    "count": "crossings",
}


def draw_stored_sweep(
    sweep: StoredSweep, *names: Any, at: Mapping[str, float] | None = None, ax: Any = None
) -> Any:
    """Draw values over a grid; see :meth:`hamsym.StoredSweep.plot`."""
    axes_of, values = sweep.store.axes, sweep.values()
    fixed, said = _fixed(axes_of, at or {})
    cut = tuple(fixed.get(name, slice(None)) for name in axes_of)
    free = {name: axis for name, axis in axes_of.items() if name not in fixed}
    numbers = {n: v[cut] for n, v in values.items() if v.dtype.kind in "fiub" and n != "done"}
    done = values["done"][cut]
    failed = done & ~values["success"][cut].astype(bool) if "success" in values else ~done & done
    panels = {
        name: Panel(
            functools.partial(
                _draw_values,
                name=name,
                free=free,
                values=np.where(done, shown, np.nan),
                failed=failed,
            ),
            7.0,
        )
        for name, shown in numbers.items()
    }
    if not panels:
        raise InputError(f"'{sweep.path.name}' has no number at any point; complete the sweep")
    asked = sweep.store.attributes
    usual = [name for name in numbers if name != "success" and not name.startswith("z0_")]
    shown = [name for name in _SHOWN.get(asked["task"], usual) if name in panels][:_MOST]
    words = words_of(f"H = {asked['H']}.")
    if asked["parameters"]:
        words += parameter_words(asked["parameters"])
        words[-1] += "."
    start, end = asked["span"]
    words += words_of(f"Task {asked['task']}, t from {start:.6g} to {end:.6g}.")
    words += said
    if not done.all():
        words += words_of("Points that are not in the store are grey.")
    warning = ""
    if failed.any():
        message = next(text for text in values["message"][cut][failed].ravel())
        count = f"{int(failed.sum()):,} of {int(done.sum()):,}"
        warning = f"{count} points drawn failed, for example: {message}"
    return draw_panels(panels, shown or list(panels)[:1], names, ax, words, warning)


def _fixed(
    axes: Mapping[str, np.ndarray], at: Mapping[str, float]
) -> tuple[dict[str, int], list[str]]:
    """Return the axes at one of their values, as indices, and words about them."""
    fixed: dict[str, int] = {}
    for name, value in at.items():
        known_name(name, list(axes), "an axis of the grid")
        if not _is_number(value) or not np.isfinite(value):
            raise InputError(f"at[{name!r}]={value!r} is not a finite number; give a value of it")
        fixed[name] = int(np.argmin(np.abs(axes[name] - value)))
    if len(fixed) == len(axes):
        raise InputError("at= leaves no axis of the grid to draw over; leave one out")
    for name, axis in axes.items():  # an axis of one value is no direction to draw in
        if len(axis) == 1 and len(axes) - len(fixed) > 1:
            fixed.setdefault(name, 0)
    said = []
    for name in [name for name in axes if name not in fixed][2:]:
        fixed[name] = 0
        said += words_of(f"plot(at={{'{name}': ...}}) draws its other values.")
    words = [f"{math_name(name)} = {number(float(axes[name][k]))}," for name, k in fixed.items()]
    if words:
        words = ["Drawn", "at", *words[:-1], words[-1].removesuffix(",") + "."]
    return fixed, words + said


def _draw_values(
    axes: Axes, name: str, free: Mapping[str, np.ndarray], values: np.ndarray, failed: np.ndarray
) -> None:
    sorts = [np.argsort(axis) for axis in free.values()]
    values, failed = (array[np.ix_(*sorts)] for array in (values, failed))
    sides = [axis[order] for axis, order in zip(free.values(), sorts, strict=True)]
    title = _TITLES.get(name, math_name(name))
    good = np.where(~failed & np.isfinite(values), values, np.nan)
    if len(sides) == 1:
        if _is_wide(good):
            axes.set_yscale("log")
        if _is_wide(sides[0]):
            axes.set_xscale("log")
        axes.plot(sides[0], good, "o-", color=color_of(0), markersize=3)
        for place in sides[0][~failed & ~np.isfinite(values)]:
            axes.axvline(place, color="0.85", linewidth=2.5, zorder=0)
        if failed.any():
            _mark_failed(axes, sides[0][failed], values[failed].astype(float))
        label(axes.xaxis, math_name(next(iter(free))))
        label(axes.yaxis, title)
        legend(axes)
        return
    y, x = sides
    norm = LogNorm() if _is_wide(good) else Normalize()
    image = axes.pcolormesh(x, y, np.ma.masked_invalid(good), norm=norm, shading="nearest")
    axes.set_facecolor("0.85")
    axes.grid(visible=False)
    for side, scale in ((x, axes.set_xscale), (y, axes.set_yscale)):
        if _is_wide(side):
            scale("log")
    if failed.any():
        rows, columns = np.nonzero(failed)
        axes.plot(x[columns], y[rows], **_RED, markersize=4)
    for axis, text in zip((axes.yaxis, axes.xaxis), free, strict=True):
        label(axis, math_name(text))
    if np.isfinite(good).any():
        bar = figure_of(axes).colorbar(image, ax=axes, pad=0.02)
        bar.ax.set_ylabel(title)
    axes.set_title(title)
