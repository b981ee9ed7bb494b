"""Collocation points of the user's choice."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

import hamsym
from hamsym import InputError
from hamsym.networks.points import checked_points, points_within
from hamsym.solving.methods import made_method

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


@pytest.mark.slow_cases("span1-adam", "span0-adam")
@pytest.mark.parametrize("method", ["adam", "lbfgs"])
@pytest.mark.parametrize("span", [(0.0, 3.0), (3.0, 0.0)])
def test_loss_is_trained_at_exactly_the_given_times(method: str, span: tuple[float, float]) -> None:
    seen = Seen()
    solution = hamsym.solve(
        H,
        [1, 0],
        span,
        method=made_method(
            method,
            {
                "points": OWN,
                "hidden": (6,),
                "regularizers": [hamsym.Regularizer(1.0, seen)],
                **(BRIEF[method] | {"stages": 1}),
            },
        ),
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
        method=hamsym.LevenbergMarquardt(
            points=np.array(OWN), hidden=(8,), iterations=30, stages=1, patience=None
        ),
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
        method=hamsym.Adam(
            points=OWN,
            noise=0.2,
            epochs=5,
            hidden=(4,),
            regularizers=[hamsym.Regularizer(1.0, seen)],
        ),
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
        hamsym.solve(H, [1, 0], (0, 1), method=made_method(method, {"points": points}))
    assert message in str(caught.value)
