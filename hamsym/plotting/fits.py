"""Figures of fits to data."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.errors import InputError
from hamsym.fitting.fitted import Fit
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import Figure, figure_of, label, legend_above, one_panel
from hamsym.plotting.names import (
    amount,
    enumerated,
    escaped,
    known_name,
    math_name,
    quantity,
    shortened,
    some_of,
)
from hamsym.plotting.names import number as shown_number
from hamsym.plotting.style import COLUMN, GREY, PAGE, SAMPLES, color_of, styled
from hamsym.plotting.time_axes import label_time
from hamsym.support.validation import require_whole

_MOST = 6  # observables of an overview


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
        estimate = shown_number(float(np.asarray(value)[at]), 6)
        text = f"{math_name(name)} = {estimate} ± {amount(found.H, name, error, 2)}"
        estimates.append(text.split())
    chi = float(np.asarray(found.chi_square)[at])
    freedom = int(np.asarray(found.degrees_of_freedom)[at])
    quality = f"$\\chi^2$ = {shown_number(chi, 4)} with {freedom:,} degrees of freedom"
    p = float(np.asarray(found.p_value)[at])
    if np.isfinite(p):
        quality += f" (p = {shown_number(p, 2)})"
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
