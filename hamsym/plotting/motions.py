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
from matplotlib.colors import Normalize
from matplotlib.ticker import NullFormatter, NullLocator

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import axis_words, caption_words, formula_of
from hamsym.plotting.figure import color_bar, figure_of, label, legend, one_panel
from hamsym.plotting.names import (
    distinct_numbers,
    enumerated,
    math_name,
    number,
    quantity,
    shortened,
    time_name,
    with_unit,
)
from hamsym.plotting.phase_portraits import draw_levels, power_of_ten
from hamsym.plotting.style import (
    COLUMN,
    MAX_LINES,
    SEQUENTIAL,
    line_styles,
)
from hamsym.plotting.time_axes import envelope, fill_time, label_time
from hamsym.support.suggestions import similar, unknown

#: Most trajectories of an ensemble that are drawn: more cover each other.
MAX_DRAWN = 200
# Points from which lines are drawn as pixels in files of vector graphics, which would be slow.
_DENSE = 8_000
# Points of a path: a figure has fewer pixels along it.
_MAX_POINTS = 40_000
#: A legend on the right of its axes.
BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5), "ncols": 1}
_DOTS: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2}
#: A coordinate along an axis of a plane or of space, and the body to which it belongs.
CARTESIAN = re.compile(r"([xyzXYZ])_?([0-9]*|[A-Za-z]?)\Z")


#: A style with a label, and values along the axes, each of shape (n,).
Line = tuple[dict[str, Any], Sequence[np.ndarray]]


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
        return distinct_numbers(self.varied[2].tolist())

    def curves(self, values: np.ndarray) -> list[tuple[np.ndarray, dict[str, Any]]]:
        """Return a curve for each row of values, with style and entry of its trajectory."""
        entries = zip(values, self.styles, self.labels(), strict=True)
        return [(row, {**style, "label": text}) for row, style, text in entries]

    def lines(self, columns: Sequence[np.ndarray]) -> list[Line]:
        """Return the path of each trajectory, from values along the axes, shape (members, n)."""
        paths = zip(self.path_styles, self.labels(), zip(*columns, strict=True), strict=True)
        return [({**style, "label": text}, path) for style, text, path in paths]

    def legend(self, axes: Axes, **options: Any) -> None:
        """Add a legend of several trajectories, whose title is what varies."""
        if any(self.labels()):
            legend(axes, title=with_unit(*self.varied[:2]), title_fontsize=7, **options)

    def color_bar(self, axes: Any) -> None:
        """Add the colour bar of many trajectories beside axes."""
        if self.mapped:
            color_bar(axes, self._norm, *self.varied[:2], fraction=0.04, aspect=40)

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
    ranges = {
        name: [math_name(name), "from", number(values.min(), 4), "to", number(values.max(), 4)]
        for name, values in varied.items()
        if np.ptp(values) > 0
    }
    same = {name: value for name, value in H.parameters.items() if name not in ranges}
    return same if ranges else None, enumerated(ranges.values())


def own_parameters(
    H: Hamiltonian, given: Mapping[str, Any], shape: tuple[int, ...]
) -> np.ndarray | None:
    """Return the values of all parameters, given ones and those of H, shape (*shape, k)."""
    known = {**H.parameters, **given}
    columns = [np.broadcast_to(known[name], shape) for name in H.parameter_names]
    return np.stack(columns, axis=-1) if columns else None


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
        bodies = [CARTESIAN.match(name) for name in (x, y)]
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
    if all(CARTESIAN.match(name) for name in owners):
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
    paths_in_plane(axes, motion, motion.lines(columns))
    for side, each, column in zip("xy", (x, y), columns, strict=True):
        if each.place is None:
            _fold_escape(axes, side, motion.t, column)
    label(axes.xaxis, *axis_words(x))
    label(axes.yaxis, *axis_words(y))
    if x.place is None or y.place is None:
        return notes
    if same_scale(H, x.text, y.text):
        notes += equal_aspect(axes, *columns)
    if H.dof == 1 and x.place != y.place and levels:
        axes.margins(0.15)
        if not H.time and motion.parameters in (None, H.parameters):
            start = float(H.compile("numpy").energy(motion.z[0, 0])) if motion.total == 1 else None
            notes += draw_levels(axes, H, x.text, y.text, start)
        else:
            why = "H depends on time" if H.time else "H differs between the trajectories"
            notes.append(f"Level sets of H are not drawn: {why}")
    return notes


