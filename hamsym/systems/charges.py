"""Charged particles in fields: magnets, ion traps, a dipole, two waves."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_number
from hamsym.systems.catalogue import Problem, check_positive, listed


@listed
def charged_particle(field: float = 1.0) -> Problem:
    """A charged particle in a uniform magnetic field, symmetric gauge: not separable.

    H = ((p_x + B y/2)^2 + (p_y - B x/2)^2)/2 in units of charge and mass; exactly, circles of
    angular frequency B.

    Raises
    ------
    InputError
        If the field B is zero, or not finite.
    """
    require(0 < abs(field) < math.inf, "field", field, "a number other than 0")
    H = Hamiltonian("((p_x + B*y/2)**2 + (p_y - B*x/2)**2)/2", parameters={"B": field})
    x0, y0, px0, py0 = z0 = (1.0, 0.0, 0.0, 1.0)
    vx0, vy0 = px0 + field * y0 / 2, py0 - field * x0 / 2

    def exact(t: np.ndarray) -> np.ndarray:
        # v' = B (v_y, -v_x): the velocity turns clockwise.
        sine, cosine = np.sin(field * np.asarray(t)), np.cos(field * np.asarray(t))
        vx, vy = vx0 * cosine + vy0 * sine, vy0 * cosine - vx0 * sine
        x = x0 + (vx0 * sine + vy0 * (1 - cosine)) / field
        y = y0 + (vy0 * sine - vx0 * (1 - cosine)) / field
        return np.stack((x, y, vx - field * y / 2, vy + field * x / 2), axis=-1)

    return Problem(
        "charged particle in a magnetic field",
        H,
        z0,
        (0.0, 4 * math.pi),
        "textbooks",
        exact,
        2 * math.pi / abs(field),
        ("p_x - B*y/2", "p_y + B*x/2", "x*p_y - y*p_x"),
    )


@listed
def penning_trap(field: float = 5.0, omega: float = 2.0) -> Problem:
    """A charged particle in a Penning trap: a magnetic field B and an electric quadrupole.

    H = ((p_x + B y/2)^2 + (p_y - B x/2)^2 + p_z^2)/2 + omega^2 (2 z^2 - x^2 - y^2)/4 in units of
    charge and mass. Exactly, z oscillates with omega, and x + i y is a sum of two circles of the
    frequencies (B +- sqrt(B^2 - 2 omega^2))/2, the cyclotron and the magnetron motion.

    Raises
    ------
    InputError
        If omega is not positive, or B not above sqrt(2) omega: the particle would escape.
    """
    check_positive(omega=omega)
    require_number("field", field)
    trapped = field > 0 and field**2 > 2 * omega**2
    require(trapped, "field", field, "a number above sqrt(2)*omega")
    z0 = (1.0, 0.0, 0.5, 0.0, 1.0, 0.0)
    x0, y0, height, px0, py0, pz0 = z0
    start = x0 + 1j * y0
    velocity = px0 + field * y0 / 2 + 1j * (py0 - field * x0 / 2)
    root = math.sqrt(field**2 - 2 * omega**2)
    fast, slow = (field + root) / 2, omega**2 / (field + root)
    # x + i y = a exp(-i fast t) + b exp(-i slow t)
    a = (1j * velocity - slow * start) / root
    b = start - a

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        first, second = a * np.exp(-1j * fast * t), b * np.exp(-1j * slow * t)
        u = first + second
        p = -1j * (fast * first + slow * second) + 0.5j * field * u
        cosine, sine = np.cos(omega * t), np.sin(omega * t)
        z, pz = height * cosine + pz0 * sine / omega, pz0 * cosine - omega * height * sine
        return np.stack((u.real, u.imag, z, p.real, p.imag, pz), axis=-1)

    return Problem(
        "Penning trap",
        Hamiltonian(
            "((p_x + B*y/2)**2 + (p_y - B*x/2)**2 + p_z**2)/2 + omega**2*(2*z**2 - x**2 - y**2)/4",
            parameters={"B": field, "omega": omega},
        ),
        z0,
        (0.0, 20.0),
        "Brown & Gabrielse 1986",
        exact,
        conserved=("x*p_y - y*p_x", "p_z**2/2 + omega**2*z**2/2"),
    )


_TERMS = 12  # Fourier coefficients on each side, for q below 1: the last ones are below 1e-20


def _mismatch(nu: float, a: float, q: float) -> float:
    """Zero where nu is the exponent of Mathieu's equation: a continued fraction on each side."""
    above = below = 0.0
    for order in range(2 * _TERMS, 0, -2):
        above = q**2 / ((nu + order) ** 2 - a - above)
        below = q**2 / ((nu - order) ** 2 - a - below)
    return nu**2 - a - above - below


