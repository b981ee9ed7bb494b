"""Units and precision of a proof, estimated by a non-rigorous pre-integration.

The proof does not depend on these estimates: with poor ones it takes longer, or fails.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import scipy.integrate

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.call_limit import TooManyCallsError, limited

__all__ = ["Presolution", "presolve"]

_SAMPLES = 1_000  # of the trajectory, at least
_CALLS = 60_000  # of the vector field, at most
_SWEEPS = 6  # over all changes of units
_LEAST_BITS = 96
_BITS_STEP = 32
_CALM = 7.0  # error growth, as a natural logarithm, below which one set of units suffices
_MOST_PARTS = 300  # parts of the span with their own units
_ROUNDS = 6  # of choosing these parts
_RANGE = 1_000  # largest exponent of a scale that is a power of two


#: Pairs of an elapsed time and the units of the components from there on.
Schedule = tuple[tuple[float, tuple[float, ...]], ...]


@dataclass(frozen=True)
class Presolution:
    """Units and precision suggested by a non-rigorous pre-integration.

    Attributes
    ----------
    scales : tuple of float
        Sizes of the components, powers of two.
    units : tuple of (float, tuple of float)
        Elapsed times, the first of which is 0, and the units of errors from there on, powers of
        two. In these units the logarithmic norm is small.
    times, growths : numpy.ndarray
        Elapsed times, and estimates of log2 of the error growth until then, by the logarithmic norm
        and by changes of units; shape (n,).
    energy_scale, rate_scale : float
        Scales of the change of H along the motion, and of the vector field (2-norm).
    """

    scales: tuple[float, ...]
    units: Schedule
    times: np.ndarray = field(repr=False)
    growths: np.ndarray = field(repr=False)
    energy_scale: float
    rate_scale: float

    @property
    def bits(self) -> int:
        """Precision at which the enclosure of the solution should be accurate enough."""
        needed = _LEAST_BITS + max(0.0, 1.1 * float(self.growths[-1]) - 10)
        return _BITS_STEP * math.ceil(min(needed, 1e6) / _BITS_STEP)

    def until(self, bits: int) -> float:
        """The elapsed time for which a precision should suffice."""
        return float(
            self.times[np.searchsorted(self.growths, bits - _LEAST_BITS, side="right") - 1]
        )


def presolve(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], guess: np.ndarray
) -> Presolution:
    """Integrate with DOP853 to estimate scales, units and error growth.

    Parameters
    ----------
    H : Hamiltonian
    z0 : numpy.ndarray
        Shape (dim,).
    span : (float, float)
    guess : numpy.ndarray
        Approximate sizes of the components, shape (dim,).
    """
    with np.errstate(all="ignore"):
        times, states = _trajectory(H, z0, span, guess)
        system = H.compile("numpy")
        matrices = np.asarray(system.jacobian(*system.arguments(states, times)))
        rates = np.asarray(system.vector_field(*system.arguments(states, times)))
        usable = np.isfinite(matrices).all(axis=(1, 2)) & np.isfinite(rates).all(axis=1)
        times, matrices, rates = times[usable], matrices[usable], rates[usable]
        exponents = _exponents(np.abs(states[usable]).max(axis=0, initial=0.0))
        scales = 2.0**exponents
        if len(times) < 2:
            nothing = np.zeros(1)
            return Presolution(
                _numbers(scales), ((0.0, _numbers(scales)),), nothing, nothing, 1.0, 1.0
            )
        elapsed = np.abs(times - span[0])
        schedule, growths = _schedule(elapsed, matrices, exponents)
        slopes = np.roll(np.abs(rates), H.dof, axis=1)
    return Presolution(
        scales=_numbers(scales),
        units=schedule,
        times=elapsed,
        growths=growths / math.log(2),
        energy_scale=float((slopes * scales).sum(axis=1).max()),
        rate_scale=float(np.linalg.norm(rates, axis=1).max()),
    )


def _numbers(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _schedule(
    times: np.ndarray, matrices: np.ndarray, exponents: np.ndarray
) -> tuple[Schedule, np.ndarray]:
    """Units for parts of the span, and the error growth until each time.

    A change to larger units is free; a change to smaller units multiplies errors by the ratio. Near
    a close encounter this costs far less than fixed units.
    """
    units, total = _best_units(times, matrices, exponents)
    rates = _norms(matrices, units)
    growth = np.concatenate(([0.0], np.cumsum(np.diff(times) * (rates[1:] + rates[:-1]) / 2)))
    best: tuple[Schedule, np.ndarray] = ((0.0, _numbers(2.0**units)),), growth
    if not _CALM <= total < math.inf:
        return best
    for _ in range(_ROUNDS):
        found, growth = _parts(times, matrices, units, growth)
        if not growth[-1] < 0.8 * best[1][-1]:
            break
        best = found, growth
    return best


def _parts(
    times: np.ndarray, matrices: np.ndarray, units: np.ndarray, growth: np.ndarray
) -> tuple[Schedule, np.ndarray]:
    """Units for parts of equal error growth, and the error growth with these units."""
    total = float(growth[-1])
    count = int(min(total / _CALM * 2, _MOST_PARTS))
    joints = np.searchsorted(growth, np.linspace(0, total, count + 1)[1:-1])
    end = len(times) - 1
    joints = np.unique(np.concatenate(([0], np.clip(joints, 0, end), [end])))
    found: list[tuple[float, tuple[float, ...]]] = []
    costs, current = np.zeros(len(times)), None
    for first, last in pairwise(joints):
        part = slice(first, last + 1)
        start = units if current is None else current
        chosen, _ = _best_units(times[part], matrices[part], start, current)
        rates = _norms(matrices[part], chosen)
        costs[first + 1 : last + 1] = np.diff(times[part]) * (rates[1:] + rates[:-1]) / 2
        if current is not None:
            costs[first + 1] += math.log(2) * max(0.0, float((current - chosen).max()))
        current = chosen
        found.append((float(times[first]), _numbers(2.0**current)))
    return tuple(found), np.cumsum(costs)


def _trajectory(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Times and states, shapes (n,) and (n, dim), until the integration fails or ends."""
    system = H.compile("numpy")
    found = [(span[0], z0)]
    # The start sets the scales, because a trajectory that escapes becomes large later; at rest the
    # largest sizes set them.
    at_rest = ~np.abs(z0).reshape(2, -1).any(axis=1).repeat(H.dof)
    own, largest = _exponents(np.abs(z0)), _exponents(guess)
    unit = 2.0 ** np.where(at_rest, largest, np.minimum(own, largest))

    def vector_field(t: float, y: np.ndarray) -> np.ndarray:
        return np.asarray(system.vector_field(*system.arguments(y * unit, t))) / unit

    rate = limited(vector_field, _CALLS)

    try:
        solver = scipy.integrate.DOP853(rate, span[0], z0 / unit, span[1], rtol=1e-8, atol=1e-12)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                break
            dense = solver.dense_output()
            share = abs(solver.t - solver.t_old) / abs(span[1] - span[0])
            for t in np.linspace(solver.t_old, solver.t, 3 + int(_SAMPLES * share))[1:]:
                found.append((float(t), dense(t) * unit))
    except (TooManyCallsError, ValueError, OverflowError, FloatingPointError):
        pass
    return np.array([t for t, _ in found]), np.array([z for _, z in found])


