"""Figures of results: one for each type."""

from __future__ import annotations

import textwrap
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hamsym.dynamics.lyapunov import LyapunovExponents
from hamsym.dynamics.lyapunov_map import LyapunovMap
from hamsym.dynamics.sections import Section
from hamsym.errors import InputError
from hamsym.fitting.fitted import Fit
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.integrators.integrate import Trajectory
from hamsym.solution.solution import Solution
from hamsym.study.compare import Comparison, Row

__all__ = ["plot"]

_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # Okabe and Ito
_SAMPLES = 2_001
_MAX_LINES = 8
_MAX_PLANES = 3


@singledispatch
def plot(result: Any, *args: Any, **options: Any) -> Figure:
    """Draw a solution, trajectory, fit, flow map, section, comparison or Lyapunov exponents.

    Parameters
    ----------
    result : Solution, Trajectory, Fit, FlowMap, Section, Comparison or LyapunovExponents
        Or LyapunovMap.
    *args, **options
        As in the method ``plot`` of the result.

    Returns
    -------
    matplotlib.figure.Figure
        Save it with ``.savefig(path)``.

    Raises
    ------
    InputError
        If the result is of another type.

    Examples
    --------
    >>> import hamsym
    >>> figure = plot(hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 10)))
    >>> [axis.get_title() for axis in figure.axes][:2]
    ['Trajectory', 'Phase space']
    """
    raise InputError(
        f"{type(result).__name__} cannot be plotted; give a solution, a trajectory, a fit, "
        "a flow map, a section, a comparison or Lyapunov exponents"
    )


@plot.register
def _plot_solution(solution: Solution) -> Figure:
    """Draw components, phase space, residual and energy error, and the loss in four panels."""
    figure, axes = _panels(f"H = {solution.H.formula}")
    t = np.linspace(*solution.span, _SAMPLES)
    z = solution(t)
    names, d = solution.H.names, solution.H.dof
    for i, name in enumerate(names[:_MAX_LINES]):
        axes[0, 0].plot(t, z[:, i], color=_color(i), label=name)
    axes[0, 0].set(title="Trajectory", xlabel="t")
    axes[0, 0].legend(ncols=2, fontsize=8)

    for i in range(min(d, _MAX_LINES)):
        label = f"({names[i]}, {names[d + i]})"
        axes[0, 1].plot(z[:, i], z[:, d + i], color=_color(i), label=label)
        axes[0, 1].plot(z[0, i], z[0, d + i], "o", color=_color(i), markersize=4)
    axes[0, 1].set(title="Phase space", xlabel="q", ylabel="p")
    axes[0, 1].legend(fontsize=8)

    ell = np.linalg.norm(solution.residual(t), axis=-1)
    axes[1, 0].semilogy(t[1:], _positive(ell)[1:], color=_color(0), label=r"$|\ell|$")
    if solution.H.time is None:
        drift = np.abs(solution.energy(t) - solution.energy(solution.span[0]))
        axes[1, 0].semilogy(t[1:], _positive(drift)[1:], color=_color(1), label=r"$|H - E_0|$")
    axes[1, 0].set(title="Residual and energy error", xlabel="t")
    axes[1, 0].legend(fontsize=8)

    history = solution.history
    if solution.record.edges is not None:
        lengths = np.abs(np.diff(history.edges))
        axes[1, 1].stairs(lengths, history.edges, baseline=None, color=_color(0))
        several = f"{len(lengths):,} windows" if len(lengths) > 1 else "window"
        axes[1, 1].set(title=f"Length of the {several}", xlabel="t")
        return figure
    axes[1, 1].loglog(
        np.arange(1, len(history.loss) + 1),
        history.loss,
        color="0.75",
        linewidth=0.6,
        label="at the training points",
    )
    best = np.minimum.accumulate(history.fixed_loss)
    axes[1, 1].loglog(history.iteration, best, color=_color(0), label="best, at fixed points")
    axes[1, 1].set(title="Loss", xlabel="iteration")
    axes[1, 1].legend(fontsize=8)
    return figure


