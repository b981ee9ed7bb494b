"""The trainer works on any residual, and is honest about how it ended."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from hamsym import InputError
from hamsym.training import AdamOptions, Objective, Regularizer, TrainingState, train_adam
from hamsym.trial import Network, TrialSolution


def decay_trial(seed: int = 0) -> tuple[TrialSolution, torch.Generator]:
    generator = torch.Generator().manual_seed(seed)
    network = Network(1, (10,), "tanh", generator=generator)
    return TrialSolution(network, torch.ones(1, dtype=torch.float64)), generator


# z' = -z, which is no Hamiltonian system.
DECAY = Objective(residual=lambda t, z, dz: dz + z)


def test_solves_an_equation_that_is_not_hamiltonian() -> None:
    trial, generator = decay_trial()
    options = AdamOptions(epochs=3000, points=20, learning_rate=0.01)
    training = train_adam(trial, DECAY, (0, 2), options, generator=generator)
    t = torch.linspace(0, 2, 101, dtype=torch.float64)
    with torch.no_grad():
        error = (trial(t)[0][:, 0] - torch.exp(-t)).abs().max()
    assert error < 0.01
    assert training.stopped == "epochs"
    assert training.best_loss < 1e-4


def test_best_weights_are_kept_by_the_loss_at_fixed_points() -> None:
    trial, generator = decay_trial()

    def spoil(state: TrainingState) -> None:
        if state.epoch >= 250:
            with torch.no_grad():
                next(trial.parameters()).add_(1.0)

    training = train_adam(
        trial,
        DECAY,
        (0, 2),
        AdamOptions(epochs=300, points=10, learning_rate=0.05),
        generator=generator,
        callbacks=[spoil],
    )
    fixed = (torch.arange(20, dtype=torch.float64) + 0.5) * 0.1
    with torch.no_grad():
        assert float(DECAY(fixed, *trial(fixed))) == training.best_loss
    assert training.best_loss == training.history.fixed_loss.min()
    assert np.argmin(training.history.fixed_loss) < len(training.history.fixed_loss) - 1


def test_stops_at_the_target() -> None:
    trial, generator = decay_trial()
    options = AdamOptions(epochs=5000, points=20, learning_rate=0.01, target_loss=1e-3)
    training = train_adam(trial, DECAY, (0, 2), options, generator=generator)
    assert training.reached_target
    assert training.stopped == "target"
    assert training.epochs < 5000
    assert training.best_loss <= 1e-3


def test_noise_stays_inside_the_interval_and_moves_the_points() -> None:
    seen = []

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        seen.append(t.clone())
        return dz + z

    for span in ((1.0, 3.0), (3.0, 1.0)):
        trial, generator = decay_trial()
        options = AdamOptions(epochs=10, points=50, noise=5.0)
        train_adam(trial, Objective(residual), span, options, generator=generator)
    times = torch.cat(seen)
    assert times.min() >= 1.0
    assert times.max() <= 3.0
    noisy = [t for t in seen if len(t) == 50]
    assert not torch.equal(noisy[0], noisy[1])
    # Reflection leaves wide noise uniform over the interval.
    assert torch.cat(noisy).mean() == pytest.approx(2.0, abs=0.1)


def test_without_noise_the_points_stay() -> None:
    seen = []

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        seen.append(t)
        return dz + z

    trial, generator = decay_trial()
    options = AdamOptions(epochs=3, points=5, noise=0.0)
    train_adam(trial, Objective(residual), (0, 1), options, generator=generator)
    grid = torch.linspace(0, 1, 5, dtype=torch.float64)
    assert sum(torch.equal(t, grid) for t in seen if len(t) == 5) == 3


def test_loss_is_the_weighted_sum_of_its_terms() -> None:
    t = torch.linspace(0, 1, 4, dtype=torch.float64)
    z, dz = t.reshape(2, 2), t.reshape(2, 2) ** 2
    terms = (
        Regularizer(2.0, lambda t, z, dz: z[:, 0] ** 2),
        Regularizer(0.5, lambda t, z, dz: dz.abs().sum(-1)),
    )
    objective = Objective(lambda t, z, dz: dz - z, regularizers=terms)
    expected = ((dz - z) ** 2).sum(-1).mean() + 2 * (z[:, 0] ** 2).mean() + 0.5 * dz.sum(-1).mean()
    torch.testing.assert_close(objective(t, z, dz), expected)
    replaced = Objective(lambda t, z, dz: dz - z, loss=lambda t, z, dz: z.sum())
    torch.testing.assert_close(replaced(t, z, dz), z.sum())


def test_diverging_loss_is_reported_and_the_best_weights_restored() -> None:
    calls = 0

    def residual(t: torch.Tensor, z: torch.Tensor, dz: torch.Tensor) -> torch.Tensor:
        nonlocal calls
        calls += 1
        return (dz + z) * (math.nan if calls > 100 else 1.0)

    trial, generator = decay_trial()
    options = AdamOptions(epochs=1000, points=10)
    training = train_adam(trial, Objective(residual), (0, 1), options, generator=generator)
    assert training.stopped == "diverged"
    assert math.isfinite(training.best_loss)
    assert all(torch.isfinite(weight).all() for weight in trial.parameters())


def test_interruption_returns_what_was_done() -> None:
    def interrupt(state: TrainingState) -> None:
        if state.epoch >= 50:
            raise KeyboardInterrupt

    trial, generator = decay_trial()
    training = train_adam(
        trial,
        DECAY,
        (0, 1),
        AdamOptions(epochs=1000, points=10),
        generator=generator,
        callbacks=[interrupt],
    )
    assert training.stopped == "interrupted"
    assert 50 <= training.epochs < 1000
    assert math.isfinite(training.best_loss)


def test_callbacks_and_history_tell_the_same() -> None:
    states: list[TrainingState] = []
    trial, generator = decay_trial()
    options = AdamOptions(epochs=200, points=10)
    training = train_adam(
        trial, DECAY, (0, 1), options, generator=generator, callbacks=[states.append]
    )
    history = training.history
    assert len(history.loss) == training.epochs == 200
    assert [s.epoch for s in states] == history.epoch.tolist()
    assert [s.loss for s in states] == history.fixed_loss.tolist()
    assert [s.ell_max for s in states] == history.ell_max.tolist()
    assert np.all(np.diff(history.seconds) >= 0)
    assert states[-1].best_loss == training.best_loss


def test_same_seed_same_weights_and_global_state_untouched() -> None:
    threads, before = torch.get_num_threads(), torch.get_rng_state()
    weights = []
    for _ in range(2):
        trial, generator = decay_trial(seed=5)
        train_adam(trial, DECAY, (0, 1), AdamOptions(epochs=50, points=10), generator=generator)
        weights.append([weight.detach().clone() for weight in trial.parameters()])
    assert all(torch.equal(a, b) for a, b in zip(*weights, strict=True))
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_default_dtype() == torch.float32


def test_cosine_schedule_comes_to_rest() -> None:
    moved = {}
    for schedule in ("constant", "cosine"):
        trial, generator = decay_trial()
        snapshots: list[torch.Tensor] = []

        def snapshot(state: TrainingState, trial=trial, snapshots=snapshots) -> None:
            snapshots.append(torch.cat([w.detach().flatten() for w in trial.parameters()]))

        options = AdamOptions(epochs=600, points=20, learning_rate=0.05, schedule=schedule)
        train_adam(trial, DECAY, (0, 2), options, generator=generator, callbacks=[snapshot])
        moved[schedule] = (snapshots[-1] - snapshots[-2]).norm()
    assert moved["cosine"] < 0.1 * moved["constant"]


@pytest.mark.parametrize(
    "settings",
    [
        {"epochs": 0},
        {"epochs": 1.5},
        {"points": 1},
        {"learning_rate": 0.0},
        {"learning_rate": math.nan},
        {"noise": -1.0},
        {"target_loss": 0.0},
        {"betas": (0.9, 1.0)},
        {"schedule": "linear"},
    ],
)
def test_unusable_settings(settings: dict[str, object]) -> None:
    (name,) = settings
    with pytest.raises(InputError, match=f"{name}=.* cannot be used; give"):
        AdamOptions(**settings)  # type: ignore[arg-type]
