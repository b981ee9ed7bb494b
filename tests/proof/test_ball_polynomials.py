"""Polynomials of balls against exact rational arithmetic: every operation contains the result."""

from __future__ import annotations

import itertools
import random
from fractions import Fraction

import pytest
from flint import acb, arb, fmpq

from hamsym.proof.arithmetic.ball_polynomials import BallPolynomial
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.functions import SingularityError

DEGREE = 5
Exact = dict[tuple[int, ...], tuple[Fraction, Fraction]]


def _drawn(source: random.Random, variables: int, terms: int, lowest: int = 0) -> Exact:
    found: Exact = {}
    while len(found) < terms:
        powers = tuple(source.randint(0, 3) for _ in range(variables))
        if lowest <= sum(powers) <= DEGREE:
            # of sizes from 1e-30 to 1e30, thirds cannot be written in binary
            found[powers] = tuple(
                Fraction(source.randint(-99, 99), 3) * Fraction(10) ** source.randint(-30, 30)
                for _ in range(2)
            )
    return found


def _times(f: Exact, g: Exact, degree: int = DEGREE) -> Exact:
    found: Exact = {}
    for (p, (a, b)), (q, (c, d)) in itertools.product(f.items(), g.items()):
        powers = tuple(map(int.__add__, p, q))
        if sum(powers) <= degree:
            re, im = found.get(powers, (Fraction(0), Fraction(0)))
            found[powers] = re + a * c - b * d, im + a * d + b * c
    return found


def _plus(f: Exact, g: Exact, sign: int = 1) -> Exact:
    zero = (Fraction(0), Fraction(0))
    return {
        p: tuple(x + sign * y for x, y in zip(f.get(p, zero), g.get(p, zero), strict=True))
        for p in {**f, **g}
    }


def _slope(f: Exact, k: int) -> Exact:
    return {
        (*p[:k], p[k] - 1, *p[k + 1 :]): (p[k] * re, p[k] * im) for p, (re, im) in f.items() if p[k]
    }


def _balls(f: Exact) -> BallPolynomial:
    def ball(x: Fraction) -> arb:
        return arb(fmpq(x.numerator, x.denominator))

    return BallPolynomial.of({p: acb(ball(a), ball(b)) for p, (a, b) in f.items()}, DEGREE)


def _contains(found: BallPolynomial, exact: Exact) -> bool:
    """Whether every coefficient up to the degree is in its ball, and no ball is wide."""
    powers = {*exact, *found.terms()}
    largest = max((abs(x) for pair in exact.values() for x in pair), default=Fraction(1))
    for p in powers:
        ball = found.coefficient(p)
        for part, value in zip((ball.real, ball.imag), exact.get(p, (0, 0)), strict=True):
            value = Fraction(value)
            if not part.contains(fmpq(value.numerator, value.denominator)):
                return False
        if not ball.imag.rad() < arb(float(largest)) * arb(2) ** -90:
            return False
    return True


@pytest.mark.parametrize("seed", range(12))
def test_sums_products_and_brackets_contain_the_exact_ones(seed: int) -> None:
    source = random.Random(seed)
    variables = source.choice([2, 4, 6])
    f, g = (_drawn(source, variables, 8) for _ in range(2))
    chi = _drawn(source, variables, 3, lowest=3)
    half = variables // 2
    bracket: Exact = {}
    for k in range(half):
        bracket = _plus(bracket, _times(_slope(f, k), _slope(chi, half + k)))
        bracket = _plus(bracket, _times(_slope(f, half + k), _slope(chi, k)), -1)
    with working(128, DEGREE + 1):
        F, G, CHI = map(_balls, (f, g, chi))
        assert _contains(F + G, _plus(f, g))
        assert _contains(F - G, _plus(f, g, -1))
        assert _contains(F * G, _times(f, g))
        assert _contains(F.bracket(CHI), bracket)
        assert _contains(F**3, _times(_times(f, f), f))
        # a point of many: what cancels is within the error, and goes when it is cleaned
        nothing = F * G - G * F
        assert all(value.contains(0) for value in nothing.terms().values())
        assert all(not nothing.cleaned(n).terms(n) for n in range(DEGREE + 1))


def test_functions_are_inverse_to_each_other() -> None:
    with working(192, DEGREE + 1):
        x = BallPolynomial.of({(0, 0): arb(2), (1, 0): arb(1) / 3, (1, 1): arb(5)}, DEGREE)
        root = x.applied(lambda s: s.sqrt())
        for zero in (root * root - x, x / root - root, (1 / x) * x - 1, x ** (-2) * x**2 - 1):
            assert all(abs(c) < arb(2) ** -150 and c.contains(0) for c in zero.terms().values())
        with pytest.raises(SingularityError):
            1 / (x - 2)


def test_numbers_of_very_different_size_are_kept() -> None:
    with working(128, DEGREE + 1):
        small, large = (BallPolynomial.of({(1, 0): arb((1, e))}, DEGREE) for e in (-900, 900))
        sums = [small + large, small + large - large + small]
        assert not (small - small).parts
    with working(4000):
        for found, exact in zip(sums, (arb((1, 900)), arb((1, -900))), strict=True):
            assert found.coefficient((1, 0)).real.contains(exact + arb((1, -900)))


def test_coefficients_that_vanish_beside_a_large_one_are_in_the_error() -> None:
    """The error of a part bounds those of all of its coefficients together."""
    small = 2**117 - 2**54  # just below one unit of the sum at this precision
    with working(64, DEGREE + 1):
        large = BallPolynomial.of({(3, 0): arb((1, 180))}, DEGREE)
        others = {(2, 1): arb(small), (1, 2): arb(small), (0, 3): arb(small)}
        part = (large + BallPolynomial.of(others, DEGREE)).parts[3]
        assert part.powers() == [(3, 0)]
    with working(400):
        assert part.error >= 3 * arb(small)


def test_size_of_a_rounded_part_bounds_its_norm() -> None:
    """Each coefficient below zero is rounded away from zero."""
    with working(128, DEGREE + 1):
        value = acb(arb(-(2**127) - 1), arb(-(2**126) - 1))
        part = BallPolynomial.of({(a, 3 - a): value for a in range(4)}, DEGREE).parts[3]
    norm = sum(abs(int(c)) for c in (*part.re.coeffs(), *part.im.coeffs()))
    with working(400):
        assert part.size >= arb((norm, part.exponent))


def test_terms_over_divisors_have_the_error_of_all_terms() -> None:
    with working(128, DEGREE + 1):
        terms = {(2, 1): acb(arb(3, 2.0**-40)), (0, 3): acb(6)}
        f = BallPolynomial.of(terms, DEGREE)
        over, left = f.split(3, {(2, 1): acb(0, 3)}, arb(2.0**-10))
        # (3, 0) is in the error alone: its divisor may be the smallest
        assert over.coefficient((3, 0)).abs_upper() >= arb(2.0**-30)
        assert over.coefficient((2, 1)).contains(acb(0, -1))
        assert left.terms().keys() == {(0, 3)}
        assert not left.coefficient((3, 0)).is_zero()
        assert f.with_part(3, left).coefficient((0, 3)).contains(6)
