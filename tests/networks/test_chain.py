"""Chains of networks: accuracy, units, spans, verdicts, files and proofs."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.networks.chain import Chain, ChainTraining
from hamsym.networks.chain_error import estimate_chain_error
from hamsym.networks.network import Network
from hamsym.networks.window_training import Equations, Settings, train_window
from hamsym.solving.methods import made_method

PENDULUM = Hamiltonian("p**2/2 - cos(x)")
CIRCLE = Hamiltonian("p**2/2 + x**2/2")


def _saddle(t: np.ndarray) -> np.ndarray:
    """x and p of p**2/2 - x**2/2 from (1, -0.5)."""
    x = np.cosh(t) - 0.5 * np.sinh(t)
    return np.stack((x, np.sinh(t) - 0.5 * np.cosh(t)), axis=-1)


@pytest.mark.slow_cases("2", "1")
@pytest.mark.parametrize("seed", range(3))
def test_linear_motion_is_exact_to_round_off(seed: int) -> None:
    solution = hamsym.solve(
        CIRCLE, [1.0, 0.0], (0, 20), method="network-chain", seed=seed, tol=1e-11
    )
    assert solution.success, solution.message
    t = np.linspace(0, 20, 997)
    truth = np.stack((np.cos(t), -np.sin(t)), axis=-1)
    error = np.abs(solution(t) - truth).max(axis=0)
    assert (error <= 1e-12).all()
    assert (error <= 2 * solution.largest_error).all()


def test_growing_motion_is_solved() -> None:
    H = Hamiltonian("p**2/2 - x**2/2")
    solution = hamsym.solve(H, [1.0, -0.5], (0, 10), method="network-chain")
    assert solution.success, solution.message
    t = np.linspace(0, 10, 501)
    truth = _saddle(t)
    assert (np.abs(solution(t) - truth).max(axis=0) <= 1e-11 * np.abs(truth).max(axis=0)).all()


@pytest.mark.parametrize("size", [1e-9, 1e6])
def test_weights_have_no_units(size: float) -> None:
    one = hamsym.solve(CIRCLE, [1.0, 0.5], (0, 5), method="network-chain")
    other = hamsym.solve(CIRCLE, [size, 0.5 * size], (0, 5), method="network-chain")
    slow = hamsym.solve(
        Hamiltonian("p**2/2e6 + x**2/2e6"), [1.0, 0.5], (0, 5e6), method="network-chain"
    )
    t = np.linspace(0, 5, 101)
    assert one.success
    assert other.success
    assert slow.success
    np.testing.assert_allclose(other(t) / size, one(t), atol=1e-12)
    np.testing.assert_allclose(slow(1e6 * t), one(t), atol=1e-12)


def test_backward_and_far_spans() -> None:
    there = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 12), method="network-chain")
    back = hamsym.solve(PENDULUM, there(12.0), (12, 0), method="network-chain")
    far = hamsym.solve(PENDULUM, [1.0, 0.5], (1e9, 1e9 + 12), method="network-chain")
    assert back.success
    assert far.success
    np.testing.assert_allclose(back(0.0), [1.0, 0.5], atol=1e-11)
    np.testing.assert_allclose(far(1e9 + 12), there(12.0), atol=1e-9)


@pytest.mark.slow
def test_cost_grows_in_proportion_to_the_span() -> None:
    short, long = (
        hamsym.solve(PENDULUM, [1.0, 0.5], (0, end), method="network-chain")
        for end in (20.0, 200.0)
    )
    assert short.success
    assert long.success
    assert len(long.trial.pieces) <= 15 * len(short.trial.pieces)
    assert long.evaluations <= 40 * short.evaluations


@pytest.mark.parametrize("hidden", [(10, 10), pytest.param((50, 50), marks=pytest.mark.slow)])
@pytest.mark.parametrize(("activation", "envelope"), [("sin", "linear"), ("tanh", "exponential")])
def test_other_networks(hidden: tuple[int, ...], activation: str, envelope: str) -> None:
    solution = hamsym.solve(
        PENDULUM,
        [1.0, 0.5],
        (0, 4),
        method=hamsym.NetworkChain(hidden=hidden, activation=activation, envelope=envelope),
        tol=1e-7,
    )
    truth = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 4), tol=1e-11)
    t = np.linspace(0, 4, 101)
    assert solution.success, solution.message
    np.testing.assert_allclose(solution(t), truth(t), atol=1e-7)


@pytest.mark.slow
def test_hidden_layers_are_trained_where_readouts_do_not_suffice() -> None:
    narrow: dict[str, Any] = {"hidden": (10, 10)}
    trained = hamsym.solve(
        PENDULUM, [1.0, 0.5], (0, 5), method=hamsym.NetworkChain(**narrow), tol=1e-7
    )
    readouts = hamsym.solve(
        PENDULUM,
        [1.0, 0.5],
        (0, 5),
        method=hamsym.NetworkChain(train_hidden=False, time_limit=1, **narrow),
        tol=1e-7,
    )
    assert trained.success
    assert trained.record.hidden_steps.sum() > 0
    assert readouts.record.hidden_steps.sum() == 0
    assert not readouts.success or len(readouts.trial.pieces) > len(trained.trial.pieces)


def test_one_network_over_the_whole_span() -> None:
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, (0, 5), method=hamsym.NetworkChain(windows=1), tol=1e-11
    )
    assert solution.success, solution.message
    assert len(solution.trial.pieces) == 1
    assert solution.trial.edges.tolist() == [0, 5]
    truth = hamsym.solve(problem.H, problem.z0, (0, 5), tol=1e-12)
    t = np.linspace(0, 5, 301)
    assert np.abs(solution(t) - truth(t)).max() <= 1e-11


def test_given_number_of_windows() -> None:
    solution = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 6), method=hamsym.NetworkChain(windows=3))
    assert solution.success
    np.testing.assert_allclose(solution.trial.edges, [0, 2, 4, 6])


def test_windows_end_at_breakpoints() -> None:
    H = Hamiltonian("p**2/2 + abs(t - 1)*x**2")
    solution = hamsym.solve(H, [1.0, 0.5], (0, 3), method="network-chain", breakpoints=[1.0])
    assert solution.success, solution.message
    assert 1.0 in solution.trial.edges


@pytest.mark.slow
def test_narrow_pulse_is_not_stepped_over() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + x*exp(-1e6*(t - 3.3)**2)")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 6), method="network-chain")
    assert solution.success, solution.message
    # The pulse changes p by about its area.
    kick = -math.sqrt(math.pi) * 1e-3
    assert abs(solution(6.0)[0] - math.cos(6) - kick * math.sin(2.7)) < 1e-5


@pytest.mark.slow_cases("p**2/2 + abs(x)-z00-stopped at t = 1.41421")
@pytest.mark.parametrize(
    ("text", "z0", "message"),
    [
        ("p**2/2 + abs(x)", [1.0, 0.0], "stopped at t = 1.41421"),
        ("p**2/2 - x**4", [1.0, 1.0], "stopped at t = 0.7530"),
    ],
)
def test_motions_that_end_are_refused(text: str, z0: list[float], message: str) -> None:
    solution = hamsym.solve(text, z0, (0, 5), method="network-chain")
    assert not solution.success
    assert message in solution.message
    assert solution.span[1] < 5


@pytest.mark.slow
def test_chaos_beyond_round_off_is_refused() -> None:
    problem = hamsym.systems.henon_heiles()
    solution = hamsym.solve(problem.H, [0.0, -0.15, 0.5555, 0.0], (0, 700), method="network-chain")
    assert not solution.success
    assert "met only until t = " in solution.message
    held = float(solution.message.split("until t = ")[1].split(":")[0])
    assert 10 < held < 700


@pytest.mark.slow
def test_time_limit_keeps_what_was_reached() -> None:
    solution = hamsym.solve(
        PENDULUM, [1.0, 0.5], (0, 1e4), method=hamsym.NetworkChain(time_limit=0.5)
    )
    assert not solution.success
    assert "the time limit was reached" in solution.message
    assert 0 < solution.span[1] < 1e4


@pytest.mark.slow
def test_networks_that_are_too_small_are_named() -> None:
    solution = hamsym.solve(
        PENDULUM, [1.0, 0.5], (0, 20), method=hamsym.NetworkChain(hidden=(5, 5), train_hidden=False)
    )
    assert not solution.success
    assert "give wider layers" in solution.message


def test_interruption_keeps_what_was_reached() -> None:
    def interrupt(state: Any) -> None:
        if state.iteration == 3:
            raise KeyboardInterrupt

    solution = hamsym.solve(
        PENDULUM, [1.0, 0.5], (0, 100), method="network-chain", progress=interrupt
    )
    assert not solution.success
    assert "interrupted" in solution.message


def test_file_and_pickle_restore_the_same_bits(tmp_path: Path) -> None:
    solution = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 5), method="network-chain")
    solution.save(tmp_path / "chain.hamsym")
    t = np.linspace(0, 5, 77)
    for other in (hamsym.load(tmp_path / "chain.hamsym"), pickle.loads(pickle.dumps(solution))):
        assert isinstance(other.trial, Chain)
        assert isinstance(other.record, ChainTraining)
        np.testing.assert_array_equal(other(t), solution(t))
        np.testing.assert_array_equal(other.error_estimate(t), solution.error_estimate(t))
        assert (other.success, other.message) == (solution.success, solution.message)


def test_solutions_that_contradict_themselves_are_not_saved(tmp_path: Path) -> None:
    solution = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 5), method="network-chain")
    first, *rest = solution.trial.pieces
    broken = [
        replace(solution, trial=Chain((first, *rest[1:]), solution.trial.end)),
        replace(solution, trial=Chain(tuple(rest), solution.trial.end)),
        replace(solution, error=None),
        replace(solution, record=replace(solution.record, steps=solution.record.steps[:-1])),
        replace(solution, method="features"),
    ]
    for wrong in broken:
        with pytest.raises(hamsym.FileError):
            wrong.save(tmp_path / "wrong.hamsym")
    assert not (tmp_path / "wrong.hamsym").exists()


def test_tensors_are_differentiable_in_time() -> None:
    solution = hamsym.solve(PENDULUM, [1.0, 0.5], (0, 5), method="network-chain")
    t = torch.linspace(0, 5, 40, dtype=torch.float64).flip(0).requires_grad_()
    z = solution(t)
    rates = torch.stack([torch.autograd.grad(part.sum(), t, retain_graph=True)[0] for part in z.T])
    np.testing.assert_allclose(rates.T.numpy(), solution.derivative(t.detach().numpy()), atol=1e-11)


def test_estimate_is_that_of_an_error_that_was_put_in() -> None:
    solution = hamsym.solve(CIRCLE, [1.0, 0.0], (0, 6), method="network-chain")
    # Another Hamiltonian: the exact difference of the two motions is known.
    other = Hamiltonian("p**2/2 + x**2*(1 + 2e-4)/2")
    estimate = estimate_chain_error(other, solution.trial, solution.points)
    assert not estimate.limit
    t = np.linspace(0, 6, 50)
    w = math.sqrt(1 + 2e-4)
    difference = np.cos(w * t) - np.cos(t)
    np.testing.assert_allclose(estimate.error(t)[:, 0], difference, atol=1e-11)


def test_estimate_of_a_wrong_motion_is_infinite() -> None:
    solution = hamsym.solve(CIRCLE, [1.0, 0.0], (0, 30), method="network-chain")
    estimate = estimate_chain_error(
        Hamiltonian("p**2/2 + x**2 + x**4"), solution.trial, solution.points
    )
    assert "errors grow too large" in estimate.limit
    assert np.isinf(estimate.error.largest).all()


def test_roundings_of_terms_that_cancel_are_in_the_estimate() -> None:
    """exp(x) - 1 is zero in float64, and the networks stand still."""
    solution = hamsym.solve(
        "p**2/2 + exp(x) - x", [1e-17, 0.0], (0, 3), method="network-chain", tol=1e-3
    )
    assert not solution.success
    assert "round-off" in solution.message


def test_estimate_agrees_with_its_check() -> None:
    solution = hamsym.solve(
        PENDULUM, [1.0, 0.5], (0, 5), method=hamsym.NetworkChain(hidden=(8,)), tol=1e-3
    )
    t = np.linspace(0, 5, 60)
    largest = np.abs(solution.error_estimate(t)).max()
    assert np.abs(solution.error_estimate_check(t)).max() <= 0.05 * largest + 1e-13


def test_certificate_proves_round_off() -> None:
    solution = hamsym.solve(CIRCLE, [1.0, 0.0], (0, 2), method="network-chain", tol=1e-11)
    certificate = solution.certify()
    assert certificate.bound <= 1e-12
    assert certificate.bound <= 1.05 * certificate.lower
    t = np.linspace(0, 2, 41)
    truth = np.stack((np.cos(t), -np.sin(t)), axis=-1)
    assert np.linalg.norm(solution(t) - truth, axis=1).max() <= certificate.bound + 4e-16


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tol": 1e-14}, "tol=1e-14 cannot be used"),
        ({"tol": math.nan}, "tol=nan cannot be used"),
        ({"atol": [1.0, 2.0, 3.0]}, "atol="),
        ({"windows": 0}, "windows=0"),
        ({"windows": 1.5}, "windows=1.5"),
        ({"max_window": 1}, "'max_window' is not an option of method 'network-chain'"),
        ({"breakpoints": [7.0]}, "breakpoint 7 is not inside"),
        ({"time_limit": 0}, "time_limit=0"),
        ({"hidden": ()}, "hidden=()"),
        ({"frequency": -1}, "frequency=-1"),
        ({"activation": "relu"}, "relu"),
        ({"points": 50}, "'points' is not an option of method 'network-chain', but of 'levenberg-"),
        ({"windows": 2, "target_loss": 1e-5}, "'target_loss' is not an option of method"),
    ],
)
def test_options_that_cannot_be_used(options: dict[str, Any], message: str) -> None:
    asked = {name: options[name] for name in ("tol", "atol", "breakpoints") if name in options}
    rest = {name: value for name, value in options.items() if name not in asked}

    def solve() -> None:
        method = made_method("network-chain", rest)
        hamsym.solve(PENDULUM, [1.0, 0.5], (0, 5), method=method, **asked)

    with pytest.raises(InputError) as caught:
        solve()
    assert message in str(caught.value)


def test_start_without_finite_derivatives_is_refused() -> None:
    solution = hamsym.solve("p**2/2 + abs(x)**1.5", [0.0, 0.0], (0, 5), method="network-chain")
    assert not solution.success
    assert "met only until t = 0: the Hessian of H is not finite" in solution.message


def test_window_of_many_seeds_reaches_the_tolerance() -> None:
    def rates(u: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return 2 * torch.stack((y[:, 1], -torch.sin(1 + y[:, 0])), 1)

    def jacobian(u: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        matrix = torch.zeros(len(u), 2, 2, dtype=y.dtype)
        matrix[:, 0, 1], matrix[:, 1, 0] = 2.0, -2 * torch.cos(1 + y[:, 0])
        return matrix

    for seed in range(5):
        network = Network(
            2, (20, 20), frequency=3.0, generator=torch.Generator().manual_seed(seed)
        ).requires_grad_(False)
        fit = train_window(
            Equations(rates, jacobian, lambda u: u),
            network,
            1.5,
            40,
            Settings(1e-10, 20, "exponential"),
            lambda u: torch.zeros(len(u), 2, dtype=u.dtype),
        )
        assert fit.residual <= 1e-10
