"""Validated Taylor integration encloses the exact solution, or ends with a reason."""

import math

import mpmath
import numpy as np
import pytest
from flint import arb

from hamsym import Hamiltonian, systems
from hamsym.errors import CertificationError
from hamsym.proof.balls import above, below, exact, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.limits import Deadline, PrecisionError
from hamsym.proof.taylor import enclose_solution

_NO_LIMIT = Deadline.after(None)


def enclosed(H, z0, span, bits=96, units=None, deadline=_NO_LIMIT):
    units = [(0.0, [1.0] * len(z0))] if units is None else units
    return enclose_solution(Enclosures(H), np.array(z0), span, units, bits, deadline)


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
def test_harmonic_oscillator_to_twenty_digits(span):
    found = enclosed(systems.harmonic_oscillator().H, [1.0, 0.0], span)
    for t in np.linspace(*span, 17):
        with mpmath.workdps(50):
            elapsed = mpmath.mpf(float(t)) - span[0]
            truth = [mpmath.cos(elapsed), -mpmath.sin(elapsed)]
        assert contains(found(float(t)), truth)
        assert max(above(value.rad()) for value in found(float(t))) < 1e-20


def duffing(t):
    """x'' = -x - x**3 from (1.3, 0): x = A cn(w t)."""
    a = mpmath.mpf(1.3)
    w, m = mpmath.sqrt(1 + a**2), a**2 / (2 * (1 + a**2))
    sn, cn, dn = (mpmath.ellipfun(kind, w * t, m=m) for kind in ("sn", "cn", "dn"))
    return [a * cn, -a * w * sn * dn]


def pendulum(t):
    """x'' = -sin(x) from (2, 0): sin(x/2) = k cd(t) with k = sin(1)."""
    k = mpmath.sin(1)
    sn, cn, dn = (mpmath.ellipfun(kind, t, m=k**2) for kind in ("sn", "cn", "dn"))
    half = mpmath.asin(k * cn / dn)
    return [2 * half, -2 * k * (1 - k**2) * sn / dn**2 / mpmath.cos(half)]


def driven(t):
    """x'' = -x + cos(2 t)/3 from (1, 0)."""
    x = (10 * mpmath.cos(t) - mpmath.cos(2 * t)) / 9
    return [x, (-10 * mpmath.sin(t) + 2 * mpmath.sin(2 * t)) / 9]


def coupled(t):
    """x' = p (1 + x**2), p' = -x (1 + p**2) from (0.5, 0): x'**2 = (a**2 - x**2)(1 + x**2)."""
    a = mpmath.mpf(0.5)
    w, m = mpmath.sqrt(1 + a**2), a**2 / (1 + a**2)
    sn, cn, dn = (mpmath.ellipfun(kind, w * t, m=m) for kind in ("sn", "cn", "dn"))
    return [a * cn, -a * w * sn * dn / (1 + (a * cn) ** 2)]


@pytest.mark.parametrize(
    ("formula", "start", "exact_solution", "end"),
    [
        ("p**2/2 + x**2/2 + x**4/4", 1.3, duffing, 2.0),
        ("p**2/2 - cos(x)", 2.0, pendulum, 2.0),
        ("p**2/2 + x**2/2 - x*cos(2*t)/3", 1.0, driven, 2.0),
        ("p**2*(1 + x**2)/2 + x**2/2", 0.5, coupled, -1.5),
    ],
)
def test_exact_solutions_are_enclosed(formula, start, exact_solution, end):
    """To thirty digits, by elliptic functions."""
    found = enclosed(Hamiltonian(formula), [start, 0.0], (0.0, end), bits=160)
    with mpmath.workdps(50):
        for t in np.linspace(0, end, 7):
            assert contains(found(float(t)), exact_solution(mpmath.mpf(float(t))))
            assert max(above(value.rad()) for value in found(float(t))) < 1e-30


def test_units_of_any_size():
    H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1e-27, "k": 1e-27})
    units = [(0.0, [1.0, 2.0**-90])]
    found = enclosed(H, [1.0, 0.0], (0.0, 3.0), units=units)(3.0)
    assert below(found[0]) <= math.cos(3.0) + 1e-15
    assert above(found[0]) >= math.cos(3.0) - 1e-15
    assert above(found[1].rad()) < 1e-45


def test_changes_of_units_keep_the_enclosure():
    H = systems.nonlinear_oscillator().H
    fixed = enclosed(H, [1.3, 1.0], (0.0, 3.0), bits=128)
    changing = enclosed(
        H,
        [1.3, 1.0],
        (0.0, 3.0),
        bits=128,
        units=[(0.0, [1.0, 1.0]), (1.0, [0.5, 2.0]), (2.0, [1.0, 1.0])],
    )
    for t in (0.5, 1.5, 2.5, 3.0):
        for one, other in zip(fixed(t), changing(t), strict=True):
            assert one.overlaps(other)


def test_more_bits_give_nested_enclosures():
    problem = systems.kepler()
    coarse = enclosed(problem.H, problem.z0, (0.0, 0.3), bits=128)(0.3)
    fine = enclosed(problem.H, problem.z0, (0.0, 0.3), bits=192)(0.3)
    with working(192):
        for one, other in zip(coarse, fine, strict=True):
            assert one.contains(other)


def test_energy_is_conserved():
    problem = systems.henon_heiles()
    H = Enclosures(problem.H)
    found = enclosed(problem.H, problem.z0, (0.0, 5.0))
    with working(96):
        start = H.energy([arb(value) for value in problem.z0], arb(0))
        assert H.energy(found(5.0), arb(5)).overlaps(start)


def test_singularity_is_named_with_its_time():
    H = Hamiltonian("p**2/2 + x**(5/2)")
    with pytest.raises(CertificationError, match=r"t = 1\.0.*(sqrt|3/2).* not smooth"):
        enclosed(H, [1.0, 0.0], (0.0, 3.0), bits=128)


@pytest.mark.parametrize("formula", ["p**2/2 - x**4/4", "p**2/2 - 1/x"])
def test_escape_or_collision_ends_the_enclosure(formula):
    with pytest.raises((CertificationError, PrecisionError)):
        enclosed(Hamiltonian(formula), [1.0, 0.0], (0.0, 3.0))


def test_time_limit_is_kept():
    with pytest.raises(CertificationError, match=r"time limit of 1e-06 s .* t = "):
        enclosed(systems.kepler().H, systems.kepler().z0, (0.0, 6.0), deadline=Deadline.after(1e-6))