def paths_in_plane(axes: Axes, motion: Motion, lines: Sequence[Line]) -> None:
    """Draw paths in a plane."""
    count = motion.z.shape[1] * len(motion.z)
    every = max(1, round(motion.z.shape[1] / _MAX_POINTS))
    for style, (x, y) in lines:
        color, dense = style["color"], count > _DENSE
        if motion.apart:
            style = {**style, **_DOTS}
        if every > 1:  # lines between distant points would be chords
            style = {"color": color, "label": style["label"], **_DOTS, "markersize": 0.8}
        axes.plot(x[::every], y[::every], **style, rasterized=dense)
        if len(motion.z) <= MAX_LINES:
            axes.plot(x[0], y[0], "o", color=color, markersize=3.5, zorder=3)


def equal_aspect(axes: Axes, x: np.ndarray, y: np.ndarray) -> list[str]:
    """Give two axes one scale, unless one would be lost."""
    with np.errstate(invalid="ignore"):
        ranges = [np.nanmax(values) - np.nanmin(values) for values in (x, y)]
    if not max(ranges) <= 8 * min(ranges):
        return ["The axes of the plane have different scales"]
    axes.set_aspect("equal", adjustable="datalim")
    return []


def in_space(axes: Any, motion: Motion, drawn: Sequence[Observable]) -> list[str]:
    """Draw paths in the space of three components or formulas; return sentences for the caption."""
    names = [each.text for each in drawn if each.place is not None]
    alike = len(names) == 3 and all(same_scale(motion.H, names[0], name) for name in names)
    columns = [motion.column(each) for each in drawn]
    words = [axis_words(each) for each in drawn]
    return paths_in_space(axes, motion.lines(columns), words, alike)


def paths_in_space(
    axes: Any, lines: Sequence[Line], words: Sequence[tuple[str, str]], alike: bool
) -> list[str]:
    """Draw paths in space; return sentences for the caption.

    - words: Text and unit of each axis.
    - alike: Whether the axes are lengths of one space.
    """
    columns = [np.concatenate(own) for own in zip(*(path for _, path in lines), strict=True)]
    powers = [power_of_ten(np.nanmax(np.abs(column), initial=0.0)) for column in columns]
    columns = [column / 10.0**power for column, power in zip(columns, powers, strict=True)]
    every = max(1, max(len(path[0]) for _, path in lines) // 20_000)
    for style, path in lines:
        own = [values / 10.0**power for values, power in zip(path, powers, strict=True)]
        axes.plot(*(values[::every] for values in own), **style)
        if len(lines) <= MAX_LINES:
            axes.plot(*(values[:1] for values in own), "o", color=style["color"], ms=3.5)
    for axis, (text, unit), power in zip("xyz", words, powers, strict=True):
        getattr(axes, f"set_{axis}label")(with_unit(text, unit, f"$10^{{{power}}}$" * bool(power)))
        axes.tick_params(axis, pad=-2)
    spans = np.array([np.nanmax(column) - np.nanmin(column) for column in columns])
    shares = np.ones(3)
    if alike and len(set(powers)) == 1 and spans.max() <= 8 * spans.min():
        axes.set_aspect("equal")
        shares = spans / spans.max()
    axes.set_box_aspect(shares, zoom=0.95 * (3 / float(shares @ shares)) ** 0.1)
    for axis, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), shares, strict=True):
        axis.get_major_locator().set_params(nbins=max(2, int(4 * share)), min_n_ticks=1)
        axis.labelpad = -4
    return [] if every == 1 else [f"Every {every}th time is drawn"]


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
    notes, spatial = _missing(motion), len(drawn) == 3
    wider = 1.0 if motion.mapped or spatial else 1.8 if any(motion.labels()) else 0.0
    size: dict[str, Any] = {"width": COLUMN + wider, "height": 6.0 if len(drawn) == 1 else 7.5}
    size["projection"] = "3d" if spatial else None
    with one_panel(ax, motion.caption(), motion.warning, **size) as axes:
        if len(drawn) == 1:
            over_time(axes, motion, drawn[0])
        elif spatial:
            notes += in_space(axes, motion, drawn)
        else:
            notes += in_plane(axes, motion, *drawn)
            if ax is None and not motion.formulas:
                axes.set_title(plane_title(motion.H, drawn[0].text, drawn[1].text))
        beside = BESIDE if ax is None else {}
        motion.legend(axes, **({"loc": "upper left"} if spatial else beside))
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
