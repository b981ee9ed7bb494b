"""Starts that are proposed for a system: accepted by ``solve``, near a stable equilibrium."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import scipy

import hamsym
from hamsym.hamiltonian import Hamiltonian

_LARGEST_GROWTH = 10.0  # of the coordinates, against the first quarter


def usual_state(names: Sequence[str]) -> dict[str, float]:
    """Return an initial state for a new H: different coordinates, so that nothing collides.

    Examples
    --------
    >>> usual_state(("x", "y", "p_x", "p_y"))
    {'x': 1.0, 'y': 0.54, 'p_x': 0.0, 'p_y': 0.67}
    """
    dof = len(names) // 2
    coordinates = {name: round(math.cos(k), 2) for k, name in enumerate(names[:dof])}
    return coordinates | {name: round(0.8 * math.sin(k), 2) for k, name in enumerate(names[dof:])}


def proposed_start(
    H: Hamiltonian, span: tuple[float, float], first: Sequence[float] | None = None
) -> dict[str, float]:
    """Return a start whose motion ``solve`` accepts and that does not escape.

    The usual state, if it is one; else the same nearer to a stable equilibrium, if there is one,
    or to the origin. The first one that was tried, if none is accepted.

    - first: A start that is tried before all others.

    Examples
    --------
    >>> H = Hamiltonian("(p_x**2 + p_y**2 + x**2 + y**2)/2 + x**2*y - y**3/3")
    >>> proposed_start(H, (0, 20))
    {'x': 0.25, 'y': 0.135, 'p_x': 0.0, 'p_y': 0.1675}
    """
    tried: list[list[float]] = []
    for state in _candidates(H, span[0], first):
        tried.append(state)
        if _stays(H, state, span):
            return dict(zip(H.names, state, strict=True))
    return dict(zip(H.names, tried[0], strict=True))


def _candidates(
    H: Hamiltonian, time: float, first: Sequence[float] | None
) -> Iterator[list[float]]:
    if first is not None:
        yield list(first)
    usual = np.array(list(usual_state(H.names).values()))
    yield usual.tolist()
    moving = usual + np.repeat([0.0, 0.5], H.dof)  # an angle without momentum may fall to a centre
    yield np.round(moving, 2).tolist()
    centre = _stable_equilibrium(H, usual, time)
    for share in (0.5, 0.25, 0.125, 0.05, 0.01):
        yield [float(f"{value:.6g}") for value in centre + share * usual]


def _stable_equilibrium(H: Hamiltonian, near: np.ndarray, time: float) -> np.ndarray:
    """A minimum of H at rest, of the origin and of what descent from a state finds; else zero."""
    system, d = H.compile("numpy"), H.dof

    def at_rest(q: np.ndarray) -> np.ndarray:
        return np.concatenate([q, np.zeros(d)])

    def height(q: np.ndarray) -> float:
        value = float(system.at("energy", at_rest(q), time))
        return value if math.isfinite(value) else 1e300

    def slope(q: np.ndarray) -> np.ndarray:
        return np.nan_to_num(system.at("gradient", at_rest(q), time)[:d])

    origin = np.zeros(2 * d)
    with np.errstate(all="ignore"):
        for q in (np.zeros(d), near[:d]):
            if q.any():
                q = scipy.optimize.minimize(height, q, jac=slope, options={"maxiter": 100}).x
            z = at_rest(q)
            gradient = system.at("gradient", z, time)
            hessian = system.at("hessian", z, time)
            if not np.isfinite(hessian).all() or not np.abs(gradient).max() <= 1e-4:
                continue
            if np.linalg.eigvalsh(hessian).min() >= -1e-9 * np.abs(hessian).max():
                return z
    return origin


def _stays(H: Hamiltonian, state: Sequence[float], span: tuple[float, float]) -> bool:
    """Whether a motion is accepted, moves, and its coordinates do not escape."""
    try:
        solution = hamsym.solve(H, list(state), span, progress=False)
    except hamsym.HamsymError:
        return False
    if not solution.success:
        return False
    z = solution(np.linspace(*span, 201))
    sizes = np.abs(z[:, : H.dof]).max(axis=1)
    moves = bool(np.any(np.ptp(z, axis=0) > 1e-9 * np.abs(z).max()))
    return moves and bool(sizes.max() <= _LARGEST_GROWTH * sizes[:51].max())
