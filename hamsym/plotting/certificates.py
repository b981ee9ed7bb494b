"""Figures of proofs: enclosures over time, and proven bounds."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, legend_above, one_panel
from hamsym.plotting.names import math_name, number, quantity, some_of, words_of
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.style import color_of, positive
from hamsym.plotting.time_axes import (
    component_curves,
    fill_time,
    label_time,
    log_lines,
    name_curves,
)
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.boxes.box_certificate import BoxCertificate
from hamsym.proof.windows.certificate import Certificate
from hamsym.proof.windows.enclose import Enclosure

_TIMES = 401
_MOST_PANELS = 6
_MOST_BARS = 30
_VISIBLE = 5e-3  # of the range of a component: bands that are narrower look like a line


def draw_enclosure(found: Enclosure, *names: Any, ax: Any = None) -> Any:
    """Draw enclosures as bands over time, and their widths; see :meth:`hamsym.Enclosure.plot`."""
    H = found.H
    t = np.linspace(*found.span, _TIMES)
    states = found(t)
    panels = {
        name: Panel(functools.partial(_draw_band, found=found, t=t, states=states, index=k), 5.0)
        for k, name in enumerate(H.names)
    }
    widths = "width" if "width" not in H.names else "widths"
    panels[widths] = Panel(lambda axes: _draw_widths(axes, found, t, states), 5.0)
    shown = [*H.names[:_MOST_PANELS], widths]
    if H.dim > _MOST_PANELS:
        half = _MOST_PANELS // 2
        shown = [*H.names[:half], *H.names[H.dof : H.dof + half], widths]
    contained = (
        f"Bands contain the exact solution at the {_TIMES} times drawn, and at all others, for all "
        "starts and parameters in their balls"
    )
    sentences: list[Any] = [contained]
    for name, ball in found.parameters.items():
        middle, radius = number(float(ball.mid), 8), number(float(ball.radius), 2)
        sentences.append([math_name(name), f"= {middle}", "±", radius])
    if not names:
        sentences += some_of(len(shown) - 1, H.dim, "components", H.names[H.dof - 1])
    extent = np.ptp(states.mid, axis=0)
    if (2 * states.radius.max(axis=0) < _VISIBLE * extent).all():
        sentences.append("Bands are narrower than lines; their widths are drawn too")
    parameters = {k: v for k, v in H.parameters.items() if k not in found.parameters}
    caption = caption_words(H, *sentences, parameters=parameters)
    return draw_panels(panels, shown, names, ax, caption)


def _draw_band(axes: Axes, found: Enclosure, t: np.ndarray, states: Ball, index: int) -> None:
    H = found.H
    color = color_of(0)
    low, high = states.lower[:, index], states.upper[:, index]
    axes.fill_between(t, low, high, color=color, alpha=0.3, linewidth=0, label="proven band")
    axes.plot(t, states.mid[:, index], color=color, linewidth=0.8, label="its middle")
    label(axes.yaxis, *quantity(H, H.names[index]))
    label_time(axes, H)
    fill_time(axes, t)


def _draw_widths(axes: Axes, found: Enclosure, t: np.ndarray, states: Ball) -> None:
    sizes = np.abs(states.mid).max(axis=0)
    widths = 2 * states.radius / np.where(sizes > 0, sizes, 1.0)
    log_lines(axes, t, component_curves(found.H, widths), unknown="")
    name_curves(axes, found.H, "Widths", "width of the band / size")
    legend_above(axes)


# -- bounds ----------------------------------------------------------------------------------------


def draw_certificate(found: Certificate, *names: Any, ax: Any = None) -> Any:
    """Draw proven bounds; see :meth:`hamsym.Certificate.plot`."""
    shown = [math_name(name) for name in found.components]
    text = f"Proven: the largest error |z^(t) − z(t)| is at least {number(found.lower, 3)} "
    text += f"and at most {number(found.bound, 3)}."
    for name, bound in (("Energy error", found.energy_bound), ("Residual", found.ell_max_bound)):
        text += f" {name} {f'at most {number(bound, 3)}' if np.isfinite(bound) else 'not bounded'}."
    words = f"{text} SHA-256 {found.digest[:16]}…".split()
    panels = {
        "bound": Panel(lambda axes: _draw_bound(axes, found), 6.0),
        "components": Panel(lambda axes: _draw_components(axes, found, shown), 6.0),
    }
    return draw_panels(panels, list(panels), names, ax, words)


def _draw_bound(axes: Axes, found: Certificate) -> None:
    """Draw the bound on each piece of the span, and the lower bound on the largest error."""
    edges, bounds = np.array(found.edges), np.array(found.piece_bounds)
    shown = positive(bounds)
    if edges[-1] < edges[0]:
        edges, shown = edges[::-1], shown[::-1]
    axes.stairs(shown, edges, baseline=None, color=color_of(0), label="proven bound on |z^ − z|")
    if found.lower > 0:
        style: dict[str, Any] = {"color": color_of(1), "linestyle": "--", "linewidth": 0.9}
        axes.axhline(found.lower, **style, label="the largest error is above")
    if found.asked is not None:
        style = {"color": color_of(2), "linestyle": ":", "linewidth": 1.1}
        axes.axhline(max(found.asked), **style, label="asked, of each component")
    axes.set_yscale("log")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_title(f"Bound over time, on {len(bounds):,} piece{'s' if len(bounds) > 1 else ''}")
    label(axes.yaxis, "error")
    label(axes.xaxis, "$t$")
    if not np.isfinite(shown).any():
        text = "no error" if (bounds == 0).all() else "infinite"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center")
    axes.legend(fontsize=6)


def _draw_components(axes: Axes, found: Certificate, names: Sequence[str]) -> None:
    """Draw the interval in which the largest error of each component lies."""
    _draw_intervals(axes, names, np.array(found.component_lowers), np.array(found.component_bounds))
    if found.asked is not None:
        x = np.arange(min(len(found.asked), _MOST_BARS))
        style: dict[str, Any] = {
            "color": color_of(2),
            "marker": "_",
            "markersize": 9,
            "linestyle": "none",
        }
        axes.plot(x, positive(np.array(found.asked))[: len(x)], **style, label="asked")
        axes.legend(fontsize=6)
    axes.set_title("Largest error of each component, between bounds")


def _draw_intervals(
    axes: Axes, names: Sequence[str], lower: np.ndarray, upper: np.ndarray
) -> None:  # fmt: skip
    """Draw an interval for each component on a logarithmic axis; of many those with the largest."""
    chosen = np.arange(len(upper))
    if len(upper) > _MOST_BARS:
        chosen = np.sort(np.argsort(-np.nan_to_num(upper, posinf=np.inf))[:_MOST_BARS])
    top = positive(upper[chosen])
    bottom = np.where(lower[chosen] > 0, lower[chosen], np.nan)
    x = np.arange(len(chosen))
    style: dict[str, Any] = {"color": color_of(0), "markersize": 4, "linestyle": "none"}
    axes.plot(x, top, marker="v", **style)
    axes.plot(x, positive(bottom), marker="^", **style)
    axes.vlines(x, np.where(np.isfinite(bottom), bottom, top), top, color=color_of(0), linewidth=1)
    axes.set_yscale("log")
    shown = [names[k] for k in chosen.tolist()]
    upright = len(shown) > 12 or max(map(len, shown)) * len(shown) > 100
    axes.set_xticks(x, shown, rotation=90 if upright else 0)
    axes.set_xlim(-0.6, len(chosen) - 0.4)
    label(axes.yaxis, "error")
    note = ""
    if len(chosen) < len(upper):
        note = f"the {_MOST_BARS} largest of {len(upper)}"
    if not np.isfinite(top).all():
        zeros = int((upper[chosen] == 0).sum())
        note += f"{'; ' if note else ''}{zeros or 'some'} {'zero' if zeros else 'infinite'}"
    if note:
        axes.text(0.99, 0.98, note, transform=axes.transAxes, ha="right", va="top", fontsize=6)


def draw_box_certificate(found: BoxCertificate, *, ax: Any = None) -> Any:
    """Draw the proven bound of each component; see :meth:`hamsym.BoxCertificate.plot`."""
    start, end = (number(t, 6) for t in found.span)
    words = ["Proven", "for"]
    for name, (low, high) in found.box.items():
        words += ["all", math_name(name), "from", number(low, 6), "to", number(high, 6) + ","]
    words += ["for", "all", "times", "from", start, "to", end + "."]
    words += [f"{found.parts:,}", "parts", "of", "the", "box.", *words_of(f"H = {found.formula}.")]
    words += words_of(f"SHA-256 {found.digest[:16]}…")
    upper = np.array(found.bound)
    with one_panel(ax, words, height=6.0) as axes:
        names = [math_name(name) for name in found.components]
        _draw_intervals(axes, names, np.zeros_like(upper), upper)
        axes.set_title("Proven bound on the error of each component")
        return figure_of(axes)
