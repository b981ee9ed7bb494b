"""Figures of a network beside integrators."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.integrators.trajectory import Trajectory
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import Figure, figure_of, label, legend, one_panel, require_no_axes
from hamsym.plotting.names import energy_unit, known_name, math_name, quantity
from hamsym.plotting.style import PAGE, SAMPLES, line_style, styled
from hamsym.plotting.time_axes import LARGEST, log_lines, name_curves
from hamsym.study.compare import Comparison, Row


def draw_comparison(comparison: Comparison, *names: Any, ax: Any = None) -> Any:
    """Draw a comparison; see :meth:`hamsym.Comparison.plot`."""
    solution = comparison.solution
    caption = caption_words(
        solution.H,
        f"Network: {solution.points:,} points. Errors against {comparison.reference.text}",
        "Phase plane: the network, and the integrator whose error is nearest to its",
        LARGEST,
    )
    warning = comparison.facts.warning
    curves = _curves(comparison)
    if names:
        panel = known_name(names[0], list(_PANELS), "a panel of a comparison")
        with one_panel(ax, caption, warning, height=7.0) as axes:
            _PANELS[panel](axes, comparison, curves)
            legend(axes)
            return figure_of(axes)
    require_no_axes(ax, "'error'")
    with styled():
        keys = 0.3 + 0.4 * -(-len(curves) // 4)
        figure = Figure.of_size(PAGE, 12.5 + keys, caption, warning)
        grid = figure.add_gridspec(3, 2, height_ratios=(5.6, 5.6, keys))
        panels = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(4)]
        for draw, one in zip(_PANELS.values(), panels, strict=True):
            draw(one, comparison, curves)
        handles, labels = panels[0].get_legend_handles_labels()
        row = figure.add_subplot(grid[2, :])
        row.set_axis_off()
        row.legend(handles, labels, loc="center", ncols=4, frameon=False)
        return figure


def _curves(comparison: Comparison) -> list[tuple[str, np.ndarray, np.ndarray, dict[str, Any]]]:
    """Return label, times, states and style of the network and of the integrators shown."""
    t = np.linspace(*comparison.solution.span, SAMPLES)
    curves = [("network", t, comparison.solution(t), line_style(0))]
    for place, (row, path) in enumerate(_shown(comparison)):
        tolerance = row.tolerance
        amount = f"{row.points:,} steps" if tolerance is None else f"rtol {tolerance:.0e}"
        label = f"{row.label}, {amount}".replace("_", " ")
        curves.append((label, path.t, path.z, line_style(place + 1)))
    return curves


def _draw_error(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    errors = []
    for text, times, z, style in curves:
        size = np.linalg.norm(z - comparison.reference(times), axis=-1)
        errors.append((times, size, {**style, "label": text}))
    _draw_curves(axes, errors)
    name_curves(axes, comparison.solution.H, "Error", r"$|\delta z|$")


def _draw_energy(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    H = comparison.solution.H
    system = H.compile("numpy")
    errors = []
    for text, times, z, style in curves:
        right = system.at("energy", comparison.reference(times), times)
        with np.errstate(all="ignore"):
            change = np.abs(system.at("energy", z, times) - right)
        errors.append((times, change, {**style, "label": text}))
    _draw_curves(axes, errors)
    name_curves(axes, H, "Energy error", r"$|\delta H|$", energy_unit(H))


def _draw_curves(axes: Axes, curves: list[tuple[np.ndarray, np.ndarray, dict[str, Any]]]) -> None:
    """Draw curves of different times, one after the other, on one logarithmic axis."""
    span = np.concatenate([times for times, _, _ in curves])
    common = np.linspace(span.min(), span.max(), SAMPLES)
    drawn = []
    for times, values, style in curves:
        order = np.argsort(times)
        size = np.interp(common, times[order], values[order], right=np.nan, left=np.nan)
        drawn.append((size, style))
    log_lines(axes, common, drawn, unknown="")


def _draw_plane(axes: Axes, comparison: Comparison, curves: list[Any]) -> None:
    """Draw errors of the first pair: the network's, and the nearest in size."""
    H = comparison.solution.H
    i, j = 0, H.dof
    errors = [z - comparison.reference(times) for _, times, z, _ in curves]
    sizes = np.array([np.abs(error).max() for error in errors])
    with np.errstate(divide="ignore"):
        orders = np.log(np.nan_to_num(sizes, nan=np.inf))
    with np.errstate(invalid="ignore"):
        distances = np.nan_to_num(np.abs(orders[1:] - orders[0]), nan=np.inf)
    nearest = 1 + int(np.argmin(distances))
    for k in (0, nearest):
        axes.plot(errors[k][:, i], errors[k][:, j], **curves[k][3], label=curves[k][0])
    axes.set_title("Error in the phase plane")
    for axis, name in ((axes.xaxis, H.names[i]), (axes.yaxis, H.names[j])):
        _, unit = quantity(H, name)
        label(axis, f"error of {math_name(name)}", unit)


def _draw_work(axes: Axes, comparison: Comparison, _: list[Any]) -> None:
    """Draw errors against evaluations of the vector field."""
    network = comparison.rows[0]
    for i, name in enumerate(comparison.matches):
        own = [row for row in comparison.rows if row.label == name and np.isfinite(row.error)]
        work, errors = [row.evaluations for row in own], [row.error for row in own]
        style = line_style(i + 1)
        axes.loglog(work, errors, marker="o", **style, label=name.replace("_", " "))
    style = line_style(0)
    axes.loglog(network.evaluations, network.error, "s", color=style["color"], label="network")
    axes.axhline(network.error, color=style["color"], linewidth=0.8, linestyle=":")
    axes.set_title("Error against work")
    axes.set(xlabel="evaluations of the vector field", ylabel=r"$\max|\delta z|$")


_PANELS = {"error": _draw_error, "energy": _draw_energy, "plane": _draw_plane, "work": _draw_work}


def _shown(comparison: Comparison) -> list[tuple[Row, Trajectory]]:
    """Return all trajectories of one integrator, or the middle one of each of several."""
    pairs = list(zip(comparison.rows[1:], comparison.trajectories, strict=True))
    if len(comparison.matches) == 1:
        return pairs
    return [[pair for pair in pairs if pair[0].label == name][1] for name in comparison.matches]
