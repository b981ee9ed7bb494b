"""Interpolation between the saved states of trajectories, by Hermite polynomials.

Input:  times, states and the generated vector field with its derivatives.
Output: states at any time between, and the estimated error of the interpolation.

On each interval between saved states the polynomial has the states and rates of both ends and, if
H does not depend on time, their second derivatives, A dz/dt with A the derivatives of the rates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval

from hamsym.errors import InputError
from hamsym.numerics.scales import SMALLEST
from hamsym.problems.ensemble import Ensemble
from hamsym.support.validation import checked_numbers, outside_span

_COARSEST = 0.01  # of the size of a component: errors above are refused
_HELD = 4_000_000  # numbers of the derivatives of the rates that are evaluated at once
_QUARTERS = (0.25, 0.75)  # of an interval, where the defect is largest, nearly

# Coefficients in s, on [0, 1], of the polynomials that multiply the states, the rates and the
# second derivatives at the two ends; powers ascend.
_QUINTIC = np.array(
    [
        [1, 0, 0, -10, 15, -6],
        [0, 0, 0, 10, -15, 6],
        [0, 1, 0, -6, 8, -3],
        [0, 0, 0, -4, 7, -3],
        [0, 0, 0.5, -1.5, 1.5, -0.5],
        [0, 0, 0, 0.5, -1, 0.5],
    ]
)
_CUBIC = np.array([[1, 0, -3, 2], [0, 0, 3, -2], [0, 1, -2, 1], [0, 0, -1, 1]], dtype=float)


class Interpolant:
    """A function of time through the saved states of each trajectory of an ensemble.

    - t: Times, strictly monotone, shape (n,).
    - z: States, shape (*shape, n, dim); nan after the end of a trajectory.
    - ensemble: H and the values of the parameters, of shape ``shape``.
    """

    def __init__(self, t: np.ndarray, z: np.ndarray, ensemble: Ensemble) -> None:
        self._t, self._members = t, ensemble
        self._z = z.reshape(len(ensemble), len(t), -1)
        self._system = ensemble.H.compile("numpy")
        self._smooth = not self._system.time_dependent
        self._basis = _QUINTIC if self._smooth else _CUBIC
        self._sizes = np.nanmax(np.abs(z), axis=-2, initial=0.0, where=np.isfinite(z))
        self._sizes = self._sizes.reshape(len(ensemble), -1)

    @property
    def order(self) -> int:
        """Order of the error in the time between saved states: 6, or 4 if H depends on time."""
        return 6 if self._smooth else 4

    def states(self, t: Any) -> np.ndarray:
        """States at times t, shape (*shape, n, dim), or (*shape, dim) for a scalar.

        Raise InputError if a time is outside the saved ones, or the estimated error there is above
        1 % of the size of a component.
        """
        times, found, errors, limits = self._evaluated(t)
        with np.errstate(invalid="ignore"):
            # States that are not finite are the answer after the end of a trajectory.
            coarse = np.isfinite(found) & ~(errors <= limits)
        if coarse.any():
            _, index, component = np.argwhere(coarse)[0]
            raise InputError(
                f"the saved states near t = {np.ravel(times)[index]:.6g} are too far apart to "
                f"interpolate {self._members.H.names[component]}; save more of them (saves with "
                "tol, else more steps or a smaller save_every)"
            )
        return self._shaped(found, times)

    def errors(self, t: Any) -> np.ndarray:
        """Estimated error of each component at times t, shaped as the states."""
        times, _, errors, _ = self._evaluated(t)
        return self._shaped(errors, times)

    def _shaped(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        return values.reshape(*self._members.shape, *times.shape, values.shape[-1])

    def _evaluated(self, t: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Times, and states, errors and largest allowed errors of shape (members, n, dim)."""
        times = self._checked(t)
        flat = np.atleast_1d(times)
        count, dim = len(self._members), self._z.shape[-1]
        found, errors, limits = (np.empty((count, len(flat), dim)) for _ in range(3))
        if len(self._t) == 1:  # which the checked times are
            found[:], errors[:], limits[:] = self._z, 0.0, np.inf
            return times, found, errors, limits
        direction = 1.0 if self._t[-1] > self._t[0] else -1.0
        before = np.searchsorted(direction * self._t, direction * flat, side="right") - 1
        before = np.clip(before, 0, len(self._t) - 2)
        order = np.argsort(before, kind="stable")
        each = max(1, _HELD // (count * dim * dim))
        for first in range(0, len(flat), each):
            part = order[first : first + each]
            intervals, which = np.unique(before[part], return_inverse=True)
            begin, length = self._t[intervals], np.diff(self._t)[intervals]
            share = (flat[part] - begin[which]) / length[which]
            with np.errstate(all="ignore"):
                ends, limit = self._ends(intervals, length)
                found[:, part] = self._polynomial(ends[..., which, :], share)
                error = self._largest_error(ends, begin, length)
            errors[:, part], limits[:, part] = error[:, which], limit[:, which]
        saved = flat == self._t[before]
        found[:, saved] = self._z[:, before[saved]]
        last = flat == self._t[-1]
        found[:, last] = self._z[:, -1:]
        errors[:, saved | last] = 0.0
        return times, found, errors, limits

    def _checked(self, t: Any) -> np.ndarray:
        times = checked_numbers("t", t)
        if times.ndim > 1:
            raise InputError(f"t has shape {times.shape}; give one time or a list of times")
        low, high = sorted((self._t[0], self._t[-1]))
        outside = outside_span(times, (low, high))
        if outside.any():
            raise InputError(
                f"t = {times[outside].flat[0]:.16g} is outside the trajectory, from {low:.16g} to "
                f"{high:.16g}; give times inside it, or integrate over a longer span"
            )
        return np.clip(times, low, high)

    # -- the polynomials -------------------------------------------------------------------------

    def _ends(self, intervals: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the polynomials of intervals multiply, shape (4 or 6, members, intervals, dim).

        Also the largest error that is not refused, (members, intervals, dim).
        """
        step = length[:, None]
        states = [self._z[:, intervals], self._z[:, intervals + 1]]
        times = [self._t[intervals], self._t[intervals + 1]]
        rates = [self._at("vector_field", z, t) for z, t in zip(states, times, strict=True)]
        ends = [*states, *(step * rate for rate in rates)]
        moved = np.zeros_like(states[0])
        for z, t, rate in zip(states, times, rates, strict=True):
            slopes = self._at("jacobian", z, t)
            if self._smooth:
                ends.append(step**2 * (slopes * rate[..., None, :]).sum(axis=-1))
            turned = (np.abs(slopes) * self._sizes[:, None, None]).sum(axis=-1)
            moved = np.fmax(moved, np.abs(step) * turned)
        # A component that is zero, or round-off, has the size that its own equation gives it.
        sizes = np.maximum(self._sizes[:, None], SMALLEST * moved)
        return np.array(ends), _COARSEST * sizes

    def _largest_error(self, ends: np.ndarray, begin: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Estimated error in the middle of intervals, shape (members, intervals, dim).

        The error is E (s (1 - s))^k at the share s of an interval, with k = order/2, to leading
        order. Its derivative is the defect dz/dt - f(z), so that E follows from a defect.
        """
        k = self.order // 2
        worst = np.zeros(ends.shape[1:])
        for s in _QUARTERS:
            share = np.full(len(begin), s)
            z = self._polynomial(ends, share)
            rate = self._polynomial(ends, share, derivative=True)
            defect = rate - length[:, None] * self._at("vector_field", z, begin + s * length)
            size = np.abs(defect) / (k * (s * (1 - s)) ** (k - 1) * abs(1 - 2 * s))
            worst = np.maximum(worst, size)  # nan stays
        return worst / 4**k

    def _at(self, name: str, z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return self._system.at(name, z, t, self._members.own_parameters(np.s_[:, None]))

    def _polynomial(
        self, ends: np.ndarray, share: np.ndarray, derivative: bool = False
    ) -> np.ndarray:
        """Values of polynomials at shares of their intervals, or derivatives in the share."""
        basis = self._basis
        if derivative:
            basis = basis[:, 1:] * np.arange(1, basis.shape[1])
        weights = polyval(share, basis.T)
        # Sums in a fixed order: the same to the last bit for one time and for many.
        return np.asarray(
            sum(w[:, None] * part for w, part in zip(weights, ends, strict=True)), dtype=float
        )
