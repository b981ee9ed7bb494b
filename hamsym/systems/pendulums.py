"""Pendulums: plane, double, elastic, and on a pulley."""

from __future__ import annotations

import math

import numpy as np
import scipy

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_number
from hamsym.systems.catalogue import Problem, check_positive, listed


@listed
def pendulum(amplitude: float = 2.0) -> Problem:
    """The pendulum H = p^2/2 - cos(theta), released at rest from an angle below pi.

    Exactly, sin(theta/2) = k cd(t | k^2) with k = sin(amplitude/2).

    Raises
    ------
    InputError
        If the angle is not between 0 and pi.
    """
    require(0 < amplitude < math.pi, "amplitude", amplitude, "an angle between 0 and pi")
    k = math.sin(amplitude / 2)

    def exact(t: np.ndarray) -> np.ndarray:
        sn, cn, dn, _ = scipy.special.ellipj(np.asarray(t), k**2)
        theta = 2 * np.arcsin(k * cn / dn)
        return np.stack((theta, -2 * k * math.cos(amplitude / 2) * sn / dn), axis=-1)

    return Problem(
        "pendulum",
        Hamiltonian("p**2/2 - cos(theta)"),
        (amplitude, 0.0),
        (0.0, 20.0),
        "textbooks; DLMF 22.19(i)",
        exact,
        4 * float(scipy.special.ellipk(k**2)),
    )


@listed
def double_pendulum() -> Problem:
    """The planar double pendulum with unit masses, lengths and gravity: not separable, chaotic."""
    H = Hamiltonian(
        "(p1**2 + 2*p2**2 - 2*p1*p2*cos(theta1 - theta2))/(2*(1 + sin(theta1 - theta2)**2))"
        " - 2*g*cos(theta1) - g*cos(theta2)",
        parameters={"g": 1.0},
    )
    return Problem("double pendulum", H, (1.0, 0.5, 0.0, 0.0), (0.0, 20.0), "textbooks")


@listed
def spring_pendulum(stiffness: float = 4.0, length: float = 0.75, gravity: float = 1.0) -> Problem:
    """A unit mass on an elastic spring that swings in the plane, y upwards.

    H = (p_x^2 + p_y^2)/2 + k (sqrt(x^2 + y^2) - l)^2/2 + g y. By default the spring hangs down to
    y = -1 and oscillates twice per swing: both motions are in resonance.

    Raises
    ------
    InputError
        If the stiffness k, the length l at rest or the gravity g is not positive.
    """
    check_positive(stiffness=stiffness, length=length, gravity=gravity)
    H = Hamiltonian(
        "(p_x**2 + p_y**2)/2 + k*(sqrt(x**2 + y**2) - l)**2/2 + g*y",
        parameters={"k": stiffness, "l": length, "g": gravity},
    )
    z0 = (0.1, -1.2, 0.0, 0.0)
    return Problem("spring pendulum", H, z0, (0.0, 20.0), "Vitt & Gorelik 1933; Lynch 2002")


@listed
def swinging_atwood(ratio: float = 3.0) -> Problem:
    """Atwood's machine whose unit mass swings in the plane while the other, mu, counterbalances it.

    H = p_r^2/(2 (1 + mu)) + p_theta^2/(2 r^2) + r (mu - cos(theta)), with the length r of the
    swinging part, its angle theta from the vertical, and unit gravity. The unit mass is released at
    rest from r = 1, theta = pi/2. The default mass ratio mu = 3 is integrable.

    Raises
    ------
    InputError
        If the ratio mu is not above 1: the swinging mass would pull the other one up for ever.
    """
    require_number("ratio", ratio)
    require(ratio > 1, "ratio", ratio, "a number above 1")
    H = Hamiltonian(
        "p_r**2/(2*(1 + mu)) + p_theta**2/(2*r**2) + r*(mu - cos(theta))", parameters={"mu": ratio}
    )
    integral = (
        "p_r*p_theta*cos(theta/2)/4 - p_theta**2*sin(theta/2)/(2*r)"
        " + r**2*sin(theta/2)*cos(theta/2)**2"
    )
    return Problem(
        "swinging Atwood machine",
        H,
        (1.0, math.pi / 2, 0.0, 0.0),
        (0.0, 20.0),
        "Tufillaro, Abbott & Griffiths 1984; integral: Tufillaro 1986",
        conserved=(integral,) if ratio == 3 else (),
    )
