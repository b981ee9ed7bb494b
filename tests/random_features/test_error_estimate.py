"""The estimate of a march's error: where it ends, and its floor of round-off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym import Hamiltonian
from hamsym.random_features.basis import FeatureBasis, feature_basis
from hamsym.random_features.error_estimate import (
    FINE,
    Estimate,
    MarchError,
    error_tables,
    estimate_error,
)
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import march
from hamsym.random_features.members import checked_accuracy
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.window_error import _dense
from hamsym.systems import CATALOGUE

EXTENDED = np.finfo(np.longdouble).eps < 1e-18


def _extended_residuals(windows: March, basis: FeatureBasis, field: Any) -> Iterator[np.ndarray]:
    """The residual of each window at its places in extended precision, shape (dim, places)."""
    place = error_tables(basis)["place"].astype(np.longdouble)
    values, slopes = basis.columns(place)
    for w, readout in enumerate(windows.readouts.astype(np.longdouble)):
        length = np.longdouble(windows.edges[w + 1]) - np.longdouble(windows.edges[w])
        z = (windows.states[w].astype(np.longdouble) + values @ readout).T
        rates = np.stack([np.broadcast_to(row, z.shape[1:]) for row in field(*z)])
        yield ((slopes @ readout / length).T - rates).astype(float)


def _estimate_with(residuals: Iterator[np.ndarray], *found: Any) -> MarchError:
    """Estimate with given residuals in place of those in float64."""
    return estimate_error(*found, residuals=np.array([*residuals])).error


@pytest.mark.slow_cases(
    "p**2/2 - x**2/2-z02-span2",
    "p**2/2 + x**2/2-z00-span0",
    "p**2/2 - cos(x)-z01-span1",
    "(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3-z03-span3",
    "(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)-z05-span5",
)
@pytest.mark.skipif(not EXTENDED, reason="this processor has no extended precision")
@pytest.mark.parametrize(
    ("formula", "z0", "span"),
    [
        ("p**2/2 + x**2/2", [1.0, 0.0], (0, 300)),
        ("p**2/2 - cos(x)", [2.5, 0.0], (0, 200)),
        ("p**2/2 - x**2/2", [1.0, 0.3], (0, 20)),
        ("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3", [0.3, -0.3, 0.3, 0.15], (0, 200)),
        ("(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)", [0.4, 0.0, 0.0, 2.0], (0, 30)),
        ("(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)", [0.01, 0.0, 0.0, 14.1067], (0, 10)),
    ],
)
def test_floor_is_above_the_round_off_of_the_estimate(
    formula: str, z0: list[float], span: tuple[float, float]
) -> None:
    """The estimate omits round-off in the residual; the floor represents it."""
    H, ratios = Hamiltonian(formula), []
    field = sympy.lambdify(H.z, list(H.vector_field), "numpy")
    for seed in range(4):
        windows = hamsym.solve(H, z0, span, tol=1e-11, seed=seed).record
        found = windows, feature_basis(seed), flow_of(H)
        error = estimate_error(*found).error
        better = _estimate_with(_extended_residuals(*found[:2], field), *found)
        change = error.series - better.series
        missed = np.abs(_dense(change.shape[1]) @ change).max(axis=(0, 1))
        assert (error.floors.max(axis=0) >= missed).all()
        ratios.append((error.floors.max(axis=0) / missed).max())
    # Signs of the rounding errors are a matter of luck: of several, one is not lucky.
    assert min(ratios) < 30


def test_roundings_beside_the_edge_of_a_domain_are_finite() -> None:
    """The root of (t - 3.3)**2, written out, is that of a negative number with other roundings."""
    H = Hamiltonian("p**2/2 + x**2/2 + x*sqrt(t**2 - 6.6*t + 10.89)/10")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 10), tol=1e-11)
    assert solution.success, solution.message


def test_estimate_of_chaos_ends_with_the_motion() -> None:
    """The tangent map of this orbit overflows; inf - inf once counted as no error."""
    H = Hamiltonian("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
    solution = hamsym.solve(H, {"x": 0, "y": -0.15, "px": 0.5555, "py": 0}, (0, 3000), tol=1e-6)
    assert not solution.success
    assert "met only until t = " in solution.message
    assert "errors grow too large for an estimate by t = " in solution.message
    assert np.isinf(solution.error_estimate(2999.0)).all()
    assert np.isfinite(solution.error_estimate(10.0)).all()
    assert np.isinf(solution.relative_error)


def test_allowed_error_is_relative_to_the_true_size() -> None:
    # Where the computed motion is as much larger than the true one as the error allows.
    for tol in (0.9, 0.3, 1e-2):
        accuracy = checked_accuracy(tol, 0.0, None, (0.0, 1.0), 2)
        computed = np.array([1.0, 5.0])
        allowed = accuracy.allowed(computed)
        np.testing.assert_allclose(allowed, tol * (computed - allowed), rtol=1e-14)


# -- large errors beside a pole --------------------------------------------------------------------

KEPLER = Hamiltonian("(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)")


def _ellipse(e: float, start: float, end: float, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and exact states of an orbit of semi-major axis 1 between two eccentric anomalies.

    The orbit is that of its rounded first state: beside the pole the difference is large.
    """
    exact = np.longdouble
    q, p = _on_ellipse(e, np.array([start]), np.sqrt(1 - e**2), turn)
    (x, y), (px, py) = q.ravel().astype(exact), p.ravel().astype(exact)
    r, square, radial = np.hypot(x, y), px**2 + py**2, x * px + y * py
    a = 1 / (2 / r - square)
    pole = (square - 1 / r) * x - radial * px, (square - 1 / r) * y - radial * py
    e = np.hypot(*pole)
    first = np.arctan2(radial / np.sqrt(a), 1 - r / a)
    anomaly = first + np.linspace(0, end - start, 20_001)
    b = abs(x * py - y * px) / np.sqrt(a)
    q, p = _on_ellipse(e, anomaly, b, np.arctan2(pole[1], pole[0]))
    moments = a**1.5 * (anomaly - first - e * (np.sin(anomaly) - np.sin(first)))
    q, p = a * q, p / np.sqrt(a)
    times = moments.astype(float)
    rates = np.concatenate((p, -q / np.hypot(*q) ** 3))
    return times, (np.concatenate((q, p)) + rates * (times - moments)).T.astype(float)


