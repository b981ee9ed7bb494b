"""Methods that train a deep network: accuracy, rules for stopping."""

from __future__ import annotations

import math
import re
from dataclasses import fields

import numpy as np
import pytest
import torch

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.networks.method import _objective, _Penalty
from hamsym.networks.methods import JointTraining
from hamsym.networks.network import ACTIVATIONS
from hamsym.networks.record import Stopped
from hamsym.networks.trial import ENVELOPES
from hamsym.solving.methods import made_method
from hamsym.systems import CATALOGUE, Problem

SMALL = {"hidden": (12, 12), "points": 40}


def accurate(name: str) -> tuple[Problem, np.ndarray, np.ndarray]:
    """A problem with times and a solution a hundred times more accurate than the one judged."""
    problem = CATALOGUE[name]()
    t = np.linspace(*problem.span, 4_001)
    return problem, t, hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-11, seed=5)(t)


@pytest.mark.slow
def test_least_squares_on_the_papers_oscillator() -> None:
    problem, t, truth = accurate("nonlinear_oscillator")
    method = hamsym.LevenbergMarquardt()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, method=method, tol=2e-7)
    assert solution.success, solution.message
    assert np.abs(solution(t) - truth).max() <= 1e-6
    np.testing.assert_allclose(
        solution.error_estimate(t),
        truth - solution(t),
        atol=0.02 * np.abs(truth - solution(t)).max(),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nonlinear_oscillator", "henon_heiles"])
def test_least_squares_from_every_seed(name: str) -> None:
    problem, t, truth = accurate(name)
    errors = []
    for seed in range(10):
        solution = hamsym.solve(
            problem.H, problem.z0, problem.span, method="network-chain", seed=seed
        )
        errors.append(np.abs(solution(t) - truth).max())
    assert max(errors) <= 1e-6
    assert sorted(errors)[7] <= 1e-7  # eight of ten


@pytest.mark.slow
def test_least_squares_independent_of_time_unit() -> None:
    settings = {"iterations": 60, **SMALL}
    slow = Hamiltonian("(p**2/2 + x**2/2 + x**4/4)/1000")
    fast = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    t = np.linspace(0, 2, 21)
    one = hamsym.solve(fast, [1.3, 1.0], (0, 2), method=hamsym.LevenbergMarquardt(**settings))
    other = hamsym.solve(
        slow, [1.3, 1.0], (5.0, 2005.0), method=hamsym.LevenbergMarquardt(**settings)
    )
    np.testing.assert_allclose(other(5 + 1000 * t), one(t), atol=1e-4)


DRIVEN = "p1**2/2 + p2**2/3 + x1**4/4 + x1**2*x2 - x2*sin(3*t)"


@pytest.mark.parametrize(("formula", "energy_weight"), [(None, 0.0), (None, 0.7), (DRIVEN, 0.0)])
def test_slopes_are_those_of_the_rows(formula: str | None, energy_weight: float) -> None:
    H = Hamiltonian(formula) if formula else hamsym.systems.henon_heiles().H
    objective = _objective(H, [_Penalty(H.compile("torch"), 0.1, energy_weight)], ())
    generator = torch.Generator().manual_seed(0)
    t, z, dz = (
        torch.randn(5, *n, generator=generator, dtype=torch.float64) for n in ((), (4,), (4,))
    )
    rows = objective.rows(t, z, dz)
    assert float(rows.square().sum(-1).mean()) == pytest.approx(float(objective(t, z, dz)))
    found = objective.slopes(t, z, dz)
    for argument, slopes in enumerate(found):

        def of(one: torch.Tensor, k: int, argument=argument) -> torch.Tensor:
            parts = [z[k : k + 1], dz[k : k + 1]]
            parts[argument] = one.unsqueeze(0)
            return objective.rows(t[k : k + 1], *parts)[0]

        for k in range(5):
            expected = torch.func.jacrev(lambda one, k=k: of(one, k))((z, dz)[argument][k])
            torch.testing.assert_close(slopes[k], expected)


@pytest.mark.slow
def test_time_dependent_and_penalised_by_least_squares() -> None:
    driven = Hamiltonian("p**2/2 + x**2/2 - x*cos(2*t)")
    settings = {**SMALL}
    solution = hamsym.solve(driven, [0, 0], (0, 3), method=hamsym.LevenbergMarquardt(**settings))
    t = np.linspace(0, 3, 50)
    np.testing.assert_allclose(solution(t)[:, 0], (np.cos(t) - np.cos(2 * t)) / 3, atol=2e-5)
    problem = hamsym.systems.pendulum()
    penalised = hamsym.solve(
        problem.H,
        problem.z0,
        (0, 3),
        method=hamsym.LevenbergMarquardt(energy_weight=1.0, **settings),
    )
    assert penalised.success
    assert np.abs(penalised(t) - problem.exact(t)).max() < 2e-5


# -- rules for stopping ----------------------------------------------------------------------------


STOPPED = {
    "target_loss": Stopped.TARGET_LOSS,
    "target_ell_max": Stopped.TARGET_ELL_MAX,
    "tol": Stopped.TOLERANCE,
    "accuracy": Stopped.ACCURACY,
}


@pytest.mark.slow_cases(
    "levenberg-marquardt-target_loss-0.001",
    "levenberg-marquardt-accuracy-0.1",
    "lbfgs-target_loss-0.001",
    "ssbroyden-target_loss-0.001",
    "levenberg-marquardt-tol-0.01",
    "adam-target_loss-0.001",
)
@pytest.mark.parametrize(
    ("method", "option", "value"),
    [
        ("levenberg-marquardt", "target_loss", 1e-3),
        ("levenberg-marquardt", "target_ell_max", 0.1),
        ("levenberg-marquardt", "tol", 0.01),
        ("levenberg-marquardt", "accuracy", 0.1),
        ("ssbroyden", "target_loss", 1e-3),
        ("lbfgs", "target_loss", 1e-3),
        ("adam", "target_loss", 1e-3),
    ],
)
def test_target_ends_training(method: str, option: str, value: float) -> None:
    problem = hamsym.systems.nonlinear_oscillator()
    settings = {"epochs": 5_000, "tau": 0.25} if method == "adam" else {}
    asked = {option: value}
    made = made_method(method, {**SMALL, **settings, **({} if option == "tol" else asked)})
    solution = hamsym.solve(
        problem.H, problem.z0, (0, 1), method=made, **(asked if option == "tol" else {})
    )
    record = solution.record
    assert record.stopped == STOPPED[option]
    assert record.iterations < made.total
    reached = {
        "target_loss": record.best_loss,
        "target_ell_max": record.best_ell_max,
        "tol": solution.relative_error,
        "accuracy": solution.error_bound,
    }
    assert reached[option] <= value
    if option != "tol":
        assert f"({option.replace('_', ' ', 1)} {value} reached), " in solution.message
    # What ends a training says nothing of the error, by which alone it succeeds.
    assert solution.success == bool((solution.largest_error <= solution.allowed_error).all())
    assert solution.success or option != "tol"


@pytest.mark.slow
def test_accuracy_undefined_where_sigma_min_is_zero() -> None:
    H = Hamiltonian("p**2/2 + cos(x)")  # the curvature of cos changes its sign on the way
    solution = hamsym.solve(
        H,
        [1.2, 0.9],
        (0, 2),
        method=hamsym.LevenbergMarquardt(accuracy=1e-3, iterations=30, **SMALL),
    )
    assert solution.sigma_min == 0
    assert solution.record.stopped != Stopped.ACCURACY
    assert "accuracy is undefined: sigma_min = 0 on this trajectory" in solution.message


@pytest.mark.slow
def test_patience_and_time_limit_end_training() -> None:
    problem = hamsym.systems.nonlinear_oscillator()
    patient = hamsym.solve(
        problem.H,
        problem.z0,
        (0, 1),
        tol=1e-12,
        method=hamsym.LevenbergMarquardt(patience=7, hidden=(4,), points=10),
    )
    assert not patient.success
    assert re.search(
        "no lower loss in the last 7 iterations|the optimizer stalled", patient.message
    )
    brief = hamsym.solve(
        problem.H,
        problem.z0,
        (0, 1),
        tol=1e-12,
        method=hamsym.LevenbergMarquardt(time_limit=1e-6, **SMALL),
    )
    assert not brief.success
    assert "(time limit of 1e-06 s reached), " in brief.message
    assert brief.record.stopped == "time limit"


@pytest.mark.slow
def test_restarts_are_counted_in_the_message() -> None:
    """A network far too small for its problem stalls."""
    problem = hamsym.systems.henon_heiles()
    solution = hamsym.solve(
        problem.H,
        problem.z0,
        (0, 60),
        method=hamsym.LevenbergMarquardt(hidden=(2,), points=30, restarts=1, stages=1),
    )
    assert not solution.success
    assert solution.record.restarts == 1
    assert "with 1 restart" in solution.message


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "lbfgs", "iterations": 0}, "iterations=0"),
        ({"method": "lbfgs", "stages": 0}, "stages=0"),
        ({"method": "lbfgs", "points": 1}, "points=1 cannot be used; give a whole number from 2"),
        ({"method": "adam", "points": 2.5}, "points=2.5 cannot be used"),
        ({"method": "ssbroyden", "iterations": 0}, "iterations=0"),
        ({"method": "ssbroyden", "dtype": "float32"}, "'ssbroyden'; it trains in float64"),
        ({"method": "ssbroyden", "hidden": (200, 200)}, "weights, more than the 20,000"),
        ({"method": "lbfgs", "target_loss": 0.0}, "target_loss=0.0"),
        ({"method": "lbfgs", "accuracy": math.inf}, "accuracy=inf"),
        ({"method": "lbfgs", "frequency": -1.0}, "frequency=-1.0"),
        ({"method": "lbfgs", "dtype": "float16"}, "choose one of float64, float32"),
        ({"method": "levenberg-marquardt", "restarts": -1}, "restarts=-1"),
        ({"method": "levenberg-marquardt", "epochs": 5}, "'epochs' is not an option"),
        (
            {"method": "levenberg-marquardt", "regularizers": [hamsym.Regularizer(1.0, abs)]},
            "no least-squares form",
        ),
    ],
)
def test_unusable_settings_are_rejected(settings: dict[str, object], message: str) -> None:
    name, *options = settings

    def solve() -> None:
        method = made_method(str(settings[name]), {option: settings[option] for option in options})
        hamsym.solve(Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 1), method=method)

    with pytest.raises(InputError) as caught:
        solve()
    assert message in str(caught.value)


