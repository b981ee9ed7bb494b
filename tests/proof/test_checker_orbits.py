"""The independent checker of periodic orbits: what it accepts."""

from __future__ import annotations

import json

import pytest
from flint import arb, ctx

import hamsym
from hamsym.problems.description import described
from hamsym.proof.checker import orbits
from hamsym.proof.checker.formulas import NotProvenError
from hamsym.proof.checker.functions import Equations, column
from hamsym.proof.checker.guesses import Effort
from hamsym.proof.checker.motion import steps
from hamsym.proof.checker.orbits import check_orbit
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


@pytest.mark.parametrize(
    ("within", "reason"),
    [
        (0.1, "may be singular"),
        (2.0, "does not close"),  # where it crosses the plane again
    ],
)
def test_distances_from_other_orbits_are_proven_and_forged_ones_refused(within, reason):
    orbit = ORBITS["quarter"]()
    claims = json.loads(orbit.certify().to_json())
    assert 0.01 < claims["unique_within"] < 0.05
    check(orbit, claims)
    with pytest.raises(NotProvenError, match=f"distance from other orbits .*{reason}"):
        check(orbit, claims | {"unique_within": within})


def test_bounds_are_about_the_states_in_the_arc_too():
    orbit = ORBITS["quarter"]()
    data, claims = _orbit_data(orbit), json.loads(orbit.certify().to_json())
    data["ends"][1][0] += 1e-6
    with pytest.raises(NotProvenError, match="distance from the computed states"):
        check_orbit(described(orbit.H), data, claims, lambda: None)


def test_a_box_that_is_not_mapped_into_its_interior_proves_nothing(monkeypatch):
    orbit = ORBITS["quarter"]()
    claims = json.loads(orbit.certify().to_json())
    monkeypatch.setattr(orbits, "krawczyk", lambda centre, box, *_: box)
    with pytest.raises(NotProvenError, match="no box around the orbit"):
        check(orbit, claims)


def test_averages_on_the_way_contain_differences_of_solutions():
    start, radius, widths = (1.0, 0.2), 2.0**-6, []
    with ctx.workprec(128):
        equations = Equations(described(hamsym.Hamiltonian(QUARTIC)))

        def end(z0):
            *_, last = steps(equations, z0, (0, 0.5), Effort(40, 2.0**-120), lambda: None)
            return column(last.states(arb(1), [arb(0)] * 2))

        for ways in (1, 4):
            rough = Effort(14, 2.0**-70, 12, ways=ways)
            *_, last = steps(equations, start, (0, 0.5), rough, lambda: None, [arb(radius)] * 2)
            matrix = last.derivative()
            widths.append([entry.rad() for entry in matrix.entries()])
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                moved = [a + 63 / 64 * radius * s for a, s in zip(start, signs, strict=True)]
                apart = [arb(a) - b for a, b in zip(moved, start, strict=True)]
                found, true = matrix * column(apart), end(moved) - end(start)
                assert found.contains(true)
    assert all(b < a for a, b in zip(*widths, strict=True))


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