def _on_ellipse(e: Any, anomaly: np.ndarray, b: Any, turn: Any) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and momenta on an ellipse of semi-axes 1 and b."""
    r = 1 - e * np.cos(anomaly)
    q = np.stack((np.cos(anomaly) - e, b * np.sin(anomaly)))
    p = np.stack((-np.sin(anomaly), b * np.cos(anomaly))) / r
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return turned @ q, turned @ p


def _share_of_allowed(solution: Any, times: np.ndarray, exact: np.ndarray, tol: float) -> float:
    return float((np.abs(solution(times) - exact) / np.abs(exact).max(axis=0)).max() / tol)


def test_error_is_followed_through_many_close_passages() -> None:
    """It grows by orders of magnitude and shrinks again in each of them."""
    times, exact = _ellipse(0.9965, 3.9, 3.9 + 28 * np.pi, 4.75)
    for tol in (1e-2, 1e-4):
        solution = hamsym.solve(KEPLER, exact[0], (0, times[-1]), tol=tol)
        assert solution.success, solution.message
        errors = np.abs(exact - solution(times)).max(axis=0)
        estimated = np.abs(solution.error_estimate(times)).max(axis=0)
        np.testing.assert_allclose(estimated, errors, rtol=0.05)


@pytest.mark.parametrize(
    ("seed", "cases"),
    [(11, 8), *(pytest.param(seed, 60, marks=pytest.mark.slow) for seed in (5, 6))],
)
def test_success_on_eccentric_orbits_is_true(seed: int, cases: int) -> None:
    generator, successes = np.random.default_rng(seed), 0
    for _ in range(cases):
        e, tol = 1 - 10 ** generator.uniform(-4, -1.3), 10 ** generator.uniform(-6, -1.5)
        start, turn = generator.uniform(0, 2 * np.pi, 2)
        times, exact = _ellipse(e, start, start + generator.uniform(1, 80), turn)
        solution = hamsym.solve(KEPLER, exact[0], (0, times[-1]), tol=tol)
        successes += solution.success
        if solution.success:
            assert _share_of_allowed(solution, times, exact, tol) <= 1, (e, start, turn, tol)
            errors = np.abs(exact - solution(times)).max(axis=0)
            assert (errors <= solution.error.largest).all(), (e, start, turn, tol)
    assert successes > cases / 2


def _estimated(eccentricity: float, end: float, local: float) -> tuple[Estimate, Any, Any]:
    """Return the estimate of a march from the apocentre, with times and errors."""
    times, exact = _ellipse(eccentricity, np.pi, 7 * np.pi, 0.0)
    times, exact = times[times < end], exact[times < end]
    flow, basis = flow_of(KEPLER), feature_basis(0, 16)
    with np.errstate(all="ignore"):
        windows = march(flow, exact[0], (0.0, end), local, basis, longest=end / 8)
        found = estimate_error(windows, basis, flow, local)
    trial = FeatureTrial.of_march(windows, basis.series)
    return found, times, np.abs(trial.states_at(times) - exact)


@pytest.mark.parametrize(
    ("eccentricity", "local"),
    [(0.9, 0.1), (0.994, 1e-3), (0.995, 3e-3), (0.998, 3e-4), (0.99, 1e-8)],
)
def test_errors_of_the_size_of_the_distance_are_followed(eccentricity: float, local: float) -> None:
    """They change the force beyond first order, and are up to a third of the orbit here."""
    found, _, error = _estimated(eccentricity, 9.0, local)
    assert found.limit == ""
    share = found.error.largest / error.max(axis=0)
    assert (share >= 1).all()
    assert (share <= 1.2).all()


@pytest.mark.parametrize(
    ("eccentricity", "end", "local"), [(0.998, 10.0, 1e-3), (0.98, 19.0, 1e-2), (0.994, 19.0, 1e-3)]
)
def test_estimate_ends_where_errors_are_as_large_as_the_motion(
    eccentricity: float, end: float, local: float
) -> None:
    found, times, error = _estimated(eccentricity, end, local)
    assert "errors grow too large for an estimate" in found.limit
    assert np.isinf(found.error.largest).all()
    held = found.error.until(np.full(4, np.inf))
    # Before that time the estimate is right.
    some = times < 0.999 * held
    estimated = np.abs(found.error(times[some])) + found.error.floor(times[some])
    assert 0 < held < end
    assert (error[some].max(axis=0) <= 1.1 * estimated.max(axis=0)).all()
    assert np.isfinite(found.linear).all()


@pytest.mark.parametrize("local", [1e-6, 1e-8, 1e-9])
def test_error_in_long_windows_is_resolved(local: float) -> None:
    """Windows of a march to a loose tolerance are long, and their residuals oscillate fast."""
    flow = flow_of(CATALOGUE["double_pendulum"]().H.with_parameters(g=1))
    basis, found = feature_basis(0, 16), 0
    for z0 in np.random.default_rng(1).uniform(-2, 2, (12, 4)):
        windows = march(flow, z0, (0.0, 20.0), local, basis, longest=2.5)
        usual = estimate_error(windows, basis, flow, local)
        fine = estimate_error(windows, basis, flow, local, resolution=FINE)
        if not usual.limit:
            t = np.linspace(0, 20, 2_001)
            error, exact = usual.error(t), fine.error(t)
            assert (np.abs(error - exact).max(axis=0) <= 0.01 * np.abs(exact).max(axis=0)).all()
            found += 1
    assert found >= 9


@pytest.mark.parametrize("start", ["0.7", "3.3", "47.1", "-5.3"])
def test_rounded_times_at_which_H_switches_are_in_the_estimate(start: str) -> None:
    """The impulse of a short pulse is known as well as its two times are."""
    middle = float(start)
    with mpmath.workdps(40):
        first, last = mpmath.mpf(start), mpmath.mpf(start) + mpmath.mpf("1e-8")
        pulse = f"Heaviside(t - ({start}))*Heaviside({mpmath.nstr(last, 15)} - t)"
        x, p, begun = mpmath.mpf(1), mpmath.mpf(0), mpmath.mpf(middle - 1)
        for end, force in ((first, 0), (last, 10**6), (mpmath.mpf(middle + 1), 0)):
            c, s, from_rest = mpmath.cos(end - begun), mpmath.sin(end - begun), x + force
            x, p, begun = from_rest * c + p * s - force, p * c - from_rest * s, end
    H, span = f"p**2/2 + x**2/2 + 1e6*x*{pulse}", (middle - 1, middle + 1)
    solution = hamsym.solve(H, [1, 0], span, tol=1e-5)
    assert solution.success, solution.message
    error = np.abs(solution(span[1]) - [float(x), float(p)])
    assert (error > 1e-13).all()
    assert (error <= solution.largest_error).all()


def test_hessian_that_is_not_finite_ends_the_estimate() -> None:
    formula = "(px**2 + py**2 + pz**2)/2 + (x**2 + y**2)**(3/2) + z**2/2"
    z0 = {"x": 0, "y": 0, "z": 1, "px": 0, "py": 0, "pz": 0}
    solution = hamsym.solve(formula, z0, (0, 10))
    assert not solution.success
    assert "the Hessian of H is not finite near t = 0" in solution.message


@pytest.mark.parametrize("end", [48, 50, 60])
def test_march_that_reached_further_is_returned(end: float) -> None:
    """Leaving the equilibrium on one side or the other is decided by the last digits."""
    solution = hamsym.solve("p**2/2 - cos(x)", [np.pi - 1e-6, 0.0], (0, end), tol=1e-4)
    assert solution.span == (0, end)
    assert not solution.success
    assert "limited by float64 round-off" in solution.message


# -- round-off of formulas whose terms cancel ------------------------------------------------------


@pytest.mark.parametrize(
    ("formula", "parameters", "start", "end", "tol"),
    [
        # Of exp(x) - 1 few digits are left, or none, although x has sixteen.
        ("p**2/2 + exp(x) - x", {}, 1e-17, 3, 1e-3),
        ("p**2/2 + exp(x) - x", {}, 1e-13, 3, 1e-6),
        # Roundings of 1/3 and 1/9, and of w**2, push all windows the same way.
        ("p**2/2 + x/3 - 2*(1/9 + x)**(3/2)/3", {}, 1e-12, 3, 1e-3),
        ("p**2/2 + (k - w**2)*x**2/2", {"k": 1.0, "w": 0.9999999}, 1.0, 1e6, 1e-9),
    ],
)
def test_roundings_of_terms_that_cancel_are_in_the_estimate(
    formula: str, parameters: dict[str, float], start: float, end: float, tol: float
) -> None:
    """The motion is linear; its frequency is the root of the second derivative of H at rest."""
    H = Hamiltonian(formula, parameters=parameters, q=["x"], p=["p"])
    solution = hamsym.solve(H, [start, 0.0], (0, end), tol=tol)
    form = H.real_equations
    exact = {symbol: sympy.Rational(value) for symbol, value in form.parameters.values()}
    stiffness = sympy.diff(form.expr, form.z[0], 2).subs({**exact, form.z[0]: 0})
    with mpmath.workdps(40):
        w = mpmath.sqrt(mpmath.mpf(str(stiffness.evalf(40))))
        true = start * mpmath.cos(w * end), -start * w * mpmath.sin(w * end)
        error = [float(abs(x - y)) for x, y in zip(solution(end), true, strict=True)]
    assert (error <= solution.largest_error).all()


@pytest.mark.parametrize("n", [2, 3, 100])
def test_exponents_by_parameters_may_have_bases_of_both_signs(n: int) -> None:
    """n - 1 is exact; another exponent would make powers of negative x complex."""
    start, span = [0.5, 1.0], (0, 3)
    H = Hamiltonian("p**2/2 + x**2 + x**n/n", parameters={"n": float(n)}, q=["x"], p=["p"])
    solution = hamsym.solve(H, start, span)
    assert solution.success, solution.message
    other = hamsym.solve(f"p**2/2 + x**2 + x**{n}/{n}", start, span)
    t = np.linspace(*span, 50)
    np.testing.assert_allclose(solution(t), other(t), atol=2e-9 * solution.error.scale.max())


# -- the origin of time ----------------------------------------------------------------------------


@pytest.mark.parametrize("start", [1e7, -1e7, 12345.678])
def test_late_starts_change_nothing(start: float, tmp_path) -> None:
    H, z0 = Hamiltonian("p**2/2 - cos(x)"), [1.0, 0.5]
    early = hamsym.solve(H, z0, (0, 20), tol=1e-10)
    late = hamsym.solve(H, z0, (start, start + 20), tol=1e-10)
    assert late.success, late.message
    t = start + np.linspace(0, 20, 101)
    np.testing.assert_allclose(late(t), early(t - start), atol=1e-9)
    np.testing.assert_allclose(
        late.sensitivity(t[50]), early.sensitivity(t[50] - start), rtol=1e-6, atol=1e-6
    )
    assert late.events("x = 0").t_events[0] - start == pytest.approx(
        early.events("x = 0").t_events[0], abs=1e-7
    )
    late.save(tmp_path / "late.hamsym")
    again = hamsym.load(tmp_path / "late.hamsym")
    np.testing.assert_array_equal(again(t), late(t))
    np.testing.assert_array_equal(again.error_estimate(t), late.error_estimate(t))


def test_late_start_is_certified() -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1.0, 0.0], (1e6, 1e6 + 4), tol=1e-9)
    certificate = solution.certify()
    assert certificate.lower <= certificate.bound < 1e-9
    hamsym.verify(certificate, solution)
