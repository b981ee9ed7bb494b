"""Edge cases of enclosures: times beyond the span, tiny numbers, inputs that float64 rounds."""

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import InputError
from hamsym.kernel.enclosures import enclosures
from hamsym.proof.windows.window_proof import norm_and_parts
from tests.proof.kernel_calls import balls


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
    ((high, low, radius),) = balls(enclosures(), "exponential", np.array([[x, 0.0, 0.0]]))
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
    series = np.zeros((2, 8))
    series[:, 0] = 3e-200, -4e-200
    uppers, lowers = norm_and_parts(series, np.full(2, 1e-201), 1024)
    assert lowers[0] <= 5e-200 <= uppers[0] <= 1e-199
    assert lowers[0] >= 3e-200


@pytest.mark.parametrize("count", [1, 3, 2_001])
def test_bounds_on_the_norm_include_its_own_roundings(count: int) -> None:
    """Of constants, whose exact norms fractions give: also where the bounds cancel."""
    random = np.random.default_rng(count)
    for gap in (0.0, 1e-16, 1e-15, 1e-13, 1e-6):
        sizes = (
            np.full(count, math.sqrt(2.0**-53) * (1 - 1e-15)) if gap else random.normal(size=count)
        )
        sizes[0] = 1.0
        uppers, lowers = norm_and_parts(sizes[:, None], np.abs(sizes) * (1 - gap), 256)
        squares = sum(Fraction(value) ** 2 for value in sizes.tolist())
        others = sum(Fraction(abs(value) * (1 - gap)) ** 2 for value in sizes.tolist())
        digits = 10**60
        norm, whole = (
            Fraction(math.isqrt(int(part * digits)), 10**30) for part in (squares, others)
        )
        assert Fraction(lowers[0]) <= max(norm - whole + Fraction(1, 10**29), 0)
        assert Fraction(uppers[0]) >= norm + whole
        assert Fraction(uppers[0]) <= (norm + whole) * (1 + Fraction(1, 10**4))


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
