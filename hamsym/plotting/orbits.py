"""Figures of periodic orbits, their families and their proofs."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.facts.wording import evenly
from hamsym.orbits.certificate import OrbitCertificate
from hamsym.orbits.family import OrbitFamily
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.plotting.bodies import PROJECTIONS, bodies_of, draw_bodies, draw_projection
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import figure_of, label, one_panel
from hamsym.plotting.motions import (
    Motion,
    draw_motion,
    drawn_of,
    formulas_of,
)
from hamsym.plotting.names import amount, energy_unit, number, quantity, time_name
from hamsym.plotting.overview import draw_energies
from hamsym.plotting.panels import Panel, draw_panels
from hamsym.plotting.sampling import resolved, with_formulas
from hamsym.plotting.style import GREY, SAMPLES, color_of, marker_style

_BIFURCATIONS = "*DsPXv^"
_FAR = 2.5  # from 0: beyond, all multipliers are drawn in an inset
_BESIDE_CIRCLE = 1.15  # from 0: largest drawn beside the inset
_MOST_ORBITS = 40  # of a family, in a plane


def draw_orbit(orbit: PeriodicOrbit, *names: Any, ax: Any = None) -> Any:
    """Draw an orbit and its multipliers; see :meth:`hamsym.PeriodicOrbit.plot`."""
    H = orbit.H
    _, drawn = drawn_of(H, names, ("orbit", "energies", "multipliers"))
    times = orbit.problem.start + np.linspace(0, orbit.period, SAMPLES)
    formulas = formulas_of(drawn)
    t, z, apart = resolved(orbit, times, formulas=formulas)
    energy = f"{number(orbit.energy, 8)} {energy_unit(H)}".strip()
    period = amount(H, time_name(H), orbit.period, 8)
    words = ["Period", f"{period},", "energy", f"{energy},", orbit.stability]
    headline = orbit.facts.headline
    sentences, warning = [words, headline[:1].upper() + headline[1:]], orbit.facts.warning
    motion = Motion(
        H, t, z[None], sentences=sentences, warning=warning, apart=apart, formulas=formulas
    )
    if drawn:
        return draw_motion(motion, drawn, ax)
    path, projections = _paths(motion, "Orbit")
    panels = {
        "orbit": path,
        "multipliers": Panel(
            lambda axes: draw_multipliers(axes, orbit.multipliers, _title(orbit.stability)), 7.5
        ),
        **projections,
        "energies": Panel(lambda axes: draw_energies(axes, motion), 6.0),
    }
    shown = [name for name in panels if projections or name != "energies"]
    return draw_panels(panels, shown, names, ax, motion.caption(), warning)


def _paths(motion: Motion, title: str, *, levels: bool = True) -> tuple[Panel, dict[str, Panel]]:
    """Return the panel of paths in their plane or in space, and of space its projections."""
    spatial = bool(bodies_of(motion.H, "xyz"))

    def path(axes: Any) -> list[Any]:
        notes = draw_bodies(axes, motion, "xyz" if spatial else "xy", levels=levels)
        if axes.get_title("left") in ("", "Orbit", "Phase portrait"):
            axes.set_title(title, loc="left")
        return notes

    if not spatial:
        return Panel(path, 7.5), {}
    projections = {
        letters: Panel(functools.partial(draw_projection, motion=motion, letters=letters), 6.0)
        for letters in PROJECTIONS
    }
    return Panel(path, 7.5, "3d"), projections


def _title(stability: str) -> str:
    return f"Multipliers: {stability}"


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


# -- families --------------------------------------------------------------------------------------


def draw_family(family: OrbitFamily, *names: Any, ax: Any = None) -> Any:
    """Draw periods, stability and orbits of a family; see :meth:`hamsym.OrbitFamily.plot`."""
    if not len(family):
        raise InputError("the family has no orbits to draw")
    H = family[0].H
    parameters = {k: v for k, v in H.parameters.items() if k != family.parameter}
    warning = family.facts.warning
    _, drawn = drawn_of(H, names, ("period", "multipliers"))
    if len(drawn) == 1:
        raise InputError(
            "orbits of a family have periods of their own; name two components for their "
            "plane, or draw one orbit over time: family[0].plot(...)"
        )
    motion = _motion_of(family, parameters, warning, formulas_of(drawn))
    several = not motion.mapped and len(motion.z) > 1
    if drawn:
        figure = draw_motion(motion, drawn, ax)
        if ax is None and several and len(drawn) == 2:
            _legend_beside(figure.axes[0])
        return figure
    sentences = [f"{len(family)} orbits and {len(family.bifurcations)} bifurcations"]
    if len(motion.z) < len(family):
        sentences.append(
            f"{len(motion.z)} of {len(family)} orbits are drawn in the plane, evenly chosen"
        )
    paths, projections = _paths(motion, "Orbits", levels=False)

    def orbits(axes: Any) -> Sequence[Any] | None:
        notes = paths.draw(axes)
        motion.color_bar(axes)
        if several:
            _legend_beside(axes)
        return notes

    panels = {
        "period": Panel(lambda axes: _draw_periods(axes, family), 7.5),
        "orbits": replace(paths, draw=orbits),
        "multipliers": Panel(lambda axes: _draw_sizes(axes, family), 7.5),
        **projections,
    }
    caption = caption_words(H, *sentences, parameters=parameters)
    return draw_panels(panels, list(panels), names, ax, caption, warning)


def _legend_beside(axes: Axes) -> None:
    style: dict[str, Any] = {"fontsize": 6, "frameon": False, "title": None}
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **style)


def _abscissa(family: OrbitFamily) -> tuple[Callable[[PeriodicOrbit], float], tuple[str, str]]:
    H = family[0].H
    if family.parameter:
        name = family.parameter
        return (lambda orbit: float(orbit.H.parameters[name])), quantity(H, name)
    return (lambda orbit: orbit.energy), ("energy", energy_unit(H))


def _motion_of(
    family: OrbitFamily,
    parameters: dict[str, float],
    warning: str,
    formulas: Sequence[Observable],
) -> Motion:
    """Return some orbits of a family, over one period each."""
    place, (text, unit) = _abscissa(family)
    orbits = [family[k] for k in evenly(len(family), _MOST_ORBITS).tolist()]
    phase = np.linspace(0, 1, 401)
    times = [orbit.problem.start + phase * orbit.period for orbit in orbits]
    paths = [(orbit(t), t, orbit.H) for orbit, t in zip(orbits, times, strict=True)]
    z = np.array(
        [with_formulas(path, t, [H.observable(f.expr) for f in formulas]) for path, t, H in paths]
    )
    values = np.array([place(orbit) for orbit in orbits])
    return Motion(
        family[0].H,
        phase,
        z,
        total=len(family),
        sentences=[],
        warning=warning,
        what="orbits",
        varied=(text, unit, values),
        parameters=parameters,
        formulas=formulas,
    )


def _draw_stabilities(
    axes: Axes, family: OrbitFamily, ordinate: Callable[[PeriodicOrbit], float]
) -> None:
    """Draw a number of each orbit, with a marker for its stability and for bifurcations."""
    place, words = _abscissa(family)
    x = np.array([place(orbit) for orbit in family])
    y = np.array([ordinate(orbit) for orbit in family])
    axes.plot(x, y, color="0.75", linewidth=0.8, zorder=1)
    stabilities = np.array(family.stabilities)
    for k, kind in enumerate(sorted(set(family.stabilities))):
        own = stabilities == kind
        axes.plot(x[own], y[own], **marker_style(k), markersize=3.5, label=kind)
    kinds = sorted({found.kind for found in family.bifurcations})
    for kind, mark in zip(kinds, _BIFURCATIONS * len(kinds), strict=False):
        found = [b.orbit for b in family.bifurcations if b.kind == kind]
        own_y = [ordinate(orbit) for orbit in found]
        style = {**marker_style(0), "color": "black", "marker": mark, "markersize": 6}
        axes.plot([place(orbit) for orbit in found], own_y, **style, label=kind, zorder=4)
    label(axes.xaxis, *words)


def _draw_periods(axes: Axes, family: OrbitFamily) -> None:
    H = family[0].H
    _draw_stabilities(axes, family, lambda orbit: orbit.period)
    axes.set_title("Period")
    label(axes.yaxis, "period", quantity(H, time_name(H))[1])
    axes.legend(fontsize=6)


def _draw_sizes(axes: Axes, family: OrbitFamily) -> None:
    """Draw the size of the largest multiplier of each orbit."""
    _draw_stabilities(axes, family, lambda orbit: float(np.abs(orbit.multipliers[0])))
    axes.axhline(1, color=GREY, linewidth=0.7)
    axes.set_title("Largest multiplier")
    largest = max(float(np.abs(orbit.multipliers[0])) for orbit in family)
    if np.isfinite(largest) and largest > 30:
        axes.set_yscale("log")
    label(axes.yaxis, "size of the largest multiplier")
    axes.legend(fontsize=6)


# -- proofs ----------------------------------------------------------------------------------------


def draw_orbit_certificate(found: OrbitCertificate, *, ax: Any = None) -> Any:
    """Draw the multipliers of a proven orbit; see :meth:`hamsym.OrbitCertificate.plot`."""
    middle = np.asarray(found.monodromy.mid)
    values = np.linalg.eigvals(middle)
    words = (
        f"Proven: one orbit, period {number(float(found.period.mid), 12)} within "
        f"{number(float(found.period.radius), 2)}, states within {number(found.bound, 2)} of the "
        f"numerical ones, {found.stability}. Drawn are the multipliers of one shift of its "
        "symmetry, from the middle of their enclosure."
    ).split()
    with one_panel(ax, words, height=7.5) as axes:
        draw_multipliers(axes, values, _title(found.stability))
        return figure_of(axes)
