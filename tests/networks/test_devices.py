"""Devices and precisions of the methods that train."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import hamsym
from hamsym import InputError
from hamsym.cli.commands import main
from hamsym.networks.levenberg_marquardt import LevenbergMarquardt
from hamsym.networks.network import Network
from hamsym.networks.trial import TrialSolution
from hamsym.solving.methods import made_method
from tests.networks.objectives import squares_of

H = hamsym.Hamiltonian("p**2/2 + x**2/2")
BRIEF = {
    "adam": {"epochs": 40},
    "lbfgs": {"iterations": 12},
    "levenberg-marquardt": {"iterations": 8, "stages": 2},
}
SMALL = {"hidden": (6,), "points": 12}


@pytest.fixture
def no_default_device() -> Iterator[None]:
    """Tensors made without a device cannot be used, as those of another device."""
    torch.set_default_device("meta")
    yield
    torch.set_default_device(None)


@pytest.mark.slow_cases("adam-False", "lbfgs-False", "levenberg-marquardt-True")
@pytest.mark.parametrize(
    ("method", "own"), [*((method, False) for method in BRIEF), ("levenberg-marquardt", True)]
)
def test_every_tensor_is_made_on_the_device_of_the_training(
    method: str, own: bool, request: pytest.FixtureRequest
) -> None:
    options = {"energy_weight": 0.1, **BRIEF[method]}
    if own:
        module = nn.Sequential(nn.Linear(1, 6), nn.Tanh(), nn.Linear(6, 2))
        options |= {"trial": module, "points": 12}
    else:
        options |= SMALL
    one = hamsym.solve(H, [1, 0], (0, 3), method=made_method(method, options))
    request.getfixturevalue("no_default_device")
    other = hamsym.solve(
        H, [1, 0], (0, 3), method=made_method(method, {"device": torch.device("cpu"), **options})
    )
    np.testing.assert_array_equal(one([0.5, 3.0]), other([0.5, 3.0]))
    assert other.message == one.message


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ("nonsense", "is not a device of torch; give 'cpu', 'cuda' or 'mps'"),
        (3.5, "device=3.5 is not a device of torch"),
        ("cuda:99", "device='cuda:99' cannot be used here"),
        (torch.device("cuda", 99), "device='cuda:99' cannot be used here"),
        ("meta", "device='meta' cannot be used here"),
        ("mps", "device='mps' has no float64; give dtype='float32'"),
    ],
)
@pytest.mark.parametrize("method", BRIEF)
def test_absent_devices_are_refused_in_one_sentence(
    method: str, device: object, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        hamsym.solve(H, [1, 0], (0, 1), method=made_method(method, {"device": device}))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_command_line_takes_device_and_precision(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["solve", "p**2/2 + x**2/2", "--z0", "1,0", "--t-end", "1", "--method", "lbfgs"]
    arguments += ["--iterations", "5", "--hidden", "4", "--dtype", "float32"]
    assert main([*arguments, "--device", "cpu"]) in (0, 1)
    assert "ell_max" in capsys.readouterr().out
    assert main([*arguments, "--device", "cuda:99"]) == 2
    assert "device='cuda:99' cannot be used here" in capsys.readouterr().err


@pytest.mark.slow_cases("adam", "levenberg-marquardt")
@pytest.mark.parametrize("method", BRIEF)
def test_float32_weights_are_evaluated_in_float64(method: str) -> None:
    solution = hamsym.solve(
        H,
        [1.3, -0.7],
        (0, 2),
        method=made_method(method, {"dtype": "float32", **BRIEF[method], **SMALL}),
    )
    trial = solution.trial
    assert trial.network.theta.dtype == torch.float32
    t = np.linspace(0, 2, 9)
    precise = Network(2, (6,), dtype=torch.float64)
    precise.load_state_dict(trial.network.state_dict())
    exact = TrialSolution(precise, trial.z0.double(), tau=trial.tau)
    np.testing.assert_array_equal(solution(t), exact.states_at(t))
    np.testing.assert_array_equal(solution(0.0), np.float32([1.3, -0.7]))


@pytest.mark.slow_cases("lbfgs")
@pytest.mark.parametrize("method", ["lbfgs", "levenberg-marquardt"])
def test_float32_converges_with_its_error_estimated(method: str) -> None:
    settings = {"dtype": "float32", "hidden": (12, 12), "points": 40, "stages": 3}
    iterations = 400 if method == "lbfgs" else 40
    solution = hamsym.solve(
        H, [1, 0], (0, 3), method=made_method(method, {"iterations": iterations, **settings})
    )
    assert solution.success, solution.message
    t = np.linspace(0, 3, 31)
    error = np.stack((np.cos(t), -np.sin(t)), 1) - solution(t)
    assert np.abs(error).max() < 5e-3
    np.testing.assert_allclose(
        solution.error_estimate(t), error, atol=0.05 * np.abs(error).max() + 1e-7
    )


def test_least_damping_is_that_of_the_precision() -> None:
    least = {}
    for dtype in (torch.float32, torch.float64):
        network = Network(1, (4,), generator=torch.Generator().manual_seed(0), dtype=dtype)
        trial = TrialSolution(network, torch.ones(1, dtype=dtype))
        optimizer = LevenbergMarquardt(hamsym.LevenbergMarquardt(points=8))
        optimizer.bind(trial, squares_of(lambda t, z, dz: dz + z), torch.Generator())
        optimizer._mu = optimizer._mu_least
        optimizer.iterate((0.0, 1.0), 1.0, 0.0)
        assert optimizer._mu >= optimizer._mu_least
        least[dtype] = optimizer._mu_least
    assert least[torch.float64] == 1e-14
    assert 1e-6 < least[torch.float32] < 1e-5


def test_constants_of_a_module_must_be_buffers() -> None:
    class Fixed(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.last = nn.Linear(4, 2)
            self.first = torch.ones(1, 4)  # stays float32, where it is

        def forward(self, x: Tensor) -> Tensor:
            return self.last(torch.tanh(x @ self.first))

    with pytest.raises(InputError, match="with weights in float64: .*; register its constant"):
        hamsym.solve(H, [1, 0], (0, 1), method=hamsym.Adam(trial=Fixed(), dtype="float32"))
