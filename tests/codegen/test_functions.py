"""Compilation of expressions in the symbols of H to numpy functions."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.codegen.functions import compile_expressions, expressions_source
from hamsym.formula.parser import FUNCTIONS, parse_expression

x, p, t, k = sympy.symbols("x p t k", real=True)
H = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 0.5})


def test_values_follow_the_expressions() -> None:
    expressions = [k * x + t, sympy.Max(x, p, 0), sympy.sign(x - p), sympy.erf(x), 7]
    function = compile_expressions(expressions, H.real_equations)
    z, times = np.array([[1.0, -2.0], [-3.0, 4.0]]), np.array([0.25, 0.5])
    expected = [
        [float(sympy.sympify(e).subs({x: a, p: b, t: c, k: 0.5})) for e in expressions]
        for (a, b), c in zip(z, times, strict=True)
    ]
    np.testing.assert_allclose(function(z, times), expected, rtol=1e-15)
    np.testing.assert_allclose(function(z[0], times[0]), expected[0], rtol=1e-15)


def test_every_function_of_formulas_compiles() -> None:
    """At 1.7 or at 0.4, whichever is in its domain."""
    for name, row in FUNCTIONS.items():
        arguments = "x" if row.most == 1 else "x, p"
        expression = parse_expression(f"{name}({arguments})")
        function = compile_expressions([expression], H.real_equations)
        for at in (0.4, 1.7):
            value = sympy.N(expression.subs({x: at, p: 0.9}))
            if value.is_real:
                found = function(np.array([at, 0.9]))[0]
                assert found == pytest.approx(float(value), rel=1e-14), name


def test_shared_parts_are_computed_once() -> None:
    shared = sympy.exp(-(x**2) - p**2)
    source = expressions_source([shared * x, shared * p, shared], H.real_equations)
    assert source.count("np.exp") == 1


def test_infinite_expressions_are_nan() -> None:
    function = compile_expressions([x, sympy.zoo * x], H.real_equations)
    assert np.isnan(function([1.0, 2.0])[1])


def test_text_is_not_evaluated() -> None:
    with pytest.raises(sympy.SympifyError):
        compile_expressions(["x + 1"], H.real_equations)


def test_float32_is_kept() -> None:
    function = compile_expressions([x * p], H.real_equations)
    assert function(np.ones((3, 2), dtype=np.float32)).dtype == np.float32


@pytest.mark.parametrize("name", ["lambda", "np", "out", "t", "values"])
def test_python_keywords_as_names(name: str) -> None:
    q, r = sympy.Symbol(name, real=True), sympy.Symbol("momentum", real=True)
    own = Hamiltonian(r**2 / 2 + q**2, q=[q], p=[r])
    function = compile_expressions([q * r], own.real_equations)
    assert function([2.0, 3.0]) == 6.0


def test_wrong_state_length_is_rejected() -> None:
    with pytest.raises(ValueError, match=r"shape \(3,\); its last axis must have length 2"):
        compile_expressions([x], H.real_equations)([1.0, 2.0, 3.0])
