"""The trial solution: exact initial state, derivatives consistent with values."""

from __future__ import annotations

import pytest
import torch

from hamsym import InputError
from hamsym.networks.network import ACTIVATIONS, ComponentNetworks, Network
from hamsym.networks.trial import ENVELOPES, TrialSolution


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def make(activation: str = "sin", envelope: str = "exponential", shared: bool = True, **settings):
    make_network = lambda outputs: Network(outputs, (7, 5), activation, generator=generator())
    network = make_network(2) if shared else ComponentNetworks([make_network(1) for _ in range(2)])
    z0 = torch.tensor([1.3, 1.0], dtype=torch.float64)
    return TrialSolution(network, z0, envelope=envelope, **settings)


TIMES = torch.linspace(0.5, 3, 6, dtype=torch.float64)


@pytest.mark.parametrize("envelope", ENVELOPES)
@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("shared", [True, False])
def test_time_derivative_is_the_derivative(activation: str, envelope: str, shared: bool) -> None:
    trial = make(activation, envelope, shared, t0=0.5, tau=1.7)
    t = TIMES.clone().requires_grad_()
    z, dz = trial(t)
    for i in range(2):
        (slope,) = torch.autograd.grad(z[:, i].sum(), t, retain_graph=True)
        torch.testing.assert_close(dz[:, i], slope)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("shared", [True, False])
def test_explicit_gradient_equals_automatic_differentiation(activation: str, shared: bool) -> None:
    trial = make(activation, shared=shared, tau=0.7)
    weights = list(trial.parameters())

    def objective(t: torch.Tensor) -> torch.Tensor:
        z, dz = trial(t)
        return (z**2).sum() + (dz**3).sum() + (z * dz).sum()

    fast = objective(TIMES)
    plain = objective(TIMES.clone().requires_grad_())  # the path without the custom gradient
    torch.testing.assert_close(fast, plain)
    for ours, automatic in zip(
        torch.autograd.grad(fast, weights), torch.autograd.grad(plain, weights), strict=True
    ):
        torch.testing.assert_close(ours, automatic)


def test_second_order_through_the_weights_is_refused() -> None:
    trial = make()
    z, dz = trial(TIMES)
    weights = list(trial.parameters())
    (slope, *_) = torch.autograd.grad((z * dz).sum(), weights, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


@pytest.mark.parametrize("envelope", ENVELOPES)
@pytest.mark.parametrize("tau", [1.0, -2.0, 1e-15, 1e9])
def test_starts_exactly_at_z0(envelope: str, tau: float) -> None:
    trial = make(envelope=envelope, t0=2.0, tau=tau)
    z, _ = trial(torch.tensor([2.0], dtype=torch.float64))
    assert torch.equal(z[0], trial.z0)


def test_components_share_the_hidden_layers_or_not() -> None:
    count = lambda module: sum(p.numel() for p in module.parameters())
    assert count(Network(2, (50, 50))) == 50 + 50 + 2500 + 50 + 100 + 2
    assert count(make(shared=False)) == 2 * (7 + 7 + 35 + 5 + 5 + 1)


def test_same_seed_same_weights() -> None:
    first, second = Network(2, generator=generator(3)), Network(2, generator=generator(3))
    other = Network(2, generator=generator(4))
    assert torch.equal(first.theta, second.theta)
    assert not torch.equal(first.theta, other.theta)


def test_initial_weights_are_within_their_bounds() -> None:
    layers = Network(3, (64, 32), generator=generator()).layers
    assert [tuple(matrix.shape) for matrix, _ in layers] == [(64, 1), (32, 64), (3, 32)]
    for (matrix, bias), inputs in zip(layers, (1, 64, 32), strict=True):
        for weights in (matrix, bias):
            assert weights.abs().max() <= inputs**-0.5
        assert matrix.abs().max() > 0.9 * inputs**-0.5


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Network(2, activation="relu"), "'relu' is not an activation; choose one of sin"),
        (lambda: make(envelope="cubic"), "'cubic' is not an envelope; choose one of expon"),
        (lambda: Network(2, hidden=()), "hidden=() is not a list of layer widths"),
        (lambda: Network(2, hidden=(50, 0)), "is not a list of layer widths"),
        (lambda: Network(2, hidden=(50.0,)), "is not a list of layer widths"),
    ],
)
def test_unusable_settings_are_rejected(build, message: str) -> None:
    with pytest.raises(InputError) as caught:
        build()
    assert message in str(caught.value)
