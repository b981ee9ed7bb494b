"""The validated reference contains the true solution, or says why it cannot."""

import math

import mpmath
import numpy as np
import pytest
from flint import arb

from hamsym import Hamiltonian, systems
from hamsym.errors import CertificationError
from hamsym.proof.balls import above, below, exact, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.taylor import Deadline, PrecisionError, validated_reference

_NO_LIMIT = Deadline.after(None)


def reference(H, z0, span, bits=96, units=None, deadline=_NO_LIMIT):
    units = [(0.0, [1.0] * len(z0))] if units is None else units
    return validated_reference(Enclosures(H), np.array(z0), span, units, bits, deadline)


def contains(balls, values):
    """Whether balls hold numbers that are known to forty digits."""
    for enclosed, value in zip(balls, values, strict=True):
        middle = exact(enclosed)
        with mpmath.workdps(50):
            distance = abs(mpmath.mpf(middle.numerator) / middle.denominator - value)
            if not distance <= mpmath.mpf(above(enclosed.rad())) + mpmath.mpf(10) ** -36:
                return False
    return True


@pytest.mark.parametrize("span", [(0.0, 7.0), (2.0, -5.0)])
def test_the_harmonic_oscillator_is_enclosed_to_twenty_digits(span):
    found = reference(systems.harmonic_oscillator().H, [1.0, 0.0], span)
    for t in np.linspace(*span, 17):
        with mpmath.workdps(50):
            elapsed = mpmath.mpf(float(t)) - span[0]
            truth = [mpmath.cos(elapsed), -mpmath.sin(elapsed)]
        assert contains(found(float(t)), truth)
        assert max(above(value.rad()) for value in found(float(t))) < 1e-20


@pytest.mark.parametrize(
    ("formula", "z0", "rates", "end"),
    [
        ("p**2/2 + x**2/2 + x**4/4", [1.3, 1.0], lambda t, z: [z[1], -z[0] - z[0] ** 3], 2.0),
        ("p**2/2 - cos(x)", [2.0, 0.0], lambda t, z: [z[1], -mpmath.sin(z[0])], 2.0),
        (
            "p**2/2 + x**2/2 - x*cos(2*t)/3",
            [1.0, 0.0],
            lambda t, z: [z[1], -z[0] + mpmath.cos(2 * t) / 3],
            2.0,
        ),
        (
            "p**2*(1 + x**2)/2 + x**2/2",  # not separable
            [0.5, 0.7],
            lambda t, z: [z[1] * (1 + z[0] ** 2), -z[0] - z[0] * z[1] ** 2],
            -1.5,
        ),
    ],
)
def test_nonlinear_systems_agree_with_mpmath_to_thirty_digits(formula, z0, rates, end):
    found = reference(Hamiltonian(formula), z0, (0.0, end), bits=160)
    with mpmath.workdps(45):
        # mpmath's method goes forwards in time only.
        sign = 1 if end > 0 else -1
        solution = mpmath.odefun(
            lambda s, z: [sign * rate for rate in rates(sign * s, z)],
            0,
            [mpmath.mpf(value) for value in z0],
        )
        for part in (0.3, 1.0):
            t = part * end
            assert contains(found(t), solution(sign * mpmath.mpf(t)))
            assert max(above(value.rad()) for value in found(t)) < 1e-30


def test_units_of_any_size_do():
    H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1e-27, "k": 1e-27})
    units = [(0.0, [1.0, 2.0**-90])]
    found = reference(H, [1.0, 0.0], (0.0, 3.0), units=units)(3.0)
    assert below(found[0]) <= math.cos(3.0) + 1e-15
    assert above(found[0]) >= math.cos(3.0) - 1e-15
    assert above(found[1].rad()) < 1e-45


def test_changing_units_on_the_way_changes_nothing_but_the_radius():
    H = systems.nonlinear_oscillator().H
    fixed = reference(H, [1.3, 1.0], (0.0, 3.0), bits=128)
    changing = reference(
        H,
        [1.3, 1.0],
        (0.0, 3.0),
        bits=128,
        units=[(0.0, [1.0, 1.0]), (1.0, [0.5, 2.0]), (2.0, [1.0, 1.0])],
    )
    for t in (0.5, 1.5, 2.5, 3.0):
        for one, other in zip(fixed(t), changing(t), strict=True):
            assert one.overlaps(other)


def test_more_bits_give_a_nested_enclosure():
    problem = systems.kepler()
    coarse = reference(problem.H, problem.z0, (0.0, 1.0), bits=128)(1.0)
    fine = reference(problem.H, problem.z0, (0.0, 1.0), bits=192)(1.0)
    with working(192):
        for one, other in zip(coarse, fine, strict=True):
            assert one.contains(other)


def test_energy_is_conserved_along_the_enclosure():
    problem = systems.henon_heiles()
    H = Enclosures(problem.H)
    found = reference(problem.H, problem.z0, (0.0, 5.0))
    with working(96):
        start = H.energy([arb(value) for value in problem.z0], arb(0))
        assert H.energy(found(5.0), arb(5)).overlaps(start)


def test_a_singularity_on_the_way_is_refused_with_its_time_and_name():
    H = Hamiltonian("p**2/2 + x**(5/2)")
    with pytest.raises(CertificationError, match=r"t = 1\.0.*(sqrt|3/2).* not smooth"):
        reference(H, [1.0, 0.0], (0.0, 3.0), bits=192)


@pytest.mark.parametrize("formula", ["p**2/2 - x**4/4", "p**2/2 - 1/x"])
def test_nothing_is_claimed_beyond_an_escape_or_a_collision(formula):
    with pytest.raises((CertificationError, PrecisionError)):
        reference(Hamiltonian(formula), [1.0, 0.0], (0.0, 3.0))


def test_a_time_limit_is_kept_and_named():
    with pytest.raises(CertificationError, match=r"time limit of 1e-06 s .* t = "):
        reference(
            systems.kepler().H, systems.kepler().z0, (0.0, 6.0), deadline=Deadline.after(1e-6)
        )
