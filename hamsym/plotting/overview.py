"""Figures of motions: the overview with panels of a result below, or one part of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from matplotlib.axes import Axes

from hamsym.codegen.observable import Observable
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.bodies import PROJECTIONS, bodies_of, draw_bodies, draw_projection
from hamsym.plotting.figure import Figure, figure_of, legend_above, one_panel, require_no_axes
from hamsym.plotting.motions import Motion, draw_motion, in_plane, over_time, plane_title
from hamsym.plotting.names import energy_unit, some_of, with_unit
from hamsym.plotting.panels import Draw
from hamsym.plotting.style import PAGE, line_style, styled
from hamsym.plotting.time_axes import envelope, fill_time, name_curves

# Most degrees of freedom, one in each row of a page.
_MAX_DOF = 6
# Centimetres of a row, by the number of rows, and of other rows, so that a page has all.
_ROW = {1: 3.0, 2: 2.5, 3: 2.2, 4: 2.0}
_PLANE, _PROJECTION, _BESIDE_PORTRAIT, _LOWER = 5.8, 4.9, 3.2, 3.0


def draw_motions(
    motion: Motion,
    word: str,
    drawn: Sequence[Observable],
    ax: Any,
    panels: Mapping[str, Draw],
    shown: Sequence[str],
    sentences: Sequence[Any] = (),
    keyed: Collection[str] = (),
) -> Any:
    """Draw a panel, or components and formulas, or the overview, with what is left out of it.

    - word, drawn: What was asked for, as :func:`drawn_of` returns it; nothing for the overview.
    - panels: All panels of the result, by name.
    - shown: Those of the overview, below the motion.
    - sentences: Of the caption of the overview.
    - keyed: Panels with a curve for each trajectory, which need a legend where they are alone.
    """
    H = motion.H
    if drawn:
        return draw_motion(motion, drawn, ax)
    if word:
        with one_panel(ax, motion.caption(), motion.warning, height=6.0) as axes:
            notes = panels[word](axes) or ()
            if word in keyed:
                motion.legend(axes)
                motion.color_bar(axes)
            if ax is None:
                figure_of(axes).add_to_caption(notes)
            return figure_of(axes)
    require_no_axes(ax, f"'{H.names[0]}', '{H.names[H.dof]}'")
    with styled():
        return _overview(motion, [panels[name] for name in shown], sentences)


def _overview(motion: Motion, lower: Sequence[Draw], sentences: Sequence[Any]) -> Figure:
    """Draw components over time and paths, then panels below.

    - lower: Of one degree of freedom the first two stand beside the phase portrait.
    """
    H = motion.H
    shown = min(H.dof, _MAX_DOF)
    row = max(_ROW.get(shown, 1.75), 2.5 if H.units else 0.0)  # units make labels long
    beside = 2 if H.dof == 1 else 0
    below = -(-(len(lower) - beside) // 2) if len(lower) > beside else 0
    named = any(motion.labels())
    keys = [0.55 + 0.35 * -(-len(motion.z) // 6)] if named else []
    spatial = bool(bodies_of(H, "xyz"))
    planes = [_PROJECTION] * 2 if spatial else [_PLANE]
    planes = [_BESIDE_PORTRAIT] * 2 if H.dof == 1 else planes
    heights = keys + [row] * shown + planes + [_LOWER] * below
    last = H.names[H.dof - 1], H.names[-1]
    notes: list[Any] = [*some_of(shown, H.dof, "degrees of freedom", *last)]
    figure = Figure.of_size(PAGE, sum(heights) + 1.2)
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    if named:  # a row for the legend
        key = figure.add_subplot(grid[0, :])
        key.set_axis_off()
    tops: list[Axes] = []
    first = len(keys)
    for k in range(shown):
        for column in (0, 1):
            axes = figure.add_subplot(grid[first + k, column])
            over_time(axes, motion, motion.component(k + column * H.dof), timed=k == shown - 1)
            tops.append(axes)
    if named:
        handles, texts = tops[0].get_legend_handles_labels()
        title = with_unit(*motion.varied[:2])
        key.legend(handles, texts, title=title, loc="center", ncols=6, frameon=False)
    first += shown
    places: list[Any] = []
    if H.dof == 1:
        axes = figure.add_subplot(grid[first : first + 2, 0])
        notes += in_plane(axes, motion, motion.component(0), motion.component(1))
        axes.set_title(plane_title(H, H.names[0], H.names[1]))
        places = [grid[first, 1], grid[first + 1, 1]]
        if len(lower) == 1:
            places = [grid[first : first + 2, 1]]
    elif spatial:
        space = figure.add_subplot(grid[first, 0], projection="3d")
        notes += draw_bodies(space, motion, "xyz")
        for k, letters in enumerate(PROJECTIONS, 1):
            place = grid[first + k // 2, k % 2]
            draw_projection(figure.add_subplot(place), motion, letters)
    else:
        notes += draw_bodies(figure.add_subplot(grid[first, 0]), motion, "xy")
        plane = figure.add_subplot(grid[first, 1])
        in_plane(plane, motion, motion.component(0), motion.component(H.dof))
        plane.set_title(plane_title(H, H.names[0], H.names[H.dof]))
    for k in range(below):
        lowest = len(heights) - below + k
        alone = len(lower) - len(places) == 1
        places += [grid[lowest, :]] if alone else [grid[lowest, 0], grid[lowest, 1]]
    free = [figure.add_subplot(place) for place in places]
    motion.color_bar(tops)
    for axes, draw in zip(free, lower, strict=False):
        notes += [note for note in draw(axes) or () if note not in notes]
    figure.set_caption(motion.caption(*notes, *sentences), motion.warning)
    return figure


# -- energies --------------------------------------------------------------------------------------


def energies_of(H: Hamiltonian) -> dict[str, sympy.Expr]:
    """Return the parts of H with and without momenta by their names, and H.

    The first is called kinetic where it depends on momenta alone or is quadratic in them.

    Examples
    --------
    >>> energies_of(Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r"))["potential"]
    -1/r
    >>> list(energies_of(Hamiltonian("p_x**2/2 + p_y**2/2 + y*p_x - x*p_y")))
    ['with momenta', 'without', '$H$']
    >>> list(energies_of(Hamiltonian("x*log(p)")))
    ['$H$']
    """
    rest = H.expr.xreplace({p: sympy.Integer(0) for p in H.p})
    if rest.has(sympy.nan, sympy.zoo, sympy.oo):
        return {"$H$": H.expr}
    kinetic = H.expr - rest
    twice = kinetic.xreplace({p: 2 * p for p in H.p})
    if H.is_separable or sympy.expand(twice - 4 * kinetic) == 0:
        return {"kinetic": kinetic, "potential": rest, "$H$": H.expr}
    return {"with momenta": kinetic, "without": rest, "$H$": H.expr}


def draw_energies(axes: Axes, motion: Motion) -> None:
    """Draw the kinetic and the potential energy of one trajectory, and their sum."""
    H = motion.H
    for k, (name, expr) in enumerate(reversed(energies_of(H).items())):
        with np.errstate(all="ignore"):
            values = H.observable(expr).values(motion.z[0, :, : H.dim], motion.t)
        t, values = envelope(motion.t, np.broadcast_to(values, motion.t.shape))
        style = {"color": "black", "linewidth": 0.8} if name == "$H$" else line_style(k - 1)
        axes.plot(t, values, **style, label=name)
    axes.margins(y=0.12)
    name_curves(axes, H, "Energies", "energy", energy_unit(H))
    fill_time(axes, motion.t)
    legend_above(axes)
