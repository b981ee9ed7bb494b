"""Training of any residual function: rules for stopping and restarts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import hamsym
from hamsym import InputError
from hamsym.networks.levenberg_marquardt import LevenbergMarquardt, _Linearised
from hamsym.networks.network import ComponentNetworks, Network
from hamsym.networks.objective import Objective, Regularizer
from hamsym.networks.optimizers import LBFGS, Adam, Optimizer
from hamsym.networks.record import Training, TrainingState
from hamsym.networks.rules import Course, Stages, limit_reached
from hamsym.networks.self_scaled_broyden import SelfScaledBroyden
from hamsym.networks.training import train
from hamsym.networks.trial import TrialSolution
from tests.networks.objectives import squares_of


def decay_trial(seed: int = 0) -> tuple[TrialSolution, torch.Generator]:
    generator = torch.Generator().manual_seed(seed)
    network = Network(1, (10,), "tanh", generator=generator)
    return TrialSolution(network, torch.ones(1, dtype=torch.float64)), generator


# z' = -z, which is not a Hamiltonian system.
DECAY = squares_of(lambda t, z, dz: dz + z)
WHOLE = Stages()


def adam(**options: object) -> Adam:
    return Adam(hamsym.Adam(**options))


def trained(
    objective: Objective, span: tuple[float, float], optimizer: Optimizer, **others: object
) -> Training:
    trial, generator = decay_trial()
    return train(
        trial, objective, span, optimizer, generator=generator, **{"stages": WHOLE, **others}
    )


def test_best_weights_at_fixed_points_are_kept() -> None:
    trial, generator = decay_trial()

    def spoil(state: TrainingState) -> None:
        if state.iteration >= 250:
            with torch.no_grad():
                next(trial.parameters()).add_(1.0)

    training = train(
        trial,
        DECAY,
        (0, 2),
        adam(points=10, learning_rate=0.05, epochs=300),
        generator=generator,
        stages=WHOLE,
        tell=spoil,
    )
    fixed = (torch.arange(20, dtype=torch.float64) + 0.5) * 0.1
    with torch.no_grad():
        assert float(DECAY(fixed, *trial(fixed))) == pytest.approx(training.best_loss, rel=1e-12)
    assert training.best_loss == training.history.fixed_loss.min()
    assert np.argmin(training.history.fixed_loss) < len(training.history.fixed_loss) - 1


@pytest.mark.slow
def test_training_stops_at_the_target() -> None:
    optimizer = adam(points=20, learning_rate=0.01, epochs=5000, target_loss=1e-3)
    training = trained(DECAY, (0, 2), optimizer)
    assert training.stopped == "target loss"
    assert training.iterations < 5000
    assert training.best_loss <= 1e-3


def test_noisy_points_stay_inside_the_interval() -> None:
    seen = []

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        seen.append(t.clone())
        return dz + z

    for span in ((1.0, 3.0), (3.0, 1.0)):
        trained(squares_of(residual), span, adam(points=50, noise=5.0, epochs=10))
    times = torch.cat(seen)
    assert times.min() >= 1.0
    assert times.max() <= 3.0
    noisy = [t for t in seen if len(t) == 50]
    assert not torch.equal(noisy[0], noisy[1])
    # Reflection leaves wide noise uniform over the interval.
    assert torch.cat(noisy).mean() == pytest.approx(2.0, abs=0.1)


def test_points_without_noise_stay() -> None:
    seen = []

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        seen.append(t)
        return dz + z

    trained(squares_of(residual), (0, 1), adam(points=5, noise=0.0, epochs=3))
    grid = torch.linspace(0, 1, 5, dtype=torch.float64)
    assert sum(torch.equal(t, grid) for t in seen if len(t) == 5) == 3


def test_loss_is_the_weighted_sum_of_its_terms() -> None:
    t = torch.linspace(0, 1, 4, dtype=torch.float64)
    z, dz = t.reshape(2, 2), t.reshape(2, 2) ** 2
    terms = (
        Regularizer(2.0, lambda t, z, dz: z[:, 0] ** 2),
        Regularizer(0.5, lambda t, z, dz: dz.abs().sum(-1)),
    )
    objective = squares_of(lambda t, z, dz: dz - z, regularizers=terms)
    expected = ((dz - z) ** 2).sum(-1).mean() + 2 * (z[:, 0] ** 2).mean() + 0.5 * dz.sum(-1).mean()
    torch.testing.assert_close(objective(t, z, dz), expected)


@pytest.mark.parametrize(
    ("weight", "function", "name"),
    [
        (-1.0, abs, "weight"),
        (math.nan, abs, "weight"),
        (math.inf, abs, "weight"),
        ("1", abs, "weight"),
        (1.0, 3, "function"),
    ],
)
def test_unusable_regularizers_are_rejected(weight: object, function: object, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}=.* cannot be used; (give|choose)"):
        Regularizer(weight, function)


def test_divergence_restores_the_best_weights() -> None:
    calls = 0

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        nonlocal calls
        calls += 1
        return (dz + z) * (math.nan if calls > 100 else 1.0)

    trial, generator = decay_trial()
    training = train(
        trial,
        squares_of(residual),
        (0, 1),
        adam(points=10, epochs=1000),
        generator=generator,
        stages=WHOLE,
    )
    assert training.stopped == "diverged"
    assert math.isfinite(training.best_loss)
    assert all(torch.isfinite(weight).all() for weight in trial.parameters())


def test_interruption_returns_the_best_so_far() -> None:
    def interrupt(state: TrainingState) -> None:
        if state.iteration >= 50:
            raise KeyboardInterrupt

    training = trained(DECAY, (0, 1), adam(points=10, epochs=1000), tell=interrupt)
    assert training.stopped == "interrupted"
    assert 50 <= training.iterations < 1000
    assert math.isfinite(training.best_loss)


def test_callbacks_agree_with_history() -> None:
    states: list[TrainingState] = []
    training = trained(DECAY, (0, 1), adam(points=10, epochs=200), tell=states.append)
    history = training.history
    assert len(history.loss) == training.iterations == 200
    assert [s.iteration for s in states] == history.iteration.tolist()
    assert [s.loss for s in states] == history.fixed_loss.tolist()
    assert [s.ell_max for s in states] == history.ell_max.tolist()
    assert np.all(np.diff(history.seconds) >= 0)
    assert states[-1].best_loss == training.best_loss


def test_training_is_reproducible_and_leaves_torch_state() -> None:
    threads, before = torch.get_num_threads(), torch.get_rng_state()
    weights = []
    for _ in range(2):
        trial, generator = decay_trial(seed=5)
        optimizer = adam(points=10, epochs=50)
        train(trial, DECAY, (0, 1), optimizer, generator=generator, stages=WHOLE)
        weights.append([weight.detach().clone() for weight in trial.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*weights, strict=True))
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_default_dtype() == torch.float32


@pytest.mark.slow
def test_cosine_schedule_ends_at_rate_zero() -> None:
    moved = {}
    for schedule in ("constant", "cosine"):
        trial, generator = decay_trial()
        snapshots: list[torch.Tensor] = []

        def snapshot(state: TrainingState, trial=trial, snapshots=snapshots) -> None:
            snapshots.append(torch.cat([w.detach().flatten() for w in trial.parameters()]))

        options = {"learning_rate": 0.05, "schedule": schedule, "epochs": 400}
        train(
            trial,
            DECAY,
            (0, 2),
            adam(points=20, **options),
            generator=generator,
            stages=WHOLE,
            tell=snapshot,
        )
        moved[schedule] = (snapshots[-1] - snapshots[-2]).norm()
    assert moved["cosine"] < 0.1 * moved["constant"]


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (hamsym.LBFGS, {"iterations": 0}),
        (hamsym.LBFGS, {"iterations": 1.5}),
        (hamsym.Adam, {"target_loss": 0.0}),
        (hamsym.Adam, {"target_ell_max": math.nan}),
        (hamsym.Adam, {"patience": 0}),
        (hamsym.Adam, {"time_limit": -1.0}),
        (hamsym.Adam, {"stages": 0}),
        (hamsym.LevenbergMarquardt, {"restarts": -1}),
        (hamsym.Adam, {"learning_rate": 0.0}),
        (hamsym.Adam, {"learning_rate": math.nan}),
        (hamsym.Adam, {"noise": -1.0}),
        (hamsym.Adam, {"betas": (0.9, 1.0)}),
        (hamsym.Adam, {"schedule": "linear"}),
        (hamsym.LBFGS, {"points": 1}),
        (hamsym.LevenbergMarquardt, {"points": True}),
    ],
)
def test_unusable_settings_are_rejected(kind: type, settings: dict[str, object]) -> None:
    (name,) = settings
    with pytest.raises(InputError, match=f"{name}=.* cannot be used; (give|choose)"):
        kind(**settings)


# -- the same trainer for every optimizer ---------------------------------------------------------


class BriefLBFGS(LBFGS):
    memory, refresh = 5, 15


class BriefBroyden(SelfScaledBroyden):
    refresh = 15


OPTIMIZERS = {
    "adam": (Adam, hamsym.Adam, {"learning_rate": 0.01, "noise": 0.02}),
    "lbfgs": (BriefLBFGS, hamsym.LBFGS, {}),
    "ssbroyden": (BriefBroyden, hamsym.SSBroyden, {}),
    "levenberg-marquardt": (LevenbergMarquardt, hamsym.LevenbergMarquardt, {"patience": None}),
}


@pytest.fixture(params=OPTIMIZERS)
def optimizer(request: pytest.FixtureRequest):
    own, method, options = OPTIMIZERS[request.param]

    def made(count: int, **rules: object) -> Optimizer:
        unit = "epochs" if own is Adam else "iterations"
        return own(method(**{unit: count, "points": 20, **options, **rules}))

    return made


@pytest.mark.slow_cases("adam", "lbfgs", "ssbroyden")
def test_each_optimizer_solves_another_equation(optimizer) -> None:
    trial, generator = decay_trial()
    made = optimizer(1000)
    if isinstance(made, LevenbergMarquardt):
        made = optimizer(150)
    training = train(trial, DECAY, (0, 2), made, generator=generator, stages=WHOLE)
    t = torch.linspace(0, 2, 101, dtype=torch.float64)
    with torch.no_grad():
        error = (trial(t)[0][:, 0] - torch.exp(-t)).abs().max()
    largest = {Adam: 0.02, BriefLBFGS: 1e-4, BriefBroyden: 1e-6, LevenbergMarquardt: 1e-7}
    assert error < largest[type(made)]
    assert math.isfinite(training.best_loss)


@pytest.mark.parametrize(
    ("rule", "name"),
    [
        ({"target_loss": 1e-2}, "target loss"),
        ({"target_ell_max": 0.3}, "target ell_max"),
        ({"time_limit": 1e-9}, "time limit"),
        ({"criteria": {"enough": lambda training: True}}, "enough"),
        ({}, "iterations"),
    ],
)
def test_each_optimizer_stops_by_each_rule(optimizer, rule: dict, name: str) -> None:
    count = 60 if name == "iterations" else 2_000
    if "criteria" in rule:
        training = trained(DECAY, (0, 2), optimizer(count), **rule)
    else:
        training = trained(DECAY, (0, 2), optimizer(count, **rule))
    assert training.stopped in (name, "stalled")  # less than 60 steps may solve so small a problem
    if name != "iterations":
        assert training.stopped == name
        assert training.iterations < 2_000
    assert training.best_loss <= rule.get("target_loss", math.inf)
    assert training.best_ell_max <= rule.get("target_ell_max", math.inf)


def test_patience_ends_training() -> None:
    constant = squares_of(lambda t, z, dz: 0 * dz + 1)
    training = trained(constant, (0, 1), adam(points=5, epochs=5_000, patience=120))
    assert training.stopped == "patience"
    assert 120 <= training.iterations < 300


def test_patience_begins_with_a_stage() -> None:
    method = hamsym.Adam(patience=50)
    course = Course(WHOLE, (0, 1), 1_000, iteration=100, improved=10, in_stage=49)
    assert limit_reached(method, course) is None
    course.in_stage = 50
    assert limit_reached(method, course) == "patience"


@pytest.mark.slow_cases("levenberg-marquardt", "ssbroyden", "lbfgs")
def test_sequential_training_grows_the_span(optimizer) -> None:
    seen: list[float] = []

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        if len(t) <= 20:
            seen.append(float(t.max()))
        return dz + z

    made = optimizer(300)
    stages = Stages(4, residual=1e-9 if isinstance(made, Adam) else 0.03)
    trained(squares_of(residual), (0.0, 2.0), made, stages=stages)
    steps = sorted({round(2 * time) for time in seen})
    assert steps == [1, 2, 3, 4]
    assert seen == sorted(seen, key=lambda time: round(2 * time))  # never back


class Stubborn(Adam):
    """Adam whose loss stays at 1 until its weights have been replaced twice."""

    check_every = 5

    def bind(self, trial, objective, generator) -> None:
        self.resets = -1
        super().bind(trial, objective, generator)

    def reset(self) -> None:
        self.resets += 1
        super().reset()

    def iterate(self, span, share, done):
        loss, motion = super().iterate(span, share, done)
        return (loss if self.resets == 2 else 1.0), max(motion, 1e-3)


@pytest.mark.parametrize("stages", [1, 3])
def test_restarts_draw_new_weights(stages: int) -> None:
    trial, generator = decay_trial()
    first = trial.network.theta.detach().clone()
    training = train(
        trial,
        squares_of(lambda t, z, dz: dz + z, loss=lambda t, z, dz: (dz + z).square().mean() + 1),
        (0, 1),
        Stubborn(hamsym.Adam(points=5, epochs=200)),
        stages=Stages(stages, restart_after=20, restarts=3),
        generator=generator,
    )
    assert training.restarts == 3
    assert training.stopped == "stalled"
    assert not torch.equal(first, trial.network.theta)


# -- Levenberg-Marquardt --------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("hidden", [(7,), (6, 5), (4, 5, 6)])
def test_products_with_the_jacobian(hidden: tuple[int, ...], shared: bool) -> None:
    generator = torch.Generator().manual_seed(1)
    if shared:
        network = Network(2, hidden, "tanh", frequency=2.0, generator=generator)
        networks = [network]
    else:
        networks = [Network(1, hidden, "sin", generator=generator) for _ in range(2)]
        network = ComponentNetworks(networks)
    trial = TrialSolution(network, torch.tensor([0.3, -0.2], dtype=torch.float64), tau=0.7)
    t = torch.linspace(0, 2, 5, dtype=torch.float64)

    def rows(z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        return torch.stack((dz[:, 0] - z[:, 1] ** 2, dz[:, 1] + z.prod(1), z.sum(1)), 1)

    names = [name for name, _ in trial.named_parameters()]

    def flat(*weights: torch.Tensor) -> torch.Tensor:
        out = torch.func.functional_call(trial, dict(zip(names, weights, strict=True)), (t,))
        return rows(*out).T.reshape(-1)

    with torch.no_grad():  # the forward pass that automatic differentiation can follow
        weights = tuple(n.theta.detach().clone() for n in networks)
    explicit = torch.cat(torch.func.jacfwd(flat, tuple(range(len(weights))))(*weights), 1)
    objective = squares_of(lambda t, z, dz: rows(z, dz))
    with torch.no_grad():
        z, dz = trial(t)
        linearised = _Linearised(trial, t, *objective.slopes(t, z, dz))
        gram = linearised.gram().tril()
        y = torch.randn(15, dtype=torch.float64, generator=generator)
        transposed = torch.cat(linearised.transposed(y))
    torch.testing.assert_close(gram, (explicit @ explicit.T).tril())
    torch.testing.assert_close(transposed, explicit.T @ y)


def test_least_squares_needs_squares_and_networks() -> None:
    trial, generator = decay_trial()
    optimizer = LevenbergMarquardt(hamsym.LevenbergMarquardt())
    penalised = squares_of(
        DECAY.residual, regularizers=(Regularizer(1.0, lambda t, z, dz: z[:, 0]),)
    )
    with pytest.raises(InputError, match="regularizers have no least-squares form"):
        optimizer.bind(trial, penalised, generator)
    with pytest.raises(InputError, match="is not a TrialSolution"):
        optimizer.bind(torch.nn.Linear(1, 1), DECAY, generator)