@plot.register
def _plot_flow_map(flow: FlowMap) -> Figure:
    """Draw what the box becomes: in each phase plane at six times, or each component over time."""
    box, names, dof = flow.region, flow.H.names, flow.H.dof
    random = np.random.default_rng(0)
    if box.is_whole:
        shown = min(dof, _MAX_PLANES)
        figure = Figure(figsize=(4.6 * shown, 4.6), layout="constrained")
        side = np.linspace(-1, 1, 200)
        ends = np.ones_like(side)
        around = np.stack(
            (
                np.concatenate((side, ends, -side, -ends)),
                np.concatenate((-ends, side, ends, -side)),
            ),
            axis=1,
        )
        for k, axis in enumerate(figure.subplots(1, shown, squeeze=False)[0]):
            y = np.zeros((len(around), len(box)))
            y[:, [k, dof + k]] = around
            for number, t in enumerate(np.linspace(*flow.span, len(_COLORS))):
                states = flow.map.evaluate(np.full(len(y), t), box.at(y))
                color = _color(number)
                axis.fill(states[:, k], states[:, dof + k], color=color, alpha=0.25, linewidth=0)
                axis.plot(states[:, k], states[:, dof + k], color=color, label=f"t = {t:.4g}")
            axis.set(xlabel=names[k], ylabel=names[dof + k])
            if not k:
                axis.legend(fontsize=8)
        shape = "box" if dof == 1 and len(box) == 2 else "box, through its centre"
        figure.suptitle(_wrapped(f"The {shape}, moved by H = {flow.H.formula}"), fontsize=10)
        return figure
    shown = min(len(names), _MAX_LINES)
    rows = (shown + 1) // 2
    figure = Figure(figsize=(9, 2.2 * rows), layout="constrained")
    times = np.linspace(*flow.span, 401)
    inputs = box.at(random.uniform(-1, 1, (200, len(box))))
    queries = np.tile(times, len(inputs)), inputs.repeat(len(times), axis=0)
    states = flow.map.evaluate(*queries).reshape(len(inputs), len(times), -1)
    grid = figure.subplots(rows, 2, squeeze=False, sharex=True)
    for i, axis in enumerate(grid.ravel()[:shown]):
        low, high = states[..., i].min(axis=0), states[..., i].max(axis=0)
        axis.fill_between(times, low, high, color=_color(i), alpha=0.2, linewidth=0)
        axis.plot(times, states[:8, :, i].T, color=_color(i), linewidth=0.7)
        axis.set(ylabel=names[i])
    for axis in grid.ravel()[shown:]:
        axis.set_axis_off()
    for axis in grid[-1]:
        axis.set_xlabel("t")
    varied = ", ".join(f"{n} from {low:.4g} to {high:.4g}" for n, (low, high) in flow.box.items())
    figure.suptitle(_wrapped(f"H = {flow.H.formula}, {varied}"), fontsize=10)
    return figure


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 90)


