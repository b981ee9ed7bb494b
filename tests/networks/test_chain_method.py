"""The method "network-chain": what it promises and what it refuses."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import InputError, Solution
from hamsym.networks import chain_training
from hamsym.networks.chain_training import ChainRun, ChainSettings, TrainedChain
from hamsym.networks.window_training import _damped
from hamsym.support.records import packed

KEPLER = "(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)"
DRIVEN = "p**2/2 + q**2/2 + q*cos(t)"


def trained(
    H: str,
    z0: list[float],
    span: tuple[float, float],
    *,
    tol: float | None = None,
    breakpoints: Sequence[float] = (),
    **options: Any,
) -> Solution:
    method = hamsym.NetworkChain(**options)
    return hamsym.solve(
        H, z0, span, method=method, tol=tol, breakpoints=breakpoints, progress=False
    )


def driven(t: np.ndarray, start: float) -> np.ndarray:
    """q of DRIVEN from (1, 0)."""
    c, s, x = math.cos(start), math.sin(start), t - start
    return np.cos(x) - c * x / 2 * np.sin(x) + s / 2 * (np.sin(x) - x * np.cos(x))


@pytest.mark.parametrize("windows", [None, 3])
@pytest.mark.parametrize("span", [(1e9, 1e9 + 10), (1e7 + 10, 1e7)])
def test_forced_motion_far_from_time_zero(span: tuple[float, float], windows: int | None) -> None:
    solution = trained(DRIVEN, [1.0, 0.0], span, tol=1e-9, windows=windows)
    assert solution.success, solution.message
    assert solution.record.hidden_steps.sum() == 0
    t = np.linspace(*span, 201)
    allowed = 1e-9 * np.abs(solution(t)[:, 0]).max()
    assert np.abs(solution(t)[:, 0] - driven(t, span[0])).max() <= allowed


def test_coarse_windows_meet_a_coarse_tolerance() -> None:
    z0 = [1.6, 0.0, 0.0, math.sqrt(0.4 / 1.6)]
    solution = trained(KEPLER, z0, (0, 2 * math.pi), tol=1e-3, windows=4, train_hidden=False)
    assert solution.success, solution.message
    assert solution.record.residuals.max() > 1e-10
    assert np.abs(solution(2 * math.pi) - z0).max() <= 1e-3


@pytest.mark.slow
def test_pulse_between_the_points_is_refused() -> None:
    H = "p**2/2 + q**2/2 + 1e5*q*exp(-(1e6*(t - 1.217))**2)"
    solution = trained(H, [1.0, 0.0], (0, 2), tol=1e-1, windows=2)
    assert not solution.success
    assert "near t = 1.21" in solution.message
    assert "narrow pulse" in solution.message


@pytest.mark.slow
def test_late_pulse_in_a_long_motion_is_passed() -> None:
    H = "p**2/2 + q**2/2 + 1e4*q*exp(-(1e5*(t - 55.3))**2)"
    solution = trained(H, [1.0, 0.0], (0, 60), tol=1e-6)
    assert solution.success, solution.message
    # The pulse is so narrow that it changes p at once, by -0.1 sqrt(pi).
    kick = 0.1 * math.sqrt(math.pi)
    assert solution(55.31)[1] == pytest.approx(-math.sin(55.31) - kick * math.cos(0.01), abs=1e-5)


@pytest.mark.slow
def test_networks_that_are_too_narrow_are_named() -> None:
    H = "p**2/2 - cos(q) + 0.4*cos(5*q - t)"
    solution = trained(H, [2.5, 0.1], (0, 20), windows=1, hidden=[4], train_hidden=False)
    assert not solution.success
    assert "give more windows or wider layers" in solution.message
    assert "pulse" not in solution.message


def test_windows_that_need_too_many_neurons_are_refused() -> None:
    with pytest.raises(InputError, match=r"2,500 neurons .* more than 1,000; give windows=3"):
        trained("p**2/2 + q**2/2", [1.0, 0.0], (0, 250), tol=1e-3, windows=1)


def test_breakpoints_that_contradict_equal_windows_are_refused() -> None:
    with pytest.raises(InputError, match="windows=3 makes equal windows, but breakpoints"):
        trained("p**2/2 + q**2/2", [1.0, 0.0], (0, 2), windows=3, breakpoints=[1.0])


@pytest.mark.parametrize("windows", [0, 1.5, 50_001])
def test_unusable_numbers_of_windows_are_refused(windows: Any) -> None:
    with pytest.raises(InputError, match="windows"):
        trained("p**2/2 + q**2/2", [1.0, 0.0], (0, 2), windows=windows)


def test_training_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert trained("p**2/2 + q**2/2", [1.0, 0.0], (0, 3), windows=2, tol=1e-6).success


def windows_of_pendulum(count: int, deadline: float | None = None) -> TrainedChain:
    H = hamsym.Hamiltonian("p**2/2 - cos(q)")
    method = hamsym.NetworkChain(hidden=(8,), windows=count)
    guess = hamsym.solve(H, [2.0, 0.3], (0, 4)).trial
    settings = ChainSettings(1e-10, 20, method.envelope, deadline, limit=math.inf)
    generator = torch.Generator().manual_seed(0)
    edges = np.linspace(0, 4, count + 1)
    return ChainRun(H, guess, edges, method, settings, generator).trained()


def test_no_steps_are_begun_after_the_deadline() -> None:
    free, ended = windows_of_pendulum(2), windows_of_pendulum(2, deadline=0.0)
    assert sum(fit.hidden_steps for fit in free.fits) > 0
    assert sum(fit.hidden_steps for fit in ended.fits) == 0
    assert ended.reason == "the time limit was reached"
    assert ended.reached == 2.0


def test_interrupted_windows_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    train, calls = chain_training.train_window, []

    def interrupted(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return train(*arguments)

    monkeypatch.setattr(chain_training, "train_window", interrupted)
    found = windows_of_pendulum(3)
    assert found.reason == "interrupted"
    assert len(found.chain.pieces) == 1


def digest_of_training(rubbish: int) -> str:
    """Return a digest of a window that is trained where memory has held this number."""
    # Freed at once, so that arrays of the training take the same memory.
    for size in range(1, 400):
        torch.full((size,), rubbish, dtype=torch.int32)
    solution = trained("p**2/2 - cos(q)", [2.0, 0.3], (0, 4), hidden=(20, 20), windows=1)
    assert solution.record.hidden_steps.sum() > 0
    digest = hashlib.sha256(solution.error_estimate(np.linspace(0, 4, 50)).tobytes())
    for array in packed(solution.trial)[0].values():
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@pytest.mark.slow
def test_same_seed_gives_the_same_bits_whatever_memory_held() -> None:
    assert len({digest_of_training(rubbish) for rubbish in (0, 1, -1)}) == 1


@pytest.mark.slow
def test_same_seed_gives_the_same_bits_in_another_process() -> None:
    code = f"import runpy; print(runpy.run_path({__file__!r})['digest_of_training'](7))"
    command = [sys.executable, "-c", code]
    other = subprocess.run(command, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == digest_of_training(0)


def test_system_without_full_rank_has_a_solution_only_if_damped() -> None:
    matrix = torch.tensor([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], dtype=torch.float64)
    right = matrix[:, 0].clone()
    assert _damped(matrix, right, 0.0) is None
    step = _damped(matrix, right, 1e-30)
    assert step is not None
    assert torch.allclose(step[:, 0], torch.tensor([1.0, 0.0], dtype=torch.float64))
