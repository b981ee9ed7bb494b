"""Paths of bodies whose coordinates are x, y and z: planes, space and its three projections."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.figure import label, legend, legend_above
from hamsym.plotting.motions import (
    BESIDE,
    CARTESIAN,
    Motion,
    equal_aspect,
    in_plane,
    in_space,
    paths_in_plane,
    paths_in_space,
    plane_title,
)
from hamsym.plotting.names import math_name, quantity
from hamsym.plotting.style import MAX_LINES, line_style

#: Projections of space, by the axes that they keep.
PROJECTIONS = ("xy", "xz", "yz")
_NAMED = 4  # bodies in a legend above axes


def bodies_of(H: Hamiltonian, letters: str) -> list[list[str]]:
    """Return the coordinates along these axes of each body that has all of them.

    Examples
    --------
    >>> H = Hamiltonian("(p_x1**2 + p_y1**2 + p_x2**2 + p_y2**2)/2 + (x1 - x2)**2 + y1*y2")
    >>> bodies_of(H, "xy"), bodies_of(H, "xyz")
    ([['x1', 'y1'], ['x2', 'y2']], [])
    """
    found: dict[tuple[str, bool], dict[str, str]] = {}
    for symbol in H.q:
        if match := CARTESIAN.match(symbol.name):
            key = match[2], match[1].isupper()
            found.setdefault(key, {})[match[1].lower()] = symbol.name
    return [[own[k] for k in letters] for own in found.values() if {*letters} <= own.keys()]


def draw_bodies(axes: Any, motion: Motion, letters: str, *, levels: bool = True) -> list[Any]:
    """Draw the paths of bodies in a plane, "xy", or in space, "xyz"; return sentences.

    Of one trajectory all bodies are drawn, of several the first one.
    """
    H = motion.H
    bodies = bodies_of(H, letters) or [list(H.names[: len(letters)])]
    if len(bodies) == 1 or len(motion.z) > 1:
        drawn = [H.observable(name) for name in bodies[0]]
        first = [f"Of {len(bodies)} bodies the first one is drawn"] if len(bodies) > 1 else []
        if len(letters) == 3:
            return first + list(in_space(axes, motion, drawn))
        axes.set_title(plane_title(H, *bodies[0]))
        return first + in_plane(axes, motion, drawn[0], drawn[1], levels=levels)
    shown = bodies[:MAX_LINES]
    columns = [
        np.concatenate([motion.column(H.observable(body[k])) for body in shown])
        for k in range(len(letters))
    ]
    labels = ["(" + ", ".join(math_name(name) for name in body) + ")" for body in shown]
    words = [(math_name(name[0]), quantity(H, name)[1]) for name in bodies[0]]
    paths = zip(labels, zip(*columns, strict=True), strict=True)
    lines = [({**line_style(k), "label": text}, path) for k, (text, path) in enumerate(paths)]
    notes: list[Any] = []
    if len(letters) == 3:
        notes += paths_in_space(axes, lines, words, True)
    else:
        paths_in_plane(axes, motion, lines)
        label(axes.xaxis, *words[0])
        label(axes.yaxis, *words[1])
        notes += equal_aspect(axes, *columns)
        axes.set_title("Orbits")
        if len(bodies) <= _NAMED:
            legend_above(axes)
        else:
            legend(axes, **BESIDE)
    if len(bodies) > len(shown):
        notes.append(f"Orbits of {len(shown)} of {len(bodies)} bodies are drawn")
    return notes


def draw_projection(axes: Axes, motion: Motion, letters: str) -> None:
    """Draw the projection of paths in space along one axis."""
    draw_bodies(axes, motion, letters, levels=False)
    if letters != PROJECTIONS[0] and (own := axes.get_legend()) is not None:
        own.remove()
    seen = {"xy": "z", "xz": "y", "yz": "x"}[letters]
    axes.set_title(f"Seen along ${seen}$")
