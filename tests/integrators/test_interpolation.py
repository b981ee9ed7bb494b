"""Interpolation between saved states: its order, its estimated error, and what is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError, Trajectory

CUBIC = Hamiltonian("p**2/2 + k*x**2/2 + x**4/4", parameters={"k": 1.0})
DRIVEN = Hamiltonian("p**2/2 + x**2/2 + x**4/4 + x*cos(t)")
DAMPED = Hamiltonian("p**2/2 + x**2/2 + x**4/4", forces={"p": "-p/5"})


def saved(
    H: Hamiltonian, count: int, span: tuple[float, float] = (0, 4), **given: object
) -> Trajectory:
    """A trajectory whose saved states are nearly exact, at ``count`` intervals."""
    z0 = given.pop("z0", [1.0, 0.0])
    return hamsym.integrate(H, z0, span, "dop853", steps=count, **given)


@pytest.mark.parametrize(("H", "order"), [(CUBIC, 6), (DAMPED, 6), (DRIVEN, 4)])
def test_error_has_the_stated_order(H: Hamiltonian, order: int) -> None:
    truth, t = hamsym.solve(H, [1, 0], (0, 4), tol=1e-12), np.linspace(0, 4, 801)
    errors = [np.abs(saved(H, n)(t) - truth(t)).max() for n in (20, 40, 80)]
    found = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(found, order, atol=0.35)


@pytest.mark.parametrize("H", [CUBIC, DAMPED, DRIVEN])
@pytest.mark.parametrize("span", [(0, 4), (4, 0)])
def test_estimated_error_is_the_true_one(H: Hamiltonian, span: tuple[float, float]) -> None:
    truth, t = hamsym.solve(H, [1, 0], span, tol=1e-12), np.linspace(*span, 801)
    trajectory = saved(H, 40, span)
    true = np.abs(trajectory(t) - truth(t)).max(axis=0)
    ratio = true / trajectory.interpolation_error(t).max(axis=0)
    assert ((ratio > 0.7) & (ratio < 1.3)).all(), ratio


def test_saved_states_are_kept_to_the_last_bit() -> None:
    trajectory = hamsym.integrate(CUBIC, [1, 0], (0, 5), tol=1e-9)
    np.testing.assert_array_equal(trajectory(trajectory.t), trajectory.z)
    np.testing.assert_array_equal(trajectory.interpolation_error(trajectory.t), 0.0)


def test_one_time_gives_one_state_and_many_give_rows() -> None:
    trajectory = saved(CUBIC, 40)
    t = np.array([3.3, 0.7, 2.2])  # in any order
    assert trajectory(0.7).shape == (2,)
    np.testing.assert_array_equal(trajectory(t)[1], trajectory(0.7))
    assert trajectory([]).shape == (0, 2)


def test_members_of_an_ensemble_are_interpolated_by_themselves() -> None:
    starts = np.random.default_rng(3).uniform(-1, 1, (2, 3, 2))
    k = np.array([1.0, 2.0, 3.0])
    many, t = saved(CUBIC, 60, z0=starts, parameters={"k": k}), np.linspace(0.1, 3.9, 7)
    assert many(t).shape == (2, 3, 7, 2)
    assert many(1.0).shape == (2, 3, 2)
    own = saved(CUBIC.with_parameters(k=2.0), 60, z0=starts[1, 1])
    np.testing.assert_allclose(many(t)[1, 1], own(t), rtol=0, atol=1e-14)


def test_ensembles_larger_than_a_block_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory, t = saved(CUBIC, 30, z0=[[1.0, 0.0], [0.5, 0.2]]), np.linspace(0, 4, 97)
    whole = trajectory(t)
    monkeypatch.setattr("hamsym.integrators.interpolation._HELD", 40)
    np.testing.assert_array_equal(trajectory(t), whole)


def test_after_the_end_of_a_member_is_nan() -> None:
    falling = Hamiltonian("p**2/2 - x**4/4")
    many = hamsym.integrate(falling, [[1.0, 0.0], [0.1, 0.0]], (0, 10), tol=1e-9)
    last = many.t[np.isfinite(many.z[0, :, 0])][-1]
    assert np.isnan(many([last + 0.5, 9.0])[0]).all()
    assert np.isfinite(many([last + 0.5, 9.0])[1]).all()


@pytest.mark.parametrize("scale", [1e-24, 1.0, 1e12])
def test_units_do_not_matter(scale: float) -> None:
    H = Hamiltonian("p**2/(2*m) + m*x**2/2", parameters={"m": scale})
    trajectory = saved(H, 40, z0=[1.0, 0.0])
    np.testing.assert_allclose(trajectory(2.02) / [1, scale], [np.cos(2.02), -np.sin(2.02)], 1e-8)


def test_components_of_round_off_are_not_refused() -> None:
    kepler = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
    trajectory = hamsym.integrate(kepler, [1, 1e-17, 0.1, 0], (0, 0.5), tol=1e-9)
    assert abs(trajectory(0.3333)[1]) < 1e-15


def test_states_too_far_apart_are_refused() -> None:
    trajectory = hamsym.integrate(CUBIC, [5, 0], (0, 20), tol=1e-9, saves=10)
    with pytest.raises(InputError, match=r"saved states near t = 3\.3 are too far apart"):
        trajectory(3.3)
    assert trajectory.interpolation_error(3.3).min() > 0.01


@pytest.mark.parametrize(
    ("t", "message"),
    [
        (4.1, "t = 4.1 is outside the trajectory, from 0 to 4"),
        ([1.0, -1.0], "t = -1 is outside"),
        (np.nan, "t = nan is outside"),
        ("now", "t has an entry that is not a real number"),
        ([[1.0]], r"t has shape \(1, 1\); give one time or a list"),
    ],
)
def test_unusable_times_are_rejected(t: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        saved(CUBIC, 40)(t)


def test_a_trajectory_that_stopped_ends_at_its_last_state() -> None:
    stopped = hamsym.integrate(Hamiltonian("p**2/2 - x**4/4"), [1.0, 0.0], (0, 10), tol=1e-9)
    assert not stopped.success
    with pytest.raises(InputError, match="is outside the trajectory, from 0 to 1.8"):
        stopped(5.0)


def test_components_are_views_by_name() -> None:
    many = saved(CUBIC, 8, z0=[[1.0, 0.0], [0.5, 0.2]])
    np.testing.assert_array_equal(many["p"], many.z[..., 1])
    assert np.shares_memory(many["x"], many.z)


def test_unknown_components_are_answered_with_the_nearest() -> None:
    H = Hamiltonian("(p_theta**2 + p_phi**2)/2 - cos(theta) - cos(phi)")
    trajectory = hamsym.integrate(H, [0.1, 0.2, 0, 0], (0, 1), "dop853", steps=4)
    message = "'tehta' does not occur in H (did you mean 'theta'?)"
    with pytest.raises(InputError, match=re.escape(message)):
        trajectory["tehta"]
    with pytest.raises(InputError, match="0 is neither a component nor a formula"):
        trajectory[0]
    with pytest.raises(TypeError, match="not a sequence"):
        list(trajectory)
