"""Energy drift: the change of H by time steps, relative to the energy that the motion exchanges.

That energy goes between coordinates and momenta: twice the standard deviation over time of the
integral of dH/dq_i dq_i, summed over the pairs i. For p^2/2 + V(q) that is the variation of V along
the trajectory, to which a short close encounter contributes little. It does not depend on a
constant in H, the origin of q or the units. It is limited by twice the root mean square of
p_i dH/dp_i, twice a kinetic energy, which matters when the states are too far apart to resolve the
integral.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from hamsym.hamiltonian import Hamiltonian

#: Drift above which the given steps do not represent the system.
COARSE = 0.01

_EPS = float(np.finfo(float).eps)
# Components of the states in one evaluation of H: 16 MB an array.
_MAX_COMPONENTS = 2_000_000


class EnergyDrift:
    """Accumulator of the change of H along trajectories, given in pieces.

    - H: If it is not conserved, by explicit time or forces, the drift is nan.
    - count: Number of trajectories.
    - parameters: Values of each trajectory, shape (count, k); by default those of H.
    """

    def __init__(self, H: Hamiltonian, count: int, parameters: np.ndarray | None = None) -> None:
        self._H, self._system, self._count = H, H.compile("numpy"), count
        self._values = None if parameters is None else parameters[:, None]
        self._first = np.full(count, np.nan)
        #: max_t |H - H(start)| of each trajectory; infinite where H is nan or infinite.
        self.change = np.zeros(count)
        # Energy exchanged so far; sums over the states of it, of its square and of (p dH/dp)^2.
        self._exchanged, self._sum, self._squares, self._kinetic = np.zeros((4, count, H.dof))
        self._states, self._size = np.zeros(count), np.zeros(count)

    def add(self, path: np.ndarray) -> None:
        """Add states of shape (count, n, dim), beginning with the last state of the piece before.

        States after the end of a trajectory are not finite and are ignored.
        """
        if not self._H.conserves_energy:
            return
        rows = max(2, _MAX_COMPONENTS // (self._count * self._H.dim))
        for first in range(0, max(path.shape[1] - 1, 1), rows - 1):
            with np.errstate(all="ignore"):
                self._add(path[:, first : first + rows])

    def _add(self, path: np.ndarray) -> None:
        dof, there = self._H.dof, np.isfinite(path).all(axis=-1)
        energy, gradient = (
            self._system.at(name, path, 0.0, self._values) for name in ("energy", "gradient")
        )
        self._first = np.where(np.isnan(self._first), energy[:, 0], self._first)
        change = np.abs(energy - self._first[:, None])
        change = np.where(there, np.nan_to_num(change, nan=np.inf), 0.0)
        self.change = np.maximum(self.change, change.max(axis=1))
        q, p, force = path[..., :dof], path[..., dof:], gradient[..., :dof]
        work = finite_or_zero((force[:, 1:] + force[:, :-1]) / 2 * np.diff(q, axis=1))
        work = np.cumsum(np.concatenate((self._exchanged[:, None], work), axis=1), axis=1)
        self._exchanged = work[:, -1]
        work = np.where(there[..., None], work, 0.0)
        self._sum += work.sum(axis=1)
        self._squares += (work**2).sum(axis=1)
        self._kinetic += (finite_or_zero(p * gradient[..., dof:]) ** 2).sum(axis=1)
        self._states += there.sum(axis=1)
        size = finite_or_zero(np.abs(path * gradient)).sum(axis=-1) + finite_or_zero(np.abs(energy))
        self._size = np.maximum(self._size, size.max(axis=1))

    @property
    def scale(self) -> np.ndarray:
        """Energy that each trajectory exchanges, shape (count,)."""
        states = np.maximum(self._states, 1)[:, None]
        with np.errstate(all="ignore"):
            variance = np.maximum(self._squares / states - (self._sum / states) ** 2, 0.0)
            return 2 * np.sqrt(np.minimum(variance, self._kinetic / states)).sum(axis=1)

    def relative(self, steps: int) -> np.ndarray:
        """Change of H in excess of round-off, divided by the scale, shape (count,).

        Infinite where the quotient is not finite, nan if H is not conserved.

        - steps: Steps of the run, from which the round-off is estimated.
        """
        if not self._H.conserves_energy:
            return np.full(self._count, np.nan)
        with np.errstate(all="ignore"):
            excess = np.maximum(self.change - round_off(steps) * self._size, 0.0)
            share = np.where(excess == 0, 0.0, excess / self.scale)
        return np.where(np.isfinite(share), share, np.inf)


def finite_or_zero(values: np.ndarray) -> np.ndarray:
    """Replace non-finite values by zero: a smaller scale gives a stricter test."""
    return np.where(np.isfinite(values), values, 0.0)


def round_off(steps: int) -> float:
    """Relative round-off error that accumulates over a number of steps."""
    return 4 * _EPS * math.sqrt(1 + steps)


def work_of(t: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Integrate power over time by splines, from the first time to each.

    - t: Times in order, shape (n,).
    - power: Shape (..., n); nan from the end of a trajectory on.
    - returns: Shape (..., n); nan where the power is.

    Examples
    --------
    >>> t = np.linspace(0, 2, 21)
    >>> float(work_of(t, t**4)[-1].round(12))
    6.4
    """
    rows = power.reshape(-1, len(t))
    work = np.full(rows.shape, np.nan)
    elapsed, sign = np.abs(t - t[0]), np.sign(t[-1] - t[0])
    for row, found in zip(rows, work, strict=True):
        count = int(np.logical_and.accumulate(np.isfinite(row)).sum())
        degree = 5 if count > 5 else 3 if count > 3 else 1
        if count > 1:
            spline = scipy.interpolate.make_interp_spline(elapsed[:count], row[:count], k=degree)
            found[:count] = sign * spline.antiderivative()(elapsed[:count])
        elif count:
            found[0] = 0.0
    return work.reshape(power.shape)
