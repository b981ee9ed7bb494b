"""Edge cases of enclosures: times beyond the span, tiny numbers, inputs that float64 rounds."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import InputError
from hamsym.proof.compiled import loops
from hamsym.proof.window_proof import _Comparison


@pytest.mark.parametrize("span", [(1.0, 2.0), (2.0, 1.0), (1e6, 1e6 + 1e-3)])
@pytest.mark.parametrize("name", ["__call__", "derivative"])
def test_times_beyond_the_span_by_a_round_off_are_refused(
    span: tuple[float, float], name: str
) -> None:
    enclosure = hamsym.enclose("p**2/2 + x**2/2", [1, 0], span)
    value = getattr(enclosure, name)
    low, high = min(span), max(span)
    for time in (np.nextafter(low, -np.inf), np.nextafter(high, np.inf)):
        with pytest.raises(InputError, match="outside the span"):
            value(time)
        with pytest.raises(InputError, match="outside the span"):
            value([low, time])
    assert np.isfinite(value([low, high]).radius).all()


@pytest.mark.parametrize("x", [-665.0, -666.2, -667.0, -800.0])
def test_the_exponential_of_very_negative_numbers_is_enclosed(x: float) -> None:
    high, low, radius = loops().exponential((x, 0.0, 0.0))
    exact = Fraction(str(sympy.exp(sympy.Rational(x)).evalf(40)))
    assert abs(exact - Fraction(high) - Fraction(low)) <= Fraction(radius)


@pytest.mark.parametrize(
    "value", [2**53 + 1, np.int64(2**53 + 1), Fraction(1, 3), Decimal("0.1"), sympy.Rational(1, 3)]
)
def test_exact_numbers_are_inside_their_balls(value: object) -> None:
    ball = hamsym.Ball.of(value)
    exact = Fraction(str(value))
    assert (
        abs(exact - Fraction(ball.mid)) <= Fraction(ball.radius) <= Fraction(np.spacing(ball.mid))
    )


def test_bounds_on_the_norm_hold_for_errors_whose_squares_vanish() -> None:
    comparison = _Comparison.__new__(_Comparison)
    comparison._samples = 1024
    series = np.zeros((2, 8))
    series[:, 0] = 3e-200, -4e-200
    uppers, lowers = comparison._norm_and_parts(series, np.full(2, 1e-201))
    assert lowers[0] <= 5e-200 <= uppers[0] <= 1e-199
    assert lowers[0] >= 3e-200


def test_parameters_must_be_a_mapping() -> None:
    H = hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1})
    with pytest.raises(InputError, match="mapping"):
        hamsym.enclose(H, [1, 0], (0, 1), parameters=["k"])  # type: ignore[arg-type]


@pytest.mark.parametrize("x", [0.0, math.pi, 2.0**-60, "0 +- 1e-6"])
def test_states_at_equilibria_are_enclosed(x: float | str) -> None:
    enclosure = hamsym.enclose("p**2/2 - cos(x)", [x, 0], (0, 2), time_limit=20)
    state, start = enclosure(2.0), enclosure.z0
    assert len(enclosure.windows) < 20
    assert (state.radius < 1e-25 + 5 * start.radius[0] + np.spacing(np.abs(state.mid))).all()
    if x == math.pi:  # x - pi grows like cosh(t)
        rest = Fraction("1.2246467991473531772e-16")  # pi - x
        exact = float(rest) * math.sinh(2.0)
        assert abs(state.mid[1] + exact) <= state.radius[1] + 1e-9 * exact
