"""Figures of stable and unstable manifolds, of their sections and of connections."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from hamsym.codegen.observable import Observable
from hamsym.dynamics.sections import free_pair
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.invariant_manifolds.connection import Connection, Connections
from hamsym.invariant_manifolds.crossings import Cut
from hamsym.invariant_manifolds.manifold import Manifold, Manifolds
from hamsym.invariant_manifolds.origins import Origin
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.plotting.bodies import bodies_of
from hamsym.plotting.captions import axis_words, caption_words
from hamsym.plotting.figure import figure_of, label, legend_above, one_panel
from hamsym.plotting.motions import Line, drawn_of, equal_aspect, paths_in_space, same_scale
from hamsym.plotting.style import COLORS
from hamsym.problems.surface import parse_surface

_COLOR = {"unstable": COLORS[1], "stable": COLORS[0]}
_CONNECTING = COLORS[2]
_NEAR = 17  # points of the local manifold
_POINTS = 401  # of an orbit, and of a connection
_ESCAPE, _USUAL = 20.0, (0.03, 0.97)  # ratio of the extent to that of most points, if some escape
_MANY = 24  # trajectories, of which lines are thin


def draw_manifold(found: Manifold, *names: Any, ax: Any = None) -> Any:
    """Draw a manifold and its origin; see :class:`hamsym.Manifold`."""
    return _drawn([found], [], names, ax, found.facts.warning)


def draw_manifolds(found: Manifolds, *names: Any, ax: Any = None) -> Any:
    """Draw both manifolds and their origin; see :class:`hamsym.Manifolds`."""
    return _drawn([found.unstable, found.stable], [], names, ax, found.facts.warning)


def draw_connection(found: Connection, *names: Any, ax: Any = None) -> Any:
    """Draw a connection and its origins; see :class:`hamsym.Connection`."""
    return _drawn([], [found], names, ax, found.facts.warning)


def _drawn(
    parts: Sequence[Manifold],
    connecting: Sequence[Connection],
    names: Sequence[Any],
    ax: Any,
    warning: str,
) -> Any:
    """Draw manifolds, or connections, with their origins, in a plane or in space."""
    H = (parts[0] if parts else connecting[0]).H
    paths = [z for part in parts for _, z in part.paths]
    _, drawn = drawn_of(H, names or _usual_names(H, [*paths, *(one.z[None] for one in connecting)]))
    if len(drawn) < 2:
        raise InputError("name two components or formulas for their plane, or three for space")
    lines = [line for part in parts for line in _manifold_lines(part, drawn)]
    lines += [_connection_line(one, drawn) for one in connecting]
    origins: dict[int, Origin] = {id(part.origin): part.origin for part in parts}
    origins |= {id(origin): origin for one in connecting for origin in one.origins}
    lines += [_origin_line(origin, drawn) for origin in origins.values()]
    seen: set[str | None] = set()
    for style, _ in lines:
        style["label"] = None if style["label"] in seen else style["label"]
        seen.add(style["label"])
    sentences = [_manifold_sentence(part) for part in parts]
    sentences += [f"Both parts meet on {one.surface} to {one.mismatch:.1e}" for one in connecting]
    caption = caption_words(H, *sentences)
    projection = "3d" if len(drawn) == 3 else None
    with one_panel(ax, caption, warning, height=7.5, projection=projection) as axes:
        if projection:
            notes = paths_in_space(axes, lines, [axis_words(each) for each in drawn], False)
        else:
            notes = _in_plane(axes, H, lines, drawn)
        if ax is None:
            axes.set_title("Manifolds" if parts else "Connection", loc="left")
            legend_above(axes)
        figure = figure_of(axes)
        if ax is None and notes:
            figure.set_caption(caption_words(H, *sentences, *notes), warning)
        return figure


def _usual_names(H: Hamiltonian, paths: Sequence[np.ndarray]) -> list[str]:
    """Two coordinates, or one with its momentum if nothing moves along the other one."""
    if H.dof == 1:
        return list(H.names)
    bodies = bodies_of(H, "xy")
    names = bodies[0] if len(bodies) == 1 else list(H.names[:2])
    extents = np.ptp(np.concatenate(paths), axis=0)
    moving = [name for name in names if extents[H.names.index(name)] > 0]
    if len(moving) == 1:
        return [moving[0], H.names[H.names.index(moving[0]) + H.dof]]
    return names


def _values(drawn: Sequence[Observable], z: np.ndarray, t: np.ndarray) -> list[np.ndarray]:
    with np.errstate(all="ignore"):
        return [np.broadcast_to(np.asarray(each(z, t), dtype=float), t.shape) for each in drawn]


def _manifold_lines(part: Manifold, drawn: Sequence[Observable]) -> Iterable[Line]:
    many = len(part) > _MANY
    near, u = np.linspace(0, 1, _NEAR)[1:, None], part.departure.coordinates
    for k, (t, z) in enumerate(part.paths):
        if part.departure.period is None:  # the local manifold, which the trajectory leaves
            inner = part.departure.local(near * u(part.directions[[k]], part.phases[[k]]))
            t, z = np.append(np.full(len(inner), t[0]), t), np.concatenate([inner, z])
        style = {
            "color": _COLOR[part.kind],
            "linewidth": 0.4 if many else 1.0,
            "label": part.kind if k == 0 else None,
            "rasterized": many,
        }
        yield style, _values(drawn, z, t)


def _connection_line(one: Connection, drawn: Sequence[Observable]) -> Line:
    t = np.linspace(*one.span, 5 * _POINTS)
    return {"color": _CONNECTING, "label": "connection"}, _values(drawn, one(t), t)


def _origin_line(origin: Origin, drawn: Sequence[Observable]) -> Line:
    if isinstance(origin, PeriodicOrbit):
        t = origin.problem.start + np.linspace(0, origin.period, _POINTS)
        return {"color": "black", "label": "periodic orbit", "zorder": 4}, _values(
            drawn, origin(t), t
        )
    style = {"color": "black", "marker": "o", "linestyle": "none", "label": "equilibrium"}
    return {**style, "zorder": 4}, _values(drawn, origin.z[None], np.zeros(1))


def _in_plane(
    axes: Any, H: Hamiltonian, lines: Sequence[Line], drawn: Sequence[Observable]
) -> list[str]:
    for style, columns in lines:
        axes.plot(*columns, **style)
    label(axes.xaxis, *axis_words(drawn[0]))
    label(axes.yaxis, *axis_words(drawn[1]))
    every = [np.concatenate([columns[k] for _, columns in lines]) for k in (0, 1)]
    names = [each.text for each in drawn if each.place is not None]
    notes: list[str] = []
    escapes = False
    for side, values in zip("xy", every, strict=True):
        finite = values[np.isfinite(values)]
        low, high = np.quantile(finite, _USUAL) if len(finite) else (0.0, 0.0)
        if high > low and np.ptp(finite) > _ESCAPE * (high - low):
            pad = 0.5 * (high - low)
            getattr(axes, f"set_{side}lim")(low - pad, high + pad)
            escapes = True
    if escapes:
        notes.append("Trajectories that escape leave the picture")
    elif len(names) == 2 and same_scale(H, *names):
        notes += equal_aspect(axes, *every)
    return notes


def _manifold_sentence(part: Manifold) -> str:
    number = "1 trajectory" if len(part) == 1 else f"{len(part)} trajectories"
    return f"{part.kind.capitalize()}: {number}, local error {part.local_error:.1e}"


# -- sections --------------------------------------------------------------------------------------


def draw_connections(found: Connections, *names: Any, ax: Any = None) -> Any:
    """Draw the section and the connections in it; see :class:`hamsym.Connections`."""
    H = found.H
    where = parse_surface(H, found.surface)
    _, drawn = drawn_of(H, names or free_pair(H, where))
    if len(drawn) != 2:
        raise InputError("name two components or formulas for their plane, or none")
    sentences = [f"Section {found.surface}: {found.message}"]
    caption, warning = caption_words(H, *sentences), found.facts.warning
    with one_panel(ax, caption, warning, height=7.5) as axes:
        for part, cut in zip((found.unstable, found.stable), found.cuts, strict=True):
            _draw_cut(axes, part, cut, drawn)
        for k, one in enumerate(found):
            place = _values(drawn, one.z[None], np.zeros(1))
            text = "connection" if k == 0 else None
            axes.plot(*place, "*", color="black", markersize=7, label=text, zorder=5)
        label(axes.xaxis, *axis_words(drawn[0]))
        label(axes.yaxis, *axis_words(drawn[1]))
        if ax is None:
            axes.set_title("Section", loc="left")
            legend_above(axes)
        return figure_of(axes)


def _draw_cut(axes: Any, part: Manifold, cut: Cut, drawn: Sequence[Observable]) -> None:
    """Draw crossings, and lines between those of neighbours."""
    color = _COLOR[part.kind]
    x, y = _values(drawn, cut.z, cut.t)
    style = {"linestyle": "none", "marker": ".", "markersize": 2.5, "color": color}
    axes.plot(x, y, **style, label=part.kind)
    pairs = cut.segments(part.starts.neighbours())
    if len(pairs):
        short = np.hypot(np.diff(x[pairs])[:, 0] / np.ptp(x).clip(1e-300),
                         np.diff(y[pairs])[:, 0] / np.ptp(y).clip(1e-300)) < 0.2  # fmt: skip
        axes.plot(x[pairs[short]].T, y[pairs[short]].T, color=color, linewidth=0.6)
