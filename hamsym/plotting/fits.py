"""Figures of fits to data and of flow maps."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.fitting.fitted import Fit
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.plotting.captions import axis_words, caption_words, formula_of
from hamsym.plotting.figure import (
    Figure,
    figure_of,
    label,
    legend_above,
    one_panel,
    require_no_axes,
)
from hamsym.plotting.motions import drawn_of, own_parameters
from hamsym.plotting.names import (
    amount,
    enumerated,
    escaped,
    known_name,
    math_name,
    number,
    quantity,
    shortened,
    some_of,
    time_name,
)
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.style import COLORS, COLUMN, GREY, PAGE, SAMPLES, color_of, shades, styled
from hamsym.plotting.time_axes import label_time
from hamsym.support.validation import require_whole

_MOST = 6  # observables, or panels, of an overview
_POINTS, _STARTS, _SHOWN, _TIMES = 200, 200, 8, 401


def draw_fit(found: Fit, *names: Any, number: int = 0, ax: Any = None) -> Any:
    """Draw data with the fitted motion; see :meth:`hamsym.Fit.plot`."""
    several = np.ndim(found.success) > 0
    sets = len(found.success) if several else 1
    require_whole("number", number, 0)
    if number >= sets:
        raise InputError(f"number={number!r} is no set of data; give one from 0 to {sets - 1}")
    at = (number,) if several else ()
    labels = list(found.data)
    chosen = [known_name(name, labels, "an observable") for name in names] or labels
    sentences = _sentences(found, at, several)
    if not names:
        chosen = labels[:_MOST]
        sentences += some_of(len(chosen), len(labels), "observables", labels[-1])
    fitted = {*found.names}
    fixed = {name: value for name, value in found.H.parameters.items() if name not in fitted}
    caption = caption_words(found.H, *sentences, parameters=fixed)
    success = bool(np.asarray(found.success)[at])
    message = found.message[number] if several else found.message
    warning = "" if success else f"Failed: {message}"
    if ax is not None:
        if len(chosen) != 1:
            raise InputError(
                f"{len(chosen)} observables need panels of their own; with ax= name one of them: "
                f"{', '.join(labels)}"
            )
        with one_panel(ax, caption, warning) as axes:
            _draw_data(axes, found, chosen[0], at)
            return figure_of(axes)
    with styled():
        columns = min(len(chosen), 2 if len(chosen) in (2, 4) else 3)
        rows = -(-len(chosen) // columns)
        width = COLUMN if columns == 1 else PAGE
        figure = Figure.of_size(width, rows * 7.5, caption, warning)
        outer = figure.add_gridspec(2 * rows, columns, height_ratios=[2, 1] * rows)
        for k, name in enumerate(chosen):
            row, column = divmod(k, columns)
            above = figure.add_subplot(outer[2 * row, column])
            below = figure.add_subplot(outer[2 * row + 1, column], sharex=above)
            _draw_data(above, found, name, at)
            _draw_residuals(below, found, name, at)
            above.set_xlabel("")
            above.tick_params(labelbottom=False)
        return figure


def _sentences(found: Fit, at: tuple[int, ...], several: bool) -> list[Any]:
    """Return the estimates with their standard errors, and how well they fit."""
    estimates = []
    for name, value in found.parameters.items():
        error = float(np.asarray(found.standard_errors[name])[at])
        estimate = number(float(np.asarray(value)[at]), 6)
        text = f"{math_name(name)} = {estimate} ± {amount(found.H, name, error, 2)}"
        estimates.append(text.split())
    chi = float(np.asarray(found.chi_square)[at])
    freedom = int(np.asarray(found.degrees_of_freedom)[at])
    quality = f"$\\chi^2$ = {number(chi, 4)} with {freedom:,} degrees of freedom"
    p = float(np.asarray(found.p_value)[at])
    if np.isfinite(p):
        quality += f" (p = {number(p, 2)})"
    head = [f"Set {at[0]}"] if several else []
    return [*head, ["Fitted:", *enumerated(estimates)], quality.split()]


def _named(found: Fit, name: str) -> tuple[str, str]:
    """Return an observable and its unit, for a label."""
    if name in found.H.names:
        return quantity(found.H, name)
    return escaped(shortened(name)), ""


def _draw_data(axes: Axes, found: Fit, name: str, at: tuple[int, ...]) -> None:
    data, sigma = found.data[name][at], found.sigma[name][at]
    own: dict[str, Any] = {"color": GREY, "markersize": 3, "elinewidth": 0.5, "zorder": 2}
    axes.errorbar(found.t, data, sigma, fmt=".", **own, label="data")
    dense = np.linspace(*found.span, SAMPLES)
    own = {"color": color_of(0), "linewidth": 1.1, "zorder": 3}
    axes.plot(dense, found(dense)[name][at], **own, label="fitted motion")
    axes.set_title(_named(found, name)[0])
    label(axes.yaxis, *_named(found, name))
    label_time(axes, found.H)
    legend_above(axes)


def _draw_residuals(axes: Axes, found: Fit, name: str, at: tuple[int, ...]) -> None:
    values = found.weighted_residuals[name][at]
    axes.plot(found.t, values, ".", color=color_of(0), markersize=3)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    for side in (-2, 2):
        axes.axhline(side, color=GREY, linewidth=0.6, linestyle=":")
    label(axes.yaxis, r"residual / $\sigma$")
    label_time(axes, found.H)


# -- flow maps -------------------------------------------------------------------------------------


def draw_flow_map(flow: FlowMap, *names: Any, ax: Any = None) -> Any:
    """Draw what becomes of the box; see :meth:`hamsym.FlowMap.plot`."""
    H = flow.H
    _, chosen = drawn_of(H, names)
    warning = flow.facts.warning
    if len(chosen) > 2:
        raise InputError(
            "one component is drawn over time and two in their plane; give one or two names"
        )
    if len(chosen) == 2 and chosen[0].text == chosen[1].text:
        raise InputError(f"the plane of '{chosen[0].text}' and itself is a line; give two others")
    if chosen:
        left = [words for each in chosen if (words := formula_of(each))]
        caption = _caption(flow, *left, over_time=len(chosen) == 1, planes=len(chosen) == 2)
        with one_panel(ax, caption, warning, height=7.5) as axes:
            if len(chosen) == 1:
                _draw_range(axes, flow, chosen[0])
            else:
                _draw_plane(axes, flow, *chosen)
            axes.legend(fontsize=6, ncols=len(chosen))
            return figure_of(axes)
    require_no_axes(ax, f"'{H.names[0]}', '{H.names[H.dof]}'")
    whole = flow.region.is_whole
    total = H.dof if whole else H.dim
    shown = min(total, _MOST)
    pairs = [k + side for k in range(H.dof) for side in (0, H.dof)]
    components = [H.observable(name) for name in H.names]
    what = "phase planes" if whole else "components"
    other = (H.names[H.dof - 1], H.names[-1]) if whole else (H.names[-1],)
    others = some_of(shown, total, what, *other)
    columns = min(shown, 3) if whole else 2
    height = (PAGE / columns if columns > 1 else COLUMN) if whole else 4.5

    def draw(axes: Axes, k: int) -> None:
        if whole:
            _draw_plane(axes, flow, components[k], components[H.dof + k])
        else:
            _draw_range(axes, flow, components[k])
        if k == 0:
            axes.legend(fontsize=6, ncols=2 if whole else 1)

    panels = {
        H.names[k]: Panel(functools.partial(draw, k=k), height)
        for k in (range(shown) if whole else pairs[:shown])
    }
    caption = _caption(flow, *others, over_time=not whole, planes=whole)
    return draw_panels(panels, list(panels), (), None, caption, warning, columns=columns)


def _caption(flow: FlowMap, *sentences: Any, over_time: bool, planes: bool) -> list[str]:
    H, varied = flow.H, flow.box
    ranges = [
        [math_name(name), "from", number(low, 4), "to", *amount(H, name, high, 4).split()]
        for name, (low, high) in varied.items()
    ]
    parts: list[Any] = [["Box:", *enumerated(ranges)]]
    if planes:
        at_centre = "" if H.dof == 1 and len(flow.region) == 2 else ", through its centre"
        parts.append(f"Shaded: the box{at_centre} at six times")
    if over_time:
        parts.append(
            f"Shaded: range of {_STARTS} random starts of the box; lines: {_SHOWN} of them"
        )
    parts.append(flow.message[:1].upper() + flow.message[1:])
    fixed = {name: v for name, v in H.parameters.items() if name not in varied}
    return caption_words(H, *parts, *sentences, parameters=fixed)


def _values(flow: FlowMap, drawn: Observable, t: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Return a component or a formula at times, from places in the box."""
    given = dict(zip(flow.inputs, inputs.T, strict=True))
    parameters = own_parameters(flow.H, given, t.shape)
    return drawn.values(flow.map.evaluate(t, inputs), t, parameters)


