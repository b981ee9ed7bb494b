"""Proven crossings: against 40-digit solutions, published ones, and what must be refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym import CertificationError, Hamiltonian, section
from hamsym.dynamics.proven_sections import prove_section
from hamsym.proof.arithmetic.ball import Ball

HENON_HEILES = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"
RESTRICTED = (
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y - (1-mu)/sqrt((x+mu)**2 + y**2)"
    " - mu/sqrt((x-1+mu)**2 + y**2)"
)
#: Hamiltonian, start, surface, g(t, z) and its rows: chosen so that crossings go both ways.
PROBLEMS: list[tuple[Any, list[float], str, Any]] = [
    (HENON_HEILES, [0.0, 0.1, 0.4, 0.1], "x = 0.05", lambda t, z: z[0] - mpmath.mpf(1) / 20),
    ("p**2/2 - cos(x)", [1.0, 0.25], "p*x = 0.2", lambda t, z: z[0] * z[1] - mpmath.mpf(1) / 5),
    ("p**2/2 + x**2/2 - x*sin(2*t)", [0.0, 0.0], "x = 0.125*t", lambda t, z: z[0] - 0.125 * t),
]


def _crossed_in_40_digits(H: Hamiltonian, z0: list[float], g: Any, end: float) -> list[mpmath.mpf]:
    """Times at which g changes its sign, from a Taylor solution and a search in 400 parts."""
    function = sympy.lambdify([*H.z, sympy.Symbol("t")], list(H.vector_field), "mpmath")
    with mpmath.workdps(40):
        solution = mpmath.odefun(lambda t, z: function(*z, t), 0, [mpmath.mpf(v) for v in z0])
        times = [mpmath.mpf(end) * k / 400 for k in range(1, 401)]
        values = [g(t, solution(t)) for t in times]
        return [
            mpmath.findroot(lambda t: g(t, solution(t)), (a, b), solver="anderson", tol=1e-35)
            for a, b, u, v in zip(times, times[1:], values, values[1:], strict=False)
            if u * v < 0
        ]


@pytest.mark.slow
@pytest.mark.parametrize(("H", "z0", "surface", "g"), PROBLEMS)
def test_crossings_of_40_digits_are_in_the_balls(
    H: Any, z0: list[float], surface: str, g: Any
) -> None:
    H = Hamiltonian(H)
    found = section(H, z0, (0, 12), surface, prove=True)
    assert found.success, found.message
    expected = _crossed_in_40_digits(H, z0, g, 12)
    t = found.certificate.t
    assert len(expected) == len(t.mid) >= 2
    for exact, middle, radius in zip(expected, t.mid.tolist(), t.radius.tolist(), strict=True):
        assert abs(exact - mpmath.mpf(middle)) <= radius < 1e-13


def test_published_half_period_of_a_lyapunov_orbit() -> None:
    H = Hamiltonian(RESTRICTED, parameters={"mu": 0.0009537})
    start = {"x": "0.9208034913207400196", "y": 0, "p_x": 0, "p_y": "1.025251164027650125854"}
    found = section(H, start, (0, 3), "y = 0", crossings=1, prove=True)
    half = found.certificate.t
    assert 1.5410595631933541 < half.lower[0] < half.upper[0] < 1.5410595631986368
    assert abs(found.certificate.z.mid[0, 2]) < 1e-12
    assert found.certificate.rising.tolist() == [0]


def test_crossings_of_a_rotation_are_known() -> None:
    found = section("p**2/2 + x**2/2", [0.6, 0.8], (0, 20), "x = 0", prove=True)
    exact = np.pi - np.arctan2(0.8, -0.6) + np.pi / 2 + np.pi * np.arange(-2, 8)
    exact = np.array([t for t in exact if 0 < t < 20])
    t = found.certificate.t
    assert np.all(np.abs(t.mid - exact) <= t.radius + 1e-14)
    # x = 0 and p = -1 or 1: dP/dz0 has the row of x zero, and p keeps its size
    assert np.abs(found.certificate.derivative.mid[:, 0]).max() < 1e-10
    along = found.certificate.derivative.mid[:, 1] * np.sign(found.z[:, 1])[:, None]
    np.testing.assert_allclose(along, np.tile([0.6, 0.8], (len(t.mid), 1)), atol=1e-10)


@pytest.mark.parametrize("end", [14.0, -14.0])
def test_starts_of_a_ball_cross_inside(end: float) -> None:
    z0 = [0.1, -0.1, 0.3, 0.2]
    balls = [Ball(value, 1e-4) for value in z0]
    found = section(HENON_HEILES, balls, (0, end), "y = 0.03", prove=True)
    assert found.success, found.message
    random = np.random.default_rng(5)
    for _ in range(10):
        start = np.array(z0) + 1e-4 * random.choice([-1, 1, 0.5], 4)
        inner = section(HENON_HEILES, start, (0, end), "y = 0.03")
        assert len(inner.t) == len(found.t) >= 2
        t, z = found.certificate.t, found.certificate.z
        assert (np.abs(inner.t - t.mid) <= t.radius + 1e-12).all()
        assert (np.abs(inner.z - z.mid) <= z.radius + 1e-12).all()
        # The times move with the starts: the balls are not much wider than the states.
        assert t.radius.max() < 0.01


def test_derivatives_are_those_of_the_poincare_map() -> None:
    z0, step = np.array([0.1, -0.1, 0.3, 0.2]), 1e-6
    found = section(HENON_HEILES, z0, (0, 9), "y = 0.03, p_y > 0", prove=True)
    for k in range(4):
        aside = [
            section(HENON_HEILES, z0 + sign * step * np.eye(4)[k], (0, 9), "y = 0.03, p_y > 0").z
            for sign in (1, -1)
        ]
        slopes = (aside[0] - aside[1]) / (2 * step)
        np.testing.assert_allclose(found.certificate.derivative.mid[..., k], slopes, atol=1e-5)


def test_directions_conditions_limits_and_several_starts() -> None:
    starts = np.array([[0.0, 0.1, 0.4, 0.1], [0.1, 0.1, 0.3, 0.1]])
    for options in ({"direction": 1}, {"direction": -1}, {"crossings": 2}, {}):
        for span in ((0, 20), (3, -17)):
            found = section(HENON_HEILES, starts, span, "x = 0.01, p_x*y < 0.3", **options)
            proven = section(
                HENON_HEILES, starts, span, "x = 0.01, p_x*y < 0.3", prove=True, **options
            )
            assert proven.success, proven.message
            t = proven.certificate.t
            assert len(t.mid) == len(found.t) > 2
            assert (np.abs(t.mid - found.t) <= t.radius + 1e-10).all()
            rising = proven.certificate.rising
            assert (found.z[:, 2] * (1 if span[1] > 0 else -1) > 0).tolist() == rising.tolist()


def test_varied_parameters_and_forces() -> None:
    H = Hamiltonian("p**2/2 - k*cos(x)", parameters={"k": 1.0}, forces={"p": "-p/10"})
    found = section(
        H, [1.0, 0.0], (0, 9), "x = 0.1", parameters={"k": np.array([1.0, 2.0])}, prove=True
    )
    assert found.success, found.message
    assert len(found.certificate.t.mid) == len(found.t) == 7


@pytest.mark.parametrize(
    ("z0", "span", "surface", "message"),
    [
        ([1, 0], (0, 9), "x = 1", "may be touched, or crossed along it, near t = 0"),
        ([0.0, 1.0], (0, 2 * np.pi), "x = 0", "within round-off of an end of the span"),
        ([0.5, 1.0], (0, 7), "abs(x) = 0.1", "the surface contains 'abs'"),
        (["0.1 +- 0.05", 1], (0, 7), "x = 0.1", "the ball of the start meets x = 0.1"),
        (["0 +- 0.9", 1], (0, 7), "x = 1.2", "near t ="),
        ([0.5, 1.0], (0, 7), "x**2 + p**2 = 1.25", "not proven"),
        ([0.6, 0.8], (0, 7), "x**2 + p**2 = 1", "not proven"),
    ],
)
def test_what_is_not_proven_is_no_success(
    z0: Any, span: tuple[float, float], surface: str, message: str
) -> None:
    found = section("p**2/2 + x**2/2", z0, span, surface, prove=True)
    assert not found.success
    assert found.certificate is None
    assert message in found.message or "may be crossed more often" in found.message


def test_a_start_on_the_surface_is_no_crossing() -> None:
    found = section("p**2/2 + x**2/2", [0, 1], (0, 7), "x = 0", prove=True)
    assert found.success
    np.testing.assert_allclose(found.certificate.t.mid, [np.pi, 2 * np.pi])


def test_files_and_verification(tmp_path: Path) -> None:
    found = section("p**2/2 - cos(x)", ["1 +- 1e-6", 0], (0, 9), "x = 0", prove=True)
    found.save(tmp_path / "section.hamsym")
    loaded = hamsym.load(tmp_path / "section.hamsym")
    hamsym.verify(loaded.certificate, tmp_path / "section.hamsym")
    claim = loaded.certificate
    narrower = Ball(claim.t.mid, claim.t.radius / 1.5)
    forged = [
        replace(claim, t=narrower),
        replace(claim, z=Ball(claim.z.mid + 1e-3, claim.z.radius)),
        replace(claim, derivative=Ball(claim.derivative.mid, claim.derivative.radius / 1.5)),
        replace(claim, rising=1 - claim.rising),
        replace(claim, starts=Ball(claim.starts.mid, claim.starts.radius * 2)),
        replace(claim, statement="the exact solution never crosses x = 0"),
        replace(claim, limit=1),
        replace(claim, direction=1.0),
    ]
    for other in forged:
        with pytest.raises(CertificationError):
            hamsym.verify(other, loaded)
    with pytest.raises(CertificationError, match="other starts"):
        hamsym.verify(claim, section("p**2/2 - cos(x)", [1.1, 0], (0, 9), "x = 0"))
    assert "proven" in found.summary()


def test_statements_say_direction_and_span() -> None:
    rising = section("p**2/2 + x**2/2", [0, 1], (0, 20), "x = 0", direction=1, prove=True)
    assert "3 times after the start for t from 0.0 to 20.0, rising," in rising.certificate.statement
    short = section("p**2/2 + x**2/2", [0, 1], (0, 9.424777), "x = 0", prove=True)
    assert "2 times after the start for t from 0.0 to 9.424777, " in short.certificate.statement
    first = section("p**2/2 + x**2/2", [0, 1], (0, 20), "x = 0", crossings=1, prove=True)
    assert "for t" not in first.certificate.statement


def test_certificates_do_not_hold_for_other_crossings() -> None:
    found = section("p**2/2 + x**2/2", [1, 0], (0, 10), "x = 0", prove=True)
    for changed in ({"z": found.z + 5.0}, {"t": found.t * 0.5, "dt": 1e3}):
        with pytest.raises(CertificationError, match="the section has"):
            found.certificate.verify(replace(found, **changed))


def test_fewer_crossings_than_the_limit_are_proven_over_the_span() -> None:
    found = section("p**2/2 + x**2/2", [0, 1], (0, 50), "x = 0", prove=True)
    fewer = replace(found, t=found.t[:3], z=found.z[:3], trajectory=found.trajectory[:3])
    with pytest.raises(CertificationError, match="has 5 crossings by the proof and 3"):
        prove_section(fewer, found.certificate.starts, 0.0, 5)
    assert len(prove_section(fewer, found.certificate.starts, 0.0, 3).t.mid) == 3


def test_certificates_without_crossings_are_no_claim(tmp_path: Path) -> None:
    found = section("p**2/2 + x**2/2", [1, 0], (0, 10), "x = 0", prove=True)
    empty = replace(found.certificate, limit=0)
    with pytest.raises(hamsym.HamsymError, match="limit"):
        hamsym.save(replace(found, certificate=empty), tmp_path / "none.hamsym")
