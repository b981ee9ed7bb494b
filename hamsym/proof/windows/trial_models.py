"""Trial solutions z^ as Chebyshev models on windows of elapsed time.

The weights are taken as the exact numbers that they are. A piece is a part of the span on which z^
is one smooth function; its models are those of z^ and of its derivative by elapsed time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb

from hamsym.errors import CertificationError
from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic import functions
from hamsym.proof.arithmetic.balls import number_of
from hamsym.proof.arithmetic.directed import up
from hamsym.proof.arithmetic.programs import ModelRows, Program, Recorder, Rows
from hamsym.random_features.trial import FeatureTrial

_TERMS = 64  # of models of features


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of the span."""

    #: start, end: Elapsed time.
    start: Fraction
    end: Fraction
    #: (start, half, terms) -> models of z^ and of dz^/ds on start + half (1 + x).
    models: Callable[[Fraction, Fraction, int], tuple[Rows, Rows]]


def trial_pieces(trial: Any, span: tuple[float, float]) -> list[Piece]:
    """The smooth pieces of a trial solution, in the direction of its span.

    Raise CertificationError if the pieces do not cover the span.
    """
    begin, end = (Fraction(value) for value in span)
    direction = 1 if end > begin else -1
    total = abs(end - begin)
    if isinstance(trial, FeatureTrial):
        pieces = _feature_pieces(trial, begin, direction)
    else:
        from hamsym.networks.chain import Chain  # needs torch

        parts: Sequence[Any] = (trial,)
        edges = [Fraction(0), total]
        if isinstance(trial, Chain):
            parts = trial.pieces
            edges = [direction * (Fraction(edge) - begin) for edge in trial.edges.tolist()]
        pieces = [
            Piece(low, high, _Network(part, begin, direction).models)
            for part, (low, high) in zip(parts, pairwise(edges), strict=True)
        ]
    if any(not piece.start < piece.end for piece in pieces) or (
        pieces[0].start > 0 or pieces[-1].end < total
    ):
        raise CertificationError("the windows do not cover the span; solve again")
    return pieces


def zero_components(trial: Any) -> set[int]:
    """Components of a trial solution whose weights are all zero."""
    if not isinstance(trial, FeatureTrial):
        return set()
    weights = np.abs(trial.states).sum(axis=0) + np.abs(trial.readouts).sum(axis=(0, 1))
    return set(np.flatnonzero(weights == 0).tolist())


# -- features ----------------------------------------------------------------------------------


def _feature_pieces(trial: FeatureTrial, begin: Fraction, direction: int) -> list[Piece]:
    first = direction * (Fraction(float(trial.origin)) - begin)
    edges = [first + Fraction(direction * edge) for edge in trial.edges.tolist()]
    return [
        Piece(low, high, _FeatureWindow(trial, k, low, high - low).models)
        for k, (low, high) in enumerate(pairwise(edges))
    ]


def feature_models(series: np.ndarray) -> tuple[Rows, Rows]:
    """Models of f N_l and of its derivative by s over a window, for each column N_l of a series."""
    return _models_of(series.tobytes(), series.shape[1])


@lru_cache(maxsize=8)
def _models_of(series: bytes, count: int) -> tuple[Rows, Rows]:
    program = _enveloped(count, "exponential")
    rows = ModelRows(program, _TERMS)
    for j, column in enumerate(np.frombuffer(series).reshape(-1, count).T):
        terms, none = len(column), np.zeros(len(column))
        slopes, rest = np.zeros(terms), np.zeros(terms)
        error = enclosures().differentiate_series((column, none), (slopes, rest), twice=True)
        value, slope = count + j, 2 * count + j
        rows.high[value, :terms], rows.length[value] = column, terms
        # dN/ds = 2 dN/dx
        rows.high[slope, :terms], rows.low[slope, :terms] = 2 * slopes, 2 * rest
        rows.radius[slope], rows.length[slope] = up(2 * error), terms
    rows.set_line(3 * count, (0.5, 0.0, 0.0), (0.5, 0.0, 0.0))
    rows.set_number(3 * count + 1, (1.0, 0.0, 0.0))
    rows.run(double=True)
    found = rows.taken(program.results)
    return found[:count], found[count:]


def _enveloped(dim: int, envelope: str) -> Program:
    """z_a + f N and r (f' N + f dN/ds) from z_a, N, dN/ds, s and r = ds/dt."""
    recorder = Recorder(3 * dim + 2)
    *values, s, pace = recorder.variables
    if envelope == "exponential":
        slope = recorder.apply(functions.FUNCTIONS["exp"], -s)
        f = arb(1) - slope
    else:
        slope, f = arb(1), s
    states = [values[i] + f * values[dim + i] for i in range(dim)]
    rates = [pace * (slope * values[dim + i] + f * values[2 * dim + i]) for i in range(dim)]
    return Program(recorder, [*states, *rates])