def _exponents(sizes: np.ndarray) -> np.ndarray:
    """Exponents of powers of two above the sizes; zero sizes take the largest of q or of p."""
    halves = np.where(np.isfinite(sizes), sizes, 0.0).reshape(2, -1)
    largest = halves.max(axis=1, keepdims=True)
    known = np.where(halves > 1e-8 * largest, halves, largest)
    known = np.where(known > 0, known, 1.0)
    return np.asarray(np.ceil(np.log2(known)).clip(-_RANGE, _RANGE).ravel())


def _norms(matrices: np.ndarray, exponents: np.ndarray) -> np.ndarray:
    """Gershgorin's bound on the logarithmic norm of each matrix, in units 2**exponents."""
    units = 2.0**exponents
    scaled = matrices * (units / units[:, None])
    symmetric = (scaled + scaled.transpose(0, 2, 1)) / 2
    own = np.einsum("nii->ni", symmetric)
    circles = own + np.abs(symmetric).sum(axis=2) - np.abs(own)
    return np.asarray(np.maximum(circles.max(axis=1), 0))


def _best_units(
    times: np.ndarray,
    matrices: np.ndarray,
    exponents: np.ndarray,
    previous: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Units that minimise the integral of the logarithmic norm, and that integral."""
    steps = np.diff(times)

    def cost(exponents: np.ndarray) -> float:
        norms = _norms(matrices, exponents)
        total = float((steps * (norms[1:] + norms[:-1])).sum() / 2)
        if previous is not None:
            total += math.log(2) * max(0.0, float((previous - exponents).max()))
        return total

    best = cost(exponents)
    dim = len(exponents)
    # All coordinates against all momenta first, then each component alone.
    moves = [np.repeat([1.0, 0.0], dim // 2), np.repeat([0.0, 1.0], dim // 2), *np.eye(dim)]
    for _ in range(_SWEEPS):
        before = best
        for move, sign in ((move, sign) for move in moves for sign in (1, -1)):
            while (found := cost(exponents + sign * move)) < 0.999 * best:
                exponents, best = exponents + sign * move, found
        if best >= 0.99 * before:
            break
    return exponents, best
