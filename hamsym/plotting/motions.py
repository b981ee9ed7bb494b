"""Panels of motions: components over time, paths in planes and in space, of one or many."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.ticker import NullFormatter, NullLocator

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import axis_words, caption_words, formula_of
from hamsym.plotting.figure import Figure, figure_of, label, legend, legend_above, one_panel
from hamsym.plotting.names import math_name, number, quantity, shortened, time_name, with_unit
from hamsym.plotting.phase_portraits import draw_levels
from hamsym.plotting.style import (
    COLUMN,
    MAX_LINES,
    PAGE,
    SEQUENTIAL,
    line_style,
    line_styles,
    style_for,
)
from hamsym.plotting.time_axes import envelope, fill_time, label_time
from hamsym.support.suggestions import similar, unknown

#: Most trajectories of an ensemble that are drawn: more cover each other.
MAX_DRAWN = 200
# Most degrees of freedom in an overview, one in each row of a page.
_MAX_DOF = 6
# Points from which lines are drawn as pixels in files of vector graphics, which would be slow.
_DENSE = 8_000
# Points of a path: a figure has fewer pixels along it.
_MAX_POINTS = 40_000
# Centimetres of a row, by the number of rows, and of other rows, so that a page has all.
_ROW = {1: 3.0, 2: 2.5, 3: 2.2, 4: 2.0}
_PLANE, _BESIDE_PORTRAIT, _LOWER = 5.8, 3.2, 3.0
#: A legend on the right of its axes.
_BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5), "ncols": 1}
_DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2}
_CARTESIAN = re.compile(r"([xyzXYZ])_?([0-9]*|[A-Za-z]?)\Z")


@dataclass(frozen=True)
class Motion:
    """One trajectory, or those of an ensemble that are drawn."""

    H: Hamiltonian
    #: Times, shape (n,).
    t: np.ndarray
    #: States, shape (members, n, dim).
    z: np.ndarray
    #: Trajectories of the result; ``z`` has these or a choice.
    total: int = 1
    #: Of the caption, as text or words.
    sentences: Sequence[Any] = ()
    #: In red, "" for none.
    warning: str = ""
    #: What the motions are, in the plural.
    what: str = "trajectories"
    #: Label, unit and value of each trajectory by which it is named or coloured.
    varied: tuple[str, str, np.ndarray] = ("", "", np.zeros(1))
    #: Values for the caption, by default those of H.
    parameters: dict[str, float] | None = None
    #: Sentence about states that are too far apart for lines between them, and drawn as dots.
    apart: str = ""
    #: Formulas whose values follow the components in ``z``.
    formulas: Sequence[Observable] = ()

    def column(self, drawn: Observable) -> np.ndarray:
        """Return the values of a component or one of the formulas, shape (members, n)."""
        place = drawn.place
        return self.z[..., self.H.dim + self.formulas.index(drawn) if place is None else place]

    def component(self, place: int) -> Observable:
        """Return a component of H."""
        return self.H.observable(self.H.names[place])

    @cached_property
    def styles(self) -> list[dict[str, Any]]:
        """Style of each trajectory, with the colours of a colour bar where they are many."""
        if not self.mapped:
            return line_styles(len(self.z))
        colors = matplotlib.colormaps[SEQUENTIAL](0.92 * self._norm(self.varied[2]))
        return [{"color": tuple(color), "linewidth": 0.6} for color in colors]

    @property
    def path_styles(self) -> list[dict[str, Any]]:
        """Styles of components and paths, which are dots where the states are far apart."""
        if not self.apart:
            return self.styles
        return [{"color": style["color"], **_DOTS} for style in self.styles]

    @property
    def _norm(self) -> Normalize:
        return Normalize(float(self.varied[2].min()), float(self.varied[2].max()))

    @property
    def mapped(self) -> bool:
        """Whether the colour of a trajectory is that of a colour bar, not of a legend."""
        return len(self.z) > MAX_LINES

    def labels(self) -> list[str]:
        """Return the legend entry of each trajectory; "" for one alone, or with a colour bar."""
        if self.total == 1 or self.mapped:
            return [""] * len(self.z)
        return [number(value, 4) for value in self.varied[2].tolist()]

    def legend(self, axes: Axes, **options: Any) -> None:
        """Add a legend of several trajectories, whose title is what varies."""
        if any(self.labels()):
            legend(axes, title=with_unit(*self.varied[:2]), title_fontsize=7, **options)

    def color_bar(self, axes: Any) -> None:
        """Add the colour bar of many trajectories beside axes."""
        if self.mapped:
            colors = matplotlib.colormaps[SEQUENTIAL](np.linspace(0, 0.92, 256))
            cmap = matplotlib.colors.ListedColormap(colors)
            bar = figure_of(np.ravel(axes)[0]).colorbar(
                ScalarMappable(self._norm, cmap), ax=axes, pad=0.02, fraction=0.04, aspect=40
            )
            label(bar.ax.yaxis, *self.varied[:2])

    def caption(self, *sentences: Any) -> list[str]:
        """Return the caption with further sentences."""
        chosen = []
        if len(self.z) < self.total:
            chosen = [f"{len(self.z)} of {self.total:,} {self.what} are drawn, evenly chosen"]
        elif self.total > 1:
            chosen = [f"{self.total:,} {self.what}"]
        if self.apart:
            chosen.append(self.apart)
        return caption_words(
            self.H, *self.sentences, *chosen, *sentences, parameters=self.parameters
        )


def chosen_members(total: int) -> np.ndarray:
    """Return the numbers of the trajectories of an ensemble that are drawn."""
    if total <= MAX_DRAWN:
        return np.arange(total)
    return np.unique(np.linspace(0, total - 1, MAX_DRAWN).round().astype(int))


def varying(
    H: Hamiltonian, z0: np.ndarray, parameters: Mapping[str, np.ndarray]
) -> tuple[str, str, np.ndarray]:
    """Return the label, unit and values of the one quantity that varies, else the numbers.

    ``z0`` has the shape (members, dim), the values of the parameters (members,).
    """
    columns = {**parameters, **dict(zip(H.names, z0.T, strict=True))}
    found = [
        (name, values)
        for name, values in columns.items()
        if np.isfinite(values).all() and np.ptp(values) > 0
    ]
    if len(found) == 1 and len(np.unique(found[0][1])) == len(z0):
        name, values = found[0]
        text, unit = quantity(H, name)
        return text if name in parameters else f"{text} at start", unit, values
    return "number", "", np.arange(len(z0), dtype=float)


def parameters_of(
    H: Hamiltonian, varied: Mapping[str, np.ndarray]
) -> tuple[dict[str, float] | None, list[str]]:
    """Return the parameters that all members share, None if they are those of H, and the ranges.

    The ranges of the others are the words of a sentence.
    """
    words: list[str] = []
    same = dict(H.parameters)
    for name, values in varied.items():
        if np.ptp(values) > 0:
            del same[name]
            low, high = number(values.min(), 4), number(values.max(), 4)
            words += [math_name(name), "from", low, "to", f"{high},"]
    if not words:
        return None, []
    return same, [*words[:-1], words[-1].removesuffix(",")]


# -- panels ----------------------------------------------------------------------------------------


def over_time(axes: Axes, motion: Motion, drawn: Observable, *, timed: bool = True) -> None:
    """Draw a component or a formula over time."""
    column = motion.column(drawn)
    dense = motion.z[..., 0].size > 5 * _DENSE
    for place, text in enumerate(motion.labels()):
        t, values = envelope(motion.t, column[place])
        # An envelope is a band, also where lines between the samples would be chords.
        style = (motion.path_styles if len(t) == len(motion.t) else motion.styles)[place]
        axes.plot(t, values, **style, label=text, rasterized=dense)
    if motion.warning or drawn.place is None:
        _fold_escape(axes, "y", motion.t, column)
    label(axes.yaxis, *axis_words(drawn))
    fill_time(axes, motion.t)
    label_time(axes, motion.H)
    if not timed:
        axes.set_xlabel("")
        axes.xaxis.set_major_formatter(NullFormatter())


def _fold_escape(axes: Axes, side: str, t: np.ndarray, column: np.ndarray) -> None:
    """Make an axis, "x" or "y", logarithmic away from zero where values escape."""
    even = np.linspace(t[0], t[-1], 200)
    forward = slice(None, None, 1 if t[-1] > t[0] else -1)
    sizes = [np.interp(even, t[forward], np.abs(values[forward])) for values in column]
    usual, largest = float(np.nanmedian(sizes)), float(np.nanmax(np.abs(column)))
    poles = not np.isfinite(column).all()
    if usual > 0 and np.isfinite(largest) and largest > (1e2 if poles else 1e4) * usual:
        stretch = np.log10(largest / usual) / 4
        getattr(axes, f"set_{side}scale")("symlog", linthresh=usual, linscale=stretch)
        powers = np.unique(np.linspace(np.log10(usual), np.log10(largest), 4).round())[1:]
        both = np.nanmin(column) < -usual
        ticks = [0.0, *10.0**powers, *(-(10.0**powers) if both else ())]
        getattr(axes, f"set_{side}ticks")(ticks)
        getattr(axes, f"{side}axis").set_minor_locator(NullLocator())


def plane_title(H: Hamiltonian, x: str, y: str) -> str:
    """Return what the plane of two components is."""
    places, d = [H.names.index(name) for name in (x, y)], H.dof
    if abs(places[0] - places[1]) == d:
        return "Phase portrait" if d == 1 else f"Phase plane of {math_name(H.names[min(places)])}"
    if max(places) < d:
        bodies = [_CARTESIAN.match(name) for name in (x, y)]
        if all(bodies) and bodies[0][2] == bodies[1][2] and x != y:  # type: ignore[index]
            return "Orbit"
        return "Coordinates"
    return "Momenta" if min(places) >= d else "Coordinate and momentum"


def same_scale(H: Hamiltonian, x: str, y: str) -> bool:
    """Whether two components are lengths along axes of one space, or of one kind else.

    Examples
    --------
    >>> H = Hamiltonian("p_r**2/2 + p_theta**2/(2*r**2) - 1/r")
    >>> same_scale(H, "r", "theta")
    False
    """
    places, d = [H.names.index(name) for name in (x, y)], H.dof
    if (places[0] < d) != (places[1] < d):
        return False
    if H.units.get(x, "1") != H.units.get(y, "1"):
        return False
    owners = [H.names[place % d] for place in places]
    if all(_CARTESIAN.match(name) for name in owners):
        return True
    stems = {re.sub(r"_?[0-9]+\Z", "", name) for name in owners}
    return len(stems) == 1 and owners != [re.sub(r"_?[0-9]+\Z", "", name) for name in owners]


def in_plane(
    axes: Axes, motion: Motion, x: Observable, y: Observable, *, levels: bool = True
) -> list[Any]:
    """Draw paths in the plane of two components or formulas; return sentences for the caption."""
    H = motion.H
    notes: list[Any] = []
    columns = motion.column(x), motion.column(y)
    _paths(axes, motion, columns, motion.labels())
    for side, each, column in zip("xy", (x, y), columns, strict=True):
        if each.place is None:
            _fold_escape(axes, side, motion.t, column)
    label(axes.xaxis, *axis_words(x))
    label(axes.yaxis, *axis_words(y))
    if x.place is None or y.place is None:
        return notes
    if same_scale(H, x.text, y.text):
        notes += _equal_aspect(axes, *columns)
    if H.dof == 1 and x.place != y.place and levels:
        axes.margins(0.15)
        if not H.time and motion.parameters is None:
            start = float(H.compile("numpy").energy(motion.z[0, 0])) if motion.total == 1 else None
            notes += draw_levels(axes, H, x.text, y.text, start)
        else:
            why = "H depends on time" if H.time else "H differs between the trajectories"
            notes.append(f"Level sets of H are not drawn: {why}")
    return notes


def _paths(
    axes: Axes,
    motion: Motion,
    columns: tuple[np.ndarray, np.ndarray],
    labels: Sequence[str],
    **own: Any,
) -> None:
    count = motion.z.shape[1] * len(motion.z)
    every = max(1, round(motion.z.shape[1] / _MAX_POINTS))
    for x, y, style, text in zip(*columns, motion.path_styles, labels, strict=True):
        style = {**style, **own, **(_DOTS if motion.apart else {})}
        color = style["color"]
        if every > 1:  # lines between distant points would be chords
            style = {"color": color, "linestyle": "none", "marker": ".", "markersize": 0.8}
        dense = count > _DENSE
        axes.plot(x[::every], y[::every], **style, label=text, rasterized=dense)
        if len(motion.z) <= MAX_LINES:
            axes.plot(x[0], y[0], "o", color=color, markersize=3.5, zorder=3)


def _equal_aspect(axes: Axes, x: np.ndarray, y: np.ndarray) -> list[str]:
    """Give two axes one scale, unless one would be lost."""
    with np.errstate(invalid="ignore"):
        ranges = [np.nanmax(values) - np.nanmin(values) for values in (x, y)]
    if not max(ranges) <= 8 * min(ranges):
        return ["The axes of the plane have different scales"]
    axes.set_aspect("equal", adjustable="datalim")
    return []


def in_space(axes: Any, motion: Motion, drawn: Sequence[Observable]) -> list[str]:
    """Draw paths in the space of three components or formulas."""
    H, count = motion.H, motion.z.shape[1]
    columns, powers = [], []
    for each in drawn:
        column = motion.column(each)
        size = np.nanmax(np.abs(column), initial=0.0)
        power = int(np.floor(np.log10(size))) if np.isfinite(size) and size > 0 else 0
        powers.append(power if not -3 <= power < 4 else 0)
        columns.append(column / 10.0 ** powers[-1])
    every = max(1, count // 20_000)
    for k, (style, text) in enumerate(zip(motion.path_styles, motion.labels(), strict=True)):
        axes.plot(*(column[k, ::every] for column in columns), **style, label=text)
    for axis, each, power in zip("xyz", drawn, powers, strict=True):
        text, unit = axis_words(each)
        unit = " ".join(filter(None, (f"$10^{{{power}}}$" if power else "", unit)))
        getattr(axes, f"set_{axis}label")(f"{text} [{unit}]" if unit else text)
        axes.tick_params(axis, pad=0)
        getattr(axes, f"{axis}axis").get_major_locator().set_params(nbins=4)
    axes.set_box_aspect(None, zoom=0.9)
    notes = [] if every == 1 else [f"Every {every}th time is drawn"]
    names = [each.text for each in drawn if each.place is not None]
    if len(names) == len(drawn) and all(same_scale(H, names[0], name) for name in names):
        spans = [np.nanmax(column) - np.nanmin(column) for column in columns]
        if len(set(powers)) == 1 and max(spans) <= 8 * min(spans):
            axes.set_aspect("equal")
            axes.set_box_aspect(spans, zoom=0.95)
    return notes


# -- figures ---------------------------------------------------------------------------------------


def drawn_of(
    H: Hamiltonian, names: Sequence[Any], words: Sequence[str] = ()
) -> tuple[str, list[Observable]]:
    """Return the word that is drawn alone, or else the components and formulas.

    - words: Names of panels, such as "error", unless H has a component of the name.

    Raise InputError if a name is neither a component nor a formula, or there are more than three.
    """
    alone = [name for name in names if name in words and name not in H.names]
    if alone:
        if len(names) > 1:
            raise InputError(f"'{alone[0]}' is drawn alone; give no other name with it")
        return str(alone[0]), []
    if len(names) == 2 and str(names[0]) == time_name(H):
        names = names[1:]
    if len(names) > 3:
        raise InputError(
            f"{len(names)} components cannot be drawn in one panel; give one, to draw it over "
            "time, two, for their plane, or three, for their space"
        )
    for name in names:
        own = (*H.names, *H.parameter_names)
        word = isinstance(name, str) and name.isidentifier()
        meant = similar(name, (*own, *words)) if word else None
        if meant in words and meant not in own and not similar(name, own):
            raise InputError(unknown(name, (*own, *words), "a component"))
    return "", [H.observable(name) for name in names]


def formulas_of(drawn: Sequence[Observable]) -> list[Observable]:
    """Return those that are no components, which are sampled beside the states."""
    return [each for each in drawn if each.place is None]


def draw_motion(motion: Motion, drawn: Sequence[Observable], ax: Any) -> Any:
    """Draw a component or formula over time, two in their plane or three in their space.

    Raise InputError if a formula has no value at any time.
    """
    missing = _missing(motion)
    if len(drawn) == 3:
        return _draw_space(motion, drawn, missing, ax)
    wider = 1.0 if motion.mapped else 1.8 if any(motion.labels()) else 0.0
    size = {"height": 6.0 if len(drawn) == 1 else 7.5, "width": COLUMN + wider}
    with one_panel(ax, motion.caption(), motion.warning, **size) as axes, style_for(ax):
        notes: list[Any] = missing
        if len(drawn) == 1:
            over_time(axes, motion, drawn[0])
        else:
            notes = missing + in_plane(axes, motion, *drawn)
            if ax is None and not motion.formulas:
                axes.set_title(plane_title(motion.H, drawn[0].text, drawn[1].text))
        motion.legend(axes, **_BESIDE if ax is None else {})
        motion.color_bar(axes)
        figure = figure_of(axes)
        if ax is None and notes:
            figure.set_caption(motion.caption(*notes), motion.warning)
        return figure


def _missing(motion: Motion) -> list[Any]:
    """Return sentences about formulas that are long, or have no value at some times."""
    notes: list[Any] = [words for each in motion.formulas if (words := formula_of(each))]
    for each in motion.formulas:
        lost = ~np.isfinite(motion.column(each)) & np.isfinite(motion.z[..., : motion.H.dim]).all(
            -1
        )
        if lost.all():
            raise InputError(
                f"'{shortened(each.text)}' is no finite real number at any time drawn; give a "
                "formula that has values along the motion"
            )
        if lost.any():
            notes.append(
                f"{shortened(each.text)} is no finite real number at {lost.sum():,} of "
                f"{lost.size:,} states drawn, where lines have gaps"
            )
    return notes


def _draw_space(
    motion: Motion, drawn: Sequence[Observable], missing: Sequence[Any], ax: Any
) -> Any:
    if ax is not None and getattr(ax, "name", "") != "3d":
        raise InputError(
            "three components need axes of three dimensions; give ax = "
            'figure.add_subplot(projection="3d")'
        )
    with style_for(ax):
        if ax is None:
            figure = Figure.of_size(COLUMN + 1, 7.5, motion.caption(), motion.warning)
            ax = figure.add_subplot(projection="3d")
        notes = in_space(ax, motion, drawn)
        motion.legend(ax, loc="upper left")
        figure = figure_of(ax)
        if isinstance(figure, Figure):
            motion.color_bar(ax)
            figure.set_caption(motion.caption(*missing, *notes), motion.warning)
        return figure


class MotionPanels:
    """The upper part of an overview: components over time, planes; then free panels below.

    - lower: Number of panels below; of one degree of freedom the first two stand beside the phase
      portrait.
    """

    def __init__(self, motion: Motion, lower: int) -> None:
        H, self.motion = motion.H, motion
        shown = min(H.dof, _MAX_DOF)
        row = max(_ROW.get(shown, 1.75), 2.5 if H.units else 0.0)  # units make labels long
        beside = 2 if H.dof == 1 else 0
        below = -(-(lower - beside) // 2) if lower > beside else 0
        named = any(motion.labels())
        keys = [0.55 + 0.35 * -(-len(motion.z) // 6)] if named else []
        planes = [_BESIDE_PORTRAIT] * 2 if H.dof == 1 else [_PLANE]
        heights = keys + [row] * shown + planes + [_LOWER] * below
        self.notes: list[Any] = []
        if shown < H.dof:
            i = H.dof - 1
            self.notes.append(
                f"{shown} of {H.dof} degrees of freedom are drawn; plot('{H.names[i]}', "
                f"'{H.names[H.dof + i]}') draws others"
            )
        figure = Figure.of_size(PAGE, sum(heights) + 1.2, (), "")
        self.figure = figure
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
        if named:  # a row for the legend
            axes = figure.add_subplot(grid[0, :])
            axes.set_axis_off()
        tops: list[Axes] = []
        first = len(keys)
        for k in range(shown):
            for column in (0, 1):
                axes = figure.add_subplot(grid[first + k, column])
                component = motion.component(k + column * H.dof)
                over_time(axes, motion, component, timed=k == shown - 1)
                tops.append(axes)
        if named:
            handles, texts = tops[0].get_legend_handles_labels()
            figure.axes[0].legend(
                handles,
                texts,
                title=with_unit(*motion.varied[:2]),
                loc="center",
                ncols=6,
                frameon=False,
            )
        first += shown
        if H.dof == 1:
            axes = figure.add_subplot(grid[first : first + 2, 0])
            self.notes += in_plane(axes, motion, motion.component(0), motion.component(1))
            axes.set_title(plane_title(H, H.names[0], H.names[1]))
            places = [grid[first, 1], grid[first + 1, 1]]
            if lower == 1:
                places = [grid[first : first + 2, 1]]
        else:
            self._planes(*(figure.add_subplot(grid[first, column]) for column in (0, 1)))
            places = []
        for k in range(below):
            last = len(heights) - below + k
            alone = lower - len(places) == 1
            places += [grid[last, :]] if alone else [grid[last, 0], grid[last, 1]]
        self.free = [figure.add_subplot(place) for place in places]
        motion.color_bar(tops)

    def _planes(self, left: Axes, right: Axes) -> None:
        motion, H = self.motion, self.motion.H
        bodies = _bodies(H)
        if len(bodies) > 1 and len(motion.z) == 1:
            extents = []
            for k, (x, y) in enumerate(bodies[:MAX_LINES]):
                columns = motion.column(H.observable(x)), motion.column(H.observable(y))
                text = f"({math_name(x)}, {math_name(y)})"
                _paths(left, motion, columns, [text], **line_style(k))
                extents.append(columns)
            x, y = bodies[0]
            unit = quantity(H, x)[1]
            stems = [_CARTESIAN.match(name) for name in (x, y)]
            label(left.xaxis, math_name(stems[0][1]), unit)  # type: ignore[index]
            label(left.yaxis, math_name(stems[1][1]), unit)  # type: ignore[index]
            self.notes += _equal_aspect(
                left, *(np.stack(part) for part in zip(*extents, strict=True))
            )
            left.set_title("Orbits")
            if len(bodies) <= 4:
                legend_above(left)
            else:
                legend(left, **_BESIDE)
            if len(bodies) > MAX_LINES:
                self.notes.append(f"Orbits of {MAX_LINES} of {len(bodies)} bodies are drawn")
        else:
            x, y = bodies[0] if bodies else H.names[:2]
            self.notes += in_plane(left, motion, H.observable(x), H.observable(y))
            left.set_title(plane_title(H, x, y))
        in_plane(right, motion, motion.component(0), motion.component(H.dof))
        right.set_title(plane_title(H, H.names[0], H.names[H.dof]))

    def finished(self, *sentences: Any) -> Figure:
        """Return the figure with its caption."""
        self.figure.set_caption(self.motion.caption(*self.notes, *sentences), self.motion.warning)
        return self.figure


def _bodies(H: Hamiltonian) -> list[tuple[str, str]]:
    """Return the pairs of Cartesian coordinates x, y of each particle in a plane or in space."""
    found: dict[tuple[str, bool], dict[str, str]] = {}
    for symbol in H.q:
        match = _CARTESIAN.match(symbol.name)
        if match:
            key = match[2], match[1].isupper()
            found.setdefault(key, {})[match[1].lower()] = symbol.name
    pairs = [own for own in found.values() if {"x", "y"} <= own.keys()]
    return [(own["x"], own["y"]) for own in pairs]