def test_choices_are_those_of_the_networks() -> None:
    choices = {field.name: field.metadata.get("choices") for field in fields(JointTraining)}
    assert set(choices["activation"]) == set(ACTIVATIONS)
    assert set(choices["envelope"]) == set(ENVELOPES)


@pytest.mark.slow
def test_initial_weights_are_those_given():
    H = Hamiltonian("p**2/2 + x**2/2")
    options = {"points": 20, "hidden": (6, 6)}
    first = hamsym.solve(H, [1.0, 0.0], (0, 2), method=hamsym.Adam(epochs=300, **options))
    options |= {"epochs": 1, "learning_rate": 1e-9}
    # One step with a small learning rate, on another span and from another initial state.
    second = hamsym.solve(H, [0.5, 0.0], (0, 3), method=hamsym.Adam(initial=first, **options))
    t = np.linspace(0, 2, 9)
    assert np.abs(second(t) - [0.5, 0.0] - (first(t) - [1.0, 0.0])).max() < 1e-6
    fresh = hamsym.solve(H, [0.5, 0.0], (0, 3), method=hamsym.Adam(**options))
    assert np.abs(second(t) - fresh(t)).max() > 0.01


@pytest.mark.slow_cases(
    "change0-1-6-6-2 sin, this training 1-7-6-2 sin", "change2-1-6-6-1 . 1-6-6-1 sin"
)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": (7, 6)}, "1-6-6-2 sin, this training 1-7-6-2 sin"),
        ({"activation": "tanh"}, "this training 1-6-6-2 tanh"),
        ({"shared_weights": False}, "1-6-6-1 . 1-6-6-1 sin"),
    ],
)
def test_initial_weights_of_another_network_are_rejected(change, message):
    H = Hamiltonian("p**2/2 + x**2/2")
    options = {"points": 20, "hidden": (6, 6), "epochs": 2}
    first = hamsym.solve(H, [1.0, 0.0], (0, 2), method=hamsym.Adam(**options))
    with pytest.raises(InputError, match=message):
        hamsym.solve(H, [1.0, 0.0], (0, 2), method=hamsym.Adam(initial=first, **options | change))
    marched = hamsym.solve(H, [1.0, 0.0], (0, 2))
    for other in (marched, "a file"):
        with pytest.raises(InputError, match="initial is not a trained network"):
            hamsym.solve(H, [1.0, 0.0], (0, 2), method=hamsym.Adam(initial=other, **options))


