"""Functions of jax under jit, vmap and grad; their values are tested with those of all backends."""

from __future__ import annotations

import importlib.util
import re
from typing import Any

import numpy as np
import pytest
import torch

from hamsym import Hamiltonian, InputError
from hamsym.systems import CATALOGUE, Problem
from tests.codegen.test_generated_code import FORMULAS, SYSTEMS, TIME, states

PARAMETERS = {"k": 1.3, "w": 3.0}
DRIVEN = "p**2/2 + k*x**4/4 + erf(k*x)*cos(w*t) + max(x, p, k)"


@pytest.fixture
def jax() -> Any:
    found = pytest.importorskip("jax", reason="needs pip install 'hamsym[jax]'")
    found.config.update("jax_enable_x64", True)
    return found


@pytest.fixture(params=SYSTEMS)
def example(request: pytest.FixtureRequest) -> Problem:
    return CATALOGUE[request.param]()


def test_derivatives_match_those_of_jax(jax: Any, example: Problem) -> None:
    system = example.H.compile("jax")
    arguments = system.arguments(states(example.H, np.array(example.z0), count=1)[0], TIME)
    gradient = jax.jit(jax.grad(system.energy))(*arguments)
    hessian = jax.jit(jax.jacfwd(system.gradient))(*arguments)
    np.testing.assert_allclose(system.gradient(*arguments), gradient, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(system.hessian(*arguments), hessian, rtol=1e-11, atol=1e-11)


def test_batches_equal_mapped_functions(jax: Any, example: Problem) -> None:
    system = example.H.compile("jax")
    z = states(example.H, np.array(example.z0), count=3)
    times = np.linspace(0.1, 0.3, 3)
    for name in ("energy", "vector_field", "hessian"):
        function = getattr(system, name)
        batch = function(*system.arguments(z, times))
        each = jax.jit(jax.vmap(function))(*system.arguments(z, times))
        np.testing.assert_allclose(each, batch, rtol=1e-13, atol=1e-14)


def test_gradients_of_the_loss_match_torch(jax: Any, example: Problem) -> None:
    """With respect to the states, their derivatives, and the weight of the energy."""
    H = example.H
    z = states(H, np.array(example.z0), count=3)
    dz = np.random.default_rng(2).normal(size=z.shape)
    more = (TIME,) if H.time is not None else (0.7, 2.5)
    tensors = [torch.tensor(a, requires_grad=True, dtype=torch.float64) for a in (z, dz, more[-1])]
    loss = H.compile("torch").loss(*tensors[:2], *more[:-1], tensors[2])
    expected = torch.autograd.grad(loss, tensors, materialize_grads=True)
    last = 1 + len(more)
    found = jax.jit(jax.grad(H.compile("jax").loss, argnums=(0, 1, last)))(z, dz, *more)
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(own, other.numpy(), rtol=1e-11, atol=1e-12)


def test_gradients_in_parameters_and_time_match_torch(jax: Any) -> None:
    H = Hamiltonian(DRIVEN, parameters=PARAMETERS)
    z, dz = np.array([[0.7, 1.1], [0.2, -0.4]]), np.array([[0.1, 0.2], [0.3, 0.4]])
    k, t = torch.tensor([1.3, 0.4], dtype=torch.float64).requires_grad_().unbind()
    loss = H.compile("torch").loss(torch.tensor(z), torch.tensor(dz), t, k=k)
    expected = torch.autograd.grad(loss, (k, t))
    system = H.compile("jax")
    found = jax.jit(jax.grad(lambda k, t: system.loss(z, dz, t, k=k), argnums=(0, 1)))(1.3, 0.4)
    np.testing.assert_allclose(found, [value.item() for value in expected], rtol=1e-12)


@pytest.mark.parametrize("dof", [1, 4])
@pytest.mark.parametrize("force", ["0", "-c*p0*x0**2"])
def test_rates_with_forces_have_the_derivatives_of_jax(jax: Any, dof: int, force: str) -> None:
    """Also without forces, where numpy takes the Hessian; dH/dt along trajectories is power."""
    terms = [f"p{i}**2/2 + x{i}**4/4 + c*x{i}*x{(i + 1) % dof}" for i in range(dof)]
    forces = {} if force == "0" else {"forces": {"p0": force}}
    H = Hamiltonian(" + ".join(terms), parameters={"c": 0.3}, **forces)
    system, z = H.compile("jax"), np.linspace(0.3, 0.9, 2 * dof)
    jacobian = jax.jit(jax.jacfwd(system.vector_field))(z)
    np.testing.assert_allclose(jax.jit(system.jacobian)(z), jacobian, rtol=1e-13, atol=1e-15)
    _, rate = jax.jvp(system.energy, (z,), (system.vector_field(z),))
    np.testing.assert_allclose(system.power(z), rate, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("formula", FORMULAS)
def test_gradients_flow_twice_through_every_function(jax: Any, formula: str) -> None:
    given = {"k": 1.3} if "k" in formula else {}
    H = Hamiltonian(f"p**2/2 + {formula}", q=["x"], p=["p"], parameters=given)
    z = np.array([FORMULAS[formula], 0.8])
    twice = jax.jit(jax.hessian(H.compile("jax").loss))(z, 0 * z, 0.0, 1.0)
    reference = torch.func.hessian(H.compile("torch").loss)
    expected = reference(torch.tensor(z)[None], torch.zeros((1, 2), dtype=torch.float64), 0.0, 1.0)
    np.testing.assert_allclose(twice, expected[0, :, 0], rtol=1e-10, atol=1e-12)


def test_states_may_be_lists_of_integers(jax: Any) -> None:
    found = Hamiltonian("p**2/2 + x**4/4").compile("jax").vector_field([2, 3])
    np.testing.assert_array_equal(found, [3.0, -8.0])
    assert found.dtype == np.float64


def test_results_are_float32_unless_float64_is_enabled(jax: Any) -> None:
    system = Hamiltonian("p**2/2 + k*x**2/3", parameters={"k": 0.1}).compile("jax")
    jax.config.update("jax_enable_x64", False)
    try:
        assert system.gradient(np.array([1.0, 2.0])).dtype == np.float32
        assert system.hessian([1, 2]).dtype == np.float32
    finally:
        jax.config.update("jax_enable_x64", True)


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The source does not need it."""
    H = Hamiltonian("p**2/2 + x**2/2 + x**6/77")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(
        InputError,
        match=re.escape("'jax' need the package jax, which is not installed; install it with "
                        "pip install 'hamsym[jax]'"),
    ):  # fmt: skip
        H.compile("jax")
    assert "import jax.numpy as jnp" in H.source("jax")
