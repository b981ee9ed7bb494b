"""Figures of Lyapunov exponents, chaos indicators and frequencies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from hamsym.dynamics.chaos_indicators import ChaosIndicators
from hamsym.dynamics.frequencies import Frequencies
from hamsym.dynamics.lyapunov import LyapunovExponents
from hamsym.dynamics.lyapunov_map import LyapunovMap
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import axis_words, caption_words
from hamsym.plotting.figure import color_bar, figure_of, label, legend, one_panel
from hamsym.plotting.motions import own_parameters, parameters_of
from hamsym.plotting.names import (
    math_unit,
    number,
    quantity,
    time_name,
    words_of,
)
from hamsym.plotting.panels import Panel, draw_panels, log_scales
from hamsym.plotting.style import (
    COLUMN,
    GREY,
    MAX_LINES,
    SEQUENTIAL,
    color_of,
    line_styles,
    positive,
)

_FEWEST = 1e-3  # part of the time from which on log(t)/t is drawn
_PIECES = 80  # of the logarithm of time
_MEANS = f"Drawn are means over {_PIECES} pieces of the logarithm of time, and the last values"


def _rate_unit(H: Hamiltonian) -> str:
    """Return the unit of a growth rate."""
    unit = H.units.get(time_name(H), "1")
    return "" if unit == "1" else f"1/{math_unit(unit)}"


def _label_elapsed(axes: Axes, H: Hamiltonian, start: float) -> None:
    text = "elapsed time" if start else "time"
    name, unit = quantity(H, time_name(H))
    label(axes.xaxis, f"{text} {name}" if not start else text, unit)


# -- exponents -------------------------------------------------------------------------------------


def draw_lyapunov(found: LyapunovExponents, *names: Any, ax: Any = None) -> Any:
    """Draw finite-time exponents over time; see :meth:`hamsym.LyapunovExponents.plot`."""
    unit, count = _rate_unit(found.H), found.exponents.shape[1]
    panels = {
        "convergence": Panel(lambda axes: _draw_convergence(axes, found)),
        "exponents": Panel(lambda axes: _draw_exponents(axes, found)),
    }
    negative = count > 1 and bool((found.exponents[-1] <= 0).any())
    shown = ["convergence", "exponents"] if negative else ["convergence"]
    largest = f"{number(found.maximal, 3)} {unit}".split()
    sentences: list[Any] = [["Largest", "exponent", *largest, *words_of(f"by {found.method}")]]
    if count == found.H.dim and not found.H.forces:
        sums = found.exponents[-1] + found.exponents[-1, ::-1]
        text = ["Exponents", "come", "in", "pairs", r"$\pm\lambda$:", "their", "sums", "are", "at"]
        sentences.append([*text, "most", number(float(np.abs(sums).max()), 2), *unit.split()])
    if len(found.t) > 2 * _PIECES:
        sentences.append(_MEANS)
    caption = caption_words(found.H, *sentences)
    return draw_panels(panels, shown, names, ax, caption, found.facts.warning)


def _thinned(t: np.ndarray, values: np.ndarray, reduce: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return one point for each piece of the logarithm of many times, and the last."""
    if len(t) <= 2 * _PIECES:
        return t, values
    edges = np.geomspace(t[0], t[-1], _PIECES + 1)
    starts = np.unique(np.searchsorted(t, edges[:-1]))
    counts = np.diff(np.append(starts, len(t)))
    shape = (-1,) + (1,) * (values.ndim - 1)
    found = reduce.reduceat(values, starts, axis=0)
    if reduce is np.add:
        found = found / counts.reshape(shape)
    times = np.exp(np.add.reduceat(np.log(t), starts) / counts)
    return np.append(times, t[-1]), np.concatenate((found, values[-1:]))


def _lines_of(found: LyapunovExponents) -> list[tuple[dict[str, Any], str]]:
    count = found.exponents.shape[1]
    last = found.exponents[-1]
    return [
        (style, f"$\\lambda_{{{k + 1}}}$ = {number(float(last[k]), 3)}")
        for k, style in enumerate(line_styles(count))
    ]


def _draw_convergence(axes: Axes, found: LyapunovExponents) -> None:
    """Draw positive exponents and log(t)/t on logarithmic axes."""
    t, exponents = _thinned(np.abs(found.t - found.span[0]), found.exponents, np.add)
    lines = _lines_of(found)
    for k, (style, text) in enumerate(lines):
        values = positive(exponents[:, k])
        if np.isfinite(values).any() and (k == 0 or found.exponents[-1, k] > 0):
            axes.plot(t, values, **style, label=text)
    unit = 1.0 if t[-1] > 30 else t[0]  # times in seconds may all be small
    late = t > max(_FEWEST * t[-1], np.e * unit)
    first = positive(np.abs(exponents[:, 0]))
    late &= np.isfinite(first)
    if late.any():
        fall = np.log(t[late] / unit) / t[late]
        middle = np.exp(np.mean(np.log(first[late] / fall)))
        axes.plot(t[late], middle * fall, "--", color=GREY, linewidth=0.8, label="~ log(t)/t")
    log_scales(axes, "no positive exponent")
    _name_exponents(axes, found, "Convergence")


