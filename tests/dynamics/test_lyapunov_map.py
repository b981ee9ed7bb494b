"""Lyapunov exponents of many starts and parameters at once."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.dynamics import lyapunov_map
from hamsym.dynamics.tangent_steps import orthonormal
from hamsym.integrators.stepper import Stepper
from hamsym.support.machine import one_core
from hamsym.systems import double_pendulum, driven_oscillator, henon_heiles, kepler

from .linear_systems import linear

ESCAPING = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + k*(x**2*y - y**3/3)",
                       parameters={"k": 1.0})  # fmt: skip


@pytest.fixture(scope="module")
def starts() -> np.ndarray:
    plane = {"x": 0, "y": [[-0.3, -0.15, 0.1], [0.0, 0.25, 0.4]], "p_y": 0.05}
    return henon_heiles().H.state_at_energy(1 / 8, plane)


# -- values ------------------------------------------------------------------------------------


def test_exponents_of_saddles_are_their_rates() -> None:
    """For -k x^2/2 they are sqrt(k) and -sqrt(k), to (log of a constant)/t."""
    k = np.array([[0.25, 1.0, 9.0], [4.0, 2.0, 1e-6]])
    found = hamsym.lyapunov(linear(1.0), [1e-200, 0.0], (0, 100), count=2, parameters={"k": -k})
    assert found.success.all()
    assert found.exponents.shape == (2, 3, 2)
    rates = np.sqrt(k)[..., None] * [1, -1]
    np.testing.assert_allclose(found.exponents, rates, atol=0.05)
    np.testing.assert_array_equal(found.maximal, found.exponents[..., 0])
    np.testing.assert_array_equal(found.parameters["k"], -k)


@pytest.mark.slow_cases("3-None", "1-gauss4")
@pytest.mark.parametrize(("count", "method"), [(1, None), (3, None), (1, "gauss4")])
def test_array_of_starts_is_loop_of_starts(
    starts: np.ndarray, count: int, method: str | None
) -> None:
    H, options = henon_heiles().H, {"steps": 1_000, "count": count, "method": method}
    together = hamsym.lyapunov(H, starts, (0, 150), **options)
    assert together.success.all()
    assert set(together.steps.ravel()) == {1_000}
    for index in np.ndindex(2, 3):
        alone = hamsym.lyapunov(H, starts[index], (0, 150), **options)
        np.testing.assert_allclose(together.exponents[index], alone.exponents[-1], atol=1e-10)
        assert together.energy_error[index] <= alone.energy_error * (1 + 1e-12)


@pytest.mark.slow
def test_parameters_are_those_of_a_loop(starts: np.ndarray) -> None:
    k = np.array([0.0, 0.7, 1.0])
    together = hamsym.lyapunov(ESCAPING, starts, (0, 100), parameters={"k": k}, steps=1_000)
    assert together.success.all()
    for index in np.ndindex(2, 3):
        H = ESCAPING.with_parameters(k=float(k[index[1]]))
        alone = hamsym.lyapunov(H, starts[index], (0, 100), steps=1_000)
        assert together.maximal[index] == pytest.approx(alone.maximal, abs=1e-10)
    one = hamsym.lyapunov(ESCAPING, starts[0, 0], (0, 100), parameters={"k": 0.7}, steps=1_000)
    alone = hamsym.lyapunov(ESCAPING.with_parameters(k=0.7), starts[0, 0], (0, 100), steps=1_000)
    np.testing.assert_array_equal(one.exponents, alone.exponents)


def test_chosen_steps_find_the_same_exponents(starts: np.ndarray) -> None:
    """Against a quarter of the step, where the motion is regular or the time short."""
    H = henon_heiles().H
    coarse = hamsym.lyapunov(H, starts, (0, 30))
    fine = hamsym.lyapunov(H, starts, (0, 30), steps=4 * int(coarse.steps.max()))
    np.testing.assert_allclose(coarse.exponents, fine.exponents, atol=1e-7)
    assert coarse.energy_error.max() < 1e-9


def test_chaos_and_order_are_told_apart() -> None:
    H = henon_heiles().H
    chaotic = H.state_at_energy(1 / 6, {"x": 0, "y": -0.15, "p_y": 0})
    found = hamsym.lyapunov(H, [chaotic, henon_heiles().z0], (0, 3_000))
    assert found.maximal[0] == pytest.approx(0.13, abs=0.04)
    assert found.maximal[1] < 5e-3


def test_explicit_time_and_backward_span() -> None:
    problem = driven_oscillator()
    back = np.array([problem.z0, 2 * np.array(problem.z0)])
    found = hamsym.lyapunov(problem.H, back, (10, -90))
    assert found.success.all()
    assert np.isnan(found.energy_error).all()
    alone = hamsym.lyapunov(problem.H, back[1], (10, -90), steps=int(found.steps[1]))
    assert found.maximal[1] == pytest.approx(alone.maximal, abs=1e-10)


@pytest.mark.slow
def test_no_separable_form_is_needed() -> None:
    problem = double_pendulum()
    both = np.array([problem.z0, 0.1 * np.array(problem.z0)])
    found = hamsym.lyapunov(problem.H, both, (0, 50), count=2)
    assert found.success.all()
    for start, exponents in zip(both, found.exponents, strict=True):
        alone = hamsym.lyapunov(problem.H, start, (0, 50), steps=20_000, count=2)
        np.testing.assert_allclose(exponents, alone.exponents[-1], atol=1e-3)


# -- steps -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_fast_members_do_not_slow_the_others() -> None:
    """Kepler orbits from the apocentre: the pericentre, far faster, comes later."""
    H, eccentricity = kepler().H, np.array([0.0, 0.5, 0.9])
    starts = {"x": 1 + eccentricity, "y": 0, "p_x": 0,
              "p_y": np.sqrt((1 - eccentricity) / (1 + eccentricity))}  # fmt: skip
    found = hamsym.lyapunov(H, starts, (0, 100))
    assert found.success.all()
    assert found.energy_error.max() < 1e-3
    assert found.steps[0] < found.steps[1] < found.steps[2]
    ratios = np.log2(found.steps / found.steps[0])
    np.testing.assert_allclose(ratios, ratios.round(), atol=0.01)
    assert found.maximal.max() < 0.2  # of regular motions


def test_too_long_given_steps_fail(starts: np.ndarray) -> None:
    options = {"method": "symplectic_euler", "dt": 0.3}
    found = hamsym.lyapunov(henon_heiles().H, starts, (0, 1e3), **options)
    assert not found.success.any()
    assert np.isnan(found.exponents).all()
    assert "of its scale: take a smaller dt" in found.message[0, 0]


def test_too_fast_motions_are_named() -> None:
    H = Hamiltonian("p**2/2 + k*x**2/2")
    found = hamsym.lyapunov(H, [1.0, 0.0], (0, 1e3), parameters={"k": [1.0, 1e40]})
    assert found.success.tolist() == [True, False]
    assert "the motion has rates up to 1.5e+20: give steps or dt" in found.message[1]


# -- failures ----------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"dt": 0.1}, {"count": 2}])
def test_bad_members_leave_others_unchanged(starts: np.ndarray, options: dict[str, object]) -> None:
    H = henon_heiles().H
    escaping = [0.0, 1.1, 0.0, 0.4]
    missing = H.state_at_energy(1 / 8, {"x": 0, "y": 0.9, "p_y": 0}, missing="nan")
    good = starts.reshape(-1, 4)
    mixed = np.concatenate((good[:2], [escaping, missing], good[2:]))
    alone = hamsym.lyapunov(H, good, (0, 60), **options)
    found = hamsym.lyapunov(H, mixed, (0, 60), **options)
    kept = np.array([0, 1, 4, 5, 6, 7])
    np.testing.assert_array_equal(found.exponents[kept], alone.exponents)
    np.testing.assert_array_equal(found.steps[kept], alone.steps)
    assert found.success.tolist() == [True] * 2 + [False] * 2 + [True] * 4
    assert np.isnan(found.exponents[2:4]).all()
    assert "the states overflowed, or a step could not be solved" in found.message[2]
    assert found.message[3] == "the start is not finite"
    assert "6 of 7 trajectories reached t = 60 (starts that are not finite: 1)" in found.statement
    assert "the first that failed is [2]: stopped after t = " in found.statement


def test_one_start_of_nan_is_rejected() -> None:
    with pytest.raises(InputError, match="'x' is not finite in z0"):
        hamsym.lyapunov("p**2/2 + x**2/2", [np.nan, 1.0], (0, 1))


def test_hessian_of_the_start_must_exist() -> None:
    found = hamsym.lyapunov("p**2/2 + 1/x", [[0.0, 1.0], [1.0, 1.0]], (0, 10))
    assert found.success.tolist() == [False, True]
    assert found.message[0] == "the Hessian of H is not finite at the start"


def test_division_into_chunks_does_not_matter(
    starts: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    H = henon_heiles().H
    whole = hamsym.lyapunov(H, starts, (0, 100), count=2)
    monkeypatch.setattr(lyapunov_map, "_HELD", 1)
    parts = hamsym.lyapunov(H, starts, (0, 100), count=2)
    np.testing.assert_array_equal(parts.exponents, whole.exponents)
    np.testing.assert_array_equal(parts.message, whole.message)


def test_ctrl_c_keeps_finished_members(starts: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    H = henon_heiles().H
    full = hamsym.lyapunov(H, starts, (0, 100))
    monkeypatch.setattr(lyapunov_map, "_HELD", 1)
    calls, original = [], Stepper.step

    def interrupted(self: Stepper, count: int) -> np.ndarray:
        calls.append(1)
        if len(calls) > 500:
            raise KeyboardInterrupt
        return original(self, count)

    monkeypatch.setattr(Stepper, "step", interrupted)
    with one_core():
        found = hamsym.lyapunov(H, starts, (0, 100))
    assert found.interrupted
    done = found.success
    assert done.ravel().tolist() == [True] * 2 + [False] * 4
    np.testing.assert_array_equal(found.exponents[done], full.exponents[done])
    assert set(found.message[~done]) == {"interrupted"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 5}, "count=5 cannot be used; give a whole number from 1 to 4"),
        ({"method": "tao2"}, "doubled phase space"),
        ({"method": "dop853"}, "dop853 is adaptive"),
        ({"dt": -1}, "dt=-1"),
        ({"parameters": {"k": 1.0}}, "'k' is not a parameter of H"),
    ],
)
def test_unusable_map_options_are_rejected(
    starts: np.ndarray, options: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        hamsym.lyapunov(henon_heiles().H, starts, (0, 10), **options)


# -- vectors and figures -----------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 4])
def test_vectors_are_those_of_each_member(count: int) -> None:
    vectors = np.random.default_rng(0).normal(size=(7, 4, count))
    found, growth = orthonormal(vectors)
    np.testing.assert_allclose(
        np.swapaxes(found, 1, 2) @ found, np.broadcast_to(np.eye(count), (7, count, count)),
        atol=1e-14,
    )  # fmt: skip
    areas = np.prod([np.linalg.svd(v, compute_uv=False) for v in vectors], axis=1)
    np.testing.assert_allclose(growth.sum(axis=1), np.log(areas), atol=1e-13)
    for one, q, g in zip(vectors, found, growth, strict=True):
        np.testing.assert_array_equal(q, orthonormal(one)[0])
        np.testing.assert_array_equal(g, orthonormal(one)[1])


def test_maps_are_drawn() -> None:
    H = henon_heiles().H
    y, p_y = np.meshgrid(np.linspace(-0.6, 0.8, 8), np.linspace(-0.6, 0.6, 5))
    plane = H.state_at_energy(1 / 8, {"x": 0, "y": y, "p_y": p_y}, missing="nan")
    assert np.isnan(plane[:, 0]).all()  # the axis is continued where there is no start
    found = hamsym.lyapunov(H, plane, (0, 20))
    axis = found.plot().axes[0]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("$y$", "$p_{y}$")
    mesh = axis.collections[0]
    np.testing.assert_array_equal(
        np.ma.filled(mesh.get_array(), np.nan).reshape(5, 8), found.maximal
    )
    corners = mesh.get_coordinates()
    np.testing.assert_allclose((corners[0, 1:, 0] + corners[0, :-1, 0]) / 2, y[0], atol=1e-12)
    np.testing.assert_allclose((corners[1:, 0, 1] + corners[:-1, 0, 1]) / 2, p_y[:, 0], atol=1e-12)


@pytest.mark.slow
def test_rows_are_drawn_over_a_parameter(starts: np.ndarray) -> None:
    k = np.linspace(0.5, 1.0, 4)
    found = hamsym.lyapunov(ESCAPING, starts[0, 0], (0, 20), parameters={"k": k})
    axis = found.plot().axes[0]
    assert axis.get_xlabel() == "$k$"
    np.testing.assert_array_equal(axis.lines[0].get_xdata(), k)
    np.testing.assert_array_equal(axis.lines[0].get_ydata(), found.maximal)
    cube = hamsym.lyapunov(ESCAPING, starts[None], (0, 20))
    with pytest.raises(InputError, match="shape .1, 2, 3. are neither a row nor a plane"):
        cube.plot()


@pytest.mark.slow_cases("implicit")
@pytest.mark.parametrize(
    ("terms", "start", "method"),
    [
        ("(x/a)**2/2 + (y/b)**2/2 + (x/a)**2*y/b - (y/b)**3/3", [0, -0.15, 0.5, 0], "gauss6"),
        ("(x/a)**4/4 + (y/b)**4/4 + (x*y/a/b)**2", [0, 0, 1, 0.3], "yoshida8"),
    ],
    ids=["implicit", "resting"],
)
def test_units_of_each_coordinate_change_no_exponent(
    terms: str, start: list[float], method: str
) -> None:
    """Of a start, too, where no force acts, from 0.042 to 0.27 before."""
    H = Hamiltonian(f"s/T*(((a*p_x/s)**2 + (b*p_y/s)**2)/2 + {terms})")
    found = []
    for a, b, s, T in ((1.0, 2.0**-60, 2.0**10, 1.0), (2.0**-33, 2.0**3, 2.0**-53, 2.0**-40)):
        map_ = hamsym.lyapunov(
            H,
            np.array([start]) * [a, b, s / a, s / b],
            (0, 100 * T),
            method=method,
            count=2,
            parameters={"a": a, "b": b, "s": s, "T": T},
        )
        assert map_.success.all()
        found.append(map_.exponents * T)
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)
    plain = H.with_parameters(a=1, b=1, s=1, T=1)
    own = hamsym.lyapunov(plain, [start], (0, 100), method=method, count=2)
    np.testing.assert_allclose(found[0], own.exponents, atol=0.01)
