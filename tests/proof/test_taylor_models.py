"""Generated functions of Taylor models contain the values of mpmath."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.arithmetic.generated import evaluated
from hamsym.proof.arithmetic.taylor_models import BITS, MODELS, Model, Space
from hamsym.proof.boxes.map_models import _lower_powers, affine_models

x, y = sympy.symbols("x y", real=True)
FORMULAS = {
    "integers": 1 - x * y - 3 * x**5 + (x - 2) * (2 - y),
    "constants": sympy.pi / 3 - sympy.sqrt(2) * x + (1 - x) / 7 + sympy.exp(1) * (sympy.pi - y),
    "reciprocals": 1 / x**3 + y / (x + y),
    "roots": sympy.sqrt(x) - (x * y + 1) ** sympy.Rational(-3, 2),
    "powers": x**y + 2 ** (x + y) + y**sympy.pi,
    "functions": sympy.sin(x) * sympy.cosh(y) + sympy.atan(x * y) - sympy.erf(x),
    "domains": sympy.log(x) + sympy.tan(y) + sympy.acos(x) + sympy.asinh(y) - sympy.acosh(x + 1),
}
CELLS = [
    ((Fraction(11, 20), Fraction(13, 20)), (Fraction(3, 4), Fraction(4, 5))),
    ((Fraction(1, 3), Fraction(2, 5)), (Fraction(1), Fraction(16, 15))),
]


@pytest.fixture(scope="module")
def space():
    return Space(2, 1, 6)


@pytest.mark.parametrize("name", FORMULAS)
def test_values_are_within_the_radius(name, space):
    inputs = affine_models(space, CELLS)
    with working(BITS):
        (model,) = evaluated(compile_straight_line([FORMULAS[name]], [x, y]), MODELS, *inputs)
    assert model.radius.max() < 1e-3
    function = sympy.lambdify((x, y), FORMULAS[name], "mpmath")
    for cell, intervals in enumerate(CELLS):
        for place in np.random.default_rng(4).uniform(-1, 1, (9, 2)).round(3):
            s = [Fraction(float(value)) for value in place]
            at = [
                (low + high) / 2 + value * (high - low) / 2
                for value, (low, high) in zip(s, intervals, strict=True)
            ]
            found = sum(
                Fraction(float(coefficient)) * s[0] ** int(i) * s[1] ** int(j)
                for coefficient, (_, i, j) in zip(
                    model.coefficients[:, cell], space.exponents, strict=True
                )
            )
            with mpmath.workdps(40):
                truth = function(*(mpmath.mpf(z.numerator) / z.denominator for z in at))
                distance = abs(truth - mpmath.mpf(found.numerator) / found.denominator)
                assert distance <= mpmath.mpf(float(model.radius[cell]))


def test_functions_without_a_model_are_refused(space):
    function = compile_straight_line([sympy.atan2(y, x)], [x, y])
    with working(BITS), pytest.raises(SingularityError, match="atan2"):
        evaluated(function, MODELS, *affine_models(space, CELLS))


def test_constants_remain_balls(space):
    function = compile_straight_line([sympy.sqrt(3) * sympy.pi, x], [x, y])
    with working(BITS):
        constant, model = evaluated(function, MODELS, *affine_models(space, CELLS))
    assert not isinstance(constant, Model)
    assert isinstance(model, Model)


def test_lower_powers_are_below_the_powers():
    sizes = np.concatenate([np.random.default_rng(1).uniform(0, 2, 200), [0, 1, 5e-324, 1e-30]])
    found = _lower_powers(sizes[None], 12)
    for size, powers in zip(sizes.tolist(), found[0].T.tolist(), strict=True):
        for n, power in enumerate(powers):
            exact = Fraction(size) ** n
            assert Fraction(power) <= exact
            assert Fraction(power) >= exact * (1 - Fraction(1, 10**12)) or exact < 1e-289


def test_lower_degrees_are_within_the_radius():
    space, lower = Space(2, 8, 6), Space(2, 5, 4)
    random = np.random.default_rng(8)
    sizes = 0.5 ** space.exponents.sum(axis=1)
    coefficients = random.normal(size=(space.count, 3)) * sizes[:, None]
    model = Model(space, coefficients, np.array([0.0, 0.0, 0.25]))
    found = space.lowered(model, lower)
    assert (found.radius[:2] > 0).all()
    assert (found.radius < 0.25 + np.abs(coefficients).sum(axis=0) / 4).all()
    assert found.radius[2] > 0.25
    for place in random.uniform(-1, 1, (50, 3)):
        values = np.prod(place**space.exponents, axis=1) @ coefficients
        lowered = np.prod(place**lower.exponents, axis=1) @ found.coefficients
        assert (np.abs(values - lowered) <= found.radius + 1e-14).all()
    assert space.lowered(model, space) is model
    # A polynomial of low degrees keeps its coefficients.
    inside = [space.places[term] for term in lower.places]
    own = np.zeros((space.count, 1))
    own[inside] = random.normal(size=(lower.count, 1))
    found = space.lowered(Model(space, own, np.zeros(1)), lower)
    assert found.coefficients == pytest.approx(own[inside], abs=1e-13)
    assert found.radius[0] < 1e-11
