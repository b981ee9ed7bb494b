"""Generated code of systems with forces, against sympy's own derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
import torch

from hamsym import Hamiltonian
from hamsym.errors import InputError

#: Names that Python reserves, a force of q and p, one of time, and a product of many factors.
H = Hamiltonian(
    "(p_x**2 + p_y**2)/(2*lambda) + x**2*y**2/2 + exp(-x)",
    forces={
        "p_x": "-lambda*p_x*abs(p_x) + a*cos(3*t)*y",
        "p_y": "-p_y/(1 + x**2) + atan(p_x)*erf(y)",
    },
    parameters={"lambda": 1.5, "a": 0.4},
)
Z = np.random.default_rng(0).uniform(-1, 1, (5, 4))
T = np.linspace(0.1, 0.9, 5)


def _expected(expression: Any) -> np.ndarray:
    values = {**dict(H.parameters), "t": 0.0}
    symbols = [*H.z, *(s for s in expression.free_symbols if s not in H.z)]
    rows = []
    for z, t in zip(Z, T, strict=True):
        known = dict(zip(H.z, map(sympy.Float, z), strict=True))
        known |= {s: values[s.name] for s in symbols if s not in H.z} | {H.time: t}
        rows.append(np.array(expression.subs(known).evalf(20).tolist(), dtype=float))
    return np.array(rows)


def _called(backend: str, name: str) -> np.ndarray:
    function = getattr(H.compile(backend), name)
    if backend == "torch":
        return np.asarray(function(torch.from_numpy(Z), torch.from_numpy(T)).numpy())
    return np.asarray(function(Z, T))


@pytest.mark.parametrize(
    "backend", ["numpy", "torch", pytest.param("numba", marks=pytest.mark.slow)]
)
def test_functions_have_the_values_of_sympy(backend: str) -> None:
    field = sympy.Matrix([H.p[0] / 1.5, H.p[1] / 1.5, 0, 0]) * 1
    x, y, u, v = H.z
    mass, a = 1.5, 0.4
    field[2] = -x * y**2 + sympy.exp(-x) - mass * u * sympy.Abs(u) + a * sympy.cos(3 * H.time) * y
    field[3] = -(x**2) * y - v / (1 + x**2) + sympy.atan(u) * sympy.erf(y)
    close = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(_called(backend, "vector_field"), _expected(field)[..., 0], **close)
    # |u| of real symbols, whose derivative sympy writes as a sign.
    real = {s: sympy.Symbol(s.name, real=True) for s in H.z}
    jacobian = field.xreplace(real).jacobian([real[s] for s in H.z])
    jacobian = jacobian.xreplace({own: s for s, own in real.items()})
    np.testing.assert_allclose(_called(backend, "jacobian"), _expected(jacobian), **close)
    power = field[2:, :].T * sympy.Matrix([u, v]) / mass
    gradient = sympy.Matrix([x * y**2 - sympy.exp(-x), x**2 * y])
    power += gradient.T * field[:2, :]
    np.testing.assert_allclose(_called(backend, "power"), _expected(power)[:, 0, 0], **close)
    np.testing.assert_allclose(
        _called(backend, "gradient")[:, :2], _expected(gradient)[..., 0], **close
    )


@pytest.mark.parametrize("backend", ["numpy", "torch"])
def test_residual_and_loss_contain_the_forces(backend: str) -> None:
    system, rates = H.compile(backend), H.compile("numpy").vector_field(Z, T)
    given = [Z, rates + 1e-3, T]
    if backend == "torch":
        given = list(map(torch.from_numpy, given))
    np.testing.assert_allclose(np.asarray(system.residual(*given)), 1e-3, rtol=1e-10)
    assert float(system.loss(*given)) == pytest.approx(4e-6)


def test_loss_without_conservation_has_no_penalty() -> None:
    system = Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p"}).compile("numpy")
    assert float(system.loss(np.array([[1.0, 2.0]]), np.array([[2.0, -3.0]]))) == 0
    with pytest.raises(TypeError):
        system.loss(np.array([[1.0, 2.0]]), np.array([[2.0, -3.0]]), 0.5)


def test_jacobian_of_large_systems_is_that_of_the_field() -> None:
    n = 6  # beyond the dimension up to which functions are written component by component
    terms = [f"p{i}**2/2 + (q{i} - q{(i + 1) % n})**4/4" for i in range(n)]
    large = Hamiltonian(" + ".join(terms), forces={"p2": "-p2**3*q1", "p5": "sin(p0)"})
    z = torch.from_numpy(np.random.default_rng(1).normal(size=2 * n))
    system = large.compile("torch")
    expected = torch.func.jacrev(system.vector_field)(z)
    torch.testing.assert_close(system.jacobian(z), expected)
    np.testing.assert_allclose(
        large.compile("numpy").jacobian(z.numpy()), expected.numpy(), atol=1e-14
    )


@pytest.mark.parametrize("backend", ["numpy", "torch"])
def test_jacobian_without_forces_is_j_times_the_hessian(backend: str) -> None:
    free = Hamiltonian("p**2/2*(1 + x**2) + x**4")
    z = np.array([[0.3, 0.7], [1.1, -0.4]])
    found = free.compile(backend).jacobian(torch.from_numpy(z) if backend == "torch" else z)
    x, p = z.T
    expected = np.array([[2 * p * x, 1 + x**2], [-(p**2) - 12 * x**2, -2 * p * x]])
    np.testing.assert_allclose(np.asarray(found), np.moveaxis(expected, -1, 0), rtol=1e-14)


def test_modules_without_forces_have_no_functions_of_forces() -> None:
    free = Hamiltonian("p**2/2 + x**2/2")
    for backend in ("numpy", "torch", "numba", "balls"):
        assert "def power" not in free.source(backend)
        assert "def jacobian" not in free.source(backend)
    with pytest.raises(InputError, match="'jacobian' is not a function of the module"):
        free.source("numpy", "jacobian")
    forced = Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p"})
    assert "F_p = -p" in forced.source("numpy")
    assert forced.source("balls", "jacobian").startswith("def jacobian")


def test_floats_of_forces_are_exact_in_balls() -> None:
    forced = Hamiltonian("p**2/2 + x**2/2", forces={"p": -sympy.Float(0.1) * sympy.Symbol("p")})
    assert "3602879701896397, 36028797018963968" in forced.source("balls", "vector_field")
