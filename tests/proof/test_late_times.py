"""Proofs far from t = 0, where float64 times have few digits of an angle."""

import re

import mpmath
import numpy as np
import pytest

import hamsym
from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel.enclosures import REDUCED_ANGLE, Models, enclosures
from hamsym.proof.arithmetic.programs import ModelRows
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.guessed_windows import still_values

_LATE = 1e8


def _driven(t0: float, s: float) -> list[mpmath.mpf]:
    """x and p of x'' = cos(t) - x at t0 + s, from x = 1, p = 0 at t0."""
    t0, s = mpmath.mpf(t0), mpmath.mpf(s)
    x = mpmath.cos(s) + s * mpmath.sin(t0 + s) / 2
    x += (mpmath.cos(s + t0) - mpmath.cos(s - t0)) / 4
    p = -mpmath.sin(s) + mpmath.sin(t0 + s) / 2 + s * mpmath.cos(t0 + s) / 2
    return [x, p + (mpmath.sin(s - t0) - mpmath.sin(s + t0)) / 4]


@pytest.mark.parametrize("t0", [-_LATE, 3.0, _LATE, 1e11])
def test_enclosure_at_late_times_contains_the_exact_solution(t0):
    enclosure = hamsym.enclose("p**2/2 + x**2/2 - x*cos(t)", [1, 0], (t0, t0 + 10))
    assert len(enclosure.windows) < 10
    with mpmath.workdps(60):
        for s in (0.0, 2.5, 10.0):
            ball = enclosure(t0 + s)
            assert (ball.radius < 1e-15).all()
            for mid, radius, exact in zip(ball.mid, ball.radius, _driven(t0, s), strict=True):
                assert abs(mpmath.mpf(mid) - exact) <= mpmath.mpf(radius)


#: Of the period 42 pi in t.
_FORMULAS = [
    "p**2/2 - cos(x - t)",
    "p**2/2 - cos(2*(x - t)/3 + 1)*(1 + sin(t)*cos(x)/3)",
    "p**2/2 + x**2*(1 + exp(-sin(t/7)**2)/5)/2",
]


@pytest.mark.parametrize("formula", _FORMULAS)
def test_late_enclosure_meets_that_of_the_same_phase(formula):
    with mpmath.workdps(60):
        phase = mpmath.nstr(mpmath.fmod(mpmath.mpf(_LATE), 42 * mpmath.pi), 50)
    early = re.sub(r"\bt\b", f"(t + {phase})", formula)
    late, same = (
        hamsym.enclose(text, [1, 0.5], (t0, t0 + 5))(t0 + 5)
        for text, t0 in ((formula, _LATE), (early, 0.0))
    )
    assert (late.radius < 1e-14).all()
    assert (np.abs(late.mid - same.mid) <= late.radius + same.radius).all()


def test_error_at_late_times_is_proven():
    solution = hamsym.solve("p**2/2 + x**2/2 - x*cos(t)", [1, 0], (_LATE, _LATE + 5), tol=1e-7)
    certificate = solution.certify()
    with mpmath.workdps(60):
        times = _LATE + np.linspace(0, 5, 41)
        error = max(
            mpmath.norm([a - b for a, b in zip(solution(t).tolist(), exact, strict=True)])
            for t in times.tolist()
            for exact in [_driven(_LATE, t - _LATE)]
        )
    assert float(error) <= certificate.bound * (1 + 1e-6) + 1e-15
    assert certificate.lower <= certificate.bound <= 1.02 * certificate.lower


def test_functions_of_time_alone_are_not_repeated():
    rates = Equation(Hamiltonian("p**2/2 + x**2/2 - x*cos(t)*exp(-sin(t))")).rates
    assert len(rates.steps) == 1  # the sum of -x and the force
    models = ModelRows(rates, 32)
    models.set_line(2, (_LATE, 0.0, 0.0), (0.5, 0.0, 0.0))
    models.run_still()
    values = still_values(models)
    assert np.isfinite(values).all()


def reduce(high, low, radius, length):
    """Make the second model that of the reduced angle of the first."""
    program, none = np.array([[REDUCED_ANGLE, 1, 0, 0]]), np.empty((0, 0))
    models = Models(none, none, high, low, radius, length)
    enclosures().run_models(program, models, twice=True)


@pytest.mark.parametrize("turns", [0, 1, -7, 10**9, 2**49])
def test_reduced_angle_contains_the_exact_one(turns):
    high, low = np.zeros((2, 2, 4))
    radius, length = np.zeros(2), np.array([3, 1])
    high[0, :3] = 2 * np.pi * turns + 0.5, 0.25, 1e-3
    low[0, 0] = 1e-20 * high[0, 0]
    reduce(high, low, radius, length)
    assert (high[1, 1:], length[1]) == (pytest.approx(high[0, 1:]), 3)
    with mpmath.workdps(60):
        exact = mpmath.mpf(high[0, 0]) + mpmath.mpf(low[0, 0]) - 2 * mpmath.pi * turns
        found = mpmath.mpf(high[1, 0]) + mpmath.mpf(low[1, 0])
        assert abs(exact - found) <= mpmath.mpf(radius[1])
    assert radius[1] <= 1e-280 + 1e-29 * abs(turns)


@pytest.mark.parametrize("angle", [1e17, np.inf, np.nan])
def test_angle_of_too_many_turns_has_no_bound(angle):
    high, low, radius = np.array([[angle], [0.0]]), np.zeros((2, 1)), np.zeros(2)
    reduce(high, low, radius, np.array([1, 1]))
    assert not radius[1] < np.inf
