"""Inverses of symbolic matrices against sympy's own, and null vectors of singular ones."""

from __future__ import annotations

import random

import pytest
import sympy

from hamsym.symbolic.rational_matrices import inverse_matrix

a, b, x, y = sympy.symbols("a b x y", real=True)


@pytest.mark.slow_cases("3-4", "4-5")
@pytest.mark.parametrize(("size", "seed"), [(1, 0), (2, 1), (2, 2), (3, 3), (3, 4), (4, 5)])
def test_product_with_the_matrix_is_the_identity(size: int, seed: int) -> None:
    generator = random.Random(seed)
    parts = [sympy.sin(x), sympy.cos(x), a, b / 3, a / (b + 2), sympy.sqrt(2), y, 1 / y, 2, 0]
    entries = [
        generator.choice(parts) * generator.choice(parts) + generator.randint(1, 5)
        for _ in range(size * size)
    ]
    matrix = sympy.Matrix(size, size, entries)
    found, denominator = inverse_matrix(matrix.tolist())
    at = {symbol: sympy.Rational(generator.randint(20, 90), 31) for symbol in (a, b, x, y)}
    product = (matrix * sympy.Matrix(found) / denominator).xreplace(at).evalf(30)
    assert max(abs(entry) for entry in product - sympy.eye(size)) < 1e-25


@pytest.mark.parametrize(
    ("rows", "direction"),
    [
        ([[0]], [1]),
        ([[1, 2], [2, 4]], [1, sympy.Rational(-1, 2)]),
        ([[a**2, a], [a, 1]], [1, -a]),
        ([[a**2 - a * a]], [1]),
        ([[1, sympy.sin(x)], [sympy.sin(x), 1 - sympy.cos(x) ** 2]], [1, -1 / sympy.sin(x)]),
    ],
)
def test_singular_matrix_gives_a_null_vector(
    rows: list[list[sympy.Expr]], direction: list[sympy.Expr]
) -> None:
    rows = [[sympy.sympify(entry) for entry in row] for row in rows]
    found, denominator = inverse_matrix(rows)
    assert denominator is None
    assert [sympy.simplify(entry) for entry in found[0]] == direction


def test_sine_and_cosine_of_one_argument_are_related() -> None:
    found, denominator = inverse_matrix(
        [[sympy.sin(x) ** 2 + sympy.cos(x) ** 2, sympy.cos(x)], [sympy.cos(x), sympy.S.One]]
    )
    assert denominator == sympy.sin(x) ** 2
    assert found[0] == [1, -sympy.cos(x)]


@pytest.mark.parametrize(
    "rows", [[[-2 * a, 2 * b], [2 * b, 2 * a]], [[0, a, 0], [0, 0, b], [a, 0, 0]]]
)
def test_matrix_without_a_trace_is_inverted(rows: list[list[sympy.Expr]]) -> None:
    matrix = sympy.Matrix(rows)
    found, determinant = inverse_matrix(matrix.tolist())
    assert sympy.simplify(matrix * sympy.Matrix(found) / determinant) == sympy.eye(len(rows))