def _draw_exponents(axes: Axes, found: LyapunovExponents) -> None:
    """Draw all exponents, on an axis that is linear around 0."""
    t, exponents = _thinned(np.abs(found.t - found.span[0]), found.exponents, np.add)
    lines = _lines_of(found)
    for k, (style, text) in enumerate(lines):
        axes.plot(t, exponents[:, k], **style, label=text)
    axes.axhline(0, color=GREY, linewidth=0.6)
    size = float(np.abs(found.exponents[-1]).max())
    axes.set_xscale("log")
    if size > 0:
        axes.set_yscale("symlog", linthresh=2 * size, linscale=2)
        top = float(np.nanmax(np.abs(exponents)))
        axes.set_yticks(_symmetric_ticks(size, top))
        axes.minorticks_off()
        axes.yaxis.set_major_formatter(lambda value, _: number(value, 3))
    _name_exponents(axes, found, f"All {len(lines)} exponents" if len(lines) > 1 else "Exponent")


def _symmetric_ticks(size: float, top: float) -> list[float]:
    """Return ticks at 0, near the exponents, and at powers of ten beyond them."""
    unit = 10.0 ** np.floor(np.log10(size))
    near = unit * max(m for m in (1, 2, 5) if m * unit <= size * 1.0001)
    far = 10.0 ** np.ceil(np.log10(2 * size))
    beyond = [far * 10.0**k for k in range(0, 12, 2) if far * 10.0**k <= top]
    positive_ticks = [float(near), *map(float, beyond)]
    return [-value for value in reversed(positive_ticks)] + [0.0, *positive_ticks]


def _name_exponents(axes: Axes, found: LyapunovExponents, title: str) -> None:
    """Add titles, and a legend, or a colour bar of the numbers of many lines."""
    axes.set_title(title)
    label(axes.yaxis, r"exponent $\lambda$", _rate_unit(found.H))
    _label_elapsed(axes, found.H, found.span[0])
    count = found.exponents.shape[1]
    if count <= MAX_LINES:
        legend(
            axes, fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, ncols=1
        )
        return
    color_bar(axes, Normalize(1, count), "number of the exponent")


# -- indicators ------------------------------------------------------------------------------------


def draw_chaos_indicators(found: ChaosIndicators, *names: Any, ax: Any = None) -> Any:
    """Draw MEGNO, SALI and GALI; see :meth:`hamsym.ChaosIndicators.plot`."""
    orders = {f"GALI {k + 2}": column for k, column in enumerate(found.gali.T)}
    panels = {
        "megno": Panel(lambda axes: _draw_megno(axes, found)),
        "sali": Panel(lambda axes: _draw_indices(axes, found, {"SALI": found.sali}, 1)),
        "gali": Panel(lambda axes: _draw_indices(axes, found, orders, 2)),
    }
    sentences = [f"By {found.method}"]
    if len(found.t) > 2 * _PIECES:
        sentences.append(
            f"Of SALI and GALI, the smallest in {_PIECES} pieces of the logarithm of time"
        )
    if not (found.gali > 0).all():
        sentences.append("Indices below 1e-307 are not drawn")
    caption = caption_words(found.H, *sentences)
    shown = [name for name in panels if name != "gali" or found.gali.shape[1] > 1]
    return draw_panels(panels, shown, names, ax, caption, found.facts.warning)


def _draw_megno(axes: Axes, found: ChaosIndicators) -> None:
    t = np.abs(found.t - found.span[0])
    axes.plot(t, found.megno, color=color_of(5), linewidth=0.7, label="MEGNO")
    axes.plot(t, found.mean_megno, color=color_of(0), label="its mean")
    axes.axhline(2.0, color=GREY, linestyle="--", linewidth=0.8, label="2, regular motion")
    axes.set_title("MEGNO")
    label(axes.yaxis, "MEGNO")
    _label_elapsed(axes, found.H, found.span[0])
    axes.legend(fontsize=6)


def _draw_indices(
    axes: Axes, found: ChaosIndicators, curves: Mapping[str, np.ndarray], color: int
) -> None:
    """Draw alignment indices, each with its name."""
    least = np.inf
    for k, (name, column) in enumerate(curves.items()):
        t, values = _thinned(np.abs(found.t - found.span[0]), column, np.minimum)
        axes.plot(t, positive(values), color=color_of(color + k), label=name)
        least = min(least, values[np.isfinite(values) & (values > 0)].min(initial=np.inf))
    log_scales(axes, "below 1e-307 at all times")
    title = next(iter(curves)).split()[0]
    axes.set_title(title)
    if 0.1 < least < np.inf:  # an axis of one decade has too few ticks
        axes.set_ylim(0.01, 3)
    label(axes.yaxis, title)
    if len(curves) > 1:
        axes.legend(fontsize=6)
    _label_elapsed(axes, found.H, found.span[0])


