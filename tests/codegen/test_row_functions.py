"""Generated functions of states as rows, which the march calls, against those of states."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hamsym import Hamiltonian

FORMULAS = [
    "px**2/2 + py**2/2 + k*x**2*y - exp(-y**2)*cos(a*t) + sqrt(a)",
    "p**2/2",
    "p*x**3/(1 + a*p**2) + abs(x)**a + tanh(x - k)*max(p, x) + erf(p)",
]


@pytest.mark.parametrize("formula", FORMULAS)
def test_rows_equal_other_functions(formula: str) -> None:
    H = Hamiltonian(formula, **({"q": ["x"], "p": ["p"]} if formula == "p**2/2" else {}))
    values = {"a": 1.5, "k": 0.5}
    H = H.with_parameters(**{name: values[name] for name in H.parameter_names})
    random = np.random.default_rng(0)
    z, t = random.uniform(-1, 1, (5, H.dim)), random.uniform(-1, 1, 5)
    plain, half = H.compile("numpy"), H.dof
    parameters = np.array([values[name] for name in H.parameter_names])

    def found(name: str, count: int) -> np.ndarray:
        out = np.full((count, 5), math.nan)
        plain.function(f"{name}_rows")(np.ascontiguousarray(z.T), t, parameters, out)
        return out.T

    rates = plain.vector_field(*plain.arguments(z, t))
    np.testing.assert_allclose(found("velocity", half), rates[:, :half], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found("force", half), rates[:, half:], rtol=1e-14, atol=1e-15)
    energy = plain.energy(*plain.arguments(z, t))
    np.testing.assert_allclose(found("energy", 1)[:, 0], energy, rtol=1e-14, atol=1e-15)
    entries = [(i, j) for i, j in H.real_equations.hessian if i <= j]
    second = plain.hessian(*plain.arguments(z, t))
    expected = np.stack([second[:, i, j] for i, j in entries], -1)
    np.testing.assert_allclose(found("hessian", len(entries)), expected, rtol=1e-13, atol=1e-14)