def _draw_plane(axes: Axes, flow: FlowMap, x: Observable, y: Observable) -> None:
    """Draw the box in the plane of two components or formulas at six times."""
    H, box = flow.H, flow.region
    label(axes.xaxis, *axis_words(x))
    label(axes.yaxis, *axis_words(y))
    times = np.linspace(*flow.span, len(COLORS))
    edge = _edge_of(flow, x.text, y.text)
    for t, color in zip(times, shades(len(times)), strict=True):
        text = f"$t$ = {amount(H, time_name(H), float(t), 4)}"
        if edge is not None:
            own = np.full(len(edge), t), box.at(edge)
            sides = _values(flow, x, *own), _values(flow, y, *own)
            axes.fill(*sides, color=color, alpha=0.2, linewidth=0)
            axes.plot(*sides, color=color, label=text)
        else:
            inputs = box.at(_random(flow))
            own = np.full(len(inputs), t), inputs
            sides = _values(flow, x, *own), _values(flow, y, *own)
            axes.plot(*sides, ".", color=color, markersize=2, label=text)


def _edge_of(flow: FlowMap, x: str, y: str) -> np.ndarray | None:
    """Return the edge of the box in the plane of two inputs, through the centre of the others."""
    inputs = list(flow.inputs)
    if x not in inputs or y not in inputs:
        return None
    side = np.linspace(-1, 1, _POINTS)
    ends = np.ones_like(side)
    first = np.concatenate((side, ends, -side, -ends))
    second = np.concatenate((-ends, side, ends, -side))
    found = np.zeros((len(first), len(flow.region)))
    found[:, inputs.index(x)], found[:, inputs.index(y)] = first, second
    return found


def _random(flow: FlowMap) -> np.ndarray:
    """Places in the box, in units of its half widths."""
    return np.random.default_rng(0).uniform(-1, 1, (_STARTS, len(flow.region)))


def _draw_range(axes: Axes, flow: FlowMap, drawn: Observable) -> None:
    """Draw the range of a component or a formula over time, and some trajectories."""
    times = np.linspace(*flow.span, _TIMES)
    inputs = flow.region.at(_random(flow))
    queries = np.tile(times, len(inputs)), inputs.repeat(len(times), axis=0)
    paths = _values(flow, drawn, *queries).reshape(len(inputs), len(times))
    color = color_of(0)
    style: dict[str, Any] = {"color": color, "linewidth": 0}
    axes.fill_between(
        times, paths.min(axis=0), paths.max(axis=0), alpha=0.2, **style, label="range"
    )
    for number_of, path in enumerate(paths[:_SHOWN]):
        axes.plot(times, path, color=color, linewidth=0.6, label=None if number_of else "starts")
    axes.set_xlim(min(flow.span), max(flow.span))
    label(axes.yaxis, *axis_words(drawn))
    label_time(axes, flow.H)
