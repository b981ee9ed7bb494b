"""Level sets of H in the phase plane of one degree of freedom."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.figure import Figure, figure_of
from hamsym.plotting.names import energy_unit, number

_LEVELS = 9
_GRID = 241


def draw_levels(axes: Axes, H: Hamiltonian, x: str, y: str, own: float | None = None) -> list[Any]:
    """Draw labelled level sets of H within the limits of axes; return sentences for the caption.

    H has one degree of freedom and no explicit time.

    - own: Energy at the start of a trajectory, which the caption says.
    """
    limits = axes.get_xlim(), axes.get_ylim()
    sides = [np.linspace(*limit, _GRID) for limit in limits]
    columns = dict(zip((x, y), np.meshgrid(*sides), strict=True))
    z = np.stack([columns[name] for name in H.names], axis=-1)
    energy = H.compile("numpy").at("energy", z, np.zeros(z.shape[:-1]))
    values = np.where(np.isfinite(energy), np.broadcast_to(energy, z.shape[:-1]), np.nan)
    finite = values[np.isfinite(values)]
    if not finite.size or not np.ptp(finite) > 0:
        return ["H has no level sets in this part of the phase plane"]
    power, unit = draw_contours(axes, sides, values, _LEVELS)
    axes.set(xlim=limits[0], ylim=limits[1])
    unit += energy_unit(H).split()
    kept = "" if H.conserves_energy else ", which forces change along a trajectory"
    words = ["Grey:", "level", "sets", "of", "$H$" + kept]
    if unit:
        words += ["in", *unit]
    if own is not None and np.isfinite(own):
        words[-1] += ";"
        words += ["at", "the", "start", "$H$", "=", number(own / 10.0**power, 4)]
    return [words]


def draw_contours(
    axes: Axes, sides: Sequence[np.ndarray], values: np.ndarray, count: int
) -> tuple[int, list[str]]:
    """Draw a number of labelled level sets of values on a grid.

    Return the power of ten in which the labels are, and the words that say so.
    """
    finite = values[np.isfinite(values)]
    levels = np.unique(np.quantile(finite, np.linspace(0.03, 0.97, count)))
    power = power_of_ten(float(np.abs(levels).max()))
    lines = axes.contour(
        *sides, values, levels=levels, colors="0.6", linewidths=0.6, linestyles="-", zorder=1
    )
    texts = axes.clabel(
        lines,
        fmt={level: f"{level / 10.0**power:.3g}".replace("-", "−") for level in levels},
        inline=False,
    )
    for text in texts:
        text.set(fontsize=6, color="0.35", zorder=1.5)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4})
    figure = figure_of(axes)
    if isinstance(figure, Figure):
        figure.thin_out(texts)
    return power, [f"$10^{{{power}}}$"] if power else []


def power_of_ten(size: float) -> int:
    """Return the power of ten in which numbers of a size are written; 0 without one."""
    power = int(np.floor(np.log10(size))) if np.isfinite(size) and size > 0 else 0
    return 0 if -3 <= power < 4 else power
