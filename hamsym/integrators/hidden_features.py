"""Features of the force that the steps of a trajectory have passed over, or do not resolve.

Runs with different steps agree if all of them step over the same pulse. Between the states after
successive steps, a trajectory is a curve z^(t): in a window of some steps a polynomial through the
states, with the slopes F there. The force along the curve is F(z^(t), t), and G^(t) is the
polynomial through its values at fixed places. A feature that is as wide as a few steps is part of
G^ and of the motion. What is narrower, a pulse, a pole, a kink or a jump, is part of F - G^, which
arithmetic of models bounds on the whole window, wherever and however narrow the feature is
(:mod:`hamsym.bounds`). The integral of |F - G^| is what the steps may have missed. Where H jumps,
the force has a delta distribution; a pole, which no model bounds, stands for it.

Most windows need no bound, since no function in F varies over their steps
(:mod:`hamsym.integrators.step_scales`). Of the others, long ones are bounded first, and divided
where the bound is too large. The shortest are judged by branch and bound. A step in which abs, sign
or a similar function switches may be wrong by the jump of the force times its whole length: that is
what is compared with a tolerance, and what is allowed without one, as the steps see such a switch.
A trajectory may also touch a switch, or pass beside it by less than its error: with a tolerance,
curves that are shifted by the estimated error must pass the same switches.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import sympy
from numpy.polynomial import chebyshev

from hamsym.bounds.models import DEGREE, NODES, PLACES
from hamsym.bounds.residual import (
    MOST_SHARES,
    NOISE,
    ROUND_OFF,
    ExcessSearch,
    Parts,
    Places,
    bounds_on_parts,
    is_short_polynomial,
    largest_ratios,
)
from hamsym.codegen.programs import programs_of
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.step_scales import StepScales
from hamsym.integrators.stepper import Stepper
from hamsym.numerics.scales import resolved_sizes
from hamsym.symbolic.derivatives import vanishes
from hamsym.symbolic.equations import Equations

_LENGTHS = (
    256,
    64,
    16,
    4,
)  # of windows, in steps; a feature of the last length is no longer hidden
_DEVIATION = 1e-4  # of the sizes, between states and the polynomial of a window longer than that
_HELD = 2**20  # components of states that are tested at once
_REPEATED = 20_000_000  # components of the states after repeated steps that are held at once
_DISAGREEMENT = 0.1  # of the sizes, between the change in a window and the integral of the force
_AT_ONCE = 256  # windows in one evaluation of models
_TRIED = 16  # windows of a length, before all of them
_SAMPLED = 256  # states from which sizes are computed
_LEAST = 4.0  # factor by which steps over a pulse that matters much are at least too long
_NOTHING = math.nan, 0.0, 1.0  # time, excess and factor where there is no feature
_SMALL = sympy.Float(2.0**-1000)  # of poles, so that they are no force

_BASIS = chebyshev.chebvander(NODES, DEGREE)
_MEAN = np.array([0.0 if k % 2 else 1 / (1 - k**2) for k in range(DEGREE + 1)])
_FIT = np.ascontiguousarray((_BASIS * np.array([1.0, *[2.0] * DEGREE]) / PLACES).T)


class Hidden(NamedTuple):
    """What the steps of trajectories may not follow."""

    #: Of the first feature that steps of each trajectory do not resolve, shape (n,), nan where
    #: there is none.
    times: np.ndarray
    #: What the steps may miss there, in units of what is allowed, 0 where there is none; and a
    #: guess of the factor by which they are too long.
    excess: np.ndarray
    factor: np.ndarray
    #: What the round-off of the force may change in each component, shape (n, dim).
    rounding: np.ndarray


@dataclass(frozen=True)
class Path:
    """States of trajectories with equal steps: all of them, or some at equal distances."""

    #: Shape (n, saves + 1, dim); nan after the end of a trajectory.
    z: np.ndarray
    #: Shape (saves + 1,).
    t: np.ndarray
    #: Of the whole trajectories, by default as many as there are intervals between the states.
    steps: int = 0
    #: (trajectories, their states and times) -> what repeats the steps from there.
    stepper: Callable[[np.ndarray, np.ndarray, np.ndarray], Stepper] | None = None

    def parts(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the states after every step and their times, in parts of the span."""
        saves, (count, _, dim) = len(self.t) - 1, self.z.shape
        every = max(1, self.steps // saves)
        if every == 1 or self.stepper is None:
            yield self.z, self.t
            return
        size = (self.t[-1] - self.t[0]) / self.steps
        together = max(1, _REPEATED // (every * count * dim))
        for first in range(0, saves, together):
            last = min(first + together, saves)
            between = last - first
            stepper = self.stepper(
                np.repeat(np.arange(count), between),
                self.z[:, first:last].reshape(count * between, dim),
                np.tile(self.t[first:last], count),
            )
            most = max(1, _REPEATED // (between * count * dim))
            if between == 1 and every > most:
                for done in range(0, every, most):
                    some = min(most, every - done)
                    t = self.t[0] + size * (first * every + done + np.arange(some + 1))
                    yield stepper.advance(some, show=False).path, t
                continue
            path = stepper.advance(every, show=False).path[:, :-1].reshape(count, -1, dim)
            t = self.t[0] + size * np.arange(first * every, last * every + 1)
            yield np.concatenate((path, self.z[:, last : last + 1]), axis=1), t


class HiddenFeatures:
    """The search for features that the steps of a trajectory do not resolve."""

    def __init__(self, H: Hamiltonian, form: Equations, has_jumps: bool) -> None:
        self.programs, self.scales = programs_of(form), StepScales(form)
        #: Whether the force or H jumps along a trajectory.
        self.has_jumps = has_jumps
        self._system = H.compile("numpy")
        self.values = np.array([H.parameters[name] for name in H.parameter_names], dtype=float)

    def search(
        self,
        path: Path,
        parameters: np.ndarray | None,
        allowed: Callable[[int], np.ndarray],
        errors: np.ndarray | None = None,
    ) -> Hidden:
        """Find for each trajectory the first feature that its steps do not resolve.

        - parameters: Values of each trajectory, shape (n, k), by default those of H.
        - allowed: Number of a trajectory -> what all features together may change in each
          component.
        - errors: Estimated errors of the states, shape (n, dim); by default the steps may be wrong
          by a jump of the force where they see a switch.
        """
        count, _, dim = path.z.shape
        nothing = np.zeros((2, count))
        found = Hidden(np.full(count, np.nan), nothing[0], nothing[1], np.zeros((count, dim)))
        steps = path.steps or len(path.t) - 1
        for z, t in path.parts():
            share = (len(t) - 1) / steps
            together = max(1, _HELD // z[0].size)
            for first in range(0, count, together):
                some = slice(first, first + together)
                own = None if parameters is None else parameters[some]
                with np.errstate(all="ignore"):
                    blocks, _ = _blocks(len(t) - 1)
                    resolved = self.scales.resolved(z[some], t, own, blocks)
                    doubtful = ~resolved.all(axis=1) | (self.has_jumps and errors is not None)
                    for i in (first + np.flatnonzero(doubtful)).tolist():
                        end = int(np.isfinite(z[i]).all(axis=1).sum())
                        if end < 2 or found.excess[i]:
                            continue
                        one = None if parameters is None else parameters[i]
                        shift = None if errors is None else errors[i]
                        known = resolved[i - first] if end == len(t) else None
                        search = _Search(
                            *(self, z[i, :end], t[:end], one, share * allowed(i), shift, known)
                        )
                        found.times[i], found.excess[i], found.factor[i] = search.run()
                        found.rounding[i] = np.sqrt(found.rounding[i] ** 2 + search.rounding)
        return found

    def passed(self, path: Path, parameters: np.ndarray | None, share: float) -> np.ndarray:
        """Find the time of the first feature that each trajectory passes over, nan without one.

        - parameters: As of :meth:`search`.
        - share: Of the sizes of the components, that all features together may change.
        """

        def allowed(index: int) -> np.ndarray:
            own = None if parameters is None else parameters[index]
            return share * self.sizes(path.z[index], path.t, own)

        return self.search(path, parameters, allowed).times

    def sizes(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> np.ndarray:
        """Sizes of the components of a trajectory, to which its errors are relative."""
        there = np.flatnonzero(np.isfinite(z).all(axis=-1))
        some = there[np.linspace(0, len(there) - 1, min(len(there), _SAMPLED)).astype(int)]
        slopes = self._system.at("jacobian", z[some], t[some], parameters)
        with np.errstate(all="ignore"):
            coupling = np.abs(slopes).mean(axis=0)
        return resolved_sizes(np.abs(z[there]).max(axis=0), coupling, abs(float(t[-1] - t[0])))

    def rates(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> np.ndarray:
        """Evaluate F at states, shape (n, dim)."""
        return np.broadcast_to(self._system.at("vector_field", z, t, parameters), z.shape)


@functools.lru_cache(maxsize=64)
def hidden_features(H: Hamiltonian) -> HiddenFeatures | None:
    """Make the search for a Hamiltonian; None if its force can hide nothing."""
    form = H.real_equations
    jumps = [
        (switch, [jump for jump in jumps if not _is_zero_at(jump, switch, form.z)], jumps[-1])
        for switch, jumps in form.switches(form.z)
    ]
    form = _with_poles(form, [last / switch for switch, own, last in jumps if last in own])
    has_jumps = any(own for _, own, _ in jumps)
    return None if is_short_polynomial(form) else HiddenFeatures(H, form, has_jumps)


def passed_over(time: float) -> str:
    """Describe a feature that steps passed over."""
    return (
        f"near t = {time:.6g} the force has a feature, for example a pulse or a pole, that the "
        "steps pass over; take smaller steps, or integrate with tol"
    )


def _with_poles(form: Equations, poles: Sequence[sympy.Expr]) -> Equations:
    """Add poles to the force, too small to act."""
    if not poles:
        return form
    first, *others = form.forces or [sympy.Integer(0)] * form.dof
    values = {name: value for name, (_, value) in form.parameters.items()}
    forces = [first + _SMALL * sympy.Add(*poles), *others]
    return Equations(form.expr, form.z, form.time, values, forces)


def _is_zero_at(jump: sympy.Expr, switch: sympy.Expr, z: Sequence[sympy.Symbol]) -> bool:
    """Whether a jump is known to be zero where its switch is, as that of x*sign(x)."""
    for symbol in z:
        slope = switch.diff(symbol)
        if slope != 0 and not slope.has(symbol):
            root = -switch.xreplace({symbol: sympy.Integer(0)}) / slope
            return vanishes(jump.xreplace({symbol: root}))
    return vanishes(jump)


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
        errors: np.ndarray | None,
        resolved: np.ndarray | None,
    ) -> None:
        self._resolved = resolved  # of the shortest windows along the states, if known
        self._features, self._scales = features, features.scales
        self._z, self._t, self._own = z, t, parameters
        self._largest = np.maximum(z.max(axis=0), -z.min(axis=0))
        self._allowed, self._errors = allowed, errors
        self._shift = np.zeros_like(allowed)
        #: Half of it is for windows that pass as a whole.
        self._rate = allowed / abs(t[-1] - t[0]) / 2
        self._steps = len(t) - 1
        self._given = features.values if parameters is None else parameters
        #: Squares of what the round-off of the force changes, summed over windows, in which its
        #: errors may be equal, while those of different windows are independent.
        self.rounding = np.zeros(z.shape[1])

    def run(self) -> tuple[float, float, float]:
        """Return time, excess and factor of the first feature."""
        own = None if self._own is None else self._own[None]
        shifts = self._shifts()
        passed = [self._scales.switched(self._z[None] + s, self._t, own)[0] for s in shifts]
        for others in passed[1:]:
            unequal = others.sum(axis=0) != passed[0].sum(axis=0)
            if unequal.any():
                differ = (others != passed[0])[:, unequal].any(axis=1)
                return float(self._t[np.argmax(differ)]), math.inf, _LEAST
        found = _NOTHING
        for self._shift, switched in zip(shifts, passed, strict=True):
            if math.isnan(found[0]):
                self._switched = switched.any(axis=1)
                found = self._found()
        return found

    def _shifts(self) -> np.ndarray:
        """Return what curves are shifted by, nothing first, shape (shifts, dim)."""
        none = np.zeros((1, len(self._allowed)))
        if self._errors is None or not self._features.has_jumps or not self._errors.any():
            return none
        signs = np.ones((4, none.size))
        signs[2:, ::2] = -1.0
        signs[1::2] *= -1.0
        return np.concatenate((none, signs * self._errors))

    def _found(self) -> tuple[float, float, float]:
        """Search along the trajectory with its present shift."""
        blocks, lengths = _blocks(self._steps)
        self._shortest = shortest = lengths[-1]
        own = None if self._own is None else self._own[None]
        path = self._z[None] + self._shift, self._t, own
        known = None if self._shift.any() else self._resolved
        resolved = self._scales.resolved(*path, blocks)[0] if known is None else known
        blocks = blocks[~resolved, 0]
        if not len(blocks):
            return _NOTHING
        for length in lengths:
            own = np.minimum(blocks // length * length, self._steps - length)
            own = np.where(length == shortest, blocks, own)
            starts, which = np.unique(own, return_inverse=True)
            blocks = blocks[~self._all_passed(starts, length)[which]]
        return self._judged(blocks) if len(blocks) else _NOTHING

    def _all_passed(self, starts: np.ndarray, length: int) -> np.ndarray:
        """Whether nothing can be hidden in windows; if it can in a sample, no other is tried."""
        passed, every = np.zeros(len(starts), dtype=bool), max(1, len(starts) // _TRIED)
        some = np.arange(0, len(starts), every)
        others = np.setdiff1d(np.arange(len(starts)), some)
        parts = (others[first : first + _AT_ONCE] for first in range(0, len(others), _AT_ONCE))
        for part in (some, *parts):
            passed[part] = self._passed(starts[part], length)
            if not passed.any() and length > self._shortest:
                break
        return passed

    def _passed(self, starts: np.ndarray, length: int) -> np.ndarray:
        """Whether nothing can be hidden in windows of equal numbers of steps."""
        windows = self._windows(starts, length)
        at, parts = windows.whole(), Parts.whole(len(starts))
        bounds, _, rounding = bounds_on_parts(
            self._features.programs, at, windows.edges, parts, self._given
        )
        passed = (bounds <= self._rate + ROUND_OFF * np.abs(at.rates).max(axis=1)).all(axis=1)
        if length > self._shortest:
            passed &= self._is_fitted(windows.curve, starts, length)
        self._count(rounding[passed] * abs(float(self._t[length] - self._t[0])))
        return np.asarray(passed)

    def _count(self, rounding: np.ndarray) -> None:
        """Count the round-off in windows once, shape (windows, dim)."""
        if not self._shift.any():
            self.rounding += np.square(rounding).sum(axis=0)

    def _is_fitted(self, curve: np.ndarray, starts: np.ndarray, length: int) -> np.ndarray:
        """Whether the polynomials of windows pass close to all states in them."""
        basis = chebyshev.chebvander(np.linspace(-1, 1, length + 1), DEGREE)
        states = self._z[starts[:, None] + np.arange(length + 1)]
        distances = np.abs(basis @ curve - self._shift - states).max(axis=1)
        return np.asarray((distances <= _DEVIATION * self._largest).all(axis=1))

    def _windows(self, starts: np.ndarray, length: int) -> _Windows:
        """Fit curve and force in windows."""
        index = starts[:, None] + np.arange(length + 1)
        edges = self._t[starts], self._t[starts + length]
        half = (edges[1] - edges[0])[:, None, None] / 2
        states, times = self._z[index], self._t[index]
        slopes = self._features.rates(states.reshape(-1, states.shape[2]), times.ravel(), self._own)
        data = np.concatenate((states, half * slopes.reshape(states.shape)), axis=1)
        curve = _hermite_fit(length) @ data
        curve[:, 0] += self._shift
        windows = _Windows(np.stack(edges), curve, np.zeros_like(curve))
        at = windows.whole()
        force = self._features.rates(at.z.reshape(-1, data.shape[2]), at.t.ravel(), self._own)
        return replace(windows, force=_FIT @ force.reshape(at.z.shape))

    def _judged(self, starts: np.ndarray) -> tuple[float, float, float]:
        """Judge the shortest windows, which share what is allowed."""
        windows, shortest = self._windows(starts, self._shortest), self._shortest
        steps = starts[:, None] + np.arange(shortest)
        slopes = self._features.rates(self._z, self._t, self._own)
        switched, changes = self._switched[steps], np.abs(np.diff(slopes, axis=0))
        at_switch = switched.any(axis=1) & (self._errors is not None)
        # A part of the rest may use as many shares, a residual that counts everywhere only one.
        shares = len(starts) * np.where(at_switch, 2.0, 2.0 * MOST_SHARES)
        lengths = np.abs(np.diff(windows.edges, axis=0)).T
        limits = self._allowed / shares[:, None]
        limits += ROUND_OFF * lengths * np.abs(windows.whole().rates).max(axis=1)
        if self._errors is None:
            limits += lengths / shortest * (switched[..., None] * changes[steps]).sum(axis=1)

        def rates(z: np.ndarray, t: np.ndarray, _window: np.ndarray) -> np.ndarray:
            return self._features.rates(z, t, self._own)

        rounding = np.zeros_like(limits)
        found = ExcessSearch(
            *(self._features.programs, rates, windows.at, windows.edges, limits, self._given),
            *(NOISE, True, at_switch, rounding),
        ).run()
        self._count(rounding)
        if found:
            first = found[0]
            excess = first.ratio / MOST_SHARES
            if not (at_switch[first.window] and first.ratio < math.inf):
                return first.time, excess, min(_LEAST, excess) / first.width
            # The error at a kink is of the second order, at a jump of the first.
            beside = np.pad(changes, ((1, 1), (0, 0)))
            jumps = np.maximum(changes - 2 * np.maximum(beside[:-2], beside[2:]), 0.0)
            error = np.abs(self._t[1] - self._t[0]) * jumps[steps[first.window]].max(axis=0)
            factor = float(largest_ratios(error, limits[first.window]))
            return first.time, excess, max(math.sqrt(excess), factor)
        missed = self._disagreeing(windows, starts)
        if not missed.any():
            return _NOTHING
        return float(windows.edges[:, np.argmax(missed)].mean()), math.inf, _LEAST

    def _disagreeing(self, windows: _Windows, starts: np.ndarray) -> np.ndarray:
        """Whether the steps through windows do not follow the force, since one has met a pulse."""
        moved = self._z[starts + self._shortest] - self._z[starts]
        impulse = np.diff(windows.edges, axis=0)[0][:, None] * (_MEAN @ windows.force)
        agree = np.abs(moved - impulse) <= _DISAGREEMENT * self._largest
        return np.asarray(~agree.all(axis=1))
