"""Order conditions to 50 digits, from the coefficients, for every method of the table."""

from __future__ import annotations

import itertools

import mpmath
import pytest

from hamsym.integrators.coefficients import Doubled, RungeKutta, Splitting
from hamsym.integrators.table import INTEGRATORS

DIGITS = 50
SPLITTINGS = [n for n, row in INTEGRATORS.items() if isinstance(row.scheme, Splitting)]
DOUBLED = [n for n, row in INTEGRATORS.items() if isinstance(row.scheme, Doubled)]
RUNGE_KUTTA = [n for n, row in INTEGRATORS.items() if isinstance(row.scheme, RungeKutta)]

Flow = tuple[str, mpmath.mpf]


@pytest.fixture(autouse=True)
def _digits() -> object:
    with mpmath.workdps(DIGITS + 20):
        yield


def number(value: object) -> mpmath.mpf:
    return mpmath.mpf(str(value))


def defects(flows: list[Flow], letters: str, order: int) -> list[mpmath.mpf]:
    """By degree, the largest difference of exp(c_1 X_1) exp(c_2 X_2)... from exp(A + B + ...).

    Both are series in words of letters that do not commute; a method has order n if and only if
    they agree in every word of up to n letters.
    """
    words = [w for n in range(order + 1) for w in itertools.product(letters, repeat=n)]
    series = dict.fromkeys(words, mpmath.mpf(0))
    series[()] = mpmath.mpf(1)
    for letter, size in flows:
        product = dict.fromkeys(words, mpmath.mpf(0))
        for word, value in series.items():
            if value:
                for power in range(order - len(word) + 1):
                    term = value * size**power / mpmath.factorial(power)
                    product[word + power * (letter,)] += term
        series = product
    exact = {word: 1 / mpmath.factorial(len(word)) for word in words}
    return [
        max(abs(series[w] - exact[w]) for w in words if len(w) == degree)
        for degree in range(order + 1)
    ]


def flows_of(scheme: Splitting | Doubled) -> list[Flow]:
    if isinstance(scheme, Splitting):
        pairs = zip(scheme.drifts, scheme.kicks, strict=True)
        return [(x, number(c)) for pair in pairs for x, c in zip("AB", pair, strict=True) if c]
    return [
        (x, number(weight) * share)
        for weight in scheme.weights
        for x, share in zip("ABCBA", (0.5, 0.5, 1, 0.5, 0.5), strict=True)
    ]


@pytest.mark.slow_cases("yoshida8", "sofroniou_spaletta10")
@pytest.mark.parametrize("method", SPLITTINGS + DOUBLED)
def test_order_conditions_of_splittings(method: str) -> None:
    row = INTEGRATORS[method]
    letters = "AB" if method in SPLITTINGS else "ABC"
    found = defects(flows_of(row.scheme), letters, row.order + 1)  # type: ignore[arg-type]
    assert max(found[: row.order + 1]) < mpmath.mpf(10) ** -DIGITS
    assert found[row.order + 1] > 1e-9  # and not of a higher order


@pytest.mark.parametrize("method", RUNGE_KUTTA)
def test_order_conditions_of_gauss_methods(method: str) -> None:
    """Butcher's B(2s), C(s) and D(s) imply order 2s; B(2s + 1) fails."""
    scheme = INTEGRATORS[method].scheme
    assert isinstance(scheme, RungeKutta)
    s = scheme.stages
    a = [[number(entry) for entry in row] for row in scheme.matrix]
    b, c = ([number(entry) for entry in side] for side in (scheme.weights, scheme.nodes))
    small = mpmath.mpf(10) ** -DIGITS

    def quadrature(k: int) -> mpmath.mpf:
        return abs(sum(b[i] * c[i] ** (k - 1) for i in range(s)) - mpmath.mpf(1) / k)

    assert max(quadrature(k) for k in range(1, 2 * s + 1)) < small
    assert quadrature(2 * s + 1) > 1e-8
    for i, k in itertools.product(range(s), range(1, s + 1)):
        inner = sum(a[i][j] * c[j] ** (k - 1) for j in range(s))
        assert abs(inner - c[i] ** k / k) < small
        outer = sum(b[j] * c[j] ** (k - 1) * a[j][i] for j in range(s))
        assert abs(outer - b[i] * (1 - c[i] ** k) / k) < small
    assert INTEGRATORS[method].order == 2 * s


@pytest.mark.parametrize("method", SPLITTINGS + DOUBLED + RUNGE_KUTTA)
def test_properties_follow_from_the_coefficients(method: str) -> None:
    row = INTEGRATORS[method]
    assert row.symplectic == (method not in DOUBLED)
    assert row.scheme.is_symmetric == (
        method not in ("symplectic_euler", "symplectic_euler_p", "ruth3")
    )


def test_non_symplectic_runge_kutta_is_recognised() -> None:
    zero, one = INTEGRATORS["symplectic_euler"].scheme.kicks[0] * 0, 1 + 0  # type: ignore[union-attr]
    euler = RungeKutta(((zero,),), (zero + one,), (zero,))
    assert not euler.is_symplectic
