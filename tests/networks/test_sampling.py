"""Collocation points: those of the user's choice, and those drawn by the residual."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import hamsym
from hamsym import InputError
from hamsym.errors import FileError
from hamsym.networks.network import Network
from hamsym.networks.objective import Objective
from hamsym.networks.options import AdamOptions, LBFGSOptions, LevenbergMarquardtOptions
from hamsym.networks.points import checked_points, points_within
from hamsym.networks.record import TrainingState
from hamsym.networks.sampling import cumulative_density, drawn_points
from hamsym.networks.trial import TrialSolution
from hamsym.support.tensor_files import read_tensors, write_tensors

H = hamsym.Hamiltonian("p**2/2 + x**2/2")
BRIEF = {
    "adam": {"epochs": 60},
    "lbfgs": {"iterations": 12, "stages": 3},
    "levenberg-marquardt": {"iterations": 8, "stages": 3},
}
OWN = [0.1, 0.3, 0.35, 1.2, 2.9]


class Seen(list):
    """A regularizer's record of the times at which a loss is evaluated."""

    def __call__(self, t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        self.append(t.detach().clone())
        return 0 * z[:, 0]


@pytest.mark.parametrize("method", ["adam", "lbfgs"])
@pytest.mark.parametrize("span", [(0.0, 3.0), (3.0, 0.0)])
def test_loss_is_trained_at_exactly_the_given_times(method: str, span: tuple[float, float]) -> None:
    seen = Seen()
    solution = hamsym.solve(
        H,
        [1, 0],
        span,
        method=method,
        points=OWN,
        hidden=(6,),
        regularizers=[hamsym.Regularizer(1.0, seen)],
        **BRIEF[method] | {"stages": 1},
    )
    assert solution.points == len(OWN)
    trained = [t for t in seen if len(t) == len(OWN)]
    assert trained
    assert all(sorted(t.tolist()) == OWN for t in trained)
    # The others are the judging points, which are apart and cover the span.
    judging = [t for t in seen if len(t) != len(OWN)]
    assert all(len(t) >= 400 and not {*t.tolist()} & {*OWN} for t in judging)


def test_least_squares_fit_the_given_times() -> None:
    """With more weights than rows the residual vanishes where it is trained, and nowhere else."""
    solution = hamsym.solve(
        H,
        [1, 0],
        (0, 3),
        method="levenberg-marquardt",
        points=np.array(OWN),
        hidden=(8,),
        iterations=30,
        stages=1,
        patience=None,
    )
    assert solution.record.history.loss[-1] < 1e-10
    found = float(np.mean(np.sum(solution.residual(np.linspace(0, 3, 301)) ** 2, axis=1)))
    assert found > 1e-6
    assert not solution.success


def test_noise_of_given_times_is_asked_for() -> None:
    seen = Seen()
    hamsym.solve(
        H,
        [1, 0],
        (0, 3),
        method="adam",
        points=OWN,
        noise=0.2,
        epochs=5,
        hidden=(4,),
        regularizers=[hamsym.Regularizer(1.0, seen)],
    )
    trained = [t for t in seen if len(t) == len(OWN)]
    assert len({tuple(t.tolist()) for t in trained}) == 5
    assert all(t.min() >= 0 and t.max() <= 3 for t in trained)


def test_stages_take_the_given_times_within_them() -> None:
    times = checked_points(OWN, (0.0, 3.0))
    assert points_within(times, (0.0, 1.0), torch.float64).tolist() == OWN[:3]
    assert points_within(times, (0.0, 0.2), torch.float64).tolist() == OWN[:2]
    backwards = checked_points(OWN, (3.0, 0.0))
    assert points_within(backwards, (3.0, 1.0), torch.float64).tolist() == [2.9, 1.2]
    assert points_within(backwards, (3.0, 0.0), torch.float64).tolist() == OWN[::-1]


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([0.5], "points has shape (1,); give at least two times"),
        ([[0.5, 0.6]], "points has shape (1, 2)"),
        ([0.5, 0.5], "do not increase; sort them"),
        ([0.6, 0.5], "do not increase; sort them"),
        ([0.5, float("nan")], "do not increase; sort them"),
        ([0.5, "a"], "an entry that is not a number"),
        ([-0.5, 0.5], "points has times from -0.5 to 0.5, outside the span from 0 to 1"),
        ([0.5, float("inf")], "outside the span"),
        (np.array([0.5, 1.5]), "outside the span"),
        (1, "points=1 cannot be used; give a whole number from 2"),
        (2.5, "points=2.5 cannot be used"),
        ("many", "points='many' cannot be used"),
        (True, "points=True cannot be used"),
        (None, "points=None cannot be used"),
    ],
)
@pytest.mark.parametrize("method", BRIEF)
def test_unusable_points_are_refused(method: str, points: object, message: str) -> None:
    with pytest.raises(InputError) as caught:
        hamsym.solve(H, [1, 0], (0, 1), method=method, points=points)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sampling": "dense"}, "sampling='dense' cannot be used; give 'uniform' or 'residual'"),
        ({"sampling": "residual", "points": OWN}, "points are times of your own; leave out one"),
    ],
)
@pytest.mark.parametrize("method", BRIEF)
def test_unusable_samplings_are_refused(method: str, options: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        hamsym.solve(H, [1, 0], (0, 3), method=method, **options)
    assert message in str(caught.value)


# -- by the residual -------------------------------------------------------------------------------


def drawn(residual, count: int = 400) -> np.ndarray:
    trial = TrialSolution(Network(1, (3,)), torch.ones(1, dtype=torch.float64))
    objective = Objective(lambda t, z, dz: residual(t).unsqueeze(-1))
    density = cumulative_density(trial, objective, lambda u: u, count)
    return drawn_points(density, count, torch.Generator().manual_seed(0)).numpy()


def test_half_of_the_points_are_where_the_residual_is() -> None:
    peak = drawn(lambda t: (t > 0.9).double())
    # The density is 1 + 10 in the last tenth, and 1 elsewhere.
    assert np.mean(peak > 0.9) == pytest.approx(0.55, abs=0.01)
    assert np.all(np.diff(peak) >= 0)
    assert (peak[0], peak[-1]) == (0.0, 1.0)
    ramp = drawn(lambda t: t)
    expected = (ramp + ramp**2) / 2  # of the density (1 + 2 u) / 2
    np.testing.assert_allclose(expected, (np.arange(400) + 0.5) / 400, atol=2e-3)


@pytest.mark.parametrize("value", [0.0, float("nan"), float("inf")])
def test_points_are_uniform_without_a_usable_residual(value: float) -> None:
    points = drawn(lambda t: torch.full_like(t, value))
    np.testing.assert_allclose(points, (np.arange(400) + 0.5) / 400, atol=2e-3)


@pytest.mark.slow_cases("adam", "lbfgs")
@pytest.mark.parametrize("method", BRIEF)
def test_training_draws_points_by_the_residual(method: str) -> None:
    options = {"method": method, "hidden": (8,), "points": 20, **BRIEF[method]}
    runs = [
        hamsym.solve(H, [1, 0], (0, 3), sampling=sampling, seed=seed, **options)
        for sampling, seed in (("residual", 1), ("residual", 1), ("residual", 2), ("uniform", 1))
    ]
    ends = [run.trial.network.theta for run in runs]
    assert torch.equal(ends[0], ends[1])
    assert not torch.equal(ends[0], ends[2])
    assert not torch.equal(ends[0], ends[3])
    assert runs[0].record.best_loss < runs[0].history.loss[0]


class KilledError(Exception):
    pass


def killed(state: TrainingState) -> None:
    if state.iteration >= 10:
        raise KilledError


@pytest.mark.slow_cases("adam", "lbfgs")
@pytest.mark.parametrize("method", BRIEF)
def test_sampling_resumes_to_the_same_bits(method: str, tmp_path: Path) -> None:
    options = {"method": method, "hidden": (5,), "points": 10, "sampling": "residual"}
    options |= {"epochs": 70} if method == "adam" else {"iterations": 25, "stages": 2}
    whole = hamsym.solve(H, [1, 0], (0, 3), **options)
    options |= {"checkpoint": tmp_path / "run", "checkpoint_every": 1e-9}
    with pytest.raises(KilledError):
        hamsym.solve(H, [1, 0], (0, 3), progress=killed, **options)
    parts = hamsym.solve(H, [1, 0], (0, 3), **options)
    assert torch.equal(whole.trial.network.theta, parts.trial.network.theta)
    with pytest.raises(FileError, match="training with sampling='residual', not 'uniform'"):
        hamsym.solve(H, [1, 0], (0, 3), **options | {"sampling": "uniform"})


@pytest.mark.parametrize(
    "change",
    [
        lambda t, v: t.update({"optimizer.density": t["optimizer.density"][::-1].copy()}),
        lambda t, v: t.update({"optimizer.density": t["optimizer.density"] * np.nan}),
        lambda t, v: t.update({"optimizer.density": t["optimizer.density"][:0].copy()}),
        lambda t, v: v["optimizer"].update(age="1"),
        lambda t, v: v["optimizer"].pop("share"),
        lambda t, v: v["optimizer"].update(more=1),
    ],
)
def test_edited_densities_are_rejected(change, tmp_path: Path) -> None:
    options = {"method": "adam", "hidden": (5,), "points": 10, "sampling": "residual"}
    options |= {"epochs": 5, "checkpoint": tmp_path / "run"}
    hamsym.solve(H, [1, 0], (0, 3), **options)
    tensors, values = read_tensors(tmp_path / "run", "checkpoint")
    change(tensors, values)
    write_tensors(tmp_path / "run", "checkpoint", tensors, values)
    with pytest.raises(FileError, match="is not a valid checkpoint"):
        hamsym.solve(H, [1, 0], (0, 3), **options)


def test_given_times_resume_to_the_same_bits(tmp_path: Path) -> None:
    options = {"method": "levenberg-marquardt", "hidden": (5,), "points": OWN}
    whole = hamsym.solve(H, [1, 0], (0, 3), iterations=20, **options)
    for iterations in (7, 20):
        parts = hamsym.solve(
            H, [1, 0], (0, 3), iterations=iterations, checkpoint=tmp_path / "run", **options
        )
    assert torch.equal(whole.trial.network.theta, parts.trial.network.theta)
    with pytest.raises(FileError, match="belongs to a training with points="):
        hamsym.solve(
            H, [1, 0], (0, 3), checkpoint=tmp_path / "run", **options | {"points": OWN[1:]}
        )


def test_options_have_the_same_defaults_everywhere() -> None:
    for options in (AdamOptions(), LBFGSOptions(), LevenbergMarquardtOptions()):
        assert (options.points, options.sampling) == (200, "uniform")