@pytest.mark.slow_cases("0.005")
@pytest.mark.parametrize("tol", [None, 0.005])
def test_network_across_potential_step_fails(tol: float | None) -> None:
    solution = hamsym.solve(
        "p**2/2 + sign(x)/2",
        [1.0, -2.0],
        (0, 1),
        method=hamsym.LevenbergMarquardt(hidden=(8, 8), points=30, iterations=60),
        tol=tol,
    )
    assert solution.relative_error < 0.005  # of an equation without the force of the step
    assert not solution.success
    assert re.match(r"H jumps at t = 0\.(49|5)\d*, beyond which", solution.message)


@pytest.mark.parametrize(
    "method",
    [
        hamsym.LevenbergMarquardt(hidden=(20,)),
        pytest.param(hamsym.LBFGS(iterations=800), marks=pytest.mark.slow),
        pytest.param(hamsym.SSBroyden(iterations=800), marks=pytest.mark.slow),
    ],
    ids=lambda method: method.name,
)
def test_pulses_between_all_sampled_times_are_refused(method: JointTraining) -> None:
    time, width = 0.234567, 1e-6  # p changes by -1/2 at once
    pulse = f"{0.5 / (width * math.sqrt(math.pi))}*x*exp(-((t - {time})/{width})**2)"
    solution = hamsym.solve(f"p**2/2 + x**2/2 + {pulse}", [1, 0], (0, 1), method=method, tol=1e-2)
    assert not solution.success
    assert "near t = 0.23456" in solution.message
    assert "a narrow pulse" in solution.message


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.02, 0.1])
def test_resolved_pulses_are_not_refused(width: float) -> None:
    H = f"p**2/2 + x**2/2 - x*exp(-((t - 1.2)/{width})**2)"
    method = hamsym.LevenbergMarquardt()
    assert hamsym.solve(H, [1, 0], (0, 3), method=method, tol=1e-2).success