# -- maps ------------------------------------------------------------------------------------------


#: Label and unit of an axis, and its values.
_Axis = tuple[tuple[str, str], np.ndarray]


def draw_lyapunov_map(found: LyapunovMap, *names: Any, ax: Any = None) -> Any:
    """Draw the largest exponents; see :meth:`hamsym.LyapunovMap.plot`.

    Starts without an exponent are grey.
    """
    columns = dict(zip(found.names, np.moveaxis(found.z0, -1, 0), strict=True)) | found.parameters
    if len(names) > 2:
        raise InputError("exponents are drawn over one quantity, or in a plane of two; give those")
    H, shape = found.H, found.maximal.shape
    if not names and not 1 <= len(shape) <= 2:
        raise InputError(
            f"exponents of shape {shape} are neither a row nor a plane; name one or two of "
            f"{', '.join(columns)}"
        )
    if names:
        own = own_parameters(H, found.parameters, shape)
        chosen = [
            (axis_words(each), np.ravel(each.values(found.z0, found.span[0], own)))
            for each in map(H.observable, names)
        ]
    else:
        chosen = [_grid_line(H, columns, along, shape) for along in reversed(range(len(shape)))]
    failed = int((~found.success).sum())
    sentences: list[Any] = [f"Exponents up to t = {found.span[1]:.6g} by {found.method}"]
    if failed:
        sentences.append(
            f"{failed:,} of {found.success.size:,} starts have no exponent, as they failed or are "
            "outside the energy; they are grey"
        )
    flat = {name: np.ravel(values) for name, values in found.parameters.items()}
    parameters = parameters_of(found.H, flat)[0]
    warning = "Interrupted: starts that were not finished are grey." if found.interrupted else ""
    caption = caption_words(found.H, *sentences, parameters=parameters)
    with one_panel(ax, caption, warning, width=COLUMN + 2, height=8.0) as axes:
        axes.set_title(f"Largest exponent of {found.maximal.size:,} starts")
        if len(chosen) == 1:
            _draw_row(axes, found, *chosen)
        else:
            _draw_plane(axes, found, *chosen, is_grid=not names)
        return figure_of(axes)


def _draw_row(axes: Axes, found: LyapunovMap, along: _Axis) -> None:
    words, x = along
    values = np.ravel(found.maximal)
    axes.plot(x, values, "o", color=color_of(0), markersize=2.5)
    label(axes.xaxis, *words)
    label(axes.yaxis, r"largest exponent $\lambda$", _rate_unit(found.H))
    for place in x[~np.isfinite(values) & np.isfinite(x)]:
        axes.axvline(place, color="0.85", linewidth=2.5, zorder=0)


def _draw_plane(axes: Axes, found: LyapunovMap, across: _Axis, up: _Axis, *, is_grid: bool) -> None:
    image: Any
    (x_words, x), (y_words, y) = across, up
    if is_grid:
        image = axes.pcolormesh(x, y, found.maximal, shading="nearest", rasterized=True)
        axes.grid(visible=False)
        axes.set_facecolor("0.85")
    else:
        values = np.ravel(found.maximal)
        there = np.isfinite(values)
        axes.plot(x[~there], y[~there], ".", color="0.8", markersize=3)
        dense = len(x) > 5_000
        image = axes.scatter(x[there], y[there], c=values[there], s=8, rasterized=dense)
    label(axes.xaxis, *x_words)
    label(axes.yaxis, *y_words)
    bar = figure_of(axes).colorbar(image, ax=axes, pad=0.02)
    label(bar.ax.yaxis, r"largest exponent $\lambda$", _rate_unit(found.H))


def _grid_line(
    H: Hamiltonian, columns: Mapping[str, np.ndarray], along: int, shape: tuple[int, ...]
) -> _Axis:
    """Return the column that varies along one axis of a grid alone, else numbers.

    Values of starts that are nan are interpolated from their neighbours.
    """
    number = np.arange(shape[along])
    for name, values in columns.items():
        rows = np.moveaxis(values, along, 0).reshape(len(number), -1)
        there = np.isfinite(rows).any(axis=1)
        if there.sum() < 2:
            continue
        low, high = np.nanmin(rows[there], axis=1), np.nanmax(rows[there], axis=1)
        if np.all(low == high) and np.all(np.diff(low) > 0):
            line = np.interp(number, number[there], low)
            slope = (low[-1] - low[0]) / (number[there][-1] - number[there][0])
            before, after = np.minimum(number - number[there][0], 0), number - number[there][-1]
            return quantity(H, name), line + slope * (before + np.maximum(after, 0))
    return ("number", ""), number


# -- frequencies -----------------------------------------------------------------------------------


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