class _FeatureWindow:
    """z_a + f(s) N(s) on one window."""

    def __init__(self, trial: FeatureTrial, number: int, start: Fraction, length: Fraction) -> None:
        self._trial, self._number = trial, number
        self._start, self._length = start, length

    @cached_property
    def _whole(self) -> Rows:
        """Models over the window of z^ and of its derivative by s."""
        state, readout = self._trial.states[self._number], self._trial.readouts[self._number]
        parts = [
            enclosures().dense(readout.T, shift, part.high, part.low, part.radius, part.length)
            for shift, part in zip(
                (state, np.zeros_like(state)), feature_models(self._trial.series), strict=True
            )
        ]
        return Rows(*map(np.concatenate, zip(*parts, strict=True)))

    def models(self, start: Fraction, half: Fraction, terms: int) -> tuple[Rows, Rows]:
        dim, found = self._trial.states.shape[1], self._whole
        if 2 * half != self._length or terms != _TERMS:
            middle = (start + half - self._start) / self._length  # of s
            share = number_of(2 * half / self._length)
            columns = np.ascontiguousarray(found.high.T), np.ascontiguousarray(found.low.T)
            high, low, error, length = enclosures().clenshaw(
                *columns, number_of(2 * middle - 1), share, terms
            )
            found = Rows(high, low, up(error + found.radius), length)
        rows = ModelRows(_paced(dim), terms)
        rows.set_models(0, found[dim:])
        rows.set_number(dim, number_of(1 / self._length))
        rows.run(double=True)
        return found[:dim], rows.taken(rows.program.results)


@cache
def _paced(dim: int) -> Program:
    """Products of values and the last of the variables."""
    recorder = Recorder(dim + 1)
    *values, pace = recorder.variables
    return Program(recorder, [value * pace for value in values])


# -- networks ----------------------------------------------------------------------------------


class _Network:
    """z0 + f(s) N(s) with a fully connected network, or one for each component."""

    def __init__(self, trial: Any, begin: Fraction, direction: int) -> None:
        self._begin, self._direction = begin, direction
        self._t0, self._tau = Fraction(trial.t0), Fraction(trial.tau)
        self._z0 = trial.z0.numpy().astype(float)
        self._parts = [
            (
                part.activation,
                [
                    (
                        np.ascontiguousarray(matrix.detach().numpy().astype(float)),
                        np.ascontiguousarray(bias.detach().numpy().astype(float)),
                    )
                    for matrix, bias in part.layers
                ],
            )
            for part in trial.parts
        ]
        self._program = _enveloped(len(self._z0), trial.envelope)

    def models(self, start: Fraction, half: Fraction, terms: int) -> tuple[Rows, Rows]:
        dim = len(self._z0)
        middle = (self._begin + self._direction * (start + half) - self._t0) / self._tau
        pace = self._direction / self._tau
        line = number_of(middle), number_of(pace * half)
        values, slopes = [], []
        for activation, layers in self._parts:
            value, slope = _propagated(activation, layers, line, terms)
            values.append(value)
            slopes.append(slope)
        rows = ModelRows(self._program, terms)
        rows.high[:dim, 0] = self._z0
        first = dim
        for part in (*values, *slopes):
            rows.set_models(first, part)
            first += len(part.radius)
        rows.set_line(3 * dim, *line)
        rows.set_number(3 * dim + 1, number_of(pace))
        rows.run(double=True)
        found = rows.taken(self._program.results)
        return found[:dim], found[dim:]


def _propagated(
    activation: str,
    layers: Sequence[tuple[np.ndarray, np.ndarray]],
    line: tuple[tuple[float, float, float], tuple[float, float, float]],
    terms: int,
) -> tuple[Rows, Rows]:
    """N and dN/ds of a network of one input."""
    value = Rows(np.zeros((1, terms)), np.zeros((1, terms)), np.zeros(1), np.array([2]))
    (value.high[0, 0], value.low[0, 0], first), (value.high[0, 1], value.low[0, 1], second) = line
    value.radius[0] = up(first + second)
    slope = Rows(np.zeros((1, terms)), np.zeros((1, terms)), np.zeros(1), np.array([1]))
    slope.high[0, 0] = 1.0
    for depth, (matrix, bias) in enumerate(layers):
        if depth:
            count = len(value.radius)
            program = _activations(activation, count)
            rows = ModelRows(program, terms)
            rows.set_models(0, value)
            rows.set_models(count, slope)
            rows.run(double=True)
            found = rows.taken(program.results)
            value, slope = found[:count], found[count:]
        none = np.zeros(len(bias))
        value, slope = (
            Rows(*enclosures().dense(matrix, shift, part.high, part.low, part.radius, part.length))
            for shift, part in ((bias, value), (none, slope))
        )
    return value, slope


@cache
def _activations(activation: str, count: int) -> Program:
    """An activation of each of a layer's values a, and its derivative times that of a."""
    recorder = Recorder(2 * count)
    values, slopes = [], []
    for k in range(count):
        a, rate = recorder.variables[k], recorder.variables[count + k]
        if activation == "sin":
            value, slope = recorder.sine_cosine(a)
        elif activation == "tanh":
            value = recorder.apply(functions.FUNCTIONS["tanh"], a)
            slope = arb(1) - value * value
        elif activation == "sigmoid":
            growth = recorder.apply(functions.FUNCTIONS["exp"], -a)
            value = recorder.apply(functions.reciprocal, arb(1) + growth)
            slope = value * (arb(1) - value)
        else:
            raise CertificationError(f"the activation '{activation}' has no enclosure")
        values.append(value)
        slopes.append(slope * rate)
    return Program(recorder, [*values, *slopes])
