"""Figures of a network beside integrators, and of sweeps over settings and seeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.integrators.trajectory import Trajectory
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import Figure, figure_of, label, legend, one_panel, require_no_axes
from hamsym.plotting.names import (
    energy_unit,
    escaped,
    known_name,
    math_name,
    number,
    quantity,
    shortened,
)
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.style import MAX_LINES, PAGE, SAMPLES, WARNING, line_style, line_styles, styled
from hamsym.plotting.time_axes import LARGEST, log_lines, name_curves
from hamsym.study.compare import Comparison, Row
from hamsym.study.sweep import Sweep

_WIDE = 30.0  # ratio of the largest to the smallest value from which an axis is logarithmic
_RED: dict[str, Any] = {"color": WARNING, "marker": "x", "linestyle": "none", "zorder": 4}
_NAMES = 30  # settings of a figure
# What is drawn: an attribute of the runs, title, words for the axis and unit.
_ERROR = ("relative_error", "Error", "largest estimated error / size")
_TIME = ("seconds", "Time", "computing time", "s")


def draw_comparison(comparison: Comparison, *names: Any, ax: Any = None) -> Any:
    """Draw a comparison; see :meth:`hamsym.Comparison.plot`."""
    solution = comparison.solution
    caption = caption_words(
        solution.H,
        f"Network: {solution.points:,} points. Errors against {comparison.reference.text}",
        "Phase plane: the network, and the integrator whose error is nearest to its",
        LARGEST,
    )
    warning = comparison.facts.warning
    curves = _curves(comparison)
    if names:
        panel = known_name(names[0], list(_PANELS), "a panel of a comparison")
        with one_panel(ax, caption, warning, height=7.0) as axes:
            _PANELS[panel](axes, comparison, curves)
            legend(axes)
            return figure_of(axes)
    require_no_axes(ax, "'error'")
    with styled():
        keys = 0.3 + 0.4 * -(-len(curves) // 4)
        figure = Figure.of_size(PAGE, 12.5 + keys, caption, warning)
        grid = figure.add_gridspec(3, 2, height_ratios=(5.6, 5.6, keys))
        panels = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(4)]
        for draw, one in zip(_PANELS.values(), panels, strict=True):
            draw(one, comparison, curves)
        handles, labels = panels[0].get_legend_handles_labels()
        row = figure.add_subplot(grid[2, :])
        row.set_axis_off()
        row.legend(handles, labels, loc="center", ncols=4, frameon=False)
        return figure


def _curves(comparison: Comparison) -> list[tuple[str, np.ndarray, np.ndarray, dict[str, Any]]]:
    """Return label, times, states and style of the network and of the integrators shown."""
    t = np.linspace(*comparison.solution.span, SAMPLES)
    curves = [("network", t, comparison.solution(t), line_style(0))]
    for place, (row, path) in enumerate(_shown(comparison)):
        tolerance = row.tolerance
        amount = f"{row.points:,} steps" if tolerance is None else f"rtol {tolerance:.0e}"
        label = f"{row.label}, {amount}".replace("_", " ")
        curves.append((label, path.t, path.z, line_style(place + 1)))
    return curves


def _draw_error(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    errors = []
    for text, times, z, style in curves:
        size = np.linalg.norm(z - comparison.reference(times), axis=-1)
        errors.append((times, size, {**style, "label": text}))
    _draw_curves(axes, errors)
    name_curves(axes, comparison.solution.H, "Error", r"$|\delta z|$")


def _draw_energy(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    H = comparison.solution.H
    system = H.compile("numpy")
    errors = []
    for text, times, z, style in curves:
        right = system.at("energy", comparison.reference(times), times)
        with np.errstate(all="ignore"):
            change = np.abs(system.at("energy", z, times) - right)
        errors.append((times, change, {**style, "label": text}))
    _draw_curves(axes, errors)
    name_curves(axes, H, "Energy error", r"$|\delta H|$", energy_unit(H))


def _draw_curves(axes: Axes, curves: list[tuple[np.ndarray, np.ndarray, dict[str, Any]]]) -> None:
    """Draw curves of different times, one after the other, on one logarithmic axis."""
    span = np.concatenate([times for times, _, _ in curves])
    common = np.linspace(span.min(), span.max(), SAMPLES)
    drawn = []
    for times, values, style in curves:
        order = np.argsort(times)
        size = np.interp(common, times[order], values[order], right=np.nan, left=np.nan)
        drawn.append((size, style))
    log_lines(axes, common, drawn, unknown="")


def _draw_plane(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    """Draw errors of the first pair: the network's, and the nearest in size."""
    H = comparison.solution.H
    i, j = 0, H.dof
    errors = [z - comparison.reference(times) for _, times, z, _ in curves]
    sizes = np.array([np.abs(error).max() for error in errors])
    with np.errstate(divide="ignore"):
        orders = np.log(np.nan_to_num(sizes, nan=np.inf))
    with np.errstate(invalid="ignore"):
        distances = np.nan_to_num(np.abs(orders[1:] - orders[0]), nan=np.inf)
    nearest = 1 + int(np.argmin(distances))
    for k in (0, nearest):
        axes.plot(errors[k][:, i], errors[k][:, j], **curves[k][3], label=curves[k][0])
    axes.set_title("Error in the phase plane")
    for axis, name in ((axes.xaxis, H.names[i]), (axes.yaxis, H.names[j])):
        _, unit = quantity(H, name)
        label(axis, f"error of {math_name(name)}", unit)


def _draw_work(axes: Axes, comparison: Comparison, _: list[Any]) -> None:
    """Draw errors against evaluations of the vector field."""
    network = comparison.rows[0]
    for i, name in enumerate(comparison.matches):
        own = [row for row in comparison.rows if row.label == name and np.isfinite(row.error)]
        work, errors = [row.evaluations for row in own], [row.error for row in own]
        style = line_style(i + 1)
        axes.loglog(work, errors, marker="o", **style, label=name.replace("_", " "))
    style = line_style(0)
    axes.loglog(network.evaluations, network.error, "s", color=style["color"], label="network")
    axes.axhline(network.error, color=style["color"], linewidth=0.8, linestyle=":")
    axes.set_title("Error against work")
    axes.set(xlabel="evaluations of the vector field", ylabel=r"$\max|\delta z|$")


_PANELS = {"error": _draw_error, "energy": _draw_energy, "plane": _draw_plane, "work": _draw_work}


def _shown(comparison: Comparison) -> list[tuple[Row, Trajectory]]:
    """Return all trajectories of one integrator, or the middle one of each of several."""
    pairs = list(zip(comparison.rows[1:], comparison.trajectories, strict=True))
    if len(comparison.matches) == 1:
        return pairs
    return [[pair for pair in pairs if pair[0].label == name][1] for name in comparison.matches]


# -- sweeps ----------------------------------------------------------------------------------------


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
