"""Figures of Poincare sections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sympy
from contourpy import contour_generator
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize

from hamsym.codegen.observable import Observable
from hamsym.dynamics.sections import Section
from hamsym.errors import InputError
from hamsym.plotting.captions import axis_words, caption_words, formula_of
from hamsym.plotting.figure import color_bar, figure_of, label, one_panel
from hamsym.plotting.motions import parameters_of, varying
from hamsym.plotting.names import distinct_numbers, escaped, math_name, number, with_unit
from hamsym.plotting.style import COLORS, COLUMN, GREY, MAX_LINES, shades
from hamsym.problems.surface import parse_surface

_WIDER, _GRID = (0.6, 2.0, 6.0), 301  # shares of the plane added on each side, to find a boundary
_ONE_ENERGY = 1e-8  # relative difference of energies that are the same
_BOUNDARY = "Grey: boundary of the states of this energy."
_VARIED = 2  # quantities of a start in the legend
_ROUND_OFF = 1e-12  # of a range: a smaller value is zero
_ASIDE = 1e-6  # of the time scale of the motion: distance along the flow to see the direction


def draw_section(section: Section, *names: Any, ax: Any = None) -> Any:
    """Draw crossings of a surface; see :meth:`hamsym.Section.plot`."""
    if len(names) not in (0, 2):
        raise InputError(
            f"a section is drawn in the plane of two components, not of {len(names)}; give two of "
            f"{', '.join(section.names)}, or none"
        )
    H, own = section.H, section.own_parameters
    drawn = [H.observable(name) for name in names or section.axes]
    x, y = (each.values(section.z, section.t, own) for each in drawn)
    numbers = np.unique(section.trajectory)
    rising, direction = _directions(section)
    warning = section.facts.warning
    sentences: list[Any] = [direction, "" if warning else section.message]
    if len(numbers) > MAX_LINES:
        sentences.insert(0, f"{len(numbers):,} trajectories")
    shared, ranges = parameters_of(H, section.parameters)
    sentences += [words for each in drawn if (words := formula_of(each))]
    words = caption_words(H, *([ranges] if ranges else []), *sentences, parameters=shared)
    varied, unit, values = varying(H, section.z0, section.parameters)
    with one_panel(ax, words, warning, width=COLUMN + 3, height=9.0) as axes:
        norm = Normalize(float(values.min()), float(values.max()))
        size = 4.0 if len(section.t) < 500 else 2.6 if len(section.t) < 5_000 else 1.6
        if len(numbers) > MAX_LINES:
            for where, marker in ((rising, "."), (~rising, "+")):
                axes.scatter(
                    x[where],
                    y[where],
                    s=size**2,
                    c=ListedColormap(shades(256))(norm(values[section.trajectory[where]])),
                    marker=marker,
                    linewidths=0.4 if marker == "+" else 0,
                    rasterized=len(section.t) > 5_000,
                )
            text = "number of the trajectory" if varied == "number" else varied
            color_bar(axes, norm, text, unit)
        else:
            if varied == "number":
                entries, title = _starts(section), "trajectory: start"
            else:
                entries = distinct_numbers(values.tolist())
                title = with_unit(varied, unit)
            _draw_named(axes, section, (x, y), [entries[k] for k in numbers], rising, size)
            if len(numbers) > 1:
                beside: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5)}
                axes.legend(title=title, title_fontsize=7, markerscale=6 / size, **beside)
        for axis, each in zip((axes.xaxis, axes.yaxis), drawn, strict=True):
            label(axis, *axis_words(each))
        if not len(section.t):
            axes.set(xticks=[], yticks=[])
            axes.text(0.5, 0.5, "no crossings", transform=axes.transAxes, ha="center")
        if (level := _allowed(section, drawn)) is not None:
            _draw_boundary(axes, *level)
            if ax is None:
                figure_of(axes).set_caption([*words, *_BOUNDARY.split()], warning)
        surface = escaped(section.surface)
        axes.set_title(f"Section {surface if len(surface) <= 40 else f'{surface[:39]}…'}")
        return figure_of(axes)


def _allowed(
    section: Section, drawn: Sequence[Observable]
) -> tuple[Callable[[np.ndarray, np.ndarray], np.ndarray], float] | None:
    """Return the function of the two axes that is the energy at the boundary of the section.

    This is H at the value of the fourth component at which H is stationary, so that the surface of
    constant energy folds there; known where H is quadratic in it. None unless H has two degrees of
    freedom and all trajectories have one energy.
    """
    H, own = section.H, parse_surface(section.H, section.surface).components
    places = {each.place for each in drawn} | {*own}
    if H.dof != 2 or not H.conserves_energy or section.parameters or len(own) != 1:
        return None
    if len(places) != 3 or None in places or not len(section.t):
        return None
    [fourth] = {*range(H.dim)} - places
    symbol, crossed = H.z[fourth], section.z[:, own[0]]
    if sympy.diff(H.expr, symbol, 3) != 0 or not np.ptp(crossed) <= _ROUND_OFF**0.5:
        return None
    system = H.compile("numpy")
    energies = np.asarray(system.energy(section.z0))
    if not np.ptp(energies) <= _ONE_ENERGY * np.abs(energies).max():
        return None

    def energy(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        z = np.zeros((*x.shape, H.dim))
        z[..., own[0]] = crossed[0]
        for each, values in zip(drawn, (x, y), strict=True):
            z[..., each.place] = values
        with np.errstate(all="ignore"):
            slope = np.asarray(system.gradient(z))[..., fourth]
            curvature = np.asarray(system.hessian(z))[..., fourth, fourth]
            found: np.ndarray = np.asarray(system.energy(z)) - slope**2 / (2 * curvature)
        return np.where(np.isfinite(found), found, np.nan)

    return energy, float(energies.mean())


def _draw_boundary(
    axes: Axes, energy: Callable[[np.ndarray, np.ndarray], np.ndarray], level: float
) -> None:
    """Draw the curve around the points where a function of both axes has a value."""
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    for share in _WIDER:
        wider = limits + share * np.ptp(limits, axis=1)[:, None] * np.array([-1, 1])
        sides = [np.linspace(first, last, _GRID) for first, last in wider.tolist()]
        lines = contour_generator(*sides, energy(*np.meshgrid(*sides))).lines(level)
        around = [
            line
            for line in map(np.asarray, lines)
            if (line.max(axis=0) > limits[:, 0]).all() and (line.min(axis=0) < limits[:, 1]).all()
        ]
        if any((line[0] == line[-1]).all() for line in around):
            break
    if not around:
        return
    for line in around:
        axes.plot(*line.T, color=GREY, linewidth=0.8, zorder=1)
    points = np.concatenate(around)
    pad = 0.02 * np.ptp(points, axis=0)
    low = np.minimum(points.min(axis=0) - pad, limits[:, 0])
    high = np.maximum(points.max(axis=0) + pad, limits[:, 1])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _draw_named(
    axes: Any,
    section: Section,
    columns: tuple[np.ndarray, np.ndarray],
    entries: list[str],
    rising: np.ndarray,
    size: float,
) -> None:
    """Draw the crossings of few trajectories, each with its entry of a legend."""
    numbers = np.unique(section.trajectory)
    colors: list[Any] = list(COLORS)
    if len(numbers) > len(COLORS):
        colors = list(shades(len(numbers)))
    for place, text, color in zip(numbers.tolist(), entries, colors, strict=False):
        own = section.trajectory == place
        for where, marker in ((own & rising, "."), (own & ~rising, "+")):
            axes.plot(
                *(column[where] for column in columns),
                linestyle="none",
                marker=marker,
                markersize=size,
                markeredgewidth=0.4 if marker == "+" else 0,
                color=color,
                label=text if marker == "." or not (own & rising).any() else "",
                rasterized=len(section.t) > 5_000,
            )


def _starts(section: Section) -> list[str]:
    """Return a text for each trajectory: its number, and what varies among the starts."""
    columns = {**section.parameters, **dict(zip(section.names, section.z0.T, strict=True))}
    varied = []
    for name, own in columns.items():
        extent = np.ptp(own)
        if extent > 0:
            rounded = np.where(np.abs(own) < _ROUND_OFF * extent, 0.0, own)
            varied.append((math_name(name), rounded))
    texts = []
    for place in range(len(section.z0)):
        values = [f"{name} = {number(float(own[place]), 4)}" for name, own in varied[:_VARIED]]
        more = ", …" if len(varied) > _VARIED else ""
        texts.append(f"{place}: {', '.join(values)}{more}" if values else f"{place}")
    return texts


def _directions(section: Section) -> tuple[np.ndarray, str]:
    """Return at which crossings the function of the surface rises, and the sentence about them."""
    rising = np.ones(len(section.t), dtype=bool)
    if not len(section.t):
        return rising, ""
    H = section.H
    value = parse_surface(H, section.surface).value
    rows = section.own_parameters
    rates = H.compile("numpy").at("vector_field", section.z, section.t, rows)
    with np.errstate(all="ignore"):
        sizes = np.abs(section.z).max(axis=0) / np.abs(rates).max(axis=0)
        step = _ASIDE * float(np.nanmin(np.where(sizes > 0, sizes, np.nan), initial=1.0))
        ahead, behind = section.z + step * rates, section.z - step * rates
        change = value(ahead, section.t, rows) - value(behind, section.t, rows)
    rising = np.asarray(change) >= 0
    left = section.surface.split(",")[0].strip()
    if rising.all() or not rising.any():
        return np.ones_like(rising), f"{left} is crossed {'up' if rising.all() else 'down'}wards"
    return rising, f"Dots: {left} is crossed upwards; crosses: downwards"
