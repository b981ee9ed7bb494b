"""Elements of arrays and functions of time become symbols; what cannot is refused."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from sympy.physics import units
from sympy.physics.mechanics import dynamicsymbols

from hamsym import Hamiltonian, InputError
from hamsym.errors import VariableError

x, p = sympy.IndexedBase("x"), sympy.IndexedBase("p")
i, t = sympy.Symbol("i", integer=True), sympy.Symbol("t")
CHAIN = Hamiltonian("p0**2/2 + p1**2/2 + (x1 - x0)**4")


def test_forces_may_contain_elements_and_functions_of_time() -> None:
    H = Hamiltonian(p[0] ** 2 / 2 + x[0] ** 2, forces={p[0]: -p[0]})
    assert Hamiltonian("p0**2/2 + x0**2", forces={"p0": "-p0"}) == H
    t = sympy.Symbol("t")
    place, momentum = sympy.Function("x")(t), sympy.Function("p")(t)
    H = Hamiltonian(momentum**2 / 2 + place**2, forces={momentum: sympy.sin(t) - momentum})
    assert Hamiltonian("p**2/2 + x**2", forces={"p": "sin(t) - p"}) == H
    with pytest.raises(InputError, match="is a velocity"):
        Hamiltonian(momentum**2 / 2 + place**2, forces={momentum: -sympy.diff(place, t)})


def test_elements_of_an_indexed_base() -> None:
    H = Hamiltonian(p[0] ** 2 / 2 + p[1] ** 2 / 2 + (x[1] - x[0]) ** 4)
    assert H == CHAIN
    kinetic = sympy.Sum(p[i] ** 2 / 2, (i, 0, 1)).doit()
    assert Hamiltonian(kinetic + (x[1] - x[0]) ** 4) == CHAIN
    np.testing.assert_array_equal(H.state_from({x[0]: 1, x[1]: 2, "p0": 3, p[1]: 4}), [1, 2, 3, 4])
    H = Hamiltonian(x[1] ** 2 + x[0] ** 2, q=[x[1]], p=x[0])
    assert H.names == ("x1", "x0")


def test_elements_of_matrices() -> None:
    position, momentum = sympy.MatrixSymbol("x", 2, 1), sympy.MatrixSymbol("p", 1, 2)
    kinetic = (momentum * momentum.T / 2)[0, 0]
    assert Hamiltonian(kinetic + (position[1, 0] - position[0, 0]) ** 4) == CHAIN
    X = sympy.MatrixSymbol("X", 2, 2)
    H = Hamiltonian(X[0, 1] ** 2 + X[1, 0] ** 2, q=[X[0, 1]], p=[X[1, 0]])
    assert H.names == ("X0_1", "X1_0")


def test_functions_of_time() -> None:
    position, momentum = dynamicsymbols("x p")
    H = Hamiltonian(momentum**2 / 2 + position**2 * sympy.cos(dynamicsymbols._t))
    assert Hamiltonian("p**2/2 + x**2*cos(t)") == H
    np.testing.assert_array_equal(H.state_from({position: 1, momentum: 2}), [1, 2])
    tau = sympy.Symbol("tau")
    H = Hamiltonian(sympy.Function("p")(tau) ** 2 + tau * sympy.Function("x")(tau))
    assert Hamiltonian("p**2 + t*x") == H
    H = Hamiltonian(position**2 + momentum**2, q=[position], p=[momentum])
    assert H.names == ("x", "p")


@pytest.mark.parametrize(
    ("expression", "mentions"),
    [
        (p[i] ** 2 + x[i] ** 2, ["index i", ".doit()"]),
        (p[-1] ** 2 + x[0] ** 2, ["index -1"]),
        (sympy.Sum(p[i] ** 2 + x[i], (i, 0, 3)), ["not a plain symbol"]),
        (p[0] ** 2 + x[0] ** 2 + sympy.Symbol("x0"), ["'x[0]'", "'x0'", "rename"]),
        (dynamicsymbols("p") ** 2 + dynamicsymbols("x").diff(), ["from_lagrangian"]),
        (dynamicsymbols("p") ** 2 + sympy.Symbol("p"), ["'p(t)'", "rename"]),
        (sympy.Function("p")(t, i) ** 2, ["functions of one time"]),
        (sympy.Function("p")(t) + sympy.Function("x")(i), ["functions of one time"]),
    ],
)
def test_other_variables_are_refused(expression: sympy.Expr, mentions: list[str]) -> None:
    with pytest.raises(VariableError) as caught:
        Hamiltonian(expression)
    for mention in mentions:
        assert mention in str(caught.value)


@pytest.mark.parametrize("unit", [units.kilogram, units.newton, 3 * units.speed_of_light])
def test_units_of_sympy_are_refused_with_the_remedy(unit: sympy.Expr) -> None:
    position, momentum = sympy.symbols("x p")
    with pytest.raises(InputError, match=r"is a unit of sympy.*units=\{"):
        Hamiltonian(momentum**2 / 2 + unit * position**2)
