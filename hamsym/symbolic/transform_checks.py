"""Checks of Legendre transforms that were solved for: right, unique, and accurate in float64.

Input:  F(s), and a candidate G(w) for its transform w s - F(s), where w = dF/ds.
Output: whether G is the transform at random s, whether F has one, and whether numbers keep it.

All comparisons take s at random and compute w from it in many digits.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import sympy

from hamsym.symbolic import derivatives

_SAMPLES = 8  # random s at which a transform is compared
_TRIALS = 200
_DIGITS = 120  # of the slopes: those of sqrt(m**2 + s**2) differ little where s is large
_NOISE = sympy.Float("1e-100", _DIGITS)  # of a determinant
_INFINITE = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo)
_DECADES = range(-3, 9)  # sizes of s at which a transform must be unique
_DRAWS = 3  # of the constants
_NEAR_REST = range(-12, 3)  # decades of s at which float64 is compared, beside s = 0
_ROUNDED = 1e-12  # largest relative error of a transform and its slopes
_ROUNDED_TWICE = 1e-9  # of its second derivatives
_EPSILONS = 16 * float(np.finfo(float).eps)  # of w: what any formula may lose


class TransformChecks:
    """Checks of candidates for the transform of one function.

    - expr: F.
    - slots, duals: s and w.
    - parameters: Values of constants; others are random.
    """

    def __init__(
        self,
        expr: sympy.Expr,
        slots: Sequence[sympy.Symbol],
        duals: Sequence[sympy.Symbol],
        parameters: Mapping[sympy.Symbol, float],
    ) -> None:
        self._expr, self._slots, self._duals = expr, list(slots), list(duals)
        self._parameters = parameters
        self._slopes = derivatives.gradient(expr, slots)
        self._second = sympy.Matrix(
            [[sympy.diff(slope, slot) for slot in slots] for slope in self._slopes]
        )

    def agrees(self, solved: sympy.Expr) -> bool:
        """Compare a transform and its slopes with w s - F and s at random s, of both signs.

        If two values of s belonged to one w, the transform could not agree for both.
        """
        generator = random.Random(1)
        back = derivatives.gradient(solved, self._duals)
        agreed = [0, 0]
        for _ in range(_TRIALS):
            at = self._constants(generator, solved)
            scale = sympy.Rational(generator.choice([1, 10, 100, 1000]), 100)
            for slot in self._slots:
                at[slot] = scale * sympy.Rational(generator.randint(-999, 999), 1000)
            rates = [slope.xreplace(at).evalf(_DIGITS) for slope in self._slopes]
            if not all(rate.is_Float for rate in rates):
                continue
            at |= dict(zip(self._duals, rates, strict=True))
            pairs = [(solved, self._transformed(at)), *zip(back, self._at(at), strict=True)]
            for found, value in pairs:
                difference = found.xreplace(at).evalf(_DIGITS) - value
                if not difference.is_number or difference.has(*_INFINITE):
                    return False
                if not abs(difference) <= 1e-18 * (1 + abs(value)):
                    return False
            agreed[int(bool(at[self._slots[0]] > 0))] += 1
            if sum(agreed) >= _SAMPLES and min(agreed) > 0:
                return True
        return sum(agreed) >= _SAMPLES

    def is_unique(self) -> bool:
        """Whether the determinant of second derivatives has one sign at random s of all sizes.

        Where it changes, two values of s belong to one w, and the transform has branches. Places
        where F is not real are no part of its domain.
        """
        generator = random.Random(3)
        for _ in range(_DRAWS):
            constants, signs = self._constants(generator), set()
            for decade in _DECADES:
                at = dict(constants)
                for slot in self._slots:
                    share = sympy.Rational(generator.randint(-999, 999), 1000)
                    at[slot] = share * sympy.Rational(10) ** decade
                first = [e.xreplace(at).evalf(20) for e in (self._expr, *self._slopes)]
                if not all(value.is_Float for value in first):
                    continue
                matrix = self._second.xreplace(at).evalf(_DIGITS)
                size, largest = matrix.det(), max(abs(entry) for entry in matrix)
                if size.is_Float and abs(size) > _NOISE * largest ** len(self._slots):
                    signs.add(bool(size > 0))
            if len(signs) > 1:
                return False
        return True

    def is_accurate(self, solved: sympy.Expr) -> bool:
        """Whether float64 keeps a transform and two derivatives at rest, near it and elsewhere.

        They are compared with w s - F, with s and with the inverse of the second derivatives of F.
        An error may be as large as the rounding of w itself makes it.
        """
        terms = sympy.Add.make_args(solved)
        back = derivatives.gradient(solved, self._duals)
        second = [
            sympy.diff(slope, dual).replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)
            for slope in back
            for dual in self._duals
        ]
        others = sorted(solved.free_symbols - {*self._duals}, key=str)
        evaluate = sympy.lambdify(
            [*self._duals, *others], [*terms, *back, *second], "numpy", dummify=True
        )
        for at in self._near_rest(solved):
            w = np.array([float(at[dual]) for dual in self._duals])
            s = np.array([float(value) for value in self._at(at)])
            matrix = self._second.xreplace(at).evalf(_DIGITS)
            curved = all(entry.is_Float or entry == 0 for entry in matrix) and matrix.det() != 0
            inverse = np.zeros((len(s), len(s)))
            if curved:
                inverse[:] = np.array(matrix.inv().tolist(), dtype=float)
            moved = _EPSILONS * (np.abs(inverse) @ np.abs(w)).max()
            if not moved <= 1e-3 * np.abs(s).max() and w.any():
                continue  # w in float64 belongs to another s
            constants = [np.float64(float(at[symbol])) for symbol in others]
            with np.errstate(all="ignore"):
                found = np.array(evaluate(*w, *constants), dtype=complex)
            value, slopes = found[: len(terms)], found[len(terms) : len(terms) + len(s)]
            size = np.abs(s).max()
            if not abs(value.sum() - float(self._transformed(at))) <= (
                _ROUNDED * np.abs(value).sum() + moved * np.abs(w).sum()
            ):
                return False
            if not np.abs(slopes - s).max() <= _ROUNDED * size + moved:
                return False
            if curved and not np.abs(
                found[len(terms) + len(s) :].reshape(inverse.shape) - inverse
            ).max() <= np.abs(inverse).max() * (
                _ROUNDED_TWICE + (100 * moved / size if size else 0.0)
            ):
                return False
        return True

    def _near_rest(self, solved: sympy.Expr) -> Iterator[dict[sympy.Symbol, sympy.Expr]]:
        """States at rest and at s of many sizes, with w where F has slopes there."""
        generator = random.Random(4)
        for decade in (None, *_NEAR_REST):
            at = self._constants(generator, solved)
            for slot in self._slots:
                sign, share = generator.choice([-1, 1]), generator.randint(200, 999)
                size = 0 if decade is None else sympy.Rational(10) ** decade
                at[slot] = size * sympy.Rational(sign * share, 1000)
            rates = [slope.xreplace(at).evalf(_DIGITS) for slope in self._slopes]
            values = [*rates, self._transformed(at | dict(zip(self._duals, rates, strict=True)))]
            if all(value.is_Float or value == 0 for value in values):
                yield at | dict(zip(self._duals, rates, strict=True))

    def _at(self, at: Mapping[sympy.Symbol, sympy.Expr]) -> list[sympy.Expr]:
        return [at[slot] for slot in self._slots]

    def _transformed(self, at: Mapping[sympy.Symbol, sympy.Expr]) -> sympy.Expr:
        pairs = zip(self._duals, self._slots, strict=True)
        found = sum(at[w] * at[s] for w, s in pairs) - self._expr.xreplace(at)
        return found.evalf(_DIGITS)

    def _constants(
        self, generator: random.Random, solved: sympy.Expr = sympy.S.Zero
    ) -> dict[sympy.Symbol, sympy.Expr]:
        """Random values of both signs, and those of parameters that have one."""
        symbols = (self._expr.free_symbols | solved.free_symbols) - {*self._slots, *self._duals}
        return {
            symbol: sympy.Rational(generator.choice([-1, 1]) * generator.randint(20, 300), 100)
            for symbol in sorted(symbols, key=str)
        } | {symbol: sympy.Rational(str(v)) for symbol, v in self._parameters.items()}
