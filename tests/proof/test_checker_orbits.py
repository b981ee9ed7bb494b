"""The independent checker of periodic orbits: what it accepts, and forgeries that it refuses."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import hamsym
from hamsym.problems.description import described
from hamsym.proof.checker.formulas import NotProvenError
from hamsym.proof.checker.orbits import _Orbit, check_orbit
from hamsym.proof.independent import _orbit_data
from tests.orbits.test_periodic_orbit import ACROSS, HENON_HEILES, RESTRICTED

QUARTIC = "p**2/2 + x**2/2 + x**4/4"
COUPLED = (
    "(p_x**2 + p_y**2 + p_z**2)/2 + x**2/2 + x**4/4 + 0.3*y**2 + 0.7*z**2 + x**2*(y**2 - z**2)/5"
)
HALO = (
    "(p_x**2 + p_y**2 + p_z**2)/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + y**2 + z**2) "
    "- mu/sqrt((x - 1 + mu)**2 + y**2 + z**2)"
)


def cycle(mu):
    H = hamsym.Hamiltonian(
        "p**2/2 + x**2/2", forces={"p": "mu*(1 - x**2)*p"}, parameters={"mu": mu}
    )
    return hamsym.periodic_orbit(H, ([2.0, 0.1], 6.66))


def halo():
    mu, period = 1.215058560962404e-2, 3.1233143922761588
    x, z, v = -0.41456184803140111, 0.90753120433295065, 1.4076145460136695
    H = hamsym.Hamiltonian(HALO, parameters={"mu": mu})
    symmetry = {"y": "-y", "p_x": "-p_x", "p_z": "-p_z"}
    return hamsym.periodic_orbit(H, ([x, 0, z, 0, v + x, 0], period), symmetry=symmetry)


ORBITS = {
    "quartic": lambda: hamsym.periodic_orbit(QUARTIC, [1.0, 0.0]),
    "reversing": lambda: hamsym.periodic_orbit(QUARTIC, [1.0, 0.0], symmetry={"p": "-p"}),
    "quarter": lambda: hamsym.periodic_orbit(
        QUARTIC, [1.0, 0.0], symmetry=({"p": "-p"}, {"x": "-x"})
    ),
    "half": lambda: hamsym.periodic_orbit(QUARTIC, [1.0, 0.2], symmetry={"x": "-x", "p": "-p"}),
    "period": lambda: hamsym.periodic_orbit(QUARTIC, [1.0, 0.0], period="3*pi/2"),
    "number": lambda: hamsym.periodic_orbit(QUARTIC, [1.0, 0.0], period=4.75),
    "pendulum": lambda: hamsym.periodic_orbit("p**2/2 - cos(x)", [1.0, 0.3]),
    "units": lambda: hamsym.periodic_orbit(
        "p**2/(2*1.67e-27) + 1e-5*x**2/2 + 3e5*x**4", [1e-6, 0.0]
    ),
    "henon": lambda: hamsym.periodic_orbit(
        HENON_HEILES, [0, -0.15, 0.35, 0], energy=1 / 12, symmetry=ACROSS
    ),
    "whole": lambda: hamsym.periodic_orbit(HENON_HEILES, [0, -0.15, 0.35, 0], energy=1 / 12),
    "lyapunov": lambda: hamsym.periodic_orbit(
        hamsym.Hamiltonian(RESTRICTED, parameters={"mu": 0.0121505856}),
        ([0.8269, 0.0, 0.0, 0.9161], 2.7),
        symmetry={"y": "-y", "p_x": "-p_x"},
    ),
    "three": lambda: hamsym.periodic_orbit(COUPLED, [1.0, 0, 0, 0, 0, 0], energy=0.75),
    "halo": halo,
    "attracting": lambda: cycle(1.0),
    "repelling": lambda: cycle(-1.0),
}


def check(orbit, claims):
    check_orbit(described(orbit.H), _orbit_data(orbit), claims, lambda: None)


@pytest.mark.slow_cases(*sorted(ORBITS))
@pytest.mark.parametrize("name", ORBITS)
def test_orbits_are_verified_and_forged_ones_refused(name):
    orbit = ORBITS[name]()
    certificate = orbit.certify()
    hamsym.verify(certificate.to_json(), orbit, checker="independent")
    claims = json.loads(certificate.to_json())
    middle, radius = claims["period"]
    shift = 1e-9 * middle
    for forged in ({"period": [middle + shift, radius]}, {"bound": 1e-3 * claims["bound"]}):
        with pytest.raises(NotProvenError):
            check(orbit, claims | forged)


def moved(ball, places, change):
    """A ball with one middle or radius changed."""
    middle, radius = (np.array(part, dtype=float) for part in ball)
    part = (middle, radius)[places[0]]
    part[places[1:]] = change(part[places[1:]])
    return [middle.tolist(), radius.tolist()]


def forgeries(claims):
    """Claims that are false, or none at all."""
    for name in ("z0", "period", "monodromy"):
        middle, radius = map(np.array, claims[name])
        for place in np.ndindex(middle.shape):
            r = float(radius[place])
            for shift in (4 * r + 1e-15, -1e-9, 0.1, math.nan, math.inf, -math.inf):
                if not abs(shift) <= 2 * r:  # which may be true
                    yield name, moved(claims[name], (0, *place), lambda v, s=shift: v + s)
            for value in (-1.0, math.nan, -5e-324):
                yield name, moved(claims[name], (1, *place), lambda v, w=value: w)
    for value in (1e-3 * claims["bound"], 1e-30, 0.0, -1.0, math.nan):
        yield "bound", value
    words = ("elliptic", "hyperbolic", "mixed", "complex unstable", "parabolic", "attracting",
             "repelling", "unstable", "stable", "")  # fmt: skip
    for word in words:
        if word != claims["stability"] and (word, claims["stability"]) != (
            "unstable",
            "hyperbolic",
        ):
            yield "stability", word
    for value in (0, -1, 10**9):
        yield "pieces", value
    yield "components", claims["components"][::-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reversing", "henon", "whole", "three", "period"])
def test_all_forgeries_are_refused(name, monkeypatch):
    assert_all_refused(name, monkeypatch)


def test_some_forgeries_are_refused(monkeypatch):
    assert_all_refused("quarter", monkeypatch, 13)


def assert_all_refused(name, monkeypatch, every=1):
    orbit = ORBITS[name]()
    claims = json.loads(orbit.certify().to_json())
    proven, known = _Orbit.proven, {}

    def once(self, given, order, *rest):
        """The orbit in a box, around which all claims are looked at."""
        if order not in known:
            known[order] = proven(self, claims, order, *rest)
        return known[order]

    monkeypatch.setattr(_Orbit, "proven", once)
    check(orbit, claims)
    found = [*forgeries(claims)]
    assert len(found) > 60
    for field, value in found[::every]:
        with pytest.raises(NotProvenError):
            check(orbit, claims | {field: value})
