"""Derivatives keep the sums of H and are those of sympy."""

from __future__ import annotations

import random

import mpmath
import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.formula.parser import parse_expression
from hamsym.symbolic.derivatives import gradient, hessian

_FUNCTIONS = "sin cos tan exp tanh sinh cosh erf atan sech".split()


def _formula(draw: random.Random, depth: int) -> str:
    kind = draw.choice("+-*/^f") if depth else "x"
    if kind == "x":
        return draw.choice(["x", "y", "p", "a", f"{draw.randint(1, 9)}/{draw.randint(1, 9)}"])
    first, second = _formula(draw, depth - 1), _formula(draw, depth - 1)
    if kind == "/":
        return f"({first})/(2 + 4*({second})**2)"
    if kind == "^":
        return f"(3 + ({first})**2)**({draw.choice(['2', '3', '1/2', '-1/2', '-3'])})"
    if kind == "f":
        return f"{draw.choice(_FUNCTIONS)}({first})"
    return f"({first}) {kind} ({second})"


@pytest.mark.sampled(12)
@pytest.mark.parametrize("seed", range(25))
def test_derivatives_are_those_of_sympy(seed: int) -> None:
    draw = random.Random(seed)
    expr = parse_expression(_formula(draw, 3))
    symbols = sympy.symbols("x y p", real=True)
    first = gradient(expr, symbols)
    second = hessian(first, symbols)
    pairs = [(found, expr.diff(one)) for found, one in zip(first, symbols, strict=True)]
    pairs += [(entry, expr.diff(symbols[i], symbols[j])) for (i, j), entry in second.items()]
    evaluate = sympy.lambdify((*symbols, sympy.Symbol("a", real=True)), pairs, "mpmath")
    with mpmath.workdps(30):
        for found, expected in evaluate(*(mpmath.mpf(draw.randint(-9, 9)) / 7 for _ in range(4))):
            assert abs(found - expected) <= 1e-20 * (1 + abs(expected))


@pytest.mark.parametrize(
    ("formula", "force"),
    [
        ("p**2/2 + k*(x - l)**2/2", "-k*(x - l)"),
        ("p**2/2 + c*(2*x - 4)**2/2", "-4*c*(x - 2)"),
        ("p**2/2 + a*exp(-(x - 2)**2/2)", "a*(x - 2)*exp(-(x - 2)**2/2)"),
        ("p**2/2 - c*x/(2 + 2*x**2)", "c/(2*(1 + x**2)) - c*x**2/(1 + x**2)**2"),
        ("p**2/2 - mu/sqrt((x - 1 + mu)**2 + 4)", "-mu*(x - 1 + mu)/((x - 1 + mu)**2 + 4)**(3/2)"),
        ("p**2/2 + (x**2 - y**2)**2*b + p_y**2/2", "-4*b*x*(x**2 - y**2)"),
    ],
)
def test_forces_are_readable(formula: str, force: str) -> None:
    H = Hamiltonian(formula)
    assert H.notation.text(H.vector_field[H.dof]) == force
