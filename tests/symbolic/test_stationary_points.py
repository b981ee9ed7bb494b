"""Closed forms of stationary points: verified, real, within the effort limit."""

from __future__ import annotations

import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.symbolic.stationary_points import blocks, periods, stationary_points


def solved(text: str, **parameters: float) -> list[tuple[sympy.Expr, ...]] | None:
    H = Hamiltonian(text, parameters=parameters)
    form = H.real_equations
    found = stationary_points(form)
    if found is None:
        return None
    return [tuple(solution.get(symbol, symbol) for symbol in form.z) for solution in found]


def test_henon_heiles_has_its_four_points() -> None:
    found = solved("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
    half, root = sympy.Rational(1, 2), sympy.sqrt(3) / 2
    assert found is not None
    assert set(found) == {(0, 0, 0, 0), (0, 1, 0, 0), (root, -half, 0, 0), (-root, -half, 0, 0)}


def test_complex_solutions_are_left_out() -> None:
    assert solved("p**2/2 + x**4/4 + x**2/2") == [(0, 0)]
    assert solved("p**2/2 + x**3/3 + x") == []


def test_parameters_without_value_remain_symbols() -> None:
    k, g = sympy.symbols("k g", real=True)
    found = solved("p**2/2 - k*x**2/2 + g*x**4/4")
    assert found is not None
    assert {value**2 for value, _ in found} == {0, k / g}


def test_numbers_are_exact_binary_fractions() -> None:
    [(value, _)] = solved("p**2/2 + x**2/2 - a*x", a=0.1) or []
    assert value == sympy.Rational(*(0.1).as_integer_ratio())


def test_free_components_of_continua_remain() -> None:
    found = solved("(p1**2 + p2**2)/2 + exp(q1 - q2) + exp(q2 - q1)")
    q2 = sympy.Symbol("q2", real=True)
    assert found == [(q2, q2, 0, 0)]


@pytest.mark.parametrize(
    "text",
    [
        "p**2/2 + x**2/2 + cos(x) - 0.3*x",
        pytest.param(
            "(px**2 + py**2)/2 + sin(x*y + x**2) + exp(x - y**3) + x*y**2",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_equations_without_closed_form_end_in_time(text: str) -> None:
    assert solved(text) is None


def test_periods_of_angles_are_found() -> None:
    H = Hamiltonian("p1**2/2 + p2**2/2 - cos(q1 - q2) - cos(q2/2) + sin(q1)*p2")
    assert periods(H.real_equations) == {0: 2 * sympy.pi, 1: 4 * sympy.pi}
    assert periods(Hamiltonian("p**2/2 + x**2 + sin(x)").real_equations) == {}


def test_blocks_follow_the_coupling() -> None:
    H = Hamiltonian("p1**2/2 + p2**2/2 + q1**2*q2 + q3**2/2 + p3**2*q3")
    assert blocks(H.real_equations) == [[0, 1], [2, 5], [3], [4]]
