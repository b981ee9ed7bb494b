"""solve and Solution, tested between the training points against exact solutions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import Hamiltonian, InputError, Regularizer, Solution
from hamsym.errors import ParameterError, ParseError, VacuousBoundWarning, VariableError
from hamsym.integrators.adaptive import reference
from hamsym.support import progress
from hamsym.systems import CATALOGUE, harmonic_oscillator, henon_heiles

QUICK: dict[str, Any] = {
    "hidden": (20, 20),
    "tau": 0.25,
    "points": 30,
    "noise": 0.0,
    "epochs": 600,
    "learning_rate": 0.02,
    "schedule": "cosine",
}


# Slow to derive and to train.
LARGE = {"calogero_moser", "fermi_pasta_ulam_tsingou", "three_bodies", "toda_chain"}
SMALL = [
    *("charged_particle", "coupled_oscillators", "double_pendulum", "driven_oscillator"),
    *("harmonic_oscillator", "henon_heiles", "kepler", "morse_oscillator", "nonlinear_oscillator"),
    *("pendulum", "spring_pendulum"),
]


@pytest.fixture(scope="module")
def solution() -> Solution:
    problem = harmonic_oscillator()
    return hamsym.solve(problem.H, problem.z0, (0, math.pi), method=hamsym.Adam(**QUICK))


def test_converges_to_the_exact_solution(solution: Solution) -> None:
    t = np.linspace(0, math.pi, 1001)
    error = np.linalg.norm(solution(t) - harmonic_oscillator().exact(t), axis=1).max()
    assert solution.success, solution.message
    assert error < 0.02
    assert solution(0.0).tolist() == [1.0, 0.0]


@pytest.mark.slow_cases("charged_particle")
@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    "name",
    [*SMALL, *(pytest.param(name, marks=pytest.mark.slow) for name in sorted(LARGE))],
)
def test_short_spans_of_the_catalogue(name: str) -> None:
    problem = CATALOGUE[name]()
    span = (problem.span[0], problem.span[0] + 0.3)
    # Of components that begin at rest a network resolves only what is large beside the others.
    atol = 0.01 * float(np.abs(problem.z0).max())
    solution = hamsym.solve(problem.H, problem.z0, span, method=hamsym.Adam(**QUICK), atol=atol)
    truth = hamsym.integrate(problem.H, problem.z0, span, "dop853", steps=200)
    assert solution.success, solution.message
    assert np.abs(solution(truth.t) - truth.z).max() < 0.03
    assert np.abs(solution.energy(truth.t) - truth.energy).max() < 0.1


def test_calls_with_arrays_scalars_and_tensors(solution: Solution) -> None:
    t = np.linspace(0, 3, 7)
    z = solution(t)
    assert (z.shape, z.dtype) == ((7, 2), np.float64)
    assert solution(1.5).shape == (2,)
    assert solution([0.0, 1.5]).shape == (2, 2)
    np.testing.assert_allclose(solution(1.5), z[3], rtol=1e-13)
    tensor = solution(torch.tensor(t))
    np.testing.assert_allclose(tensor.numpy(), z, rtol=1e-14)
    assert solution(torch.tensor(1.5)).shape == (2,)
    assert not tensor.requires_grad
    assert solution(torch.tensor(solution.span, dtype=torch.float32)).shape == (2, 2)
    assert np.shape(solution.energy(t)) == (7,)
    assert np.shape(solution.energy(1.5)) == ()
    assert solution.residual(t).shape == (7, 2)
    assert solution.derivative(1.5).shape == (2,)
    assert solution.residual(torch.tensor(t)).shape == (7, 2)


def test_derivatives_in_time(solution: Solution) -> None:
    t = torch.linspace(0.1, 3, 5, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(solution(t)[:, 0].sum(), t)
    torch.testing.assert_close(slope, solution.derivative(t.detach())[:, 0])
    h = 1e-6
    at = t.detach().numpy()
    difference = (solution(at + h) - solution(at - h)) / (2 * h)
    np.testing.assert_allclose(solution.derivative(at), difference, atol=1e-8)
    flow = solution.H.compile("numpy").vector_field(solution(at))
    np.testing.assert_allclose(solution.residual(at), solution.derivative(at) - flow)


def test_many_times_at_once(solution: Solution) -> None:
    t = np.linspace(0, 3, 50_001)
    np.testing.assert_allclose(solution(t)[::5000], solution(t[::5000]), rtol=1e-12)


def test_ell_max_is_over_continuous_time(solution: Solution) -> None:
    fine = np.linalg.norm(solution.residual(np.linspace(0, math.pi, 40_001)), axis=1).max()
    assert solution.ell_max >= fine * (1 - 1e-9)
    assert solution.ell_max <= fine * 1.001
    assert solution.ell_max_regularized == solution.ell_max


@pytest.mark.slow_cases("1000")
@pytest.mark.parametrize("epochs", [100, 1000])
def test_error_estimate_is_the_error(epochs: int) -> None:
    """For poor networks as for good ones, against the exact solution."""
    problem = CATALOGUE["nonlinear_oscillator"]()
    span = (0.0, 3.0)
    solution = hamsym.solve(
        problem.H, problem.z0, span, method=hamsym.Adam(**QUICK | {"epochs": epochs})
    )
    t = np.linspace(*span, 501)
    error = problem.exact(t) - solution(t)
    estimate = solution.error_estimate(t)
    assert np.abs(estimate - error).max() < 1e-4 * np.abs(error).max()
    assert solution.error_estimate(1.0).shape == (2,)
    relative = (np.abs(error).max(axis=0) / solution.scale).max()
    # The coupled size of a component, after a radian of motion, is at most twice its own size.
    assert relative / 3 < solution.relative_error <= relative * 1.001
    assert solution.success == (solution.relative_error <= 0.01)


@pytest.mark.slow
def test_error_estimate_is_infinite_beyond_an_escape() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    solution = hamsym.solve(H, [1.0, 1.0], (0, 3), method=hamsym.Adam(**QUICK | {"epochs": 50}))
    assert np.isfinite(solution.error_estimate(0.5)).all()
    assert np.isinf(solution.error_estimate(3.0)).all()
    assert not solution.success


def test_bound_and_scale(solution: Solution) -> None:
    assert solution.sigma_min == pytest.approx(1.0)
    assert solution.error_bound == pytest.approx(solution.ell_max)
    np.testing.assert_allclose(solution.scale, [1.0, 1.0], atol=0.02)


@pytest.mark.slow
def test_bound_is_infinite_where_the_hessian_is_singular() -> None:
    """On the Henon-Heiles orbit an eigenvalue changes its sign between any two grid points."""
    problem = henon_heiles()
    solution = hamsym.solve(
        problem.H, (0.0, 0.6, 0.0, 0.0), (0, 3), method=hamsym.Adam(epochs=300, points=30)
    )
    assert solution.sigma_min == 0.0
    with pytest.warns(VacuousBoundWarning, match="singular"):
        assert solution.error_bound == math.inf


@pytest.mark.slow
def test_bound_is_infinite_for_a_cyclic_coordinate() -> None:
    H = Hamiltonian("p**2/2", q=["x"], p=["p"])
    solution = hamsym.solve(H, [0, 1], (0, 1), method=hamsym.Adam(epochs=100, points=10))
    with pytest.warns(VacuousBoundWarning):
        assert solution.error_bound == math.inf


@pytest.mark.slow
def test_energy_weight_enters_loss_and_ell_max() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, (0, 2), method=hamsym.Adam(**QUICK, energy_weight=5.0)
    )
    grid = np.linspace(0, 2, 20_001)
    ell, drift = np.linalg.norm(solution.residual(grid), axis=1), solution.energy(grid) - 0.5
    together = np.sqrt(ell**2 + 5 * drift**2).max()
    assert solution.ell_max_regularized == pytest.approx(together, rel=1e-4)
    assert solution.ell_max == pytest.approx(ell.max(), rel=1e-4)
    t = torch.arange(60, dtype=torch.float64).add(0.5).mul(2 / 60)
    ell = solution.residual(t).square().sum(-1).mean()
    drift = (solution.energy(t) - 0.5).square().mean()
    assert float(ell + 5 * drift) == pytest.approx(solution.record.best_loss, rel=1e-9)


@pytest.mark.slow
def test_regularizers_pull() -> None:
    problem = harmonic_oscillator()
    flat = Regularizer(1e3, lambda t, z, dz: (z[:, 0] - 1) ** 2)
    solution = hamsym.solve(
        problem.H, problem.z0, (0, 2), method=hamsym.Adam(**QUICK, regularizers=[flat])
    )
    assert abs(solution(2.0)[0] - 1) < 0.1
    assert not solution.success


@pytest.mark.slow
def test_backward_time_and_other_start() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (5.0, 3.0), method=hamsym.Adam(**QUICK))
    t = np.linspace(3, 5, 101)
    assert np.abs(solution(t) - problem.exact(t - 5.0)).max() < 0.02
    assert solution(5.0).tolist() == [1.0, 0.0]


@pytest.mark.slow
def test_time_dependent_hamiltonian() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*cos(2*t)")
    solution = hamsym.solve(H, [0.0, 0.0], (0, 2), method=hamsym.Adam(**QUICK))
    t = np.linspace(0, 2, 101)
    exact = (np.cos(t) - np.cos(2 * t)) / 3
    assert np.abs(solution(t)[:, 0] - exact).max() < 0.02
    with pytest.raises(InputError, match="energy_weight=1.0 penalises .* not conserved"):
        hamsym.solve(H, [0.0, 0.0], (0, 2), method=hamsym.Adam(**QUICK, energy_weight=1.0))


@pytest.mark.slow_cases("options0", "options1", "options2")
@pytest.mark.parametrize(
    "options",
    [
        {"shared_weights": False, "activation": "sin"},
        {"dtype": "float32", "activation": "tanh"},
        {"envelope": "linear", "activation": "sigmoid"},
    ],
)
def test_network_options_lead_to_a_solution(options: dict[str, object]) -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 1), method=hamsym.Adam(**QUICK | options))
    t = np.linspace(0, 1, 101)
    assert np.abs(solution(t) - problem.exact(t)).max() < 0.05


@pytest.mark.slow
def test_same_seed_same_solution() -> None:
    problem = harmonic_oscillator()
    method = hamsym.Adam(epochs=60, points=10)
    runs = [hamsym.solve(problem.H, problem.z0, (0, 1), method=method, seed=s) for s in (1, 1, 2)]
    assert np.array_equal(runs[0](0.7), runs[1](0.7))
    assert not np.array_equal(runs[0](0.7), runs[2](0.7))


# -- failures ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_too_little_training_fails() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 10), method=hamsym.Adam(epochs=20))
    assert not solution.success
    assert solution.record.stopped == "iterations"
    assert ": the network could not be made accurate enough; 20 epochs, " in solution.message
    assert solution(3.0).shape == (2,)


@pytest.mark.slow
def test_missed_and_reached_targets() -> None:
    problem = harmonic_oscillator()
    settings: dict[str, Any] = {"points": 20, "hidden": (20,), "learning_rate": 0.01}
    missed = hamsym.solve(
        problem.H, problem.z0, (0, 1), method=hamsym.Adam(epochs=50, target_loss=1e-9, **settings)
    )
    assert not missed.success
    assert missed.record.stopped == "iterations"
    assert "50 epochs, loss" in missed.message
    reached = hamsym.solve(
        problem.H, problem.z0, (0, 1), method=hamsym.Adam(epochs=5000, target_loss=1e-3, **settings)
    )
    assert reached.record.stopped == "target loss"
    assert "(target loss 0.001 reached)" in reached.message
    assert reached.record.iterations < 5000
    # What stops a training is no verdict: the error is one part in fifty.
    assert reached.success == bool((reached.largest_error <= reached.allowed_error).all())


def test_times_outside_the_span_are_rejected(solution: Solution) -> None:
    for t in (-0.1, 3.2, [0.0, 4.0]):
        with pytest.raises(InputError, match="outside the span from 0 to 3.14159"):
            solution(t)
        assert np.all(np.isfinite(solution(t, extrapolate=True)))
        with pytest.raises(InputError, match="outside the span"):
            solution.energy(torch.tensor(t))
    with pytest.raises(InputError, match="not finite"):
        solution(math.nan)
    with pytest.raises(InputError, match="not a real number"):
        solution(1j)
    with pytest.raises(InputError, match="one time or a list"):
        solution(np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"method": "newton"},
            "'newton' is not a method; choose one of features, network-chain, levenberg-marquardt, "
            "ssbroyden, lbfgs, adam",
        ),
        ({"method": None}, "None is not a method"),
        ({"epochs": 5}, "'epochs' is an option of a method; give method=hamsym.Adam(epochs=5)"),
        ({"method": "adam", "tol": 0}, "tol=0 cannot be used"),
        ({"omega": 2.0}, "'omega' is a parameter; use H.with_parameters(omega=...)"),
        ({"method": "adam", "seed": -1}, "seed=-1"),
        ({"method": "adam", "seed": 1.5}, "seed=1.5"),
    ],
)
def test_unusable_arguments_are_rejected(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        hamsym.solve(harmonic_oscillator().H, [1, 0], (0, 1), **settings)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"epochs": 0}, "epochs=0"),
        ({"activation": "relu"}, "activation='relu' cannot be used; choose one of sin, "),
        ({"envelope": "x"}, "envelope='x' cannot be used; choose one of exponential, linear"),
        ({"hidden": ()}, "layer widths"),
        ({"hidden": 50}, "hidden=50 is not a list of layer widths"),
        ({"betas": 0.9}, "betas=0.9"),
        ({"tau": 0}, "tau=0"),
        ({"tau": -1.0}, "tau=-1.0"),
        ({"energy_weight": -1.0}, "energy_weight=-1.0"),
        ({"energy_weight": math.nan}, "energy_weight=nan"),
        ({"dtype": "float16"}, "dtype='float16'"),
        ({"learning_rate": 0}, "learning_rate=0"),
        ({"noise": -1.0}, "noise=-1.0"),
        ({"schedule": "step"}, "schedule='step' cannot be used; choose one of cosine, constant"),
        ({"shared_weights": 1}, "shared_weights=1 cannot be used; give True or False"),
    ],
)
def test_unusable_options_are_refused_when_they_are_given(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        hamsym.Adam(**options)
    assert message in str(caught.value)


@pytest.mark.parametrize("regularizers", [5, [abs]])
def test_functions_alone_are_no_regularizers(regularizers: Any) -> None:
    method = hamsym.Adam(regularizers=regularizers)
    with pytest.raises(InputError, match="regularizers is not a list of Regularizer objects"):
        hamsym.solve(harmonic_oscillator().H, [1, 0], (0, 1), method=method)


@pytest.mark.parametrize("span", [(0, 0), (0, math.inf), (math.nan, 1), 5, (0, 1, 2), ("a", 1)])
def test_unusable_spans_are_rejected(span: object) -> None:
    with pytest.raises(InputError, match="span="):
        hamsym.solve(harmonic_oscillator().H, [1, 0], span, method="adam")  # type: ignore[arg-type]


def test_unusable_starts_and_parameters_are_rejected() -> None:
    with pytest.raises(VariableError, match="shape"):
        hamsym.solve(harmonic_oscillator().H, [1], (0, 1), method="adam")
    with pytest.raises(ParameterError, match="k has no value"):
        hamsym.solve(Hamiltonian("p**2 + k*x**2"), [1, 0], (0, 1), method="adam")
    with pytest.raises(InputError, match="not finite at z0"):
        hamsym.solve(Hamiltonian("p**2/2 + log(x)"), [-1, 0], (0, 1), method="adam")
    with pytest.raises(InputError, match="not finite at z0"):
        hamsym.solve(Hamiltonian("p**2/2 - 1/x"), [0, 0], (0, 1), method="adam")


@pytest.mark.parametrize("rest", ["", " + x*t"])
@pytest.mark.parametrize(
    ("H", "z0"),
    [
        ("p**2/2 + x**2/2", [1e200, 0]),  # only H itself
        ("p**2/2 - sqrt(x)", [0, 1]),  # only its gradient
        ("p**2/2 + exp(x)", [800, 0]),
    ],
)
def test_a_march_starts_where_everything_is_finite(H: str, rest: str, z0: list[float]) -> None:
    with pytest.raises(InputError, match="not finite at z0"):
        hamsym.solve(H + rest, z0, (0, 1))


SOLVERS = {
    "solve": lambda H: hamsym.solve(H, [1, 0], (0, 1)).z0,
    "integrate": lambda H: hamsym.integrate(H, [1, 0], (0, 1), steps=9).z,
    "section": lambda H: hamsym.section(H, [1, 0], (0, 9), "x = 0", dt=0.1).t,
    "lyapunov": lambda H: hamsym.lyapunov(H, [1, 0], (0, 1), dt=0.1).exponents,
    "monodromy": lambda H: hamsym.monodromy(H, [1, 0], 2 * math.pi).matrix,
    "reference": lambda H: reference(H, [1, 0], (0, 1))(np.ones(1)),
}


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=list(SOLVERS))
def test_solvers_take_formulas(solver: Callable[..., np.ndarray]) -> None:
    found = solver(Hamiltonian("p**2/2 + x**2/2"))
    np.testing.assert_array_equal(solver("p**2/2 + x**2/2"), found)
    np.testing.assert_array_equal(solver(Hamiltonian("p**2/2 + x**2/2").expr), found)
    with pytest.raises(InputError, match="H must be a Hamiltonian or a formula, not Problem; give"):
        solver(harmonic_oscillator())
    with pytest.raises(ParameterError, match="k has no value"):
        solver("p**2 + k*x**2")
    with pytest.raises(ParseError, match=r"'\^' at column 2 is not a power"):
        solver("p^2")


def test_solving_is_silent_without_a_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hamsym.solve(
            harmonic_oscillator().H, [1, 0], (0, 1), method=hamsym.Adam(epochs=30, points=5)
        )
    assert capfd.readouterr() == ("", "")


def test_progress_shows_loss_and_ell_max(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_BEGIN", 0.0)
    hamsym.solve(
        harmonic_oscillator().H,
        [1, 0],
        (0, 1),
        method=hamsym.Adam(epochs=50, points=5),
        progress=True,
    )
    shown = capfd.readouterr().err
    assert "loss" in shown
    assert "ell_max" in shown


def test_figure_has_its_panels(solution: Solution) -> None:
    figure = solution.plot()
    titles = [axis.get_title("left") for axis in figure.axes if axis.get_title("left")]
    assert titles == [
        "Phase portrait",
        "Estimated error",
        "Energy error",
        "Residual $\\ell$",
        "Best residual so far",
    ]
    assert all(axis.lines for axis in figure.axes)


def test_times_and_events_of_other_types_are_refused():
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1))
    analysis = solution.analysis
    functions = (solution, solution.energy_drift, analysis.linearized_error, analysis.eigenvalues)
    for function in functions:
        for t in (10**400, "a", np.array([0.5 + 0.5j])):
            with pytest.raises(InputError, match="t has an entry that is not a real number"):
                function(t)
    with pytest.raises(InputError, match="events=3"):
        solution.events(3)
