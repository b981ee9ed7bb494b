"""Search for the minima of chi-square: of many sets of data, from many starts, at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hamsym.errors import InputError
from hamsym.fitting.motions import Motions, state_sizes
from hamsym.fitting.observations import Observables, Observations
from hamsym.fitting.unknowns import Unknowns
from hamsym.numerics.least_squares import Minima, are_minima, minimize_squares, projections

_FEWEST, _SHARE = 8, 4  # starts that are refined: eight, or a quarter
_SAME = 0.1  # standard errors between estimates of the same minimum
_BATCH = 4_000_000  # numbers in the derivatives of states that are computed together


@dataclass(frozen=True)
class Found(Minima):
    """The best minimum of each set, a row each.

    Residuals are (model - data)/sigma, zero where data are missing, of observables times.
    """

    #: reached, refined: Number of starts that reached it, shape (sets,), and of those that were
    #: refined.
    reached: np.ndarray
    refined: int
    #: Of one set: the different minima, the best one first.
    minima: tuple[tuple[np.ndarray, float, int], ...]

    @property
    def chi_square(self) -> np.ndarray:
        """Shape (sets,)."""
        return np.asarray((self.residuals**2).sum(axis=1))


@dataclass(frozen=True)
class Model:
    """Weighted residuals of observations as functions of the free quantities."""

    unknowns: Unknowns
    observed: Observations
    motions: Motions
    span: tuple[float, float]
    tol: float

    @cached_property
    def observables(self) -> Observables:
        unknowns = self.unknowns
        return Observables(unknowns.H, self.observed.expressions, unknowns.free_parameters)

    @cached_property
    def sizes(self) -> np.ndarray:
        """Sizes of the first guesses, shape (k,).

        A component that is zero has the size that others give it, a parameter that is zero 1.
        """
        unknowns = self.unknowns
        guesses, components = unknowns.guesses, unknowns.components
        found = np.where(guesses == 0, 1.0, np.abs(guesses))
        if any(guesses[j] == 0 for j in components):
            states = state_sizes(unknowns, self.span)
            for j, i in components.items():
                found[j] = found[j] if guesses[j] else states[i]
        return found

    def residuals(self, values: np.ndarray, sets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (n, m) and derivatives (n, m, k) for values (n, k) and their sets."""
        size = len(self.observed.t) * self.unknowns.H.dim * values.shape[1]
        step = max(1, _BATCH // size)
        parts = [
            self._weighted(*self._observed(values[k : k + step]), sets[k : k + step])
            for k in range(0, len(values), step)
        ]
        residuals, slopes = zip(*parts, strict=True)
        return np.concatenate(residuals), np.concatenate(slopes)

    def _weighted(
        self, found: np.ndarray, slopes: np.ndarray, sets: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (model - data)/sigma of some sets and its derivatives, zero without data."""
        present, sigma = self.observed.present[sets], self.observed.sigma[sets]
        with np.errstate(all="ignore"):
            slopes = np.where(present[..., None], slopes / sigma[..., None], 0.0)
        residuals = self._from_data(found, sets)
        return residuals.reshape(len(sets), -1), slopes.reshape(len(sets), -1, slopes.shape[-1])

    def _from_data(self, found: np.ndarray, sets: np.ndarray) -> np.ndarray:
        """Return (model - data)/sigma of some sets, zero without data."""
        present, sigma = self.observed.present[sets], self.observed.sigma[sets]
        with np.errstate(all="ignore"):
            return np.where(present, (found - self.observed.data[sets]) / sigma, 0.0)

    def _observed(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return observables (n, observables, times) and derivatives in the free quantities."""
        states, motion = self.motions(values)
        parameters = self.unknowns.parameter_rows(values)
        found, in_state, explicit = self.observables(states, self.observed.t, parameters)
        with np.errstate(all="ignore"):
            slopes = np.einsum("noti,ntik->notk", in_state, motion)
        columns = [j for j in range(values.shape[1]) if j not in self.unknowns.components]
        slopes[..., columns] += explicit
        return found, slopes

    def squares(self, values: np.ndarray, sets: np.ndarray) -> np.ndarray:
        """Return chi-square for values (n, k) and their sets, nan without a motion, shape (n,)."""
        parameters = self.unknowns.parameter_rows(values)
        found, _, _ = self.observables(self.motions.states(values), self.observed.t, parameters)
        with np.errstate(all="ignore"):
            return np.asarray((self._from_data(found, sets) ** 2).sum(axis=(1, 2)))

    def prospects(self, values: np.ndarray) -> np.ndarray:
        """Return the least chi-square of the linear model at values (n, k), shape (sets, n).

        It is infinite where there is no motion. It ranks starts better than chi-square itself,
        which prefers small amplitudes to the right frequency with another amplitude.
        """
        found, slopes = self._observed(values)
        least = np.full((len(self.observed.data), len(values)), np.inf)
        for k in range(len(least)):
            residuals, J = self._weighted(found, slopes, np.full(len(values), k))
            good = np.isfinite(residuals).all(axis=1) & np.isfinite(J).all(axis=(1, 2))
            residuals, J = residuals[good], J[good]
            least[k, good] = (residuals**2).sum(axis=1) - projections(residuals, J)
        return least

    def variance(self, squares: np.ndarray, sets: np.ndarray) -> np.ndarray:
        """Return the variance of a weighted residual, from chi-square of some sets, shape (n,)."""
        freedom = np.maximum(self.observed.counts[sets] - len(self.unknowns.names), 1)
        if self.observed.known:
            return np.maximum(squares / freedom, 1.0)
        # Residuals smaller than the errors of the motion say nothing of a minimum.
        squares_of_data = np.nansum(self.observed.data[sets] ** 2, axis=(1, 2))
        floor = self.tol**2 * squares_of_data / np.maximum(self.observed.counts[sets], 1)
        return np.maximum(squares / freedom, floor)

    def again(self, found: Found, motions: Motions) -> Found:
        """Return a result for one set with residuals from another source of motions."""
        model = replace(self, motions=motions)
        residuals, slopes = model.residuals(found.unknowns, np.zeros(1, dtype=int))
        converged = np.zeros(1, dtype=bool)
        if np.isfinite(residuals).all() and np.isfinite(slopes).all():
            unknowns = self.unknowns
            minimal = are_minima(
                lambda values, rows: model.residuals(values, 0 * rows),
                *(found.unknowns, residuals, slopes, unknowns.low, unknowns.high),
                model.variance((residuals**2).sum(axis=1), np.zeros(1, dtype=int)),
                self.sizes[None],
            )
            converged = found.converged & minimal
        return replace(found, residuals=residuals, jacobian=slopes, converged=converged)


def search(model: Model, starts: int, seed: int) -> Found:
    """Minimise chi-square of every set from the best of some starts.

    Raise InputError if the motion cannot be solved from any start.
    """
    unknowns, sets = model.unknowns, len(model.observed.data)
    guesses = unknowns.draw(starts, seed, model.sizes)
    if starts > 1:
        squares = model.prospects(guesses)
        _require_motion(model, np.isfinite(squares).any(), guesses)
        refined = min(starts, max(_FEWEST, starts // _SHARE))
        best = np.argsort(squares, axis=1, kind="stable")[:, :refined]
        first = guesses[best].reshape(sets * refined, -1)
    else:
        refined, first = 1, np.tile(guesses, (sets, 1))
    owners = np.repeat(np.arange(sets), refined)
    found = minimize_squares(
        lambda values, rows: model.residuals(values, owners[rows]),
        first,
        unknowns.low,
        unknowns.high,
        lambda squares, rows: model.variance(squares, owners[rows]),
        sizes=np.where(first == 0, model.sizes, np.abs(first)),
    )
    with np.errstate(all="ignore"):
        squares = (found.residuals**2).sum(axis=1)
    squares = np.where(np.isfinite(squares), squares, np.inf).reshape(sets, refined)
    _require_motion(model, np.isfinite(squares).any(), guesses)
    rows = np.argmin(squares, axis=1) + refined * np.arange(sets)
    groups = _groups(model, found, squares, 0) if sets == 1 else []
    reached = np.array([len(_same(model, found, squares, k, row)) for k, row in enumerate(rows)])
    return Found(
        found.unknowns[rows],
        found.residuals[rows],
        found.jacobian[rows],
        found.converged[rows],
        found.iterations[rows],
        reached,
        refined,
        tuple((found.unknowns[g[0]], float(squares[0, g[0]]), len(g)) for g in groups),
    )


def _require_motion(model: Model, exists: bool | np.bool_, guesses: np.ndarray) -> None:
    if not exists:
        which = "the first guess" if len(guesses) == 1 else f"any of {len(guesses):,} first guesses"
        raise InputError(
            f"the motion cannot be solved from {which}, {model.unknowns.text(guesses[0])}: "
            f"{model.motions.reason(guesses[0])}; give another first guess"
        )


def _same(model: Model, found: Minima, squares: np.ndarray, k: int, row: int) -> list[int]:
    """Return the converged rows of set k whose estimates are those of a row."""
    rows = np.arange(k * squares.shape[1], (k + 1) * squares.shape[1])
    if not np.isfinite(squares[k, row - rows[0]]):
        return []
    away = np.einsum("mk,nk->nm", found.jacobian[row], found.unknowns[rows] - found.unknowns[row])
    unit = model.variance(squares[k, [row - rows[0]]], np.array([k]))
    near = (away**2).sum(axis=1) <= _SAME**2 * unit
    return [int(other) for other in rows[near & found.converged[rows]]]


def _groups(model: Model, found: Minima, squares: np.ndarray, k: int) -> list[list[int]]:
    """Return converged rows of set k, those of each minimum together, the best one first."""
    order = [int(row) for row in np.argsort(squares[k], kind="stable") if found.converged[row]]
    groups: list[list[int]] = []
    left = set(order)
    for row in order:
        if row in left:
            same = [row, *(r for r in _same(model, found, squares, k, row) if r in left - {row})]
            groups.append(same)
            left -= set(same)
    return groups
