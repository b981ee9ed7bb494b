"""Figures of solutions, one or many, and of trajectories from time stepping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy
from matplotlib.axes import Axes

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.facts.wording import evenly
from hamsym.families.solutions import Solutions
from hamsym.integrators.interpolation import Interpolant
from hamsym.integrators.trajectory import Trajectory
from hamsym.plotting.figure import label, legend, legend_above
from hamsym.plotting.motions import (
    MAX_DRAWN,
    Motion,
    drawn_of,
    formulas_of,
    parameters_of,
    varying,
)
from hamsym.plotting.names import energy_unit, quantity, time_name
from hamsym.plotting.overview import draw_energies, draw_motions
from hamsym.plotting.panels import Draw
from hamsym.plotting.sampling import resolved, with_formulas
from hamsym.plotting.style import SAMPLES, WARNING, color_of
from hamsym.plotting.time_axes import (
    LARGEST,
    component_curves,
    decades_and_lines,
    fill_time,
    log_lines,
    name_curves,
    name_energy_error,
    relative,
)
from hamsym.proof.windows.certificate import Certificate
from hamsym.solution.solution import Solution

_MOST_OF_ERRORS = 4_000
_ASKED_STYLE: dict[str, Any] = {"color": "black", "linestyle": ":", "label": "asked for"}
_WORDS = ("error", "residual", "energy", "energies", "search")
_SAVE_MORE = "Dots: the saved states, which are too far apart for lines between them; save more"


def draw_solution(
    solution: Solution, *names: Any, ax: Any = None, certificate: Certificate | None = None
) -> Any:
    """Draw a solution; see :meth:`hamsym.Solution.plot`."""
    certificate = solution.certificate if certificate is None else certificate
    if not isinstance(certificate, Certificate | None):
        raise InputError(
            f"certificate is a {type(certificate).__name__}; give what solution.certify() returns"
        )
    word, drawn = drawn_of(solution.H, names, _WORDS)
    motion = _motion(solution, formulas_of(drawn))
    draws: tuple[Draw, ...] = (
        lambda axes: draw_error(axes, solution, certificate),
        lambda axes: draw_residual(axes, solution),
        lambda axes: draw_energy_error(axes, solution),
        lambda axes: draw_energies(axes, motion),
        lambda axes: draw_search(axes, solution),
    )
    last = "search" if solution.record.edges is None else "energies"
    panels = dict(zip(_WORDS, draws, strict=True))
    return draw_motions(motion, word, drawn, ax, panels, ("error", "energy", "residual", last))


def _motion(solution: Solution, formulas: Sequence[Observable]) -> Motion:
    times = solution.record.times(solution.span, SAMPLES)
    t, z, apart = resolved(solution, times, formulas=formulas)
    return Motion(
        solution.H,
        t,
        z[None],
        sentences=[
            f"Method {solution.method}" + (f": {solution.message}" if solution.success else "")
        ],
        warning=solution.facts.warning,
        apart=apart,
        formulas=formulas,
    )


def _times(solution: Solution) -> np.ndarray:
    """Return the times of curves of errors."""
    times = solution.record.times(solution.span, SAMPLES)
    return times[evenly(len(times), _MOST_OF_ERRORS)]


def asked_of(solution: Solution, sizes: np.ndarray) -> list[tuple[float, dict[str, Any]]]:
    """Return the line of the error that was asked for, relative to the sizes of components.

    With an absolute tolerance the components differ; the line is then that of the strictest.
    """
    allowed = solution.settings.allowed(sizes)
    ratios = allowed[sizes > 0] / sizes[sizes > 0]
    if not ratios.size:
        return []
    one = ratios.max() <= 1.01 * ratios.min()
    text = "asked for" if one else "asked for, the strictest"
    return [(float(ratios.min()), {**_ASKED_STYLE, "label": text})]


def draw_error(axes: Axes, solution: Solution, certificate: Certificate | None = None) -> list[Any]:
    """Draw the estimated errors relative to the sizes of the components, with what was asked.

    Of a certificate, the proven bound of the largest relative error and the band down to its lower
    bound. Return sentences for the caption.
    """
    H, t = solution.H, _times(solution)
    sizes = solution.scale if solution.error is None else solution.error.scale
    with np.errstate(all="ignore"):
        values = relative(np.asarray(solution.error_estimate(t)), sizes)
    lines = asked_of(solution, sizes)
    notes: list[Any] = []
    if certificate is not None:
        bounds = relative(np.array(certificate.component_bounds), sizes)
        worst = int(np.nanargmax(bounds))
        lower = certificate.component_lowers[worst] / sizes[worst]
        lines.append((float(bounds[worst]), {"color": WARNING, "label": "proven bound"}))
        if lower > 0:
            axes.axhspan(lower, bounds[worst], color=WARNING, alpha=0.25, linewidth=0)
        notes.append("Proven: no error, relative to its size, is above the red line at any time")
    log_lines(axes, t, component_curves(H, values), lines=lines, unknown="infinite where not drawn")
    name_curves(axes, H, "Estimated error", "error / size")
    legend_above(axes)
    return [*notes, LARGEST]


def draw_residual(axes: Axes, solution: Solution) -> list[str]:
    """Draw the residual of each component relative to its largest rate."""
    t = _times(solution)
    residual = np.asarray(solution.residual(t))
    rates = np.abs(np.asarray(solution.derivative(t))).max(axis=0)
    log_lines(axes, t, component_curves(solution.H, relative(residual, rates)))
    name_curves(axes, solution.H, r"Residual $\ell$", r"$|\ell_i|\,/\,\max|\dot z_i|$")
    legend_above(axes)
    return [LARGEST]


def draw_energy_error(axes: Axes, solution: Solution) -> list[str]:
    """Draw the change of H, less the work of forces and explicit time."""
    H, t = solution.H, _times(solution)
    jumps = (sympy.sign, sympy.Heaviside, sympy.Piecewise, sympy.floor)
    if H.time is not None and any(H.expr.has(kind) for kind in jumps):
        axes.plot(t, solution.energy(t), color=color_of(0))
        name_curves(axes, H, "Energy", "$H$", energy_unit(H))
        return [LARGEST]
    with np.errstate(all="ignore"):
        drift = np.abs(np.asarray(solution.energy_drift(t)))
    log_lines(axes, t, [(drift, {"color": color_of(0)})], unknown="unknown")
    name_energy_error(axes, H)
    return [LARGEST]


def draw_search(axes: Axes, solution: Solution) -> None:
    """Draw the length of the windows over time, or the residuals of a training."""
    history, H = solution.history, solution.H
    if solution.record.edges is not None:
        edges = np.asarray(history.edges)
        lengths = np.abs(np.diff(edges))
        axes.stairs(
            lengths, edges + solution.record.origin, baseline=None, color=color_of(0), linewidth=1
        )
        if lengths.max() > 20 * lengths.min():
            axes.set_yscale("log")
        else:
            axes.set_ylim(0, 1.15 * lengths.max())
        fill_time(axes, np.array(solution.span))
        title = (
            f"Lengths of {len(lengths):,} windows" if len(lengths) > 1 else "Length of one window"
        )
        name_curves(axes, H, title, "length", quantity(H, time_name(H))[1])
        return
    # The same quantity against the same cost, whatever the loss of a method and its iterations are.
    best = np.minimum.accumulate(history.ell_max)
    axes.loglog(history.seconds, best, label=solution.method)
    axes.set(title="Best residual so far", xlabel="run time [s]", ylabel=r"$\max|\ell|$")
    legend(axes)


# -- many ------------------------------------------------------------------------------------------


def draw_solutions(many: Solutions, *names: Any, ax: Any = None) -> Any:
    """Draw an ensemble; see :meth:`hamsym.Solutions.plot`."""
    if not many.size:
        raise InputError("there are no trajectories to draw; solve at least one")
    word, drawn = drawn_of(many.H, names, ("error", "energy"))
    motion, shown = _ensemble(many, formulas_of(drawn))
    panels: dict[str, Draw] = {
        "error": lambda axes: _draw_member_errors(axes, many),
        "energy": lambda axes: _draw_energies(axes, shown, motion),
    }
    return draw_motions(motion, word, drawn, ax, panels, [*panels], [LARGEST], {"energy"})


def _ensemble(many: Solutions, formulas: Sequence[Observable]) -> tuple[Motion, Solutions]:
    """Return the trajectories that are drawn, as a motion and as solutions."""
    chosen = evenly(many.size, MAX_DRAWN)
    shown = Solutions(many.family, many.table, many.windows, many.members.ravel()[chosen])
    times = np.linspace(*many.span, SAMPLES)
    t, z, apart = resolved(shown, times, len(chosen), formulas, shown.own_parameters)
    same, ranges = parameters_of(many.H, many.parameters)
    motion = Motion(
        many.H,
        t,
        z,
        total=many.size,
        sentences=[ranges, f"Relative tolerance {many.tol:.1e}"],
        warning=many.facts.warning,
        varied=varying(many.H, shown.z0, shown.parameters),
        parameters=same,
        apart=apart,
        formulas=formulas,
    )
    return motion, shown


def _draw_member_errors(axes: Axes, many: Solutions) -> None:
    """Draw the largest relative error of each trajectory, with the tolerance; failed ones red."""
    name, unit, values = varying(
        many.H, many.z0.reshape(-1, many.H.dim), {k: v.ravel() for k, v in many.parameters.items()}
    )
    errors, success = many.tol * many.excess.ravel(), many.success.ravel()
    finite = np.isfinite(errors) & (errors > 0)
    top = 3 * max(errors[finite].max(initial=many.tol), many.tol)
    good, bad = success & finite, ~success
    axes.plot(values[good], errors[good], ".", color=color_of(0), rasterized=len(values) > 5_000)
    if bad.any():
        drawn = np.where(finite, errors, top)
        axes.plot(values[bad], drawn[bad], "x", color=WARNING, label=f"{bad.sum():,} failed")
        legend_above(axes)
    axes.margins(x=0.05)
    low = min(errors[finite].min(initial=many.tol), many.tol) / 2
    decades_and_lines(axes, low, top, [(many.tol, _ASKED_STYLE)])
    axes.set_title("Largest estimated error of each trajectory")
    label(axes.xaxis, name, unit)
    label(axes.yaxis, "error / size")


def _draw_energies(axes: Axes, shown: Solutions, motion: Motion) -> None:
    energy = shown.energy(motion.t)
    if motion.H.conserves_energy:
        log_lines(axes, motion.t, motion.curves(np.abs(energy - energy[:, :1])), unknown="")
        name_energy_error(axes, motion.H)
    else:
        for values, style in motion.curves(energy):
            axes.plot(motion.t, values, **style)
        name_curves(axes, motion.H, "Energy", "$H$", energy_unit(motion.H))


# -- trajectories by time stepping -----------------------------------------------------------------


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
    motion = _stepped(trajectory, chosen, formulas_of(drawn))
    panels: dict[str, Draw] = {
        "energy": lambda axes: _draw_energy(axes, trajectory, motion, chosen)
    }
    if trajectory.errors is not None:
        panels["error"] = lambda axes: _draw_error(axes, trajectory, motion, chosen)
    if total == 1:
        panels["energies"] = lambda axes: draw_energies(axes, motion)
    return draw_motions(motion, word, drawn, ax, panels, [*panels], keyed=panels)


def _stepped(trajectory: Trajectory, chosen: np.ndarray, formulas: Sequence[Observable]) -> Motion:
    members, drawn = trajectory.ensemble, trajectory.ensemble.some(chosen)
    same, ranges = parameters_of(members.H, members.columns)
    warning = trajectory.facts.warning
    t, z, apart = _between(trajectory, chosen, formulas)
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


def _between(
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
