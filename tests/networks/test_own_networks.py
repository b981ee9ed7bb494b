"""Networks of the user's own: any module of torch as N in z^(t) = z0 + f(s) N(s)."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import hamsym
from hamsym import CertificationError, InputError
from hamsym.networks.levenberg_marquardt import LevenbergMarquardt
from hamsym.networks.module_rates import ModuleRates
from hamsym.networks.module_trial import ModuleTrial, checked_copy, rate_defect
from hamsym.networks.network import Network
from hamsym.networks.optimizers import LBFGS, Adam, Optimizer
from hamsym.networks.rules import Stages
from hamsym.networks.training import train
from hamsym.networks.trial import TrialSolution
from hamsym.solving.methods import made_method
from tests.networks.objectives import squares_of

H = hamsym.Hamiltonian("p**2/2 + x**2/2")
BRIEF = {
    "adam": {"epochs": 30},
    "lbfgs": {"iterations": 8},
    "levenberg-marquardt": {"iterations": 4},
}


class Sine(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return torch.sin(x)


def layered(width: int = 12, *, activation: Callable[[], nn.Module] = nn.Tanh) -> nn.Sequential:
    """A fully connected module whose weights depend on nothing but its width."""
    with torch.random.fork_rng():
        torch.manual_seed(width)
        return nn.Sequential(nn.Linear(1, width), activation(), nn.Linear(width, 2))


def copy_of(network: Network) -> nn.Sequential:
    """The same network made of layers of torch."""
    layers: list[nn.Module] = []
    for matrix, bias in network.layers:
        layer = nn.Linear(matrix.shape[1], matrix.shape[0], dtype=torch.float64)
        layer.load_state_dict({"weight": matrix.detach(), "bias": bias.detach()})
        layers += [layer, Sine()]
    return nn.Sequential(*layers[:-1])


@pytest.mark.parametrize(
    "optimizer",
    [
        Adam(hamsym.Adam(points=20, epochs=5)),
        LBFGS(hamsym.LBFGS(points=20, iterations=5)),
        LevenbergMarquardt(hamsym.LevenbergMarquardt(points=20, iterations=5)),
    ],
    ids=lambda optimizer: optimizer.method.name,
)
def test_module_trains_as_the_network_that_it_copies(optimizer: Optimizer) -> None:
    network = Network(2, (8, 7), frequency=3.0, generator=torch.Generator().manual_seed(4))
    z0 = torch.tensor([1.0, 0.0], dtype=torch.float64)
    losses = []
    for trial in (ModuleTrial(copy_of(network), z0), TrialSolution(network, z0)):
        training = train(
            trial,
            squares_of(lambda t, z, dz: dz - torch.stack((z[:, 1], -z[:, 0]), 1)),
            (0, 2),
            optimizer,
            stages=Stages(),
            generator=torch.Generator().manual_seed(0),
        )
        losses.append(training.history.loss)
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-6)
    assert losses[0][-1] < losses[0][0]


@pytest.mark.slow_cases("adam", "lbfgs", "levenberg-marquardt")
@pytest.mark.parametrize("method", BRIEF)
def test_solution_starts_exactly_and_leaves_the_module(method: str) -> None:
    module = layered()
    before = copy.deepcopy(module.state_dict())
    solution = hamsym.solve(
        H,
        [1.3, -0.2],
        (3.0, 1.0),
        method=made_method(method, {"trial": module, "points": 15, **BRIEF[method]}),
    )
    np.testing.assert_array_equal(solution(3.0), [1.3, -0.2])
    assert all(torch.equal(before[name], value) for name, value in module.state_dict().items())
    assert all(weight.requires_grad and weight.grad is None for weight in module.parameters())
    trained = solution.trial.network
    assert type(trained) is type(module)
    assert trained[0].weight.dtype == torch.float64
    assert not torch.equal(trained[0].weight, before["0.weight"].double())
    module.load_state_dict(trained.state_dict())  # the names are those of the module


@pytest.mark.slow
def test_solution_has_derivatives_errors_and_energy() -> None:
    solution = hamsym.solve(
        H,
        [1.0, 0.0],
        (0, 3),
        method=hamsym.LevenbergMarquardt(
            trial=copy_of(Network(2, (10, 10), frequency=3.0, generator=torch.Generator())),
            iterations=30,
            stages=3,
            points=30,
        ),
    )
    assert solution.success, solution.message
    t = np.linspace(0, 3, 31)
    truth = np.stack((np.cos(t), -np.sin(t)), 1)
    error = truth - solution(t)
    assert np.abs(error).max() <= 1e-3
    np.testing.assert_allclose(solution.error_estimate(t), error, atol=0.02 * np.abs(error).max())
    slope = (solution(t[1:-1] + 1e-5) - solution(t[1:-1] - 1e-5)) / 2e-5
    np.testing.assert_allclose(solution.derivative(t[1:-1]), slope, atol=1e-8)
    assert np.abs(solution.energy(t) - 0.5).max() < 1e-3
    times = torch.tensor([0.5, 1.0], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(solution(times)[:, 0].sum(), times)
    np.testing.assert_allclose(found, solution.derivative([0.5, 1.0])[:, 0], rtol=1e-12)


class Plain(nn.Module):
    """A module without layers."""

    def __init__(self, width: int = 6) -> None:
        super().__init__()
        self.first = nn.Parameter(torch.linspace(-2, 2, width))
        self.last = nn.Parameter(torch.linspace(-1, 1, 2 * width).reshape(width, 2))

    def forward(self, x: Tensor) -> Tensor:
        return torch.sin(x * self.first + self.last[:, 0]) @ self.last


@pytest.mark.slow
def test_modules_are_never_restarted() -> None:
    state = torch.get_rng_state()
    options = {"trial": layered(3), "points": 12, "iterations": 70, "stages": 2}
    solution = hamsym.solve(H, [1, 0], (0, 30), method=hamsym.LevenbergMarquardt(**options))
    assert solution.record.restarts == 0
    assert not solution.success
    assert torch.equal(torch.get_rng_state(), state)


def test_least_squares_products_are_those_of_the_jacobian() -> None:
    trial = ModuleTrial(
        layered(5).double(), torch.tensor([0.3, -0.2], dtype=torch.float64), tau=0.7
    )
    trial.network[0].bias.requires_grad_(False)  # weights of the user's choice stay
    t = torch.linspace(0, 2, 5, dtype=torch.float64)

    def rows(z: Tensor, dz: Tensor) -> Tensor:
        return torch.stack((dz[:, 0] - z[:, 1] ** 2, dz[:, 1] + z.prod(1), z.sum(1)), 1)

    names = [f"network.{name}" for name in ("0.weight", "2.weight", "2.bias")]
    weights = tuple(dict(trial.named_parameters())[name].detach().clone() for name in names)

    def flat(*weights: Tensor) -> Tensor:
        given = dict(zip(names, weights, strict=True))
        return rows(*torch.func.functional_call(trial, given, (t,))).T.reshape(-1)

    parts = torch.autograd.functional.jacobian(flat, weights)
    explicit = torch.cat([part.reshape(15, -1) for part in parts], 1)
    objective = squares_of(lambda t, z, dz: rows(z, dz))
    with torch.no_grad():
        rates = ModuleRates(trial, t, *objective.slopes(t, *trial(t)))
    y = torch.randn(15, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(rates.gram(), explicit @ explicit.T)
    found = torch.cat([part.reshape(-1) for part in rates.transposed(y)])
    torch.testing.assert_close(found, explicit.T @ y)


@pytest.mark.slow
def test_frozen_weights_and_eval_mode_are_kept() -> None:
    module = nn.Sequential(nn.Linear(1, 6), nn.Dropout(0.5), nn.Tanh(), nn.Linear(6, 2)).eval()
    module[0].weight.requires_grad_(False)
    for method, options in BRIEF.items():
        solution = hamsym.solve(
            H,
            [1, 0],
            (0, 1),
            method=made_method(method, {"trial": module, "points": 10, "stages": 1, **options}),
        )
        assert torch.equal(solution.trial.network[0].weight, module[0].weight.double())
        assert not torch.equal(solution.trial.network[3].weight, module[3].weight.double())
        assert not solution.trial.network.training


@pytest.mark.slow
def test_copies_are_equal_and_files_are_refused(tmp_path: Path) -> None:
    solution = hamsym.solve(
        H, [1, 0], (0, 1), method=hamsym.Adam(trial=Plain(), epochs=5, points=10)
    )
    t = np.linspace(0, 1, 7)
    for other in (pickle.loads(pickle.dumps(solution)), copy.deepcopy(solution)):
        np.testing.assert_array_equal(other(t), solution(t))
    with pytest.raises(InputError, match=r"holds networks of hamsym only.* with torch\.save"):
        solution.save(tmp_path / "a.hamsym")
    with pytest.raises(CertificationError, match="ModuleTrial, which has no enclosure; solve by"):
        solution.certify()
    torch.save(solution.trial.network.state_dict(), tmp_path / "weights")
    Plain().double().load_state_dict(torch.load(tmp_path / "weights"))
    assert [path.name for path in tmp_path.iterdir()] == ["weights"]


@pytest.mark.slow
def test_initial_weights_are_those_of_the_same_module() -> None:
    options = {"points": 10, "learning_rate": 1e-9}
    first = hamsym.solve(
        H, [1, 0], (0, 1), method=hamsym.Adam(trial=layered(6), epochs=1, **options)
    )
    other = layered(6)
    with torch.no_grad():
        other[0].weight.fill_(0.25)
    second = hamsym.solve(
        H, [1, 0], (0, 1), method=hamsym.Adam(trial=other, initial=first, epochs=1, **options)
    )
    torch.testing.assert_close(
        second.trial.network[0].weight, first.trial.network[0].weight, atol=1e-8, rtol=0
    )
    for given in ({"trial": layered(7)}, {}):
        with pytest.raises(InputError, match="initial has another network than this training"):
            hamsym.solve(
                H, [1, 0], (0, 1), method=hamsym.Adam(initial=first, epochs=1, **given, **options)
            )


# -- refused before a training ---------------------------------------------------------------------


class Wrapped(nn.Module):
    """A module that does something to the values of another."""

    def __init__(self, change: Callable[[Tensor, Tensor], object]) -> None:
        super().__init__()
        self.inner, self.change = layered(3), change

    def forward(self, x: Tensor) -> object:
        return self.change(x, self.inner(x))


class Doubled(torch.autograd.Function):
    """A function without a derivative in forward mode."""

    @staticmethod
    def forward(ctx, x):
        return 2 * x

    @staticmethod
    def backward(ctx, grad):
        return 2 * grad


def failing(x: Tensor, y: Tensor) -> Tensor:
    raise ZeroDivisionError("no such luck")


REFUSED = {
    "a string": ("tanh", "is not a torch.nn.Module; give one that returns shape (K, 2)"),
    "lazy": (nn.LazyLinear(2), "weights without a shape; call it once"),
    "complex": (nn.Linear(1, 2, dtype=torch.complex128), "has complex weights"),
    "no weights": (Sine(), "has no weights to train"),
    "frozen": (layered().requires_grad_(False), "has no weights to train"),
    "one column": (nn.Linear(1, 1), "returns shape (33, 1) for s of shape (33, 1); return (33, 2)"),
    "flat": (Wrapped(lambda x, y: y[:, 0]), "returns shape (33,)"),
    "two inputs": (nn.Linear(2, 2), "cannot be evaluated at s of shape (33, 1)"),
    "raising": (Wrapped(failing), "cannot be evaluated at s of shape (33, 1) and type torch."),
    "a tuple": (Wrapped(lambda x, y: (y, y)), "returns a tuple; return a tensor (K, 2)"),
    "another type": (Wrapped(lambda x, y: y.half()), "returns torch.float16 for s of torch."),
    "infinite": (Wrapped(lambda x, y: y / (x - x[-1])), "values that are not finite for s"),
    "infinite rate": (Wrapped(lambda x, y: y + x.sqrt()), "derivative of trial in s is not fin"),
    "dropout": (nn.Sequential(layered(), nn.Dropout(0.3)), "other values each time it is called"),
    "noise": (Wrapped(lambda x, y: y + 1e-9 * torch.rand_like(y)), "other values each time"),
    "batch": (nn.Sequential(layered(), nn.BatchNorm1d(2)), "depends on the other rows"),
    "mean": (Wrapped(lambda x, y: y - 1e-4 * y.mean(0)), "depends on the other rows"),
    "forward mode": (Wrapped(lambda x, y: Doubled.apply(y)), "no derivative in forward mode"),
    "detached": (Wrapped(lambda x, y: y.detach()), "do not depend on its weights"),
    "half detached": (
        Wrapped(lambda x, y: torch.stack((y[:, 0], y[:, 1].detach()), 1)),
        "in forward mode is not that of its values",
    ),
    "steps": (Wrapped(lambda x, y: y + torch.floor(x / 3)), "in forward mode is not that of its"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unusable_modules_are_refused_in_one_sentence(case: str) -> None:
    module, message = REFUSED[case]
    state = torch.get_rng_state()
    with pytest.raises(InputError) as caught:
        hamsym.solve(H, [1, 0], (0, 1), method=hamsym.LBFGS(trial=module))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hidden": (20,)}, "hidden describes a network of hamsym"),
        ({"activation": "tanh"}, "activation describes a network of hamsym"),
        ({"frequency": 2.0}, "frequency describes a network of hamsym"),
        ({"shared_weights": False}, "shared_weights describes a network of hamsym"),
    ],
)
def test_options_of_other_networks_are_refused(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        hamsym.solve(H, [1, 0], (0, 1), method=hamsym.LBFGS(trial=layered(), **options))


@pytest.mark.slow
def test_modules_beyond_least_squares_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def branching(x: Tensor, y: Tensor) -> Tensor:
        return y if float(x.max()) > -1 else -y

    method = {"points": 10}
    with pytest.raises(InputError, match="cannot be differentiated in batches by torch"):
        hamsym.solve(
            H, [1, 0], (0, 1), method=hamsym.LevenbergMarquardt(trial=Wrapped(branching), **method)
        )
    adam = hamsym.solve(H, [1, 0], (0, 1), method=hamsym.Adam(trial=Wrapped(branching), epochs=2))
    assert adam.record.iterations == 2
    monkeypatch.setattr("hamsym.networks.module_rates._LARGEST", 100)
    with pytest.raises(InputError, match="too many for the least squares of"):
        hamsym.solve(H, [1, 0], (0, 1), method=hamsym.LevenbergMarquardt(trial=layered(), **method))


def test_wrong_rates_are_never_a_success() -> None:
    """Only where the training moves the weights does the derivative go wrong."""

    class Later(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.inner, self.gain = layered(20), nn.Parameter(torch.zeros(1))

        def forward(self, x: Tensor) -> Tensor:
            hidden = torch.sin(3 * x).detach()
            return self.inner(x) + self.gain * hidden

    solution = hamsym.solve(
        H,
        [1, 0],
        (0, 1),
        method=hamsym.LevenbergMarquardt(trial=Later(), points=8, iterations=10, stages=1),
    )
    defect = rate_defect(solution.trial, solution.span)
    assert defect.max() > 1e-6
    assert not solution.success
    assert "is not that of its values" in solution.message


def test_kinks_are_not_mistaken_for_wrong_rates() -> None:
    module = layered(30, activation=nn.ReLU)
    checked_copy(module, 2, 4 * np.pi, torch.float64)
    checked_copy(module, 2, 4 * np.pi, torch.float32)
