"""Runs with n, 2n and 4n steps, and with perturbations that stand for round-off, compared.

Input:  members of an ensemble, a number of steps n, a tolerance.
Output: :class:`Round`: extrapolated states with estimated errors, and what the runs agree in though
        it may be wrong: a change of H, and features of the force that their steps pass over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hamsym.codegen.programs import programs_of
from hamsym.errors import InputError
from hamsym.integrators.coefficients import Scheme, Splitting
from hamsym.integrators.hidden_features import Hidden, Path, hidden_features
from hamsym.integrators.richardson import Extrapolation, extrapolate, perturb
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import INTEGRATORS, usual_method
from hamsym.kernel.loops import LANES
from hamsym.numerics.scales import SMALLEST, coupled_sizes, ratios
from hamsym.problems.ensemble import Ensemble

#: Change of H in units of the change that the tolerance allows, at which a trajectory fails; errors
#: of several components may add up.
SLACK = 10.0

# Components of the states after every step that are kept, 64 MB; more are computed again.
_MOST_KEPT = 2**23
# Fewest times at which the three runs are compared; one time may meet a zero of the difference.
_SAMPLES = 5
# Most saved states of the middle run between two of these times, for the sizes of the components.
_MIDDLE_SAVES = 64
# Most perturbations between two of these times; each costs a call of the loop.
_PERTURBED = 8
# Most states at which the change of the force with time is evaluated, and the irrational part of
# their distance by which their places between equal distances differ.
_TIMES, _GOLDEN = 4096, (math.sqrt(5) - 1) / 2
# Rounding errors of a step in units of the last place: of implicit methods, which stop iterating
# there, and of splitting methods without and with compensated summation.
_ROUNDING = {"implicit": 4.0, "plain": 8.0, "compensated": 0.25}
_EPS = float(np.finfo(float).eps)


def _saved_times(span: tuple[float, float], saves: int) -> np.ndarray:
    """Return equally spaced times, shape (saves + 1,); raise InputError if rounding joins some."""
    times = np.linspace(*span, saves + 1)
    if not (np.diff(times) * np.sign(span[1] - span[0]) > 0).all():
        raise InputError(
            f"saves={saves} gives equal saved times: float64 has too few numbers from {span[0]!r} "
            f"to {span[1]!r}; give fewer saves, a longer span, or times nearer zero"
        )
    return times


class Round(NamedTuple):
    """Result of one number of steps for some members, which are along the first axis."""

    members: np.ndarray
    coarse: int
    states: np.ndarray
    found: Extrapolation
    finite: np.ndarray
    changes: np.ndarray
    hidden: Hidden
    rounding: np.ndarray
    evaluations: int


class ComparedRuns:
    """Runs of members of an ensemble with three numbers of steps.

    - method: A splitting or implicit Runge-Kutta method.
    - saves: Number of equal intervals between the times at which states are returned.
    - compensated: Whether to sum with compensation from the start.
    """

    def __init__(
        self,
        members: Ensemble,
        method: str,
        span: tuple[float, float],
        tol: float,
        saves: int,
        compensated: bool,
    ) -> None:
        self.members, self._method, self.span, self.tol = members, method, span, tol
        scheme = INTEGRATORS[method].scheme
        assert isinstance(scheme, Scheme)
        self.scheme: Scheme = scheme
        self._order = INTEGRATORS[method].order
        #: The next power of the step in the error.
        self.next_order = self._order + (2 if scheme.is_symmetric else 1)
        #: Number of equal intervals between the times at which runs are compared.
        self.sampled = saves * math.ceil(_SAMPLES / saves)
        #: The compared times at which states are returned.
        self.kept = slice(None, None, self.sampled // saves)
        self.times = _saved_times(span, saves)
        exact = (span[1] - span[0]) * np.linspace(0.0, 1.0, saves + 1)
        #: What rounding adds to the saved times, where it is more than the round-off of the span.
        self._shifts = (self.times - span[0]) - exact
        self._shifts[np.abs(self._shifts) <= 2 * _EPS * abs(span[1] - span[0])] = 0.0
        self._hidden = hidden_features(members.H)
        self.system = members.H.compile("numpy")
        self._programs = programs_of(members.H.real_equations)
        #: Whether each member is summed with compensation; equal for members of one comparison.
        self.compensated = np.full(len(members), compensated)
        #: Whether the sizes of the components of each member are at least 1e-8 of the coupled ones.
        self.coupled = np.zeros(len(members), dtype=bool)
        #: Whether no member was compared before.
        self.is_first = True

    def middle_saves(self, coarse: int) -> int:
        """Number of saved states of the run with 2*coarse steps.

        It gives the sizes of the components. In the first round few states save time; they may all
        be at the same phase of a motion.
        """
        if self._hidden is not None and 2 * coarse * self.members.H.dim <= _MOST_KEPT:
            return 2 * coarse
        more = 1 if self.is_first else math.gcd(2 * coarse // self.sampled, _MIDDLE_SAVES)
        return self.sampled * more

    def compare(self, rows: np.ndarray, coarse: int) -> Round:
        """Integrate members with three numbers of steps and compare the results."""
        starts = self.members.states[rows]
        first, one = self._path(rows, starts, coarse, self.sampled)
        other, count, two = self._perturbed(rows, first, coarse)
        dense, three = self._path(rows, starts, 2 * coarse, self.middle_saves(coarse))
        last, four = self._path(rows, starts, 4 * coarse, self.sampled)
        evaluations = one + two + three + four
        finite = np.isfinite(last[:, -1]).all(axis=1)  # and so it was before
        found = extrapolate(
            first,
            dense,
            last,
            other,
            count,
            self._order,
            self.next_order,
            4 * coarse,
            self._rounding(rows),
            self._least(rows, dense),
        )
        states, moved = self._at_saved_times(rows, found.states[:, self.kept], 4 * coarse)
        evaluations += moved
        changes = self._energy_changes(rows, states, found.sizes, 4 * coarse)
        agree = found.errors[:, -1] <= self.tol
        # What is missed, or is round-off of the force in which the runs agree, grows as the
        # perturbations do.
        growth, unit = np.ones(len(rows)), self._rounding(rows) * math.sqrt(4 * coarse)
        grown = (found.round_off / _EPS - 4 * coarse) / unit
        growth[agree] = np.maximum(grown[agree], 1.0)
        error = np.where(agree, found.errors[:, -1], 0.0)
        with np.errstate(all="ignore"):
            hidden = self._hidden_features(
                *(rows, dense, 2 * coarse),
                ((self.tol - error) / growth)[:, None] * found.sizes,
                error[:, None] * found.sizes,
            )
            shares = ratios(hidden.rounding, found.sizes)
            shares[agree] += ratios(
                self._of_rates(rows[agree], dense[agree], coarse), found.sizes[agree]
            )
        rounding = np.where(agree, shares.max(axis=1) * growth, 0.0)
        found.add_round_off(rounding)
        return Round(*(rows, coarse, states, found, finite, changes, hidden, rounding, evaluations))

    def _least(self, rows: np.ndarray, path: np.ndarray) -> np.ndarray:
        """Compute the least sizes of the components of members from their equations.

        They belong to these runs alone: those of steps that are too long may be of any size.

        - path: States of the middle run, shape (n, times, dim).
        """
        least = np.zeros((len(rows), path.shape[2]))
        length = abs(self.span[1] - self.span[0])
        sampled = path[:, :: (path.shape[1] - 1) // self.sampled]
        times = np.linspace(*self.span, sampled.shape[1])
        for i in np.flatnonzero(self.coupled[rows]).tolist():
            given = self.members.own_parameters(rows[i : i + 1])
            with np.errstate(all="ignore"):
                coupling = np.abs(self.system.at("jacobian", sampled[i], times, given))
                found = coupled_sizes(np.abs(path[i]).max(axis=0), coupling.mean(axis=0), length)
            least[i] = np.where(np.isfinite(found), SMALLEST * found, 0.0)
        return least

    def _at_saved_times(
        self, rows: np.ndarray, states: np.ndarray, steps: int
    ) -> tuple[np.ndarray, int]:
        """Move states from the ends of equal intervals to the saved times, which are rounded.

        Return them and the number of evaluations. The steps are at most an eighth of those of the
        finest run, of the sixth order whatever the method.

        - steps: Of the finest run.
        """
        at = np.flatnonzero(self._shifts)
        if not len(at):
            return states, 0
        longest, length = float(np.abs(self._shifts).max()), abs(self.span[1] - self.span[0])
        count = max(1, math.ceil(8 * steps * longest / length))
        times, sizes = self.times[at] - self._shifts[at], self._shifts[at] / count
        stepper = Stepper(
            self.members.H,
            usual_method(self.members.H),
            states[:, at].reshape(-1, states.shape[2]),
            np.tile(times, len(rows)),
            np.tile(sizes, len(rows)),
            parameters=np.repeat(self.members.parameters[rows], len(at), axis=0),
        )
        moved = states.copy()
        moved[:, at] = stepper.step(count).reshape(len(rows), len(at), -1)
        return moved, stepper.evaluations

    def _of_rates(self, rows: np.ndarray, path: np.ndarray, coarse: int) -> np.ndarray:
        """Effect of the rounding of times, and of operations, where rates are evaluated, (n, dim).

        Where the results of operations cancel, rates have fewer digits than the state. Errors that
        differ between steps add up as independent ones do. A shift of all times changes the states
        by what they move in it.

        - path: States of the middle run, shape (n, times, dim).
        """
        start, end = self.span
        # At equal distances a periodic force may always have the same phase.
        number = np.arange(min((path.shape[1] - 1) // LANES * LANES, _TIMES) or LANES)
        places = (number + number * _GOLDEN % 1) / len(number)
        z = path[:, (places * (path.shape[1] - 1)).astype(int)]
        times = start + (end - start) * places
        given = self.members.own_parameters(rows)
        own = self.members.parameters[rows]
        with np.errstate(all="ignore"):
            by_chance, alike = self._programs.roundings(z, np.tile(times, (len(rows), 1)), own)
            found = np.abs(alike).mean(axis=1)
            squares = np.mean(by_chance**2, axis=1)
            largest = np.zeros_like(found)
            if self.system.time_dependent:
                z, t = z.transpose(1, 0, 2), times[:, None]
                rounded = _EPS * max(abs(start), abs(end))
                shifts = np.copysign(4 * rounded, (start + end) / 2 - t)  # into the span
                rates = self.system.at("vector_field", z, t, given)
                moved = self.system.at("vector_field", z, t + shifts, given)
                squares += np.mean(((moved - rates) / 4) ** 2, axis=0)
                largest = rounded / 2 * np.abs(rates).max(axis=0)
            found = abs(end - start) * (found + np.sqrt(squares / coarse)) + largest
        return np.where(np.isnan(found), np.inf, found)

    def _hidden_features(
        self,
        rows: np.ndarray,
        path: np.ndarray,
        steps: int,
        allowed: np.ndarray,
        errors: np.ndarray,
    ) -> Hidden:
        """Search for features of the force between the steps of members."""
        if self._hidden is None:
            nothing = np.zeros(len(rows))
            return Hidden(nothing, nothing, nothing, np.zeros_like(errors))

        def stepper(which: np.ndarray, states: np.ndarray, starts: np.ndarray) -> Stepper:
            return self._stepper(rows[which], states, steps, starts)

        return self._hidden.search(
            Path(path, np.linspace(*self.span, path.shape[1]), steps, stepper),
            self.members.own_parameters(rows),
            lambda i: allowed[i],
            errors,
        )

    def _rounding(self, rows: np.ndarray) -> float:
        if not isinstance(self.scheme, Splitting):
            return _ROUNDING["implicit"]
        return _ROUNDING["compensated" if self.compensated[rows[0]] else "plain"]

    def _path(
        self, rows: np.ndarray, starts: np.ndarray, steps: int, saves: int
    ) -> tuple[np.ndarray, int]:
        done = self._stepper(rows, starts, steps).advance(saves, steps // saves, show=False)
        return done.path, done.evaluations

    def _perturbed(
        self, rows: np.ndarray, coarse_path: np.ndarray, steps: int
    ) -> tuple[np.ndarray, int, int]:
        """Integrate with perturbations; return the path, their number, and evaluations."""
        stepper = self._stepper(rows, coarse_path[:, 0], steps)
        # A divisor of the steps; short runs have few perturbations.
        between = steps // self.sampled
        pieces = math.gcd(between, _PERTURBED) if between >= 2 * _PERTURBED else 1
        count = pieces * self.sampled
        path = np.empty_like(coarse_path)
        path[:, 0] = coarse_path[:, 0]
        sizes = np.fmax.reduce(np.abs(coarse_path), axis=1)
        for number in range(1, 1 + count):
            perturb(stepper.states, sizes, number)
            states = stepper.step(steps // count)
            if number % pieces == 0:
                path[:, number // pieces] = states
        return path, count, stepper.evaluations

    def _stepper(
        self, rows: np.ndarray, states: np.ndarray, steps: int, starts: np.ndarray | None = None
    ) -> Stepper:
        start, end = self.span
        return Stepper(
            self.members.H,
            self._method,
            states,
            np.full(len(rows), start) if starts is None else starts,
            np.full(len(rows), (end - start) / steps),
            parameters=self.members.parameters[rows],
            compensated=bool(self.compensated[rows[0]]),  # equal in a block
        )

    def _energy_changes(
        self, rows: np.ndarray, states: np.ndarray, sizes: np.ndarray, steps: int
    ) -> np.ndarray:
        """Largest change of H, in units of the change that errors of the tolerance can cause."""
        if not self.members.H.conserves_energy:
            return np.zeros(len(rows))
        z = states.transpose(1, 0, 2)
        given = z, 0.0, self.members.own_parameters(rows)
        energy = self.system.at("energy", *given)
        slopes = np.abs(self.system.at("gradient", *given))
        noise = 4 * _EPS * math.sqrt(steps)
        with np.errstate(all="ignore"):
            # Of the sizes, by the tolerance; of the states and of H, by round-off.
            allowed = np.einsum("tni,ni->tn", slopes, SLACK * self.tol * sizes)
            allowed += noise * (np.einsum("tni,tni->tn", slopes, np.abs(z)) + np.abs(energy))
            change = np.abs(energy - energy[0])
            allowed = np.maximum(allowed, allowed[0])
            share = np.where(change == 0, 0.0, change / allowed).max(axis=0)
        return np.where(np.isfinite(share), share, np.inf)
