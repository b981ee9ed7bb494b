"""Figures of Poincare sections."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize

from hamsym.dynamics.sections import Section
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, one_panel
from hamsym.plotting.names import known_name, math_name, quantity
from hamsym.plotting.style import COLORS, COLUMN, MAX_LINES, SEQUENTIAL, style_for
from hamsym.surface import parse_surface

__all__ = ["draw_section"]

_ASIDE = 1e-6  # of the time scale of the motion: distance along the flow to see the direction


def draw_section(section: Section, *names: Any, ax: Any = None) -> Any:
    """Draw crossings of a surface; see :meth:`hamsym.Section.plot`."""
    if len(names) not in (0, 2):
        raise InputError(
            f"a section is drawn in the plane of two components, not of {len(names)}; give two of "
            f"{', '.join(section.names)}, or none"
        )
    x, y = (known_name(name, section.names, "a component of z") for name in names or section.axes)
    H = section.H
    numbers = np.unique(section.trajectory)
    rising, direction = _directions(section)
    sentences = [direction, section.message]
    if len(numbers) > MAX_LINES:
        sentences.insert(0, f"{len(numbers):,} trajectories, coloured by their number")
    if H is None:
        words = [word for text in sentences if text for word in f"{text}.".split()]
    else:
        words = caption_words(H, *sentences)
    warning = "" if section.success else f"Failed: {section.message}"
    with one_panel(ax, words, warning, width=COLUMN + 3, height=9.0) as axes, style_for(ax):
        i, j = section.names.index(x), section.names.index(y)
        norm = Normalize(0, max(int(numbers.max(initial=0)), 1))
        colors = matplotlib.colormaps[SEQUENTIAL](np.linspace(0, 0.92, 256))
        shades = ListedColormap(colors)
        size = 4.0 if len(section.t) < 500 else 2.6 if len(section.t) < 5_000 else 1.6
        if len(numbers) > MAX_LINES:
            for where, marker in ((rising, "."), (~rising, "+")):
                axes.scatter(
                    section.z[where, i],
                    section.z[where, j],
                    s=size**2,
                    c=shades(norm(section.trajectory[where])),
                    marker=marker,
                    linewidths=0.4 if marker == "+" else 0,
                    rasterized=len(section.t) > 5_000,
                )
            bar = figure_of(axes).colorbar(ScalarMappable(norm, shades), ax=axes, pad=0.02)
            label(bar.ax.yaxis, "number of the trajectory")
        else:
            _draw_named(axes, section, i, j, numbers, rising, size)
        for axis, name in ((axes.xaxis, x), (axes.yaxis, y)):
            label(axis, *(quantity(H, name) if H is not None else (math_name(name), "")))
        if not len(section.t):
            axes.set(xticks=[], yticks=[])
            axes.text(0.5, 0.5, "no crossings", transform=axes.transAxes, ha="center")
        axes.set_title(f"Section {_surface_text(section)}")
        return figure_of(axes)


def _draw_named(
    axes: Any,
    section: Section,
    i: int,
    j: int,
    numbers: np.ndarray,
    rising: np.ndarray,
    size: float,
) -> None:
    """Draw the crossings of few trajectories, each with an entry in a legend."""
    colors: list[Any] = list(COLORS)
    if len(numbers) > len(COLORS):
        colors = list(matplotlib.colormaps[SEQUENTIAL](np.linspace(0, 0.92, len(numbers))))
    for number, color in zip(numbers.tolist(), colors, strict=False):
        own = section.trajectory == number
        for where, marker in ((own & rising, "."), (own & ~rising, "+")):
            axes.plot(
                section.z[where, i],
                section.z[where, j],
                linestyle="none",
                marker=marker,
                markersize=size,
                markeredgewidth=0.4 if marker == "+" else 0,
                color=color,
                label=f"{number}" if marker == "." or not (own & rising).any() else "",
                rasterized=len(section.t) > 5_000,
            )
    if len(numbers) > 1:
        beside: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)}
        axes.legend(title="trajectory", title_fontsize=7, markerscale=6 / size, **beside)


def _directions(section: Section) -> tuple[np.ndarray, str]:
    """Return at which crossings the function of the surface rises, and the sentence about them."""
    rising = np.ones(len(section.t), dtype=bool)
    if section.H is None or not len(section.t):
        return rising, ""
    H: Hamiltonian = section.H
    value = parse_surface(H, section.surface).value
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        rates = np.asarray(system.vector_field(*system.arguments(section.z, section.t)))
        sizes = np.abs(section.z).max(axis=0) / np.abs(rates).max(axis=0)
        step = _ASIDE * float(np.nanmin(np.where(sizes > 0, sizes, np.nan), initial=1.0))
        change = value(section.z + step * rates, section.t) - value(
            section.z - step * rates, section.t
        )
    rising = np.asarray(change) >= 0
    left = section.surface.split(",")[0].strip()
    if rising.all() or not rising.any():
        return np.ones_like(rising), f"{left} is crossed {'up' if rising.all() else 'down'}wards"
    return rising, f"Dots: {left} is crossed upwards; crosses: downwards"


def _surface_text(section: Section) -> str:
    """Return the surface, shortened if it is long."""
    text = section.surface.replace("$", r"\$")
    return text if len(text) <= 40 else f"{text[:39]}…"
