"""Figures of equilibria: places with types over level sets, and eigenvalues of one."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from hamsym.dynamics.equilibrium import Equilibria, Equilibrium
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.plotting.captions import caption_words
from hamsym.plotting.figure import Figure, figure_of, label, one_panel
from hamsym.plotting.motions import drawn_of, same_scale
from hamsym.plotting.names import energy_unit, math_name, number, quantity, words_of
from hamsym.plotting.phase_portraits import draw_contours, draw_levels
from hamsym.plotting.style import COLUMN, GREY, MAX_LINES, color_of, marker_style

_GRID, _LEVELS = 161, 16
_QUADRATIC = 1e-6  # of the rates, which vanish at zero velocity
_MOST_NUMBERED = 60
_NEAR = 1e-9  # of the axes: places that differ by round-off have one label


def draw_equilibria(found: Equilibria, *names: Any, ax: Any = None) -> Any:
    """Draw equilibria in a plane; see :meth:`hamsym.Equilibria.plot`."""
    H = found.H
    if len(names) not in (0, 2):
        raise InputError(f"equilibria are drawn in a plane; give two components, not {len(names)}")
    _, drawn = drawn_of(H, names or H.names[:2])
    for each in drawn:
        if each.place is None:
            raise InputError(
                f"'{each.text}' is a formula; equilibria and what surrounds them are drawn in the "
                f"plane of two components of {', '.join(H.names[:MAX_LINES])}"
            )
    x, y = (each.text for each in drawn)
    if x == y:
        raise InputError(f"the plane of '{x}' and '{x}' is a line; give two different components")
    there = [k for k, each in enumerate(found) if np.isfinite(each.z).all()]
    if not there and not found.undecided:
        raise InputError(f"there is no equilibrium to draw: {found.message}")
    sentences: list[Any] = [found.message]
    if len(there) < len(found):
        sentences.append(
            f"{len(found) - len(there)} of {len(found)} equilibria are not drawn, as a parameter "
            "has no value"
        )
    if any(found[k].family for k in there):
        sentences.append("Open markers: one point of a continuum")
    if found.undecided:
        sentences.append("Hatched: parts that could not be decided")
    caption = caption_words(H, *sentences)
    with one_panel(ax, caption, width=COLUMN + 2.5, height=8.0) as axes:
        i, j = H.names.index(x), H.names.index(y)
        equal = same_scale(H, x, y)
        _set_limits(axes, found, there, i, j, equal, _sizes_of(found, there, i, j))
        _draw_places(axes, found, there, i, j)
        _draw_undecided(axes, found, i, j)
        if equal:
            axes.set_aspect("equal")
        notes = _draw_behind(axes, H, x, y)
        label(axes.xaxis, *quantity(H, x))
        label(axes.yaxis, *quantity(H, y))
        count = f"{len(found):,} equilibri{'um' if len(found) == 1 else 'a'}"
        axes.set_title(count + (", proven to be all in the box" if found.complete else ""))
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
        figure = figure_of(axes)
        if ax is None:
            figure.add_to_caption(notes)
        return figure


def _draw_places(axes: Axes, found: Equilibria, there: list[int], i: int, j: int) -> None:
    kinds = sorted({found[k].type for k in there})
    places = np.array([[found[k].z[i], found[k].z[j]] for k in there]).reshape(-1, 2)
    near = _NEAR * np.abs(np.diff([axes.get_xlim(), axes.get_ylim()])[:, 0])
    for number_of, kind in enumerate(kinds):
        style, named = marker_style(number_of), False
        for filled in (True, False):
            own = [k for k in there if found[k].type == kind and (not found[k].family) == filled]
            if not own:
                continue
            axes.plot(
                [found[k].z[i] for k in own],
                [found[k].z[j] for k in own],
                markersize=5,
                markerfacecolor=style["color"] if filled else "none",
                label=None if named else kind,
                zorder=4,
                **style,
            )
            named = True
    drawn, left = [], np.arange(min(len(there), _MOST_NUMBERED))
    while len(left):
        place = places[left[0]]
        here = (np.abs(places[left] - place) <= near).all(axis=1)
        numbers = [f"{there[k] + 1}" for k in left[here]]
        left = left[~here]
        shown = ", ".join(numbers[:4]) + (", …" if len(numbers) > 4 else "")
        drawn.append(
            axes.annotate(shown, place, (4, 3), textcoords="offset points", fontsize=6, zorder=5)
        )
    figure = figure_of(axes)
    if isinstance(figure, Figure):
        figure.thin_out(drawn)


def _draw_undecided(axes: Axes, found: Equilibria, i: int, j: int) -> None:
    style: dict[str, Any] = {"hatch": "////", "edgecolor": "0.5", "linewidth": 0.5}
    for region in found.undecided:
        low, (width, height) = region.low, np.subtract(region.high, region.low)[[i, j]]
        axes.add_patch(Rectangle((low[i], low[j]), width, height, fill=False, **style))


def _sizes_of(found: Equilibria, there: list[int], i: int, j: int) -> tuple[float, float] | None:
    """Return half the width and height of the surroundings of one equilibrium alone, of 1 dof.

    The coordinate goes to where H is no longer quadratic, by half, or to 1; the momentum to where
    it has changed H as much.
    """
    H = found.H
    if (
        len(there) != 1
        or found.undecided
        or H.dof != 1
        or H.time is not None
        or H.unbound_parameters
    ):
        return None
    place = np.asarray(found[there[0]].z, dtype=float)
    system = H.compile("numpy")

    def change(index: int, sizes: np.ndarray) -> np.ndarray:
        z = np.tile(place, (len(sizes), 1))
        z[:, index] += sizes
        return np.abs(system.at("energy", z) - system.at("energy", place))

    sizes = 10.0 ** np.linspace(-40, 6, 461)
    with np.errstate(all="ignore"):
        curvatures = np.abs(np.diagonal(np.asarray(system.hessian(place)).reshape(2, 2)))
        if not (np.isfinite(curvatures) & (curvatures > 0)).all():
            return None
        changes = change(0, sizes)
        quadratic = curvatures[0] * sizes**2 / 2
        lost = np.abs(changes - quadratic) > 0.5 * quadratic
        resolved = quadratic > 1e-9 * abs(float(system.energy(place)))
        beyond = np.flatnonzero(lost & resolved)
        q = sizes[beyond[0]] if len(beyond) else 1.0
        p = q * float(np.sqrt(curvatures[0] / curvatures[1]))
    halves = {0: float(q), 1: p}
    return (halves[i], halves[j]) if np.isfinite(p) and p > 0 else None


def _set_limits(
    axes: Axes,
    found: Equilibria,
    there: list[int],
    i: int,
    j: int,
    equal: bool,
    sizes: tuple[float, float] | None,
) -> None:
    """Leave room around the places: half of their extent, or sizes of their own."""
    middles, halves = [], []
    for column in (i, j):
        ends = [found[k].z[column] for k in there]
        ends += [end[column] for region in found.undecided for end in (region.low, region.high)]
        middles.append(float(min(ends) + max(ends)) / 2)
        halves.append(float(max(ends) - min(ends)) / 2)
    largest, rooms = max(halves), []
    for middle, half in zip(middles, halves, strict=True):
        room = half if half > 1e-9 * max(largest, abs(middle)) else max(largest, abs(middle)) or 1.0
        rooms.append(1.5 * (max(room, largest) if equal else room))
    if sizes is not None and not equal:
        rooms = [2 * size for size in sizes]
    (x, y), (width, height) = middles, rooms
    axes.set(xlim=(x - width, x + width), ylim=(y - height, y + height))


def _draw_behind(axes: Axes, H: Hamiltonian, x: str, y: str) -> list[Any]:
    """Draw level sets behind equilibria; return sentences for the caption."""
    if H.unbound_parameters or H.time is not None:
        return []
    if H.dof == 1:
        return draw_levels(axes, H, x, y)
    if H.dof > 2 or {x, y} != set(H.names[:2]):
        return ["Level sets are not drawn: H has more variables than this plane"]
    limits = axes.get_xlim(), axes.get_ylim()
    sides = [np.linspace(*ends, _GRID) for ends in limits]
    columns = dict(zip((x, y), np.meshgrid(*sides), strict=True))
    q = np.stack([columns[name] for name in H.names[:2]], axis=-1)
    values = energy_at_rest(H, q)
    if values is None:
        return ["Level sets are not drawn: H is not quadratic in the momenta"]
    finite = values[np.isfinite(values)]
    if not finite.size or not np.ptp(finite) > 0:
        return []
    _, unit = draw_contours(axes, sides, values, _LEVELS)
    unit += energy_unit(H).split()
    words = ["Grey:", "level", "sets", "of", "$H$", "at", "zero", "velocity"]
    return [[*words, "in", *unit] if unit else words]


def energy_at_rest(H: Hamiltonian, q: np.ndarray) -> np.ndarray | None:
    """Return H where the velocities vanish, for coordinates of shape (..., dof).

    For H = T(p) + V(q) it is the potential, in a rotating frame the effective potential. It is
    None if H is not quadratic in the momenta.
    """
    system, d = H.compile("numpy"), H.dof
    z = np.concatenate((q, np.zeros_like(q)), axis=-1)
    with np.errstate(all="ignore"):
        hessian = np.broadcast_to(system.hessian(z), (*z.shape, 2 * d))[..., d:, d:]
        slope = np.broadcast_to(system.gradient(z), z.shape)[..., d:]
        there = np.isfinite(hessian).all(axis=(-1, -2)) & np.isfinite(slope).all(axis=-1)
        there &= np.abs(np.linalg.det(np.where(there[..., None, None], hessian, np.eye(d)))) > 0
        safe = np.where(there[..., None, None], hessian, np.eye(d))
        p = -np.linalg.solve(safe, np.where(there[..., None], slope, 0.0)[..., None])[..., 0]
        z = np.concatenate((q, p), axis=-1)
        rest = np.broadcast_to(system.gradient(z), z.shape)[..., d:]
        size = np.abs(slope).max(axis=-1) + np.abs(hessian).max(axis=(-1, -2)) * np.abs(p).max()
        values = np.broadcast_to(system.energy(z), z.shape[:-1])
    good = there & (np.abs(rest).max(axis=-1) <= _QUADRATIC * size + 1e-300)
    if not good[there].all() or not there.any():
        return None
    return np.where(there & np.isfinite(values), values, np.nan)


def draw_equilibrium(found: Equilibrium, *, ax: Any = None) -> Any:
    """Draw the eigenvalues of an equilibrium; see :meth:`hamsym.Equilibrium.plot`."""
    if found.linear is None:
        raise InputError(
            "the eigenvalues are unknown, as a parameter has no value; give values of all of them"
        )
    marks = []
    for frequency, signature in zip(found.frequencies, found.signatures, strict=True):
        sign = "+" if signature > 0 else "−"
        marks.append((1j * float(frequency), f"{number(float(frequency), 6)} ({sign})"))
    marks += [
        (complex(value), number(float(value.real), 6))
        for value in found.eigenvalues
        if value.real > 0 and value.imag >= 0
    ]
    state = [
        f"{math_name(name)} = {number(float(value) + 0.0, 6)},"
        for name, value in zip(found.names[:12], found.z, strict=False)
    ]
    if len(found.names) > 12:
        state += [*words_of(f"and {len(found.names) - 12} more components,")]
    signs = "of the frequencies (Krein signatures: signs of their energies)"
    caption = [found.type[:1].upper() + found.type[1:], "at", *state]
    caption += [f"energy {number(found.energy, 8)},", *words_of(f"{found.stability}.")]
    if len(found.frequencies):
        caption += words_of(f"In brackets, signs {signs}.")
    caption += words_of(f"{found.spectrum[:1].upper()}{found.spectrum[1:]}.")
    figure_words = caption + words_of(f"{found.evidence.partition(':')[0].capitalize()}.")
    with one_panel(ax, figure_words, height=7.5) as axes:
        _draw_exponents(axes, found.eigenvalues, marks, f"Eigenvalues: {found.type}")
        return figure_of(axes)


def _draw_exponents(
    axes: Axes, values: np.ndarray, marks: list[tuple[complex, str]], title: str
) -> None:
    """Draw eigenvalues of a linearised motion, with the axes that separate its kinds.

    - marks: Texts beside eigenvalues.
    """
    values = np.asarray(values, dtype=complex)
    axes.axhline(0, color=GREY, linewidth=0.7)
    axes.axvline(0, color=GREY, linewidth=0.7)
    growing = values.real > 0
    for k, own in enumerate((values[~growing], values[growing])):
        axes.plot(own.real, own.imag, "x", color=color_of(k), markersize=7)
    size = float(np.abs(values).max(initial=0.0)) or 1.0
    axes.set(xlim=(-1.25 * size, 1.25 * size), ylim=(-1.25 * size, 1.25 * size))
    axes.set_aspect("equal")
    texts = [
        axes.annotate(
            text, (place.real, place.imag), (6, 0), textcoords="offset points", va="center"
        )
        for place, text in marks
    ]
    if isinstance(figure := figure_of(axes), Figure):
        figure.thin_out(texts)
    axes.set_title(title)
    label(axes.xaxis, r"Re $\lambda$")
    label(axes.yaxis, r"Im $\lambda$")
