"""Audit of solve: success and error estimates are compared with references."""

from __future__ import annotations

import math

import mpmath
import pytest
from flint import arb

from hamsym.proof.arithmetic.balls import working

from .judging import Verdict, complaints, judged, references
from .systems import BY_NAME, SYSTEMS, System
from .taylor import Equations, integrate

_CASES = [
    pytest.param(
        system,
        tol,
        id=f"{system.name}-{tol:.0e}",
        marks=() if tol in system.fast else pytest.mark.slow,
    )
    for system in SYSTEMS
    for tol in system.tols
]


@pytest.mark.slow_cases(
    "kapitza-1e-08",
    "blow_up_quartic-1e-08",
    "toda_ring_12-1e-08",
    "stiff_spring_pendulum-1e-04",
    "diatomic_molecule_si-1e-08",
    "fall_into_centre-1e-08",
    "two_centres-1e-08",
    "kepler_si_polar-1e-06",
    "square_wave-1e-08",
    "kepler_0.999-1e-04",
    "phi_four_6-1e-04",
    "kepler_polar_0.95-1e-08",
    "kepler_si_polar_eccentric-1e-09",
    "rounded_abs_1e-10-1e-08",
    "henon_heiles_300-1e-11",
    "cone_through_apex-1e-08",
    "kink_quartic_root-1e-08",
    "kink_expanded_square-1e-08",
    "blow_up_plane-1e-04",
    "kink_quartic_root_quartic-1e-02",
    "kink_quartic_root_met-1e-03",
    "kink_quartic_root-1e-04",
    "kink_quartic_root_plane-1e-04",
    "scatterer_after_flight-1e-06",
    "scatterer_after_flight_0.1-1e-06",
    "pythagorean_10-1e-04",
)
@pytest.mark.parametrize(("system", "tol"), _CASES)
def test_success_and_estimate_are_true(system: System, tol: float) -> None:
    assert complaints(system, tol, judged(system, tol)) == []


def test_references_match_the_systems() -> None:
    stored = references()
    for system in SYSTEMS:
        if system.reference != "none":
            assert stored[system.name]["of"] == system.fingerprint, system.name
            assert stored[system.name]["agreement"] < 0.01 * min(system.tols), system.name
    assert set(stored) <= {system.name for system in SYSTEMS}


@pytest.mark.parametrize(
    ("verdict", "word"),
    [
        (Verdict(success=True, estimate=0.5, truth=1.1), "allowed error"),
        (Verdict(success=True, estimate=0.5, truth=math.inf), "allowed error"),
        (Verdict(success=True, estimate=0.5, truth=math.nan), "allowed error"),
        (Verdict(success=True, estimate=0.01, truth=0.9), "estimate"),
        (Verdict(success=True, estimate=0.9, truth=0.01, judgeable=True), "estimate"),
        (Verdict(success=True, estimate=math.nan, truth=0.01), "estimate"),
        (Verdict(message="stopped at t = 1"), "refused"),
        (Verdict(message="no time"), "without a time"),
        (Verdict(message="held until t = 2", held=30.0), "said to hold"),
        (Verdict(raised="LinAlgError: Singular matrix"), "raised"),
        (Verdict(raised="InputError: a. b", message="t = 1. b"), "not one sentence"),
    ],
)
def test_judge_reports_each_defect(verdict: Verdict, word: str) -> None:
    system = BY_NAME["kepler_0.9"]
    assert any(word in found for found in complaints(system, 1e-4, verdict))


def test_judge_accepts_correct_solve() -> None:
    verdict = Verdict(success=True, estimate=0.5, truth=0.4, judgeable=True)
    assert complaints(BY_NAME["kepler_0.9"], 1e-4, verdict) == []


def test_taylor_series_solve_oscillator() -> None:
    equations = Equations("p**2/2+x**2/2", ("x",), ("p",))
    found = integrate(equations, [1.0, 0.0], 0.0, [1.0, 30.0]).states[1]
    with mpmath.workdps(40), working(128):
        exact = [arb(mpmath.nstr(value, 35)) for value in (mpmath.cos(30), -mpmath.sin(30))]
        assert max(abs(float(a - b)) for a, b in zip(found, exact, strict=True)) < 1e-26


def test_every_class_has_a_fast_case() -> None:
    kinds = {system.kind for system in SYSTEMS}
    assert {system.kind for system in SYSTEMS if system.fast} == kinds


def test_listed_tolerances_are_solved() -> None:
    for system in SYSTEMS:
        listed = {*system.fast, *system.must_succeed, *system.must_refuse}
        assert listed <= set(system.tols), system.name
        assert not set(system.must_succeed) & set(system.must_refuse), system.name
        assert system.word or not system.must_refuse, system.name
