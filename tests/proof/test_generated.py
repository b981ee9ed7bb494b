"""Generated functions of H with exact values of parameters, or with parameters as arguments."""

from fractions import Fraction

import pytest
from flint import arb, arb_series

from hamsym import Hamiltonian
from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.balls import ball, working
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions

H = Hamiltonian("p**2/2 + k*x**n + 0.1*x", parameters={"k": 0.3, "n": 3.0})


def test_parameters_have_their_exact_values() -> None:
    with working(300):
        rate = GeneratedFunctions(H, BALLS)("vector_field", [arb(2), arb(5)], arb(0))
        assert rate[0] == arb(5)
        assert rate[1].contains(ball(-12 * Fraction(0.3) - Fraction(1, 10)))
        assert rate[1].rad() < arb(2) ** -290


def test_constants_follow_the_precision() -> None:
    functions = GeneratedFunctions(Hamiltonian("p**2/2 + pi*x/3 + sqrt(2)*x"), BALLS)
    for bits in (64, 400, 64):
        with working(bits):
            rate = functions("vector_field", [arb(0), arb(0)], arb(0))[1]
            assert arb(2) ** (-bits - 3) < rate.rad() < arb(2) ** (8 - bits)


def test_parameters_that_vary_are_arguments() -> None:
    functions = GeneratedFunctions(H, BALLS, ["k", "n"])
    assert functions.keywords == ["k", "n"]
    with working(100):
        energy = functions("energy", [arb(3), arb(0)], arb(0), k=arb(2), n=arb(2, 0.01))
        for n in ("1.99", "2", "2.01"):
            assert energy.contains(2 * arb(3) ** arb(n) + arb(3) / 10)


def test_exponents_that_vary_need_positive_bases() -> None:
    state = [arb(-1), arb(0)]
    assert GeneratedFunctions(H, BALLS)("energy", state, arb(0)).is_finite()
    with pytest.raises(SingularityError, match=r"^x\*\*n$"):
        GeneratedFunctions(H, BALLS, ["n"])("energy", state, arb(0), n=arb(3))


def test_series_without_a_result_are_refused() -> None:
    functions = GeneratedFunctions(Hamiltonian("p**2/2 - 1/sqrt(x**2 + 1/4)"), BALLS)
    with working(64, 4):
        series = [arb_series([arb(0, 2), 1]), arb_series([1, 1])]
        with pytest.raises(SingularityError, match=r"sqrt\(x\*\*2 \+ 1/4\)"):
            functions("vector_field", series, arb_series([0, 1]))


def test_kinks_that_derivatives_lack_are_refused() -> None:
    with pytest.raises(CertificationError, match="'sign'"):
        GeneratedFunctions(Hamiltonian("p**2/2 + sign(x)"), BALLS)
