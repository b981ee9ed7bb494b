"""Forces beside H: the equations, what follows from them, and refused arguments."""

from __future__ import annotations

import pickle
from typing import Any

import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.errors import InputError, ParameterError, ParseError, VariableError

x, p, c = sympy.symbols("x p c", real=True)
DAMPED = Hamiltonian("p**2/2 + x**2/2", forces={"p": "-c*p"})


def test_forces_change_the_rates_of_momenta_only() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + x*y", forces={"p_y": "-c*p_x + cos(t)"})
    x, y, p_x, p_y, c, t = sympy.symbols("x y p_x p_y c t", real=True)
    assert list(H.vector_field) == [p_x, p_y, -y, -x - c * p_x + sympy.cos(t)]
    assert list(H.gradient) == [y, x, p_x, p_y]
    assert H.hessian == sympy.hessian(H.expr, (x, y, p_x, p_y))
    assert H.jacobian == H.vector_field.jacobian((x, y, p_x, p_y))
    assert H.time == t
    assert H.parameter_names == ("c",)
    assert [equation.rhs for equation in H.equations] == list(H.vector_field)


def test_variational_equations_differentiate_the_forces() -> None:
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"})
    dx, dp = sympy.symbols("delta_x delta_p", real=True)
    found = [equation.rhs for equation in H.variational_equations]
    assert sympy.expand(found[1] - (dx * (-1 - 2 * x * p) + dp * (1 - x**2))) == 0
    assert found[0] == dp


def test_power_is_the_rate_of_the_energy() -> None:
    H = Hamiltonian("p**2/(2*m) + x**2*cos(t)/2", forces={"p": "-c*p + x"})
    m, t = sympy.symbols("m t", real=True)
    expected = (-c * p + x) * p / m - x**2 * sympy.sin(t) / 2
    assert sympy.expand(H.power - expected) == 0
    total = H.gradient.dot(H.vector_field) + H.expr.diff(t)
    assert sympy.expand(H.power - total) == 0
    assert Hamiltonian("p**2/2 + x**2/2").power == 0


def test_conserved_quantities_count_forces() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + x**2", forces={"p_x": "-c*p_x"})
    assert H.is_conserved("p_y")
    assert not H.is_conserved(H.expr)
    assert not H.is_conserved("p_x")
    free = Hamiltonian(
        "p_x**2/2 + p_y**2/2", forces={"p_x": "-c*p_x"}, q=["x", "y"], p="p_x p_y".split()
    )
    assert free.cyclic_coordinates == (sympy.Symbol("y", real=True),)
    assert free.is_conserved("p_x + c*x")  # its rate is -c p_x + c p_x
    assert not H.conserves_energy


def test_what_rests_on_the_symmetric_hessian_is_absent() -> None:
    assert DAMPED.sigma_min is None
    assert Hamiltonian("p**2/2 + x**2/2").sigma_min == 1
    assert not DAMPED.is_separable
    assert DAMPED.kinetic == p**2 / 2
    driven = Hamiltonian("p**2/2 + x**2/2", forces={"p": "cos(t) - x"})
    assert driven.is_separable


def test_identity_has_the_forces() -> None:
    same = Hamiltonian(p**2 / 2 + x**2 / 2, forces={p: -c * p})
    assert same == DAMPED
    assert hash(same) == hash(DAMPED)
    assert Hamiltonian("p**2/2 + x**2/2") != DAMPED
    assert Hamiltonian("p**2/2 + x**2/2", forces={"p": "-2*c*p"}) != DAMPED
    assert pickle.loads(pickle.dumps(DAMPED)) == DAMPED
    with_value = DAMPED.with_parameters(c=0.5)
    assert with_value.forces == DAMPED.forces
    assert dict(with_value.parameters) == {"c": 0.5}
    assert DAMPED.unbound_parameters == ("c",)


def test_vanishing_forces_are_left_out() -> None:
    assert Hamiltonian("p**2/2 + x**2/2", forces={"p": 0}) == Hamiltonian("p**2/2 + x**2/2")
    assert Hamiltonian("p**2/2 + x**2/2", forces={}).conserves_energy
    assert Hamiltonian("p**2/2 + x**2/2", forces={"p": 2}).forces == {"p": 2}


def test_texts_show_the_forces() -> None:
    assert repr(DAMPED) == "Hamiltonian('p**2/2 + x**2/2', pairs (x, p), force of p '-c*p')"
    assert r"\quad F_{p} = - c p$" in DAMPED._repr_latex_()
    assert DAMPED.formulas == "p**2/2 + x**2/2, force of p = -c*p"


def test_symbols_of_forces_take_those_of_the_formula() -> None:
    plain = sympy.symbols("x p")
    H = Hamiltonian(plain[1] ** 2 / 2 + plain[0] ** 2 / 2, forces={"p": "-c*p*x**2"})
    assert H.forces["p"].free_symbols >= set(plain)
    assert H.vector_field[1].free_symbols == {*plain, *H.forces["p"].free_symbols}
    greek = Hamiltonian("p_theta**2/2 - cos(theta)", forces={"p_θ": "-lambda*p_theta"})
    assert greek.parameter_names == ("lambda",)
    assert list(greek.forces) == ["p_theta"]


def test_coordinates_may_occur_in_forces_only() -> None:
    H = Hamiltonian("p**2/2", forces={"p": "-sin(x)"})
    assert H.names == ("x", "p")
    assert Hamiltonian("p**2/2 + x**2/2", forces={"p": "a*y"}).names == ("x", "p")


@pytest.mark.parametrize(
    ("forces", "error", "message"),
    [
        ({"x": "-c*p"}, VariableError, "'x' is a coordinate, and a force changes a momentum"),
        ({"v": "-c*p"}, VariableError, "'v' is no momentum of H.*give forces of p"),
        ({"p\x1b[2J": "1"}, VariableError, r"p\\x1b\[2J"),
        ({3: "1"}, VariableError, "'3' is no momentum"),
        ({p: "-p", "p": "x"}, VariableError, "given twice"),
        ("-c*p", InputError, "forces='-c.p' is not a mapping"),
        (["-c*p"], InputError, "is not a mapping; give for example"),
        ({"p": None}, InputError, "a force must be a str or a sympy expression, not NoneType"),
        ({"p": True}, InputError, "a force must be a str or a sympy expression, not bool"),
        ({"p": sympy.I * p}, InputError, "a force is real"),
        ({"p": float("nan")}, InputError, "a force is real"),
        ({"p": sympy.Heaviside(x)}, InputError, "smooth approximation"),
        ({"p": "__import__('os').system('true')"}, ParseError, "column"),
        ({"p": "p.__class__"}, ParseError, "column"),
        ({"p": "-c*p = 3"}, ParseError, "column"),
        ({"p": "9**9**9**9"}, ParseError, "column"),
        ({"p": ""}, ParseError, "formula"),
    ],
)
def test_unusable_forces_are_refused(forces: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Hamiltonian("p**2/2 + x**2/2", forces=forces)


def test_parameters_of_forces_need_values() -> None:
    with pytest.raises(ParameterError, match="c has no value; use H.with_parameters"):
        Hamiltonian.of(DAMPED)
    with pytest.raises(ParameterError, match="'d' does not occur"):
        Hamiltonian("p**2/2 + x**2/2", forces={"p": "-c*p"}, parameters={"d": 1})
    with pytest.raises(VariableError, match="variable and a parameter"):
        Hamiltonian("p**2/2", q=["x"], p=["p"], forces={"p": "-x"}, parameters={"x": 1})
