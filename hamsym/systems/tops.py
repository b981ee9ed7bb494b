"""Rigid bodies with a fixed point: the heavy tops of Lagrange and Kovalevskaya, in Euler angles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_number
from hamsym.systems.catalogue import Problem, check_positive, listed


def _third_kind(turns: Any, angle: Any, n: float, m: float) -> np.ndarray:
    """Incomplete elliptic integral Pi(n; angle + turns pi | m), angle from -pi/2 to pi/2."""

    def near(angle: Any) -> Any:
        sine, square = np.sin(angle), np.cos(angle) ** 2
        first = scipy.special.elliprf(square, 1 - m * sine**2, 1)
        second = scipy.special.elliprj(square, 1 - m * sine**2, 1, 1 - n * sine**2)
        return sine * first + n * sine**3 * second / 3

    return near(angle) + 2 * turns * near(math.pi / 2)


@listed
def lagrange_top(
    axial: float = 0.5, weight: float = 1.0, spin: float = 2.0, tilt: float = 0.5
) -> Problem:
    """The heavy symmetric top with a fixed point, in Euler angles.

    H = p_theta^2/2 + (p_phi - p_psi cos(theta))^2/(2 sin(theta)^2) + p_psi^2/(2 C)
    + k cos(theta), with moments of inertia 1 across the axis and C along it. The axis of the top,
    which spins with p_psi, is released at rest, tilted by theta, so that it falls and rises again
    to cusps. Exactly, u = cos(theta) = u_1 + (u_0 - u_1) cd(r t | m)^2, where u_1 < u_0 < u_2 are
    the roots of u'^2 = (u_0 - u) (2 k (1 - u^2) - p_psi^2 (u_0 - u)),
    r^2 = k (u_2 - u_1)/2, m = (u_0 - u_1)/(u_2 - u_1); phi and psi follow by elliptic integrals of
    the third kind.

    Raises
    ------
    InputError
        If C, the weight k or the spin p_psi is not positive, or theta not between 0 and pi.

    Examples
    --------
    >>> lagrange_top().conserved
    ('p_phi', 'p_psi')
    """
    check_positive(axial=axial, weight=weight, spin=spin)
    require_number("tilt", tilt)
    require(0 < tilt < math.pi, "tilt", tilt, "an angle between 0 and pi")
    top = math.cos(tilt)
    momentum = spin * top
    # The other two roots solve 2 k (1 - u^2) = p_psi^2 (u_0 - u).
    half = spin**2 / (4 * weight)
    root = math.sqrt((half - top) ** 2 + math.sin(tilt) ** 2)
    low, high = half - root, half + root
    m, rate = (top - low) / (high - low), math.sqrt(weight * (high - low) / 2)
    quarter = float(scipy.special.ellipk(m))
    # For 1 - u and 1 + u: n of the integral Pi, Pi over a quarter of the period, largest 1 -+ u.
    lifts = [
        (n, float(_third_kind(0.0, math.pi / 2, n, m)), divisor)
        for n, divisor in (((top - low) / (1 - low), 1 - low), ((low - top) / (1 + low), 1 + low))
    ]

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        sn, cn, dn, amplitude = scipy.special.ellipj(rate * t - quarter, m)
        u = low + (top - low) * sn**2
        sine = np.sqrt((1 - u) * (1 + u))
        p_theta = -2 * (top - low) * rate * sn * cn * dn / sine
        turns = np.round(amplitude / math.pi)
        # Integrals of 1/(1 - u) and 1/(1 + u) over the time.
        above, below = (
            (_third_kind(turns, amplitude - math.pi * turns, n, m) + whole) / (rate * divisor)
            for n, whole, divisor in lifts
        )
        phi = ((momentum - spin) * above + (momentum + spin) * below) / 2
        drag = ((spin - momentum) * above + (spin + momentum) * below) / 2
        psi = drag + (spin / axial - spin) * t
        still = np.ones_like(t)
        columns = (phi, psi, np.arctan2(sine, u), momentum * still, spin * still, p_theta)
        return np.stack(columns, axis=-1)

    H = Hamiltonian(
        "p_theta**2/2 + (p_phi - p_psi*cos(theta))**2/(2*sin(theta)**2) + p_psi**2/(2*C)"
        " + k*cos(theta)",
        q=["phi", "psi", "theta"],
        p=["p_phi", "p_psi", "p_theta"],
        parameters={"C": axial, "k": weight},
    )
    return Problem(
        "Lagrange top",
        H,
        (0.0, 0.0, tilt, momentum, spin, 0.0),
        (0.0, 20.0),
        "Lagrange 1788; Landau & Lifshitz 1976, section 35",
        exact,
        conserved=("p_phi", "p_psi"),
    )


@listed
def kovalevskaya_top() -> Problem:
    """The integrable heavy top of Kovalevskaya, in Euler angles.

    The moments of inertia are 1, 1, 1/2, and the weight acts on the first axis of the body:
    H = (M_1^2 + M_2^2)/2 + M_3^2 + sin(theta) sin(psi) with
    M_1 = (p_phi - p_psi cos(theta)) sin(psi)/sin(theta) + p_theta cos(psi),
    M_2 = (p_phi - p_psi cos(theta)) cos(psi)/sin(theta) - p_theta sin(psi), M_3 = p_psi.
    """
    across = "(p_phi - p_psi*cos(theta))/sin(theta)"
    one = f"({across}*sin(psi) + p_theta*cos(psi))"
    two = f"({across}*cos(psi) - p_theta*sin(psi))"
    integral = (
        f"({one}**2 - {two}**2 - 2*sin(theta)*sin(psi))**2"
        f" + 4*({one}*{two} - sin(theta)*cos(psi))**2"
    )
    H = Hamiltonian(
        f"p_theta**2/2 + ({across})**2/2 + p_psi**2 + sin(theta)*sin(psi)",
        q=["phi", "psi", "theta"],
        p=["p_phi", "p_psi", "p_theta"],
    )
    return Problem(
        "Kovalevskaya top",
        H,
        (0.0, 0.3, 1.2, 0.8, 0.5, 0.2),
        (0.0, 20.0),
        "Kowalevski 1889; start chosen here",
        conserved=("p_phi", integral),
    )
