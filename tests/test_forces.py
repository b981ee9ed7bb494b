"""Systems with forces beside H, from the solution to files, against exact solutions."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
import sympy

import hamsym
from hamsym.archive import load_solution
from hamsym.cli.commands import main
from hamsym.errors import (
    FileError,
    InputError,
    SeparabilityError,
    VacuousBoundWarning,
)

DAMPED = hamsym.Hamiltonian(
    "p**2/2 + k*x**2/2", forces={"p": "-c*p"}, parameters={"c": 0.2, "k": 1.5}
)
DUFFING = hamsym.Hamiltonian(
    "p**2/2 - x**2/2 + x**4/4",
    forces={"p": "-lambda*p + a*cos(w*t)"},
    parameters={"lambda": 0.3, "a": 0.37, "w": 1.2},
)
POL = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"})
T = np.linspace(0, 20, 201)


def damped(t: Any, c: float = 0.2, k: float = 1.5, x: float = 1.0, p: float = 0.0) -> np.ndarray:
    """The exact damped oscillation."""
    decay = np.exp(-c * t / 2)
    w = np.sqrt(k - c**2 / 4)
    a, b = x, (p + c * x / 2) / w
    q = decay * (a * np.cos(w * t) + b * np.sin(w * t))
    return np.stack((q, -c / 2 * q + w * decay * (b * np.cos(w * t) - a * np.sin(w * t))), -1)


@pytest.fixture(scope="module")
def solution() -> hamsym.Solution:
    return hamsym.solve(DAMPED, [1, 0], (0, 20), tol=1e-11)


def test_damped_oscillation_is_exact(solution: hamsym.Solution) -> None:
    assert solution.success
    np.testing.assert_allclose(solution(T), damped(T), atol=1e-12)
    assert np.abs(solution.error_estimate(T)).max() < 1e-11


def test_work_balances_the_energy(solution: hamsym.Solution) -> None:
    x, p = damped(T).T
    lost = p**2 / 2 + 1.5 * x**2 / 2 - 0.75
    np.testing.assert_allclose(solution.work(T), lost, atol=1e-12)
    assert np.abs(solution.energy_drift(T)).max() < 1e-12
    assert abs(solution.work(0.0)) < 1e-16
    assert np.ndim(solution.work(3.0)) == 0
    with pytest.raises(InputError, match="outside"):
        solution.work(21.0)


@pytest.mark.slow
def test_drift_of_the_balance_shows_errors() -> None:
    coarse = hamsym.solve(
        DAMPED, [1, 0], (0, 20), method=hamsym.LevenbergMarquardt(iterations=5), seed=1
    )
    error = np.abs(coarse(T) - damped(T)).max()
    assert error > 1e-4
    assert np.abs(coarse.energy_drift(T)).max() > 1e-2 * error


def test_work_of_explicit_time_counts() -> None:
    H = hamsym.Hamiltonian("p**2/2 + (1 + cos(t)/4)*x**2/2")
    found = hamsym.solve(H, [1, 0], (0, 10), tol=1e-10)
    assert np.abs(found.energy_drift(T / 2)).max() < 1e-9
    assert np.abs(found.work(T / 2)).max() > 0.01


def test_jump_of_energy_in_time_is_no_work() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2 + x*(1 + sign(t - 1))/2", forces={"p": "-p/5"})
    found = hamsym.solve(H, [1, 0], (0, 3), breakpoints=[1], tol=1e-11)
    drift = found.energy_drift(np.array([0.9, 1.5, 3.0]))
    np.testing.assert_allclose(drift, [0, *[found(1.0)[0]] * 2], atol=1e-10)


def test_tangent_map_contracts_by_the_divergence(solution: hamsym.Solution) -> None:
    maps = solution.sensitivity(T)
    np.testing.assert_allclose(np.linalg.det(maps), np.exp(-0.2 * T), rtol=1e-10)
    step = 1e-6
    expected = (damped(T, x=1 + step) - damped(T, x=1 - step)) / (2 * step)
    np.testing.assert_allclose(maps[..., 0], expected, atol=1e-9)


@pytest.mark.parametrize("name", ["c", "k"])
def test_parameters_of_forces_have_sensitivities(solution: hamsym.Solution, name: str) -> None:
    value, step = DAMPED.parameters[name], 1e-5
    expected = (damped(T, **{name: value + step}) - damped(T, **{name: value - step})) / (2 * step)
    found = solution.sensitivity(T, parameters=[name])[..., 0]
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_bounds_of_the_symmetric_hessian_are_absent(solution: hamsym.Solution) -> None:
    assert np.isnan(solution.sigma_min)
    with pytest.warns(VacuousBoundWarning, match="rests on a symmetric Hessian, and forces act"):
        assert solution.error_bound == np.inf
    assert np.isinf(solution.analysis.inequality(T[:3])).all()


def _by_taylor_series(rates: Any, state: list[float], times: list[float]) -> np.ndarray:
    """States by Taylor series of 30 digits."""
    with mpmath.workdps(30):
        solve = mpmath.odefun(rates, 0, state, tol=mpmath.mpf(10) ** -22)
        return np.array([[float(value) for value in solve(t)] for t in times])


@pytest.mark.slow_cases("duffing")
@pytest.mark.parametrize("name", ["duffing", "van der Pol"])
def test_nonlinear_systems_agree_with_taylor_series(name: str) -> None:
    if name == "duffing":
        H = DUFFING
        c, a, w = (mpmath.mpf(H.parameters[n]) for n in ("lambda", "a", "w"))
        rates = lambda t, z: [z[1], z[0] - z[0] ** 3 - c * z[1] + a * mpmath.cos(w * t)]
    else:
        H, rates = POL, lambda t, z: [z[1], -z[0] + (1 - z[0] ** 2) * z[1]]
    times = [0.7, 2.0, 4.0]
    expected = _by_taylor_series(rates, [1.0, 0.5], times)
    found = hamsym.solve(H, [1.0, 0.5], (0, 4), tol=1e-12)
    assert found.success
    np.testing.assert_allclose(found(np.array(times)), expected, atol=3e-12)


def test_radiating_charge_spirals_inwards() -> None:
    B, tau = 2.0, 0.01
    v = "p_x + B*y/2", "p_y - B*x/2"
    H = hamsym.Hamiltonian(
        f"(({v[0]})**2 + ({v[1]})**2)/2",
        forces={"p_x": f"-tau*B**2*({v[0]})", "p_y": f"-tau*B**2*({v[1]})"},
        parameters={"B": B, "tau": tau},
    )
    found = hamsym.solve(H, {"x": 0, "y": 0, "p_x": 1, "p_y": 0}, (0, 20), tol=1e-11)
    x, y, p_x, p_y = found(T).T
    # v' = (B J - tau B^2) v
    rate = complex(-tau * B**2, -B)
    speed = np.exp(rate * T)
    place = (speed - 1) / rate
    np.testing.assert_allclose(p_x + B * y / 2 + 1j * (p_y - B * x / 2), speed, atol=1e-10)
    np.testing.assert_allclose(x + 1j * y, place, atol=1e-10)


@pytest.mark.slow
def test_friction_on_one_of_thirty_momenta() -> None:
    n = 30
    kinetic = " + ".join(f"p{i}**2/2" for i in range(n))
    springs = " + ".join(f"(q{i} - q{(i + 1) % n})**2/2 + q{i}**2/20" for i in range(n))
    H = hamsym.Hamiltonian(f"{kinetic} + {springs}", forces={"p7": "-p7/2"})
    ring = np.eye(n) * 2.1 - np.roll(np.eye(n), 1, 0) - np.roll(np.eye(n), -1, 0)
    matrix = np.block([[np.zeros((n, n)), np.eye(n)], [-ring, np.zeros((n, n))]])
    matrix[n + 7, n + 7] = -0.5
    z0 = np.random.default_rng(0).normal(size=2 * n)
    found = hamsym.solve(H, z0, (0, 10), tol=1e-10)
    assert found.success
    np.testing.assert_allclose(found(10.0), scipy.linalg.expm(10 * matrix) @ z0, atol=1e-9)
    assert np.abs(found.energy_drift(T / 2)).max() < 1e-9


def test_switched_force_is_exact_beyond_the_switch() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 + sign(t - 2))/2"})
    found = hamsym.solve(H, [0, 0], (0, 9), tol=1e-11)
    later = np.linspace(2, 9, 50)
    assert found.success
    np.testing.assert_allclose(found(later)[:, 0], 1 - np.cos(later - 2), atol=1e-10)
    assert np.abs(found.energy_drift(later)).max() < 1e-10


def test_jump_in_the_state_ends_the_success() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-mu*sign(p)"}, parameters={"mu": 0.1})
    found = hamsym.solve(H, [1, 0.5], (0, 3))
    # With p > 0 the motion is a rotation about (-0.1, 0).
    stop = np.arctan2(0.5, 1.1)
    assert not found.success
    assert f"the force jumps at t = {stop:.6g}" in found.message
    assert hamsym.solve(H, [1, 0.5], (0, 0.99 * stop)).success


def test_narrow_pulse_of_a_force_is_resolved() -> None:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "100*exp(-((t - 5.01)/0.01)**2)"})
    found = hamsym.solve(H, [0, 0], (0, 10), tol=1e-9)
    kick = 100 * 0.01 * np.sqrt(np.pi) * np.exp(-(0.005**2))  # Fourier integral at frequency 1
    expected = kick * np.array([np.sin(4.99), np.cos(4.99)])
    assert not found.success or np.abs(found(10.0) - expected).max() < 1e-8
    assert np.abs(found(10.0) - expected).max() < 1e-8


# -- many trajectories -----------------------------------------------------------------------------


def test_ensembles_have_forces() -> None:
    c = np.array([0.0, 0.2, 0.5])
    many = hamsym.solve_many(DAMPED, [1, 0], (0, 20), parameters={"c": c}, tol=1e-10)
    assert many.success.all()
    for value, one in zip(c, many, strict=True):
        np.testing.assert_allclose(one(T), damped(T, c=float(value)), atol=1e-9)


# -- integrators -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_gauss_methods_keep_their_order() -> None:
    errors = []
    for steps in (20, 40):
        found = hamsym.integrate(DAMPED, [1, 0], (0, 5), "gauss4", steps=steps)
        errors.append(np.abs(found.z[-1] - damped(5.0)).max())
    assert 3.8 < np.log2(errors[0] / errors[1]) < 4.2
    found = hamsym.integrate(DAMPED, [1, 0], (0, 20), tol=1e-10)
    assert found.success
    assert found.method == "gauss6"
    np.testing.assert_allclose(found.z[-1], damped(20.0), atol=1e-10)
    assert np.isnan(found.drift)


def test_trajectories_balance_their_energy() -> None:
    found = hamsym.integrate(POL, [[1, 0], [2, 1]], (0, 20), "gauss6", steps=4_000)
    assert found.energy_drift.shape == found.energy.shape
    assert np.abs(found.energy_drift).max() < 1e-10
    assert np.abs(found.energy - found.energy[:, :1]).max() > 0.1
    back = hamsym.integrate(POL, [1, 0], (3, 0), "gauss6", steps=1_000)
    assert np.abs(back.energy_drift).max() < 1e-10


@pytest.mark.parametrize("method", ["yoshida8", "symplectic_euler", "ruth3", "blanes_moan6"])
def test_splittings_refuse_forces_of_momenta(method: str) -> None:
    with pytest.raises(SeparabilityError, match=f"{method} alternates steps .* forces without mom"):
        hamsym.integrate(DAMPED, [1, 0], (0, 1), method)


def test_doubled_phase_space_refuses_forces() -> None:
    driven = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "cos(t)"})
    for H in (DAMPED, driven):
        with pytest.raises(InputError, match="tao4 steps in a doubled phase space"):
            hamsym.integrate(H, [1, 0], (0, 1), "tao4")


def test_splittings_solve_forces_of_time_and_place() -> None:
    driven = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "cos(2*t) - 3*x"})
    # x'' = -4 x + cos(2 t) in resonance: x = t sin(2 t)/4
    errors = []
    for steps in (100, 200):
        found = hamsym.integrate(driven, [0, 0], (0, 10), "yoshida4", steps=steps)
        errors.append(abs(found.z[-1, 0] - 10 * np.sin(20) / 4))
    assert 3.6 < np.log2(errors[0] / errors[1]) < 4.4
    found = hamsym.integrate(driven, [0, 0], (0, 10), tol=1e-10)
    assert found.method == "blanes_moan6"
    assert found.success
    assert abs(found.z[-1, 0] - 10 * np.sin(20) / 4) < 1e-9


def test_comparison_chooses_methods_for_forces(solution: hamsym.Solution) -> None:
    found = hamsym.compare(solution, points=50, max_steps=1_000)
    assert {row.label for row in found.rows} == {"network", "implicit_midpoint", "gauss6", "dop853"}
    assert found.rows[0].energy_error < 1e-11


# -- dynamics --------------------------------------------------------------------------------------


def test_exponents_add_up_to_the_divergence() -> None:
    found = hamsym.lyapunov(DAMPED, [1, 0], (0, 200), count=2)
    np.testing.assert_allclose(found.exponents[-1].sum(), -0.2, atol=1e-10)
    np.testing.assert_allclose(found.exponents[-1], -0.1, atol=0.01)
    assert found.success
    assert np.isnan(found.energy_error)


def test_limit_cycle_has_known_period_and_multiplier() -> None:
    found = hamsym.section(POL, [2, 0], (0, 60), "x = 0, p > 0")
    period = found.t[-1] - found.t[-2]
    assert abs(period - 6.6632868593231301) < 1e-8  # Andersen & Geer 1982
    cycle = hamsym.monodromy(POL, found.z[-1], period)
    orbit = hamsym.solve(POL, found.z[-1], (0, period), tol=1e-11)
    divergence = scipy.integrate.quad(lambda t: 1 - orbit(t)[0] ** 2, 0, period, limit=200)[0]
    np.testing.assert_allclose(cycle.multipliers, [1, np.exp(divergence)], rtol=1e-6)


# -- fits and maps ---------------------------------------------------------------------------------


@pytest.mark.slow_cases("1")
@pytest.mark.parametrize("starts", [1, 4])
def test_friction_is_fitted_like_an_exact_model(starts: int) -> None:
    t = np.linspace(0, 10, 81)
    data = damped(t)[:, 0] + np.random.default_rng(3).normal(0, 0.01, len(t))
    free = {"c": 0.1, "k": 1.3, "x": 0.9, "p": 0.0}
    found = hamsym.fit(
        DAMPED.with_parameters(), t, {"x": data}, free=free, sigma=0.01, span=(0, 10), starts=starts
    )
    best, covariance = scipy.optimize.curve_fit(
        lambda t, c, k, x, p: damped(t, c, k, x, p)[:, 0],
        t,
        data,
        [0.1, 1.3, 0.9, 0.0],
        sigma=np.full(len(t), 0.01),
        absolute_sigma=True,
    )
    assert found.success
    errors = np.sqrt(np.diag(covariance))
    values = np.array([found.parameters[name] for name in free])
    assert (np.abs(values - best) < 1e-3 * errors).all()
    np.testing.assert_allclose([found.standard_errors[n] for n in free], errors, rtol=1e-3)


@pytest.mark.slow
def test_flow_map_of_friction() -> None:
    flow = hamsym.flow_map(
        DAMPED, {"x": (0.9, 1.1), "p": (-0.1, 0.1)}, (0, 3), {"c": (0.1, 0.3)}, tol=1e-8
    )
    assert flow.success
    assert flow.symplecticity is None
    random = np.random.default_rng(2)
    for x, p, c in random.uniform([0.9, -0.1, 0.1], [1.1, 0.1, 0.3], (20, 3)):
        expected = damped(np.array(2.5), c=c, x=x, p=p)
        np.testing.assert_allclose(flow(2.5, [x, p], {"c": c}), expected, atol=1e-8)


# -- networks --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_trained_networks_solve_forces() -> None:
    found = hamsym.solve(DAMPED, [1, 0], (0, 5), method="network-chain", tol=1e-8)
    assert found.success
    t = T / 4
    np.testing.assert_allclose(found(t), damped(t), atol=1e-7)
    joint = hamsym.solve(DAMPED, [1, 0], (0, 3), method=hamsym.LevenbergMarquardt(iterations=25))
    np.testing.assert_allclose(
        joint.error_estimate(t[:100]), damped(t[:100]) - joint(t[:100]), atol=1e-9
    )
    assert float(joint.loss(t[:100])) == np.mean(np.sum(joint.residual(t[:100]) ** 2, axis=-1))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"energy_weight": 0.1}, "not conserved, because of the forces; leave it at 0"),
        ({"accuracy": 0.1}, "needs equations without forces; give solve a tolerance, tol=..."),
    ],
)
def test_options_that_need_conservation_are_refused(option: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        hamsym.solve(DAMPED, [1, 0], (0, 1), method=hamsym.LBFGS(**option))


# -- files, figures, command line ------------------------------------------------------------------


def test_files_keep_the_forces(solution: hamsym.Solution, tmp_path: Path) -> None:
    path = tmp_path / "damped.hamsym"
    solution.save(path)
    found = load_solution(path)
    assert found.H == DAMPED
    np.testing.assert_array_equal(found(T), solution(T))
    pushing = hamsym.Hamiltonian(
        sympy.Symbol("p") ** 2 / 2, q=["x"], p=["p"], forces={"p": -sympy.Float(1) / 3}
    )
    pushed = hamsym.solve(pushing, [0, 1], (0, 1))
    pushed.save(path)
    assert pushing == load_solution(path).H


@pytest.mark.parametrize(
    "forces",
    ["-c*p", {"x": {"formula": "1", "floats": {}}}, {"p": "-c*p"}, {"p": {"formula": "p"}}],
)
def test_damaged_forces_are_refused(forces: Any) -> None:
    from hamsym.problems.description import described, hamiltonian_from

    values = json.loads(json.dumps(described(DAMPED)))
    assert hamiltonian_from(values) == DAMPED
    with pytest.raises((ValueError, FileError)):
        hamiltonian_from(values | {"forces": forces})


def test_descriptions_without_forces_say_so() -> None:
    from hamsym.problems.description import described

    assert described(hamsym.Hamiltonian("p**2/2 + x**2/2"))["forces"] == {}


@pytest.mark.slow
def test_figures_show_the_balance(solution: hamsym.Solution) -> None:
    figure = hamsym.plot(solution)
    assert "$|H - H_0 - W|$" in [axis.get_ylabel() for axis in figure.axes]
    trajectory = hamsym.integrate(DAMPED, [1, 0], (0, 3), "gauss4", steps=100)
    drawn = hamsym.plot(trajectory).axes
    assert "$|H - H_0 - W|$" in [axis.get_ylabel() for axis in drawn]


def test_command_line_takes_forces(capsys: pytest.CaptureFixture[str]) -> None:
    formula = ["p**2/2 + k*x**2/2", "--force", "p=-c*p", "-P", "c=0.2,k=1.5"]
    assert main(["solve", *formula, "--z0", "1,0", "--t-end", "5"]) == 0
    printed = capsys.readouterr().out
    assert "|H - E0 - work| at most" in printed
    assert "sigma_min" not in printed
    assert main(["derive", *formula]) == 0
    assert "force of p = -c*p" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("force", "message"),
    [
        ("-c*p", "'-c*p' is not NAME=FORMULA; write e.g. p=-c*p"),
        ("x=-c*p", "'x' is a coordinate, and a force changes a momentum"),
        ("p=p.real", "column"),
    ],
)
def test_command_line_refuses_forces(
    force: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["derive", "p**2/2 + x**2/2", "--force", force]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert "Traceback" not in printed


def test_systems_without_forces_warn_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 1)).error_bound < 1e-6


# -- what needs Hamilton's equations without forces ------------------------------------------------


def test_searches_that_rest_on_h_alone_refuse_forces() -> None:
    with pytest.raises(InputError, match="zeros of the gradient of H, which they are not"):
        DAMPED.equilibria()
    with pytest.raises(InputError, match="found from the bracket with H"):
        DAMPED.invariants()
    with pytest.raises(InputError, match="needs an H without forces"):
        hamsym.periodic_orbit(POL, [2, 0], symmetry={"x": "-x", "p": "-p"})


def test_known_invariants_count_forces() -> None:
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + x**2", forces={"p_x": "-p_x/5"})
    found = hamsym.solve(H, [1, 0, 0, 1], (0, 5), invariants=["p_y"])
    assert found.success
    with pytest.raises(InputError, match="is not an invariant"):
        hamsym.solve(H, [1, 0, 0, 1], (0, 5), invariants=["p_x**2/2 + x**2"])


@pytest.mark.slow
def test_limit_cycle_is_a_periodic_orbit() -> None:
    orbit = hamsym.periodic_orbit(POL, [2.0, 0.0])
    assert orbit.success
    assert abs(orbit.period - 6.6632868593231301) < 1e-8
    assert orbit.stability == "attracting"
    assert orbit.certify().stability == "attracting"


@pytest.mark.slow
def test_indicators_follow_the_forces() -> None:
    found = hamsym.chaos_indicators(DUFFING, [1, 0], (0, 50))
    assert found.success
    assert np.isnan(found.energy_error)