def _mathieu_motion(a: float, q: float) -> Callable[[np.ndarray], np.ndarray]:
    """Even and odd solutions of x'' + (a - 2 q cos(2 t)) x = 0 in the first zone of stability.

    They are the sums of c_k cos((nu + 2 k) t) and c_k sin((nu + 2 k) t), with value 1 and slope 1
    at the start, where c is the eigenvector to the lowest eigenvalue a of the matrix with
    (nu + 2 k)^2 in the diagonal and q beside it. The result has the values and slopes of the even
    one, then those of the odd one, in the last axis.
    """
    orders = 2.0 * np.arange(-_TERMS, _TERMS + 1)

    def lowest(nu: float) -> tuple[float, np.ndarray]:
        values, vectors = scipy.linalg.eigh_tridiagonal(
            (nu + orders) ** 2, np.full(2 * _TERMS, q), select="i", select_range=(0, 0)
        )
        return float(values[0]), vectors[:, 0]

    nu = scipy.optimize.brentq(lambda nu: lowest(nu)[0] - a, 0.0, 1.0, xtol=1e-15)
    # One step of Newton's method on the continued fraction, which has no large numbers to round.
    slope = (_mismatch(nu + 1e-6, a, q) - _mismatch(nu - 1e-6, a, q)) / 2e-6
    nu -= _mismatch(nu, a, q) / slope
    rates, c = nu + orders, lowest(nu)[1]

    def motion(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(np.asarray(t, dtype=float), rates)
        cosine, sine = np.cos(phase), np.sin(phase)
        even = cosine @ c, -sine @ (c * rates)
        odd = sine @ c, cosine @ (c * rates)
        return np.stack((*(v / c.sum() for v in even), *(v / (c @ rates) for v in odd)), axis=-1)

    return motion


@listed
def paul_trap(a: float = 0.02, q: float = 0.4) -> Problem:
    """An ion in a linear Paul trap, across its axis: explicit in time.

    H = (p_x^2 + p_y^2)/2 + (a - 2 q cos(2 t)) (x^2 - y^2)/2. Exactly, by the Mathieu functions of
    fractional order: x'' + (a - 2 q cos(2 t)) x = 0, and the same with -a, -q for y.

    Raises
    ------
    InputError
        If a, q are not in the first zone of stability, where both x and y are bounded.
    """
    require_number("a", a)
    require_number("q", q)
    low = float(scipy.special.mathieu_a(0, abs(q)))
    high = float(scipy.special.mathieu_b(1, abs(q))) if q else 1.0
    if not abs(a) < min(-low, high):
        raise InputError(
            f"a={a!r}, q={q!r} cannot be used; give values in the first zone of stability, "
            "for example 0.02 and 0.4"
        )
    across, along = _mathieu_motion(a, q), _mathieu_motion(-a, -q)
    x0, y0, px0, py0 = z0 = (1.0, 0.5, 0.0, 0.2)

    def exact(t: np.ndarray) -> np.ndarray:
        x, y = across(t), along(t)
        columns = (
            x[..., 0] * x0 + x[..., 2] * px0,
            y[..., 0] * y0 + y[..., 2] * py0,
            x[..., 1] * x0 + x[..., 3] * px0,
            y[..., 1] * y0 + y[..., 3] * py0,
        )
        return np.stack(columns, axis=-1)

    return Problem(
        "Paul trap",
        Hamiltonian(
            "(p_x**2 + p_y**2)/2 + (a - 2*q*cos(2*t))*(x**2 - y**2)/2", parameters={"a": a, "q": q}
        ),
        z0,
        (0.0, 40.0),
        "Paul 1990; DLMF 28.12",
        exact,
    )


@listed
def stormer() -> Problem:
    """A charged particle in the field of a magnetic dipole, as of the earth, in its meridian plane.

    H = (p_rho^2 + p_z^2)/2 + (1/rho - rho/r^3)^2/2, r^2 = rho^2 + z^2, in units in which the
    angular momentum about the axis is 1. The start has an energy below 1/32, so that the particle
    is trapped, as in a radiation belt.
    """
    return Problem(
        "Stormer problem",
        Hamiltonian("(p_rho**2 + p_z**2)/2 + (1/rho - rho/(rho**2 + z**2)**(3/2))**2/2"),
        (1.0, 0.0, 0.05, 0.15),
        (0.0, 40.0),
        "Stormer 1907; Dragt 1965; start chosen here",
    )
