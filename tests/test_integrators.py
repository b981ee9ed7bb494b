"""Order, symplecticity and agreement with known figures, for every integrator of the table."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.integrators import INTEGRATORS, reference
from hamsym.systems import Problem, charged_particle, double_pendulum, nonlinear_oscillator

FIXED = [name for name, row in INTEGRATORS.items() if not row.adaptive]
ADAPTIVE = [name for name, row in INTEGRATORS.items() if row.adaptive]
SYMPLECTIC = [name for name, row in INTEGRATORS.items() if row.symplectic]


def error(problem: Problem, method: str, steps: int, span: tuple[float, float]) -> float:
    trajectory = hamsym.integrate(problem.H, problem.z0, span, method, steps=steps)
    truth = problem.exact or reference(problem.H, problem.z0, span)
    return float(np.abs(trajectory.z - truth(trajectory.t)).max())


@pytest.mark.parametrize("method", FIXED)
def test_order_is_as_the_table_says(problem: Problem, method: str) -> None:
    coarse, fine = (error(problem, method, n, (0.0, 1.0)) for n in (2_000, 8_000))
    order = INTEGRATORS[method].order
    if order == 1:
        # The modified Hamiltonian of symplectic Euler is H -+ h/2 dH/dq . dH/dp + O(h^2), which
        # leaves second order where that product vanishes: for the particle in a magnetic field.
        H = problem.H
        slopes = zip(H.gradient[: H.dof], H.gradient[H.dof :], strict=True)
        order += sympy.simplify(sum(a * b for a, b in slopes)) == 0
    assert math.log(coarse / fine) / math.log(4) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("method", SYMPLECTIC)
def test_step_map_is_symplectic(problem: Problem, method: str) -> None:
    """M^T J M = J with M the derivative of one step, by fourth-order central differences."""
    H = problem.H
    J = np.array(H.poisson_matrix, dtype=float)
    z0 = np.array(problem.z0) + 0.05 * np.arange(H.dim)

    def step(z: np.ndarray) -> np.ndarray:
        return hamsym.integrate(H, z, (0.0, 0.1), method, steps=1).z[-1]

    h = 1e-3
    columns = []
    for direction in np.eye(H.dim):
        near = step(z0 + h * direction) - step(z0 - h * direction)
        far = step(z0 + 2 * h * direction) - step(z0 - 2 * h * direction)
        columns.append((8 * near - far) / (12 * h))
    M = np.array(columns).T
    assert np.abs(M.T @ J @ M - J).max() < 1e-9 * max(1, np.linalg.norm(M) ** 2)
    # The same map with its updates made simultaneously (explicit Euler) is far from symplectic.
    flow = H.compile("numpy").hessian(z0)
    explicit = np.eye(H.dim) + 0.1 * J @ flow
    assert np.abs(explicit.T @ J @ explicit - J).max() > 1e-4


@pytest.mark.parametrize("method", ADAPTIVE)
def test_adaptive_methods_are_accurate(problem: Problem, method: str) -> None:
    if problem.exact is None:
        span = (0.0, 5.0)
        truth = reference(problem.H, problem.z0, span)
    else:
        span, truth = problem.span, problem.exact
    trajectory = hamsym.integrate(problem.H, problem.z0, span, method, steps=100)
    assert trajectory.success
    assert np.abs(trajectory.z - truth(trajectory.t)).max() < 1e-8


@pytest.mark.parametrize(
    ("steps", "within"), [(2_000, 0.02), (4_000, 0.02), (5_000, 0.01), (20_000, 0.01)]
)
def test_symplectic_euler_on_the_papers_oscillator(steps: int, within: float) -> None:
    """max |delta z| times steps is 119.4, by independent computation."""
    problem = nonlinear_oscillator()
    trajectory = hamsym.integrate(problem.H, problem.z0, problem.span, steps=steps)
    distance = np.linalg.norm(trajectory.z - problem.exact(trajectory.t), axis=1).max()
    assert distance * steps == pytest.approx(119.4, rel=within)


def test_symplectic_euler_steps_as_the_paper_writes_it() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    h, (x, p) = 0.1, (1.3, 1.0)
    first = hamsym.integrate(H, (x, p), (0, h), "symplectic_euler", steps=1).z[-1]
    x1 = x + h * p
    np.testing.assert_allclose(first, [x1, p - h * (x1 + x1**3)], rtol=1e-15)
    other = hamsym.integrate(H, (x, p), (0, h), "symplectic_euler_p", steps=1).z[-1]
    p1 = p - h * (x + x**3)
    np.testing.assert_allclose(other, [x + h * p1, p1], rtol=1e-15)


@pytest.mark.parametrize("make", [charged_particle, double_pendulum])
def test_implicit_steps_satisfy_their_equations(make: object) -> None:
    problem = make()  # type: ignore[operator]
    H, d, h = problem.H, problem.H.dof, 0.05
    gradient = H.compile("numpy").gradient
    z0 = np.array(problem.z0) + 0.1
    for method, q_first in (("symplectic_euler", True), ("symplectic_euler_p", False)):
        z1 = hamsym.integrate(H, z0, (0, h), method, steps=1).z[-1]
        mixed = np.concatenate((z1[:d], z0[d:]) if q_first else (z0[:d], z1[d:]))
        slope = gradient(mixed)
        np.testing.assert_allclose(z1[:d], z0[:d] + h * slope[d:], atol=1e-15)
        np.testing.assert_allclose(z1[d:], z0[d:] - h * slope[:d], atol=1e-15)


def test_unsolvable_step_is_reported_with_what_was_done() -> None:
    # q' = q + h q'^2 has no real solution once h q exceeds 1/4.
    H = Hamiltonian("p*q**2", q=["q"], p=["p"])
    trajectory = hamsym.integrate(H, [1.0, 1.0], (0, 2), steps=20)
    assert not trajectory.success
    assert "could not be solved; take more steps" in trajectory.message
    assert 1 < len(trajectory.t) < 21
    assert np.all(np.isfinite(trajectory.z))


@pytest.mark.parametrize("method", INTEGRATORS)
def test_escape_to_infinity_is_reported(method: str) -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    trajectory = hamsym.integrate(H, [1.0, 1.0], (0, 5), method, steps=1000)
    assert not trajectory.success
    assert "stopped after t = " in trajectory.message
    assert np.all(np.isfinite(trajectory.z))
    assert len(trajectory.t) == len(trajectory.z) == len(trajectory.energy) < 1001


@pytest.mark.parametrize("method", INTEGRATORS)
def test_backward_time_and_explicit_time(method: str) -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*cos(2*t)")
    t = np.linspace(0, -3, 3001)
    exact = (np.cos(t) - np.cos(2 * t)) / 3
    trajectory = hamsym.integrate(H, [0, 0], (0, -3), method, steps=3000)
    assert np.array_equal(trajectory.t, t)
    assert np.abs(trajectory.z[:, 0] - exact).max() < 5e-3


def test_time_is_that_of_the_drift() -> None:
    H = Hamiltonian("p**2/2 + x*t")
    z = hamsym.integrate(H, [0, 0], (1.0, 1.5), "symplectic_euler", steps=1).z[-1]
    assert z.tolist() == [0.0, -0.5 * 1.5]
    z = hamsym.integrate(H, [0, 0], (1.0, 1.5), "symplectic_euler_p", steps=1).z[-1]
    assert z.tolist() == [-0.25, -0.5]


@pytest.mark.parametrize("method", FIXED)
def test_save_every_keeps_the_same_states(method: str) -> None:
    problem = nonlinear_oscillator()
    every = hamsym.integrate(problem.H, problem.z0, (0, 1), method, steps=100)
    some = hamsym.integrate(problem.H, problem.z0, (0, 1), method, steps=100, save_every=20)
    np.testing.assert_array_equal(some.z, every.z[::20])
    np.testing.assert_allclose(some.t, every.t[::20], rtol=1e-15)
    assert some.steps == 100


def test_energy_stays_near_for_symplectic_euler() -> None:
    problem = nonlinear_oscillator()
    trajectory = hamsym.integrate(problem.H, problem.z0, (0, 2_000.0), steps=200_000, save_every=10)
    drift = np.abs(trajectory.energy - trajectory.energy[0])
    assert drift[len(drift) // 2 :].max() < 1.05 * drift[: len(drift) // 2].max()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "rk4"}, "'rk4' is not a method; choose one of symplectic_euler"),
        ({"steps": 0}, "steps=0"),
        ({"steps": 1.5}, "steps=1.5"),
        ({"save_every": 0}, "save_every=0"),
        ({"steps": 10, "save_every": 3}, "does not divide"),
        ({"rtol": 1e-9}, "rtol has no meaning for symplectic_euler"),
        ({"method": "dop853", "rtol": -1.0}, "rtol=-1.0"),
        ({"steps": 10**13}, "keep fewer of them with save_every"),
    ],
)
def test_unusable_settings(arguments: dict[str, object], message: str) -> None:
    problem = nonlinear_oscillator()
    with pytest.raises(InputError, match=message):
        hamsym.integrate(problem.H, problem.z0, problem.span, **arguments)


def test_reference_refuses_a_span_without_solution() -> None:
    with pytest.raises(InputError, match="no solution beyond t = "):
        reference(Hamiltonian("p**2/2 - x**4/4"), np.array([1.0, 1.0]), (0.0, 5.0))
