"""Components and formulas as functions of states, with texts, for all that draws or tabulates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian, InputError
from hamsym.errors import ParameterError, ParseError, VariableError

H = Hamiltonian(
    "p_θ**2/(2*m) + k*(θ - l)**2/2 + a*cos(t)*θ",
    parameters={"m": 2.0, "k": 3.0, "l": 0.5, "a": 0.1},
    q=["θ"],
    p=["p_θ"],
)
Z = np.array([[1.0, 2.0], [-2.0, 0.0]])
OSCILLATOR = Hamiltonian("p**2/2 + x**2/2")


def test_components_are_views_in_any_spelling() -> None:
    for name in ("theta", "θ", " theta ", sympy.Symbol("theta")):
        found = H.observable(name)
        assert (found.text, found.place) == ("θ", 0)
        assert np.shares_memory(found(Z), Z)
    assert np.isinf(H.observable("theta").values(np.array([np.inf, 0.0])))


def test_formulas_have_parameters_and_time() -> None:
    found = H.observable("k*(θ - l)**2/2 + t")
    np.testing.assert_allclose(found(Z, np.array([1.0, 2.0])), [1.375, 11.375])
    others = np.array([[0.1, 1.0, 0.0, 2.0], [0.1, 1.0, 0.0, 2.0]])  # a, k, l, m
    np.testing.assert_allclose(found(Z, 0.0, others), [0.5, 2.0])


def test_energy_is_a_name_unless_it_is_taken() -> None:
    kinetic = H.observable("H - k*(θ - l)**2/2 - a*cos(t)*θ")
    np.testing.assert_allclose(kinetic(Z), [1.0, 0.0], atol=1e-15)
    assert kinetic.text.startswith("H - k")
    own = Hamiltonian("p**2/2 + H*x", parameters={"H": 3.0})
    assert own.observable("H")([1.0, 2.0]) == 3.0


def test_texts_have_the_order_of_the_user() -> None:
    given = H.observable("t - k*(l -  θ)")
    assert given.text == "t - k*(l - θ)"
    assert given.latex == r"t - k \left(l - θ\right)"
    x, y, p = sympy.symbols("x y p")
    spring = Hamiltonian("p**2/2 + (y - x)**2/2", q=["x", "y"], p=["p", "p_y"])
    assert spring.observable(p * (y - x)).text == "p*(y - x)"


def test_units_follow_from_those_of_the_names() -> None:
    units = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}
    own = Hamiltonian("p**2/(2*m) + k*x**2/2", units=units, parameters={"m": 1, "k": 1})
    assert own.observable("k*x**2/2").unit == "kg*m**2/s**2"
    assert own.observable("x").unit == "m"
    assert own.observable("x + p").unit == "1"


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("sqrt(x)", [1.0, np.nan]),
        ("log(x + 2)", [np.log(3.0), np.nan]),
        ("1/(x - 1)", [np.nan, -1 / 3]),
        ("exp(1000*x)", [np.nan, 0.0]),
        ("x**1.5", [1.0, np.nan]),
    ],
)
def test_values_that_are_no_finite_numbers_are_nan(formula: str, expected: list[float]) -> None:
    np.testing.assert_allclose(OSCILLATOR.observable(formula).values(Z), expected)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("tehta", VariableError, r"'tehta' does not occur in H \(did you mean 'theta'\?\)"),
        ("θ + omega", VariableError, "'omega' does not occur in H; use only θ, p_θ, a, k, l, m, t"),
        (5, InputError, "5 is neither a component nor a formula"),
        (None, InputError, "None is neither"),
        (["x"], InputError, "neither a component nor a formula"),
        pytest.param(10**5000, InputError, "<int> is neither a component", id="huge"),
        ("", ParseError, "empty"),
        ("θ^2", ParseError, r"write \*\* for powers"),
        ("θ = 1", ParseError, "'='"),
        ("__import__('os').system('ls')", ParseError, "__import__|attribute|not a"),
        ("θ.__class__", ParseError, "attribute access"),
        ("θ[0]", ParseError, r"\["),
        ("lambda: 0", ParseError, "':' at column 7 is not valid"),
        ("9**9**9**9", ParseError, "exponent"),
        ("exp(exp(exp(exp(99))))", ParseError, "finite|large"),
        ("(" * 400 + "θ" + ")" * 400, ParseError, "nested too deeply"),
        ("θ+" * 60_000 + "θ", ParseError, "characters"),
        ("θ\u202e", ParseError, "character"),
        (sympy.Symbol("x; import os"), VariableError, "'x; import os' does not occur"),
        (sympy.I * sympy.Symbol("θ"), InputError, "not real and finite; a formula is real"),
        (sympy.Function("f")(sympy.Symbol("θ")), VariableError, "not a plain symbol"),
    ],
)
def test_what_is_no_formula_is_refused(given: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        H.observable(given)


@pytest.mark.parametrize("formula", ["θ", "θ**2"])
@pytest.mark.parametrize("z", ["a", 3, [1.0] * 9])
def test_states_of_another_length_are_refused(formula: str, z: Any) -> None:
    for evaluate in (H.observable(formula), H.observable(formula).values):
        with pytest.raises(InputError, match="its last axis must have length"):
            evaluate(z)


def test_parameters_without_a_value_are_named() -> None:
    open_one = Hamiltonian("p**2/2 + k*x**2/2")
    assert open_one.observable("x*p")([2.0, 3.0]) == 6.0
    with pytest.raises(ParameterError, match="'k'|k"):
        open_one.observable("H")


def test_names_of_long_chains_are_not_all_listed() -> None:
    chain = Hamiltonian("sum(i, 1, 30, p[i]**2/2 + q[i]**2/2)")
    with pytest.raises(VariableError, match=r"q14, \.\.\.$"):
        chain.observable("w")
    total = chain.observable("sum(i, 1, 30, p[i]**2/2)")
    assert total(np.ones(60)) == pytest.approx(15.0)
