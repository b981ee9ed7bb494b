"""Panels of eigenvalues in the complex plane: multipliers and exponents."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator

from hamsym.plotting.figure import Figure, figure_of, label
from hamsym.plotting.style import GREY, color_of

_FAR = 2.5  # from 0: beyond, all multipliers are drawn in an inset
_BESIDE_CIRCLE = 1.15  # from 0: largest drawn beside the inset


def draw_multipliers(axes: Axes, values: np.ndarray, title: str) -> None:
    """Draw multipliers about the unit circle; where some are far from it, all in an inset.

    The inset shows sizes on a logarithmic axis against angles, where a pair m, 1/m is a mirror
    image.
    """
    values = np.asarray(values, dtype=complex)
    finite = values[np.isfinite(values)]
    far = bool((np.abs(finite) > _FAR).any())
    near = finite[np.abs(finite) <= (_BESIDE_CIRCLE if far else _FAR)]
    angle = np.linspace(0, 2 * np.pi, 400)
    style: dict[str, Any] = {"color": color_of(1), "linestyle": "none", "marker": "x"}
    axes.plot(np.cos(angle), np.sin(angle), color=GREY, linewidth=0.8, label="unit circle")
    axes.plot(near.real, near.imag, **style, markersize=7, label="multipliers")
    side = 1.15 * max(1.0, float(np.abs(near).max(initial=0.0)))
    axes.set(xlim=(-side, side), ylim=(-side, side))
    axes.set_aspect("equal", adjustable="box")
    if far:
        axes.set_xlim(-side, 2.4 * side)
        inset = axes.inset_axes((0.74, 0.26, 0.24, 0.62))
        inset.plot(np.angle(finite, deg=True), np.abs(finite), **style, markersize=5)
        inset.axhline(1, color=GREY, linewidth=0.8)
        inset.set(yscale="log", xlim=(-200, 200), xticks=(-180, 0, 180))
        inset.set_title("all, by size", fontsize=7)
        inset.set_xlabel("angle [°]", fontsize=7)
        inset.yaxis.set_major_locator(LogLocator(numticks=6))
        inset.yaxis.set_minor_locator(NullLocator())
        inset.tick_params(labelsize=6)
    if finite.size < values.size:
        note = f"{values.size - finite.size} of {values.size} are not finite"
        axes.text(0.02, 0.02, note, transform=axes.transAxes, fontsize=6)
    axes.set_title(title)
    label(axes.xaxis, "Re")
    label(axes.yaxis, "Im")
    if far:
        axes.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1))


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
