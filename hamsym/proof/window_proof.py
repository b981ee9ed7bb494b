"""Two-sided bounds on the error of a trial solution, from enclosures on windows.

On each window of :mod:`hamsym.proof.windows`, z = y + (a set of known size), and z^ is a Chebyshev
model (:mod:`hamsym.proof.trial_models`). So z^ - y, H(z^) - H and dz^/dt - J grad H(z^) are models,
too, formed in twice float64: P with |f - P| <= R.

*Largest values.* For a polynomial P of degree n < M and the zeros x_j of T_M,

    max_j |P(x_j)| <= max |P| <= max_j |P(x_j)| / cos(n pi/(2 M))      (Ehlich & Zeller 1964),

and for a 2-norm the same for the sum of squares, of degree 2 n. Upper bounds grow by R and by the
size of the set, lower bounds shrink by both. If H does not depend on time, H(z) = H(z0) exactly;
otherwise |H(z) - H(y)| <= sum_i sup |dH/dz_i| |z_i - y_i|, the supremum over the tube around y.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb

from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.ball_arithmetic import UNIT, number_of
from hamsym.proof.balls import working
from hamsym.proof.limits import Deadline
from hamsym.proof.programs import ModelRows, Rows, split, tables
from hamsym.proof.trial_models import Piece, trial_pieces
from hamsym.proof.windows import Equation, Window, WindowStepper
from hamsym.solution.solution import Solution

__all__ = ["WindowBounds", "window_bounds"]

_TERMS = 64  # of models of z^
_ROOM = 1 + 1e-9  # for the rounding of sums of numbers >= 0
_BITS = 240


@dataclass(frozen=True)
class WindowBounds:
    """Proven bounds on largest magnitudes over the span.

    Attributes
    ----------
    uppers, lowers : numpy.ndarray
        Of the 2-norm of the error, its components, the energy error and the residual, shape
        (dim + 3,).
    edges : tuple of fractions.Fraction
        Ends of the windows in elapsed time.
    pieces : tuple of float
        Upper bounds on the 2-norm of the error in each window.
    widths : numpy.ndarray
        Largest sizes of the set around the true state, shape (dim,).
    """

    uppers: np.ndarray
    lowers: np.ndarray
    edges: tuple[Fraction, ...]
    pieces: tuple[float, ...]
    widths: np.ndarray


def window_bounds(
    solution: Solution,
    deadline: Deadline,
    accuracy: float,
    terms: int,
    samples: int,
    progress: Callable[[float], None] | None = None,
    stop: Callable[[np.ndarray, np.ndarray], bool] | None = None,
) -> WindowBounds:
    """Bounds on the error of a solution.

    Parameters
    ----------
    solution : Solution
    deadline : Deadline
    accuracy : float
        Of the enclosure, relative to the components.
    terms : int
        Of the polynomials of the enclosure.
    samples : int
        M, a power of two.
    progress : callable, optional
        Called with the completed share of the span.
    stop : callable, optional
        (uppers, lowers) of one window -> whether to give up.

    Raises
    ------
    CertificationError
        If there is no enclosure on the whole span, or the bounds were given up.
    """
    begin, end = (Fraction(float(value)) for value in solution.span)
    direction, total = 1 if end > begin else -1, abs(end - begin)
    pieces = trial_pieces(solution.trial, solution.span)
    equation = Equation(solution.H)
    dim = equation.dim
    stepper = WindowStepper(
        equation, begin, direction, total, solution.z0, np.zeros(dim), accuracy, deadline, terms
    )
    comparison = _Comparison(solution.H, equation, begin, direction, solution.z0, samples)
    uppers, lowers, widths = np.zeros(dim + 3), np.zeros(dim + 3), np.zeros(dim)
    edges, norms = [Fraction(0)], []
    for piece in pieces:
        limit = min(piece.end, total)
        while stepper.elapsed < limit:
            window = stepper.step(limit)
            upper, lower, width = comparison.bounds(piece, window)
            if not np.isfinite(upper).all():
                raise CertificationError("the trial solution was not resolved")
            if stop is not None and stop(upper, lower):
                raise CertificationError("the bounds are wider than asked")
            uppers, lowers = np.maximum(uppers, upper), np.maximum(lowers, lower)
            widths = np.maximum(widths, width)
            edges.append(window.end)
            norms.append(float(upper[0]))
            if progress:
                progress(float(stepper.elapsed / total))
    return WindowBounds(uppers, lowers, tuple(edges), tuple(norms), widths)


class _Comparison:
    """z^ beside the enclosure of z."""

    def __init__(
        self,
        H: Hamiltonian,
        equation: Equation,
        begin: Fraction,
        direction: int,
        z0: np.ndarray,
        samples: int,
    ) -> None:
        self._equation, self._samples = equation, samples
        self._begin, self._direction = begin, direction
        self._rates = ModelRows(equation.rates, _TERMS)
        self._energy = ModelRows(equation.energy, _TERMS)
        self._start: tuple[float, float, float] | None = None
        if not equation.time_dependent:
            place = ModelRows(equation.energy, 4)
            for i, value in enumerate(z0.tolist()):
                place.set_number(i, (value, 0.0, 0.0))
            place.run(tables(4), True)
            found = place.taken(equation.energy.results)
            self._start = (
                float(found.high[0, 0]),
                float(found.low[0, 0]),
                float(found.radius[0] + np.abs(found.high[0, 1:]).sum() * _ROOM),
            )

    def bounds(self, piece: Piece, window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Upper and lower bounds of the dim + 3 quantities in a window, and widths of the set."""
        equation, dim = self._equation, self._equation.dim
        state, rate = piece.models(window.start, window.half, _TERMS)
        centre = split(self._begin + self._direction * (window.start + window.half))
        slope = split(self._direction * window.half)
        width = _widths(window)
        terms = window.high.shape[1]
        y = Rows(window.high, window.low, np.zeros(dim), np.full(dim, terms))
        error, error_radius = _difference(state, y)
        uppers, lowers = np.zeros(dim + 3), np.zeros(dim + 3)
        uppers[: dim + 1], lowers[: dim + 1] = self._norm_and_parts(
            error, (error_radius + width) * _ROOM
        )
        # the residual
        rows = self._rates
        rows.set_models(0, state)
        rows.set_line(dim, centre, slope)
        rows.run(tables(_TERMS), True)
        G = rows.taken(equation.rates.results)
        signed = Rows(self._direction * G.high, self._direction * G.low, G.radius, G.length)
        residual, residual_radius = _difference(rate, signed)
        upper, lower = self._norm_and_parts(residual, residual_radius)
        uppers[-1], lowers[-1] = upper[0], lower[0]
        # the energy
        energy = self._energy_of(state, centre, slope)
        slack = 0.0
        if self._start is not None:
            other = Rows(
                np.array([[self._start[0]]]),
                np.array([[self._start[1]]]),
                np.array([self._start[2]]),
                np.array([1]),
            )
        else:
            other = self._energy_of(y, centre, slope)
            slack = self._energy_slack(window, width, centre, slope)
        change, radius = _difference(energy, other)
        upper, lower = self._norm_and_parts(change, radius + slack * _ROOM)
        uppers[-2], lowers[-2] = upper[1], lower[1]
        return uppers, lowers, width

    def _energy_of(
        self,
        state: Rows,
        centre: tuple[float, float, float],
        slope: tuple[float, float, float],
    ) -> Rows:
        rows = self._energy
        rows.set_models(0, state)
        if state.high.shape[1] < _TERMS:
            rows.high[: len(state.radius), state.high.shape[1] :] = 0.0
            rows.low[: len(state.radius), state.high.shape[1] :] = 0.0
        rows.set_line(self._equation.dim, centre, slope)
        rows.run(tables(_TERMS), True)
        return rows.taken(self._equation.energy.results)

    def _energy_slack(
        self,
        window: Window,
        width: np.ndarray,
        centre: tuple[float, float, float],
        slope: tuple[float, float, float],
    ) -> float:
        """A bound on |H(z) - H(y)|."""
        dim = self._equation.dim
        rows = ModelRows(self._equation.rates, window.high.shape[1])
        rows.high[:dim], rows.low[:dim] = window.high, window.low
        rows.length[:dim] = window.high.shape[1]
        rows.radius[:dim] = window.tube
        rows.set_line(dim, centre, slope)
        rows.run(tables(window.high.shape[1]), False)
        found = rows.taken(self._equation.rates.results)
        slopes = (np.abs(found.high).sum(axis=1) + found.radius) * _ROOM
        # J grad H has the slopes in p first, then minus those in q.
        half = dim // 2
        return float(np.concatenate([slopes[half:], slopes[:half]]) @ width) * _ROOM

    def _norm_and_parts(
        self, series: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on the 2-norm and on the size of each of several models, shape (1 + n,)."""
        table = _sample_table(self._samples)
        with np.errstate(all="ignore"):
            values = series @ table[: series.shape[1]]
            sums = np.abs(series).sum(axis=1) * _ROOM
            rounding = sums * (series.shape[1] + 4) * 2 * UNIT
            largest = np.abs(values).max(axis=1)
            squares = math.sqrt(float((values * values).sum(axis=0).max()))
            beside = math.sqrt(float((rounding * rounding).sum()))
            whole = math.sqrt(float((radius * radius).sum()))
            degree = series.shape[1] - 1
            parts = np.minimum((largest + rounding) * _factor(degree, self._samples), sums)
            norm = (squares + beside) * math.sqrt(_factor(2 * degree, self._samples))
        uppers = np.concatenate([[norm + whole], parts + radius]) * _ROOM
        lowers = np.concatenate([[squares - beside - whole], largest - rounding - radius])
        return uppers, np.maximum(lowers * (1 - 1e-9), 0.0)


@functools.cache
def _sample_table(samples: int) -> np.ndarray:
    """T_k at the zeros of T_M, shape (terms, M), each rounded from a proven ball."""
    with working(_BITS):
        step = arb.pi() / (2 * samples)
        cosines = np.array([float((step * n).cos().mid()) for n in range(4 * samples)])
    angles = np.arange(_TERMS)[:, None] * (2 * np.arange(samples) + 1)
    return np.ascontiguousarray(cosines[angles % (4 * samples)])


def _factor(degree: int, samples: int) -> float:
    """An upper bound on 1/cos(degree pi/(2 M))."""
    with working(_BITS):
        return number_of(1 / (arb.pi() * degree / (2 * samples)).cos())[0] * (1 + 1e-12)


def _widths(window: Window) -> np.ndarray:
    """Bounds on |z_i - y_i| over the window."""
    found = window.beside.copy()
    sizes = np.abs(window.V).sum(axis=2)
    for matrix, radii in ((window.C, window.r0), (window.Q, window.r)):
        if radii.any():
            products = np.einsum("ick,cd->idk", window.V, matrix)
            found += np.abs(products).sum(axis=2) @ radii
            found += 1e-12 * (sizes @ (np.abs(matrix) @ radii))  # roundings
    return np.minimum(found * _ROOM, window.tube)


def _difference(first: Rows, second: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the difference of models, rounded, and its radii."""
    count, terms = first.high.shape
    b, c = np.zeros((count, terms)), np.zeros((count, terms))
    width = second.high.shape[1]
    b[:, :width], c[:, :width] = second.high, second.low
    used, other = (
        np.arange(terms) < first.length[:, None],
        np.arange(terms) < second.length[:, None],
    )
    a, x = np.where(used, first.high, 0.0), np.where(used, first.low, 0.0)
    b, c = np.where(other, b, 0.0), np.where(other, c, 0.0)
    s = a - b
    t = s - a
    e = (a - (s - t)) - (b + t)
    found = s + (e + (x - c))
    rounding = np.abs(found) + np.abs(e) + np.abs(x) + np.abs(c)
    radius = first.radius + second.radius + 4 * UNIT * rounding.sum(axis=1)
    return found, radius * _ROOM
