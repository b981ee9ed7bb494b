"""Figures of trajectories from time stepping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.facts.wording import evenly
from hamsym.integrators.interpolation import Interpolant
from hamsym.integrators.trajectory import Trajectory
from hamsym.plotting.motions import (
    MAX_DRAWN,
    Motion,
    drawn_of,
    formulas_of,
    parameters_of,
    varying,
)
from hamsym.plotting.overview import draw_energies, draw_motions
from hamsym.plotting.panels import Draw
from hamsym.plotting.sampling import resolved, with_formulas
from hamsym.plotting.style import SAMPLES
from hamsym.plotting.time_axes import log_lines, name_curves, name_energy_error, relative

_SAVE_MORE = "Dots: the saved states, which are too far apart for lines between them; save more"


def draw_trajectory(trajectory: Trajectory, *names: Any, ax: Any = None) -> Any:
    """Draw a trajectory or an ensemble; see :meth:`hamsym.Trajectory.plot`."""
    total = len(trajectory.ensemble)
    if not total:
        raise InputError("there are no trajectories to draw; integrate at least one")
    chosen = evenly(total, MAX_DRAWN)
    word, drawn = drawn_of(trajectory.ensemble.H, names, ("energy", "error", "energies"))
    if word == "energies" and total > 1:
        raise InputError(
            f"energies are drawn of one trajectory, not of {total:,}; integrate one of them"
        )
    if word == "error" and trajectory.errors is None:
        raise InputError(
            "this trajectory has no error estimate; integrate with tol=, for example tol=1e-9"
        )
    motion = _motion(trajectory, chosen, formulas_of(drawn))
    panels: dict[str, Draw] = {
        "energy": lambda axes: _draw_energy(axes, trajectory, motion, chosen)
    }
    if trajectory.errors is not None:
        panels["error"] = lambda axes: _draw_error(axes, trajectory, motion, chosen)
    if total == 1:
        panels["energies"] = lambda axes: draw_energies(axes, motion)
    return draw_motions(motion, word, drawn, ax, panels, [*panels], keyed=panels)


def _motion(trajectory: Trajectory, chosen: np.ndarray, formulas: Sequence[Observable]) -> Motion:
    members, drawn = trajectory.ensemble, trajectory.ensemble.some(chosen)
    same, ranges = parameters_of(members.H, members.columns)
    warning = trajectory.facts.warning
    t, z, apart = _resolved(trajectory, chosen, formulas)
    return Motion(
        members.H,
        t,
        z,
        total=len(members),
        sentences=[ranges, "" if warning else trajectory.message],
        warning=warning,
        varied=varying(members.H, drawn.states, drawn.columns),
        parameters=same,
        apart=apart,
        formulas=formulas,
    )


def _resolved(
    trajectory: Trajectory, chosen: np.ndarray, formulas: Sequence[Observable]
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return times and states to draw, between few saved ones, and a sentence if they are few."""
    members, t = trajectory.ensemble.some(chosen), trajectory.t
    z = trajectory.ensemble.flat(trajectory.z)[chosen]
    values = members.own_parameters()
    saved = with_formulas(z, t, formulas, values)
    if len(t) < 2:
        return t, saved, ""
    try:
        between = Interpolant(t, z, members).states
        first = np.linspace(t[0], t[-1], SAMPLES)
        dense, states, apart = resolved(between, first, len(chosen), formulas, values)
    except InputError:
        return t, saved, _SAVE_MORE
    return (dense, states, apart) if len(t) < len(dense) else (t, saved, "")


def _draw_energy(axes: Axes, trajectory: Trajectory, motion: Motion, chosen: np.ndarray) -> None:
    """Draw the change of H, less the work of forces and explicit time."""
    with np.errstate(all="ignore"):
        change = np.abs(trajectory.ensemble.flat(trajectory.energy_drift)[chosen])
    log_lines(axes, trajectory.t, motion.curves(change), unknown="")
    name_energy_error(axes, motion.H)


def _draw_error(axes: Axes, trajectory: Trajectory, motion: Motion, chosen: np.ndarray) -> None:
    """Draw the estimated error, the largest of the components relative to their sizes."""
    assert trajectory.errors is not None
    errors = trajectory.ensemble.flat(trajectory.errors)[chosen]
    with np.errstate(all="ignore"):
        states = trajectory.ensemble.flat(trajectory.z)[chosen]
        sizes = np.nanmax(np.abs(states), axis=1, keepdims=True)
        largest = np.nanmax(relative(errors, sizes), axis=-1)
    log_lines(axes, trajectory.t, motion.curves(largest), unknown="infinite where not drawn")
    name_curves(axes, motion.H, "Largest estimated error up to each time", "error / size")