@plot.register
def _plot_trajectory(trajectory: Trajectory) -> Figure:
    """Draw components, phase space and the change of H over time in four panels.

    Of an ensemble, the first trajectories are drawn in phase space, and only the first one over
    time.
    """
    figure, axes = _panels(f"{trajectory.method}, {trajectory.steps:,} steps")
    z = trajectory.z.reshape(-1, *trajectory.z.shape[-2:])
    energy = trajectory.energy.reshape(-1, len(trajectory.t))
    names, d = trajectory.names, len(trajectory.names) // 2
    every = max(1, len(trajectory.t) // _SAMPLES)
    t = trajectory.t[::every]
    for i, name in enumerate(names[:_MAX_LINES]):
        axes[0, 0].plot(t, z[0, ::every, i], color=_color(i), label=name, linewidth=1)
    axes[0, 0].set(title="Trajectory", xlabel="t")
    axes[0, 0].legend(ncols=2, fontsize=8)
    for k, path in enumerate(z[:_MAX_LINES]):
        axes[0, 1].plot(path[::every, 0], path[::every, d], ",", color=_color(k))
        if d > 1:
            axes[1, 0].plot(path[::every, 0], path[::every, 1], color=_color(k), linewidth=0.5)
    axes[0, 1].set(title="Phase space", xlabel=names[0], ylabel=names[d])
    if d > 1:
        axes[1, 0].set(title="Orbit", xlabel=names[0], ylabel=names[1])
    else:
        axes[1, 0].set_axis_off()
    for k, values in enumerate(energy[:_MAX_LINES]):
        axes[1, 1].plot(t, (values - values[0])[::every], color=_color(k), linewidth=0.7)
    axes[1, 1].set(title="H(t) - H(0)", xlabel="t")
    return figure


@plot.register
def _plot_fit(found: Fit, number: int = 0) -> Figure:
    """Draw data with the fitted motion above residuals in units of sigma, for each observable.

    Of several sets, the one with this number.
    """
    several = np.ndim(found.success) > 0
    if not 0 <= number < (len(found.success) if several else 1):
        raise InputError(f"number={number!r} is no set of data; give one from 0")
    at = (number,) if several else ()
    labels = list(found.data)[:_MAX_LINES]
    figure = Figure(figsize=(max(7.0, 4.5 * len(labels)), 6), layout="constrained")
    axes = figure.subplots(2, len(labels), sharex=True, squeeze=False, height_ratios=(2, 1))
    values = ", ".join(
        f"{name} = {np.asarray(value)[at]:.6g}" for name, value in found.parameters.items()
    )
    figure.suptitle(f"set {number}: {values}" if several else values, fontsize=11)
    dense = np.linspace(*found.span, _SAMPLES)
    curves = found(dense)
    for column, label in enumerate(labels):
        data, sigma = found.data[label][at], found.sigma[label][at]
        weighted = found.weighted_residuals[label][at]
        above, below = axes[:, column]
        above.errorbar(found.t, data, sigma, fmt=".", color="0.4", markersize=3, elinewidth=0.5)
        above.plot(dense, curves[label][at], color=_color(0), linewidth=1.1)
        above.set(title=label)
        below.plot(found.t, weighted, ".", color=_color(0), markersize=3)
        below.axhline(0.0, color="0.5", linewidth=0.8)
        below.set(xlabel="t", ylabel="residual / sigma")
        for axis in (above, below):
            axis.grid(alpha=0.25)
    return figure


@plot.register
def _plot_section(section: Section, x: str, y: str) -> Figure:
    """Draw crossings of a surface, with a colour for each trajectory."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    axis = figure.subplots()
    i, j = section.names.index(x), section.names.index(y)
    for k, color in enumerate(_COLORS):  # one artist per colour, for any number of trajectories
        points = section.z[section.trajectory % len(_COLORS) == k]
        axis.plot(points[:, i], points[:, j], ".", color=color, markersize=1.5)
    axis.set(title=f"{section.surface}: {len(section.t):,} crossings", xlabel=x, ylabel=y)
    axis.grid(alpha=0.25)
    return figure


@plot.register
def _plot_lyapunov(found: LyapunovExponents) -> Figure:
    """Draw finite-time exponents over time, with the decay for a regular trajectory."""
    figure = Figure(figsize=(7, 5), layout="constrained")
    axis = figure.subplots()
    t = np.abs(found.t - found.start)
    for k in range(found.exponents.shape[1]):
        label = "finite-time exponent" if k == 0 else f"exponent {k + 1}"
        positive = found.exponents[:, k] > 0
        axis.loglog(t[positive], found.exponents[positive, k], color=_color(k), label=label)
    late = t > max(1e-3 * t[-1], np.e)
    if late.any():
        fall = np.log(t[late]) / t[late]
        middle = np.exp(np.mean(np.log(np.abs(found.exponents[late, 0]) / fall)))
        axis.loglog(t[late], middle * fall, "--", color="0.5", linewidth=1, label="log(t)/t")
    axis.set(title=found.title, xlabel="t", ylabel="exponent")
    axis.legend(fontsize=9)
    axis.grid(alpha=0.25)
    return figure


@plot.register
def _plot_lyapunov_map(found: LyapunovMap) -> Figure:
    """Draw the largest exponents of a plane of starts as colours, or of a row as points.

    An axis is the component or parameter that varies along it alone, or the number of the start.
    Starts without an exponent are grey.
    """
    if not 1 <= found.maximal.ndim <= 2:
        raise InputError(
            f"exponents of shape {found.maximal.shape} are neither a row nor a plane; draw "
            "found.maximal yourself"
        )
    columns = dict(zip(found.names, np.moveaxis(found.z0, -1, 0), strict=True)) | found.parameters
    figure = Figure(figsize=(7, 5.5), layout="constrained")
    axis = figure.subplots()
    label = f"largest exponent, t = {found.span[1]:.6g}"
    if found.maximal.ndim == 1:
        x_name, x = _grid_line(columns, 0, found.maximal.shape)
        axis.plot(x, found.maximal, ".", color=_color(0), markersize=3)
        axis.set(title=found.title, xlabel=x_name, ylabel=label)
        axis.grid(alpha=0.25)
        return figure
    y_name, y = _grid_line(columns, 0, found.maximal.shape)
    x_name, x = _grid_line(columns, 1, found.maximal.shape)
    image = axis.pcolormesh(x, y, found.maximal, shading="nearest", rasterized=True)
    axis.set(title=found.title, xlabel=x_name, ylabel=y_name, facecolor="0.85")
    figure.colorbar(image, label=label)
    return figure


def _grid_line(
    columns: dict[str, np.ndarray], along: int, shape: tuple[int, ...]
) -> tuple[str, np.ndarray]:
    """Return the name and values of the column that varies along one axis of a grid alone.

    Values of starts that are nan are interpolated from their neighbours.
    """
    number = np.arange(shape[along])
    for name, values in columns.items():
        rows = np.moveaxis(values, along, 0).reshape(len(number), -1)
        there = np.isfinite(rows).any(axis=1)
        if there.sum() < 2:
            continue
        low, high = np.nanmin(rows[there], axis=1), np.nanmax(rows[there], axis=1)
        if np.all(low == high) and np.all(np.diff(low) > 0):
            line = np.interp(number, number[there], low)
            slope = (low[-1] - low[0]) / (number[there][-1] - number[there][0])
            before, after = np.minimum(number - number[there][0], 0), number - number[there][-1]
            return name, line + slope * (before + np.maximum(after, 0))
    return "number", number


@plot.register
def _plot_comparison(comparison: Comparison) -> Figure:
    """Draw errors and energies over time, errors in phase space, and errors against work."""
    solution = comparison.solution
    figure, axes = _panels(f"H = {solution.H.formula}")
    t = np.linspace(*solution.span, _SAMPLES)
    names, d = solution.H.names, solution.H.dof
    system = solution.H.compile("numpy")
    curves = [("network", t, solution(t), _color(0))]
    curves += [
        (f"{row.label}, {_amount(row)}", path.t, path.z, color)
        for row, path, color in _shown(comparison)
    ]
    sizes = [np.abs(z - comparison.reference(times)).max() for _, times, z, _ in curves]
    orders = np.log(_positive(np.nan_to_num(np.array(sizes), nan=np.inf)))
    nearest = 1 + int(np.argmin(np.abs(orders[1:] - orders[0])))
    for i, (label, times, z, color) in enumerate(curves):
        right = comparison.reference(times)
        error = z - right
        style: dict[str, Any] = {"color": color, "label": label, "linewidth": 1.1}
        axes[0, 0].semilogy(times[1:], _positive(np.linalg.norm(error, axis=-1))[1:], **style)
        energy = np.abs(
            system.energy(*system.arguments(z, times))
            - system.energy(*system.arguments(right, times))
        )
        axes[0, 1].semilogy(times[1:], _positive(energy)[1:], **style)
        if i in (0, nearest):  # others are on another scale than the network's
            axes[1, 0].plot(error[:, 0], error[:, d], **style)
    axes[0, 0].set(title=r"Error $|\delta z|$", xlabel="t")
    axes[0, 1].set(title="Energy error", xlabel="t")
    x, p = names[0], names[d]
    axes[1, 0].set(title="Error in phase space", xlabel=f"error of {x}", ylabel=f"error of {p}")
    axes[1, 0].ticklabel_format(style="sci", scilimits=(-2, 2))
    network = comparison.rows[0]
    for i, name in enumerate(comparison.matches):
        own = [row for row in comparison.rows if row.label == name and np.isfinite(row.error)]
        work, errors = [row.evaluations for row in own], [row.error for row in own]
        axes[1, 1].loglog(work, errors, "o-", color=_color(i + 1), markersize=4, label=name)
    axes[1, 1].loglog(network.evaluations, network.error, "s", color=_color(0), label="network")
    axes[1, 1].axhline(network.error, color=_color(0), linewidth=0.8, linestyle=":")
    axes[1, 1].set(title="Error against evaluations", xlabel="evaluations of the vector field")
    axes[1, 1].legend(fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
    return figure


def _shown(comparison: Comparison) -> list[tuple[Row, Trajectory, str]]:
    """Return all trajectories of one integrator, or the middle one of each of several."""
    pairs = list(zip(comparison.rows[1:], comparison.trajectories, strict=True))
    if len(comparison.matches) == 1:
        return [(*pair, _color(1 + i)) for i, pair in enumerate(pairs)]
    middle = [[pair for pair in pairs if pair[0].label == name][1] for name in comparison.matches]
    return [(*pair, _color(1 + i)) for i, pair in enumerate(middle)]


def _amount(row: Row) -> str:
    return f"{row.points:,} steps" if row.tolerance is None else f"rtol {row.tolerance:.0e}"


def _panels(title: str) -> tuple[Figure, Any]:
    # Not a figure of pyplot, which has global state and needs a window system.
    figure = Figure(figsize=(10, 7), layout="constrained")
    axes = figure.subplots(2, 2)
    figure.suptitle(title if len(title) <= 100 else title[:97] + "...", fontsize=11)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    return figure, axes


def _color(index: int) -> str:
    return _COLORS[index % len(_COLORS)]


def _positive(values: np.ndarray) -> np.ndarray:
    """Return values for a logarithmic axis, on which zero is not allowed."""
    return np.maximum(values, 1e-17)
