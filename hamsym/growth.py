"""Units and precision for a proof, guessed from a trajectory in floating-point numbers.

Nothing here is proven and nothing has to be: a bad guess makes a proof slower, or makes it fail.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.integrate

from hamsym.hamiltonian import Hamiltonian
from hamsym.tangent import generators

__all__ = ["Scout", "scout"]

_SAMPLES = 1_000
_CALLS = 60_000  # of the vector field
_SWEEPS = 6
_FINEST = 96  # bits, with which everything starts
_COARSEST = 32  # steps of the precision


class _TooManyCalls(Exception):  # noqa: N818
    pass


@dataclass(frozen=True)
class Scout:
    """What a trajectory in floating-point numbers suggests.

    Attributes
    ----------
    units : tuple of float
        Sizes of the components, powers of two, in which the logarithmic norm grows slowly.
    growth : float
        log2 of the growth of errors over the span by the logarithmic norm, about.
    energy_scale, rate_scale : float
        Sizes of changes of H across the motion, and of the vector field (2-norm).
    """

    units: tuple[float, ...]
    growth: float
    energy_scale: float
    rate_scale: float

    @property
    def bits(self) -> int:
        """Precision at which the reference is likely to be accurate enough."""
        needed = _FINEST + max(0.0, 1.1 * self.growth - 14)
        return _COARSEST * math.ceil(min(needed, 1e6) / _COARSEST)


def scout(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], guess: np.ndarray
) -> Scout:
    """Follow the trajectory roughly.

    Parameters
    ----------
    H : Hamiltonian
    z0 : numpy.ndarray
        Shape (dim,).
    span : (float, float)
    guess : numpy.ndarray
        Sizes of the components, shape (dim,), for scaling.
    """
    with np.errstate(all="ignore"):
        times, states = _trajectory(H, z0, span, guess)
        system = H.compile("numpy")
        matrices = generators(np.asarray(system.hessian(*system.arguments(states, times))))
        rates = np.asarray(system.vector_field(*system.arguments(states, times)))
        usable = np.isfinite(matrices).all(axis=(1, 2)) & np.isfinite(rates).all(axis=1)
        times, matrices, rates = times[usable], matrices[usable], rates[usable]
        exponents = _exponents(np.abs(states[usable]).max(axis=0, initial=0.0))
        if len(times) < 2:
            return Scout(tuple(2.0**exponents), 0.0, 1.0, 1.0)
        exponents, growth = _calmest(times, matrices, exponents)
        units = 2.0**exponents
        slopes = np.roll(np.abs(rates), H.dof, axis=1)
    return Scout(
        units=tuple(float(unit) for unit in units),
        growth=growth / math.log(2),
        energy_scale=float((slopes * units).sum(axis=1).max()),
        rate_scale=float(np.linalg.norm(rates, axis=1).max()),
    )


def _trajectory(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times and states, shapes (n,) and (n, dim), as far as it goes."""
    system, calls = H.compile("numpy"), 0
    found = [(span[0], z0)]
    unit = 2.0 ** _exponents(np.maximum(np.abs(z0), guess))

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > _CALLS:
            raise _TooManyCalls
        return np.asarray(system.vector_field(*system.arguments(y * unit, t))) / unit

    solver = scipy.integrate.DOP853(
        rate, span[0], z0 / unit, span[1], rtol=1e-8, atol=1e-10
    )
    try:
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                break
            dense = solver.dense_output()
            share = abs(solver.t - solver.t_old) / abs(span[1] - span[0])
            for t in np.linspace(solver.t_old, solver.t, 3 + int(_SAMPLES * share))[1:]:
                found.append((float(t), dense(t) * unit))
    except (_TooManyCalls, ValueError, FloatingPointError):
        pass
    return np.array([t for t, _ in found]), np.array([z for _, z in found])


def _exponents(sizes: np.ndarray) -> np.ndarray:
    """Powers of two of the sizes; those of the same half where a component does not move."""
    halves = np.where(np.isfinite(sizes), sizes, 0.0).reshape(2, -1)
    largest = halves.max(axis=1, keepdims=True)
    known = np.where(halves > 1e-8 * largest, halves, largest)
    known = np.where(known > 0, known, 1.0)
    return np.asarray(np.ceil(np.log2(known)).ravel())


def _calmest(
    times: np.ndarray, matrices: np.ndarray, exponents: np.ndarray
) -> tuple[np.ndarray, float]:
    """Units in which the logarithmic norm integrates to little, and to how much."""
    steps = np.abs(np.diff(times))

    def integral(exponents: np.ndarray) -> float:
        units = 2.0**exponents
        scaled = matrices * (units / units[:, None])
        symmetric = (scaled + scaled.transpose(0, 2, 1)) / 2
        own = np.einsum("nii->ni", symmetric)
        circles = own + np.abs(symmetric).sum(axis=2) - np.abs(own)
        norms = np.maximum(circles.max(axis=1), 0)
        return float((steps * (norms[1:] + norms[:-1])).sum() / 2)

    best = integral(exponents)
    dim = len(exponents)
    # All coordinates against all momenta first, then each component alone.
    moves = [np.repeat([1.0, 0.0], dim // 2), *np.eye(dim)]
    for _ in range(_SWEEPS):
        before = best
        for move, sign in ((move, sign) for move in moves for sign in (1, -1)):
            while (found := integral(exponents + sign * move)) < 0.999 * best:
                exponents, best = exponents + sign * move, found
        if best >= 0.99 * before:
            break
    return exponents, best
