"""Places of a box at which H may have a feature that is narrower than the polynomials of a map.

A pulse or a step in a parameter, or one that only few starts meet, lies between all random places.
It is near zeros and extrema of arguments in the formula, of exp, tanh and similar functions, and
of bases of negative and fractional powers (:func:`hamsym.symbolic.derivatives.narrow_arguments`).
Over the map such an argument is a smooth function of time and inputs. If its range is small, the
random places see what its function does. Otherwise a search from many places finds its zeros and
extrema, those first near which trajectories stay longest.

The residual along one solution is bounded (:mod:`hamsym.bounds`). Over a box it is a function of
time and inputs, which models of one variable do not bound: that takes the Taylor models of
:meth:`hamsym.FlowMap.certify`, seconds to minutes for each map.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy

from hamsym.flow_maps.box import Box, compiled_in
from hamsym.flow_maps.domain import random_places
from hamsym.symbolic.derivatives import Narrow, narrow_arguments

_SAMPLES = 4_096  # places at which the ranges are measured
_AT_END = 0.3  # probability that a coordinate of a sample is an end
_CHANGE = 20.0  # of the argument of exp, which random places resolve
_RATIO = 100.0  # of the base of a power, which they resolve
_SEARCHES, _MOST = 16, 192  # for each zero or extremum; in all
_CHILDREN, _GENERATIONS = 8, 96
_FIRST, _LONGER, _SHORTER = 0.3, 1.6, 0.6  # steps of the search


def narrow_places(
    map: Any, box: Box, span: tuple[float, float], random: np.random.Generator
) -> np.ndarray:
    """Return scaled times and inputs in and beside such features, shape (n, 1 + d)."""
    search = _Search(map, box, span, random)
    if not search.kinds:
        return np.empty((0, 1 + len(box)))
    with np.errstate(all="ignore"):
        return search.places()


class _Search:
    """Searches for zeros and extrema of arguments, over scaled times and inputs."""

    def __init__(
        self, map: Any, box: Box, span: tuple[float, float], random: np.random.Generator
    ) -> None:
        self._map, self._box, self._span, self._random = map, box, span, random
        form = box.H.real_equations
        varied = {*box.parameters}
        fixed = {
            symbol: sympy.Float(value)
            for name, (symbol, value) in form.parameters.items()
            if name not in varied
        }
        given = [form.parameters.get(name, (None,))[0] for name in box.parameters]
        inputs = [symbol for symbol in given if symbol is not None]
        time = [] if form.time is None else [form.time]
        formulas = [formula.xreplace(fixed) for formula in form.formulas]
        of_H = [entry for f in formulas for entry in narrow_arguments(f, [*form.z, *time, *inputs])]
        symbols = box.symbols
        of_starts = [e for f in box.formulas.values() for e in narrow_arguments(f, symbols)]
        self.kinds = [kind for _, kind in (*of_H, *of_starts)]
        self._columns = [k for k, symbol in enumerate(given) if symbol is not None]
        self._of_H = compiled_in([g for g, _ in of_H], [*form.z, *inputs], form.time)
        self._of_starts = compiled_in([g for g, _ in of_starts], symbols)

    def _arguments(self, y: np.ndarray) -> np.ndarray:
        """Return all arguments at scaled times and inputs, shape (n, 1 + d) -> (n, k)."""
        start, end = self._span
        times, inputs = start + (end - start) * (y[:, 0] + 1) / 2, self._box.at(y[:, 1:])
        states = self._map.evaluate(times, inputs)
        parameters = inputs[:, len(self._box.components) :][:, self._columns]
        known = np.concatenate((states, parameters), axis=1)
        return np.concatenate((self._of_H(known, times), self._of_starts(inputs)), axis=1)

    def places(self) -> np.ndarray:
        """Return scaled times and inputs at the zeros and extrema, and beside them."""
        d = len(self._box)
        samples = random_places(self._random, _SAMPLES, d + 1, _AT_END)
        aims = self._aims(self._arguments(samples))
        if not aims:
            return np.empty((0, d + 1))
        searches = max(1, min(_SEARCHES, _MOST // len(aims)))
        self._aim = np.repeat(np.array(aims), searches, axis=0)
        # The best of some samples each, so that searches end at different zeros and extrema.
        groups = self._random.permutation(_SAMPLES)[: searches * (_SAMPLES // searches)]
        heights = self._heights(np.tile(samples[groups], (len(aims), 1)), len(groups) // searches)
        best = heights.reshape(len(self._aim), -1).argmin(axis=1)
        groups = np.tile(groups.reshape(searches, -1), (len(aims), 1))
        y = samples[groups[np.arange(len(best)), best]]
        step, path, path_heights = np.full(len(y), _FIRST), [], []
        for _ in range(_GENERATIONS):
            moves = self._random.standard_normal((len(y), _CHILDREN, d + 1))
            children = np.clip(y[:, None] + step[:, None, None] * moves, -1, 1)
            family = np.concatenate((y[:, None], children), axis=1)
            # Averaged over a time that shrinks with the step: what acts longer is preferred.
            found = self._averaged(family, step)
            chosen = found.argmin(axis=1)
            y = family[np.arange(len(y)), chosen]
            path.append(y)
            path_heights.append(found[np.arange(len(y)), chosen])
            step = np.where(chosen > 0, np.minimum(_LONGER * step, _FIRST), _SHORTER * step)
        beside = self._beside(np.stack(path_heights))
        return np.concatenate((y, np.stack(path)[beside, np.arange(len(y))]))

    def _aims(self, g: np.ndarray) -> list[tuple[int, int]]:
        """Return arguments to search, each with -1 for a maximum, 1 for a minimum, 0 for a zero."""
        aims: list[tuple[int, int]] = []
        for k, kind in enumerate(self.kinds):
            known = g[np.isfinite(g[:, k]), k]
            low, high = (known.min(), known.max()) if len(known) else (-np.inf, np.inf)
            crossed = not low * high > 0
            if kind == Narrow.FUNCTION:
                is_wide = not high - low <= _CHANGE
            else:
                ends = sorted((abs(low), abs(high)))
                is_wide = crossed or not ends[1] <= _RATIO * ends[0]
            if is_wide and kind == Narrow.FUNCTION:
                aims += [(k, -1), (k, 1)]
            if is_wide and (crossed or kind != Narrow.FUNCTION):
                aims.append((k, 0))
        return aims

    def _heights(self, y: np.ndarray, each: int) -> np.ndarray:
        """Return what is minimised, at ``each`` places of each search; infinite where unknown."""
        g = self._arguments(y)
        k, sign = np.repeat(self._aim, each, axis=0).T
        value = g[np.arange(len(g)), k]
        height = np.where(sign == 0, np.abs(value), sign * value)
        return np.where(np.isnan(height), np.inf, height)

    def _averaged(self, y: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Return the mean of what is minimised over a short time, shape (searches, places)."""
        shifted = np.repeat(y[:, :, None], 3, axis=2)
        shifted[..., 0] += step[:, None, None] * np.array([-1.0, 0.0, 1.0])
        shifted[..., 0] = np.clip(shifted[..., 0], -1, 1)
        found = self._heights(shifted.reshape(-1, y.shape[2]), 3 * y.shape[1])
        return np.asarray(found.reshape(*y.shape[:2], 3).mean(axis=2))

    def _beside(self, heights: np.ndarray) -> np.ndarray:
        """Return the last generation in which the function still had another value.

        Of exp and similar functions where the argument differs by 1/2, of others by a half.
        """
        of_function = np.array(self.kinds)[self._aim[:, 0]] == Narrow.FUNCTION
        final = heights[-1]
        other = heights > final + np.where(of_function, 0.5, 0.5 * np.abs(final))
        return np.where(other.any(axis=0), len(heights) - 1 - other[::-1].argmax(axis=0), 0)
