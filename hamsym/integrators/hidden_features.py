"""Features of the force that the steps of a trajectory have passed over.

Runs with different steps agree if all of them step over the same pulse. Between the states after
successive steps, a trajectory is a curve z^(t): in a window of some steps a polynomial through the
states, with the slopes F there. The force along the curve is F(z^(t), t), and G^(t) is the
polynomial through its values at fixed places. A feature that is as wide as a few steps is part of
G^ and of the motion. What is narrower is part of F - G^, which arithmetic of models bounds on the
whole window, wherever and however narrow the feature is (:mod:`hamsym.bounds`). The integral of
|F - G^| is what the steps may have missed.

Most windows need no bound, since no function in F varies over their steps
(:mod:`hamsym.integrators.step_scales`). Of the others, long ones are bounded first, and divided
where the bound is too large. The shortest are judged by branch and bound.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.bounds.models import DEGREE, NODES, PLACES
from hamsym.bounds.residual import ExcessSearch, Parts, Places, bounds_on_parts, is_short_polynomial
from hamsym.codegen.programs import programs_of
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.step_scales import StepScales
from hamsym.numerics.scales import resolved_sizes

_LENGTHS = (
    256,
    64,
    16,
    4,
)  # of windows, in steps; a feature of the last length is no longer hidden
_DEVIATION = 1e-4  # of the sizes, between states and the polynomial of a window longer than that
_HELD = 2**20  # components of states that are tested at once
_DISAGREEMENT = 0.1  # of the sizes, between the change in a window and the integral of the force
_AT_ONCE = 256  # windows in one evaluation of models
_SAMPLED = 256  # states from which sizes are computed
_ROUND_OFF = 256 * 2.0**-52  # of the integral of |F - G^|, relative to the force
_NOISE = 80.0  # times the change of F for one unit in the last place of states and times

_BASIS = chebyshev.chebvander(NODES, DEGREE)
_MEAN = np.array([0.0 if k % 2 else 1 / (1 - k**2) for k in range(DEGREE + 1)])
_FIT = np.ascontiguousarray((_BASIS * np.array([1.0, *[2.0] * DEGREE]) / PLACES).T)


class Hidden(NamedTuple):
    """What the steps of trajectories may not follow."""

    #: Of the first feature that steps of each trajectory passed over, shape (n,), nan where there
    #: is none.
    times: np.ndarray
    #: What the round-off of the force may change in each component, shape (n, dim).
    rounding: np.ndarray


class HiddenFeatures:
    """The search for features that the steps of a trajectory passed over."""

    def __init__(self, H: Hamiltonian) -> None:
        self.programs, self.scales = programs_of(H.real_equations), StepScales(H)
        self._system = H.compile("numpy")
        self.values = np.array([H.parameters[name] for name in H.parameter_names], dtype=float)

    def search(
        self,
        z: np.ndarray,
        t: np.ndarray,
        parameters: np.ndarray | None,
        allowed: Callable[[int], np.ndarray],
        share: float = 1.0,
    ) -> Hidden:
        """Find for each trajectory the first feature that its steps passed over.

        - z: States after successive steps, shape (n, steps + 1, dim); nan after the end of a
          trajectory.
        - t: Equally spaced, shape (steps + 1,).
        - parameters: Values of each trajectory, shape (n, k), by default those of H.
        - allowed: Number of a trajectory -> what all features together may change in each
          component.
        - share: Of these times in those for which ``allowed`` is.
        """
        found = Hidden(np.full(len(z), np.nan), np.zeros((len(z), z.shape[2])))
        together = max(1, _HELD // z[0].size)
        for first in range(0, len(z), together):
            some = slice(first, first + together)
            own = None if parameters is None else parameters[some]
            with np.errstate(all="ignore"):
                for index in first + np.flatnonzero(self._is_doubtful(z[some], t, own)):
                    count = int(np.isfinite(z[index]).all(axis=1).sum())
                    if count >= 2:
                        one = None if parameters is None else parameters[index]
                        limits = allowed(int(index))
                        search = _Search(self, z[index, :count], t[:count], one, limits, share)
                        found.times[index] = search.run()
                        found.rounding[index] = np.sqrt(search.rounding)
        return found

    def _is_doubtful(
        self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None
    ) -> np.ndarray:
        """Whether a function may vary over some steps of each trajectory."""
        blocks, _ = _blocks(z.shape[1] - 1)
        return np.asarray(~self.scales.resolved(z, t, parameters, blocks).all(axis=1))

    def sizes(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> np.ndarray:
        """Sizes of the components of a trajectory, to which its errors are relative."""
        there = np.flatnonzero(np.isfinite(z).all(axis=-1))
        some = there[np.linspace(0, len(there) - 1, min(len(there), _SAMPLED)).astype(int)]
        given = self._system.keywords(parameters)
        with np.errstate(all="ignore"):
            slopes = self._system.jacobian(*self._system.arguments(z[some], t[some]), **given)
            coupling = np.abs(np.asarray(slopes)).mean(axis=0)
        return resolved_sizes(np.abs(z[there]).max(axis=0), coupling, abs(float(t[-1] - t[0])))

    def rates(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> np.ndarray:
        """Evaluate F at states, shape (n, dim)."""
        given = self._system.keywords(parameters)
        found = np.asarray(self._system.vector_field(*self._system.arguments(z, t), **given))
        return np.broadcast_to(found, z.shape)


@functools.lru_cache(maxsize=64)
def hidden_features(H: Hamiltonian) -> HiddenFeatures | None:
    """Make the search for a Hamiltonian; None if its force can hide nothing."""
    return None if is_short_polynomial(H.real_equations) else HiddenFeatures(H)


def passed_over(time: float) -> str:
    """Describe a feature that steps passed over."""
    return (
        f"near t = {time:.6g} the force has a feature, for example a pulse, that the steps pass "
        "over; take smaller steps, or integrate with tol"
    )


def _blocks(steps: int) -> tuple[np.ndarray, list[int]]:
    """Divide steps into the shortest windows: indices of their states, and lengths of windows."""
    lengths = [length for length in _LENGTHS if length <= steps] or [steps]
    shortest = lengths[-1]
    first = np.minimum(np.arange(0, steps, shortest), steps - shortest)
    return first[:, None] + np.arange(shortest + 1), lengths


@functools.cache
def _hermite_fit(length: int) -> np.ndarray:
    """Make the matrix from states and slopes of equal steps to coefficients of a polynomial.

    It passes through them in short windows, and is their least-squares fit in longer ones.
    """
    s = np.linspace(-1, 1, length + 1)
    degree = min(DEGREE, 2 * length + 1, 8 + 2 * math.isqrt(length))
    slopes = chebyshev.chebder(np.eye(degree + 1))
    rows = chebyshev.chebvander(s, degree), chebyshev.chebvander(s, degree - 1) @ slopes
    weight = 1 / length  # of the slopes, as in the integral over a step
    found = np.zeros((DEGREE + 1, 2 * length + 2))
    scale = np.repeat([1.0, weight], length + 1)
    found[: degree + 1] = np.linalg.pinv(np.concatenate(rows) * scale[:, None]) * scale
    return found


@dataclass(frozen=True)
class _Windows:
    """Windows with the polynomials of curve and force."""

    #: Times of start and end, shape (2, windows).
    edges: np.ndarray
    #: curve, force: Coefficients, shape (windows, DEGREE + 1, dim).
    curve: np.ndarray
    force: np.ndarray

    def whole(self) -> Places:
        """Evaluate curve and force at the places of each window."""
        start, end = self.edges[:, :, None]
        return Places(
            _BASIS @ self.curve, _BASIS @ self.force, start + (end - start) * (NODES + 1) / 2
        )

    def at(self, parts: Parts) -> Places:
        """Evaluate curve and force at the places of parts of windows."""
        start, end = self.edges[:, parts.window, None]
        s = parts.places(NODES)
        basis = chebyshev.chebvander(2 * s - 1, DEGREE)
        return Places(
            basis @ self.curve[parts.window],
            basis @ self.force[parts.window],
            start + (end - start) * s,
        )


class _Search:
    """The search in one trajectory."""

    def __init__(
        self,
        features: HiddenFeatures,
        z: np.ndarray,
        t: np.ndarray,
        parameters: np.ndarray | None,
        allowed: np.ndarray,
        share: float,
    ) -> None:
        self._features, self._z, self._t, self._own = features, z, t, parameters
        self._allowed = allowed
        self._rate = allowed * share / abs(t[-1] - t[0])
        self._steps = len(t) - 1
        self._given = features.values if parameters is None else parameters
        #: Squares of what the round-off of the force changes, summed over windows, in which its
        #: errors may be equal, while those of different windows are independent.
        self.rounding = np.zeros(z.shape[1])

    def run(self) -> float:
        """Return the time of the first feature, or nan."""
        blocks, lengths = _blocks(self._steps)
        self._shortest = shortest = lengths[-1]
        own = None if self._own is None else self._own[None]
        scales, path = self._features.scales, (self._z[None], self._t, own, blocks)
        doubtful = ~scales.resolved(*path)[0] & ~scales.switched(*path)[0]
        blocks = blocks[doubtful, 0]
        if not len(blocks):
            return math.nan
        self._slopes = self._features.rates(self._z, self._t, self._own)
        for length in lengths:
            own = np.minimum(blocks // length * length, self._steps - length)
            own = np.where(length == shortest, blocks, own)
            starts, which = np.unique(own, return_inverse=True)
            passed = [
                self._passed(starts[first : first + _AT_ONCE], length)
                for first in range(0, len(starts), _AT_ONCE)
            ]
            blocks = blocks[~np.concatenate([np.empty(0, dtype=bool), *passed])[which]]
        return self._judged(blocks) if len(blocks) else math.nan

    def _passed(self, starts: np.ndarray, length: int) -> np.ndarray:
        """Whether nothing can be hidden in windows of equal numbers of steps."""
        windows = self._windows(starts, length)
        at, parts = windows.whole(), Parts.whole(len(starts))
        bounds, rounding = bounds_on_parts(
            self._features.programs, at, windows.edges, parts, self._given
        )
        passed = (bounds <= self._rate + _ROUND_OFF * np.abs(at.rates).max(axis=1)).all(axis=1)
        if length > self._shortest:
            passed &= self._is_fitted(windows.curve, starts, length)
            rounding = rounding[passed]
        span = abs(float(self._t[length] - self._t[0]))
        self.rounding += np.square(rounding * span).sum(axis=0)
        return np.asarray(passed)

    def _is_fitted(self, curve: np.ndarray, starts: np.ndarray, length: int) -> np.ndarray:
        """Whether the polynomials of windows pass close to all states in them."""
        basis = chebyshev.chebvander(np.linspace(-1, 1, length + 1), DEGREE)
        states = self._z[starts[:, None] + np.arange(length + 1)]
        distances = np.abs(basis @ curve - states).max(axis=1)
        return np.asarray((distances <= _DEVIATION * np.abs(self._z).max(axis=0)).all(axis=1))

    def _windows(self, starts: np.ndarray, length: int) -> _Windows:
        """Fit curve and force in windows."""
        index = starts[:, None] + np.arange(length + 1)
        edges = self._t[starts], self._t[starts + length]
        half = (edges[1] - edges[0])[:, None, None] / 2
        data = np.concatenate((self._z[index], half * self._slopes[index]), axis=1)
        curve = _hermite_fit(length) @ data
        windows = _Windows(np.stack(edges), curve, np.zeros_like(curve))
        at = windows.whole()
        force = self._features.rates(at.z.reshape(-1, data.shape[2]), at.t.ravel(), self._own)
        return replace(windows, force=_FIT @ force.reshape(at.z.shape))

    def _judged(self, starts: np.ndarray) -> float:
        """Judge the shortest windows, which share what is allowed."""
        windows = self._windows(starts, self._shortest)
        whole, lengths = windows.whole(), np.abs(np.diff(windows.edges, axis=0)).T
        limits = self._allowed / len(starts)
        limits = limits + _ROUND_OFF * lengths * np.abs(whole.rates).max(axis=1)

        def rates(z: np.ndarray, t: np.ndarray, _window: np.ndarray) -> np.ndarray:
            return self._features.rates(z, t, self._own)

        found = ExcessSearch(
            *(self._features.programs, rates, windows.at, windows.edges, limits, self._given),
            *(_NOISE, True),
        ).run()
        if found:
            return found[0].time
        missed = self._disagreeing(windows, starts)
        return float(windows.edges[:, np.argmax(missed)].mean()) if missed.any() else math.nan

    def _disagreeing(self, windows: _Windows, starts: np.ndarray) -> np.ndarray:
        """Whether the steps through windows do not follow the force, since one has met a pulse."""
        moved = self._z[starts + self._shortest] - self._z[starts]
        impulse = np.diff(windows.edges, axis=0)[0][:, None] * (_MEAN @ windows.force)
        largest = np.abs(self._z).max(axis=0)
        return np.asarray(~(np.abs(moved - impulse) <= _DISAGREEMENT * largest).all(axis=1))
