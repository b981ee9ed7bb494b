"""A catalogue of Hamiltonian systems: the usual start and span, and what is known exactly.

Each function returns a :class:`Problem`; :data:`CATALOGUE` lists them all, and a new system is
one more function with the decorator.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.special

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian

__all__ = [
    "CATALOGUE",
    "Problem",
    "charged_particle",
    "coupled_oscillators",
    "double_pendulum",
    "harmonic_oscillator",
    "henon_heiles",
    "kepler",
    "nonlinear_oscillator",
    "pendulum",
    "three_bodies",
]


@dataclass(frozen=True)
class Problem:
    """An initial-value problem of the catalogue.

    Attributes
    ----------
    name : str
    H : Hamiltonian
        With values for all parameters.
    z0 : tuple of float
        The usual initial state, in the order of H.z.
    span : (float, float)
        The usual time span.
    source : str
        Where the system and its start come from.
    exact : callable, optional
        t of shape (n,) -> states of shape (n, dim), where a closed form is known.
    period : float, optional
        The period of the motion, where it is known.
    """

    name: str
    H: Hamiltonian
    z0: tuple[float, ...]
    span: tuple[float, float]
    source: str
    exact: Callable[[np.ndarray], np.ndarray] | None = field(default=None, repr=False)
    period: float | None = None


#: The functions of the catalogue, by name; each works without arguments.
CATALOGUE: dict[str, Callable[..., Problem]] = {}


def _listed(function: Callable[..., Problem]) -> Callable[..., Problem]:
    CATALOGUE[function.__name__] = function
    return function


@_listed
def harmonic_oscillator(omega: float = 1.0) -> Problem:
    """The harmonic oscillator H = (p^2 + omega^2 x^2)/2, from (1, 0).

    Examples
    --------
    >>> problem = harmonic_oscillator(omega=2.0)
    >>> problem.exact(np.array([problem.period])).round(12) + 0.0
    array([[1., 0.]])
    """

    def exact(t: np.ndarray) -> np.ndarray:
        return np.stack((np.cos(omega * t), -omega * np.sin(omega * t)), axis=-1)

    return Problem(
        "harmonic oscillator",
        Hamiltonian("p**2/2 + omega**2*x**2/2", parameters={"omega": omega}),
        (1.0, 0.0),
        (0.0, 4 * math.pi),
        "textbooks",
        exact,
        2 * math.pi / omega,
    )


@_listed
def nonlinear_oscillator(x: float = 1.3, p: float = 1.0) -> Problem:
    """The paper's oscillator H = p^2/2 + x^2/2 + x^4/4, from (1.3, 1).

    Exactly, x = A cn(Omega t + phase | m) with E = A^2/2 + A^4/4, Omega^2 = 1 + A^2 and
    m = A^2 / (2 Omega^2).

    Examples
    --------
    >>> nonlinear_oscillator().exact(np.array([0.0])).round(12)
    array([[1.3, 1. ]])
    """
    energy = p**2 / 2 + x**2 / 2 + x**4 / 4
    amplitude = math.sqrt(4 * energy / (1 + math.sqrt(1 + 4 * energy)))
    rate = math.sqrt(1 + amplitude**2)
    m = amplitude**2 / (2 * rate**2)
    # The angle whose cosine is x/A, from both functions: near a turning point p tells it better.
    dn = math.sqrt(1 - m + m * (x / amplitude) ** 2)
    angle = math.atan2(-p / (amplitude * rate * dn), x / amplitude)
    phase = float(scipy.special.ellipkinc(angle, m))

    def exact(t: np.ndarray) -> np.ndarray:
        sn, cn, dn, _ = scipy.special.ellipj(rate * np.asarray(t) + phase, m)
        return np.stack((amplitude * cn, -amplitude * rate * sn * dn), axis=-1)

    return Problem(
        "nonlinear oscillator",
        Hamiltonian("p**2/2 + x**2/2 + x**4/4"),
        (x, p),
        (0.0, 4 * math.pi),
        "Mattheakis et al. 2022, section III.A",
        exact,
        4 * float(scipy.special.ellipk(m)) / rate,
    )


@_listed
def pendulum(amplitude: float = 2.0) -> Problem:
    """The pendulum H = p^2/2 - cos(theta), released at rest from an angle below pi.

    Exactly, sin(theta/2) = k cd(t | k^2) with k = sin(amplitude/2).

    Raises
    ------
    InputError
        If the angle is not between 0 and pi.
    """
    if not 0 < amplitude < math.pi:
        raise InputError(f"amplitude={amplitude!r} cannot be used; give an angle between 0 and pi")
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


@_listed
def kepler(eccentricity: float = 0.6) -> Problem:
    """The Kepler problem H = |p|^2/2 - 1/r in the plane, from the pericentre; semi-axis 1.

    Exactly, by Kepler's equation t = E - e sin(E).

    Raises
    ------
    InputError
        If the eccentricity is not from 0 to below 1.
    """
    if not 0 <= eccentricity < 1:
        raise InputError(f"eccentricity={eccentricity!r} cannot be used; give 0 <= e < 1")
    e, minor = eccentricity, math.sqrt(1 - eccentricity**2)

    def exact(t: np.ndarray) -> np.ndarray:
        mean = np.remainder(np.asarray(t, dtype=float) + math.pi, 2 * math.pi) - math.pi
        anomaly = mean + e * np.sin(mean) / (1 - np.sin(mean + e) + np.sin(mean))
        for _ in range(50):
            anomaly = anomaly - (anomaly - e * np.sin(anomaly) - mean) / (1 - e * np.cos(anomaly))
        cosine, sine = np.cos(anomaly), np.sin(anomaly)
        rate = 1 / (1 - e * cosine)
        return np.stack((cosine - e, minor * sine, -sine * rate, minor * cosine * rate), axis=-1)

    return Problem(
        "Kepler problem",
        Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"),
        (1 - e, 0.0, 0.0, math.sqrt((1 + e) / (1 - e))),
        (0.0, 2 * math.pi),
        "Hairer, Lubich & Wanner 2006, section I.2",
        exact,
        2 * math.pi,
    )


@_listed
def henon_heiles() -> Problem:
    """The Henon-Heiles system from the paper's start."""
    return Problem(
        "Henon-Heiles",
        Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"),
        (0.3, -0.3, 0.3, 0.15),
        (0.0, 6 * math.pi),
        "Henon & Heiles 1964; start of Mattheakis et al. 2022, section III.B",
    )


@_listed
def coupled_oscillators(n: int = 3, coupling: float = 0.5) -> Problem:
    """A chain of n oscillators, q_i'' = -q_i + coupling (q_i+1 - 2 q_i + q_i-1), ends fixed.

    Only the first mass is displaced. Exactly, by the normal modes.
    """
    if not (isinstance(n, int) and n >= 1):
        raise InputError(f"n={n!r} cannot be used; give a whole number from 1")
    kinetic = " + ".join(f"p{i}**2/2" for i in range(1, n + 1))
    local = " + ".join(f"q{i}**2/2" for i in range(1, n + 1))
    positions = ["0", *(f"q{i}" for i in range(1, n + 1)), "0"]
    bonds = " + ".join(f"c*({b} - {a})**2/2" for a, b in itertools.pairwise(positions))
    H = Hamiltonian(f"{kinetic} + {local} + {bonds}", parameters={"c": coupling})
    stiffness = (1 + 2 * coupling) * np.eye(n) - coupling * (np.eye(n, k=1) + np.eye(n, k=-1))
    squares, modes = np.linalg.eigh(stiffness)
    start = np.eye(n)[0]
    frequencies, amplitudes = np.sqrt(squares), modes.T @ start

    def exact(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(np.asarray(t), frequencies)
        q = (amplitudes * np.cos(phase)) @ modes.T
        p = (-amplitudes * frequencies * np.sin(phase)) @ modes.T
        return np.concatenate((q, p), axis=-1)

    return Problem(
        "coupled oscillators",
        H,
        (*start, *np.zeros(n)),
        (0.0, 4 * math.pi),
        "textbooks",
        exact,
    )


@_listed
def charged_particle(field: float = 1.0) -> Problem:
    """A charged particle in a uniform magnetic field, symmetric gauge: not separable.

    H = ((p_x + B y/2)^2 + (p_y - B x/2)^2)/2 in units of charge and mass; exactly, circles of
    angular frequency B.
    """
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
    )


@_listed
def double_pendulum() -> Problem:
    """The planar double pendulum with unit masses, lengths and gravity: not separable, chaotic."""
    H = Hamiltonian(
        "(p1**2 + 2*p2**2 - 2*p1*p2*cos(theta1 - theta2))/(2*(1 + sin(theta1 - theta2)**2))"
        " - 2*g*cos(theta1) - g*cos(theta2)",
        parameters={"g": 1.0},
    )
    return Problem("double pendulum", H, (1.0, 0.5, 0.0, 0.0), (0.0, 20.0), "textbooks")


@_listed
def three_bodies() -> Problem:
    """Three equal masses chasing each other along a figure of eight, in the plane.

    H = (|p_1|^2 + |p_2|^2 + |p_3|^2)/2 - 1/r_12 - 1/r_13 - 1/r_23. Found by Moore (1993), proved
    by Chenciner & Montgomery (2000); the start is that of Simo's computation.
    """
    kinetic = " + ".join(f"(px{i}**2 + py{i}**2)/2" for i in (1, 2, 3))
    potential = " - ".join(
        f"1/sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in ((1, 2), (1, 3), (2, 3))
    )
    names = [f"{axis}{i}" for axis in ("x", "y") for i in (1, 2, 3)]
    H = Hamiltonian(f"{kinetic} - {potential}", q=names, p=["p" + name for name in names])
    x, y, u, v = 0.97000435669734, -0.24308753153583, -0.93240737144104, -0.86473146092102
    z0 = (x, -x, 0.0, y, -y, 0.0, -u / 2, -u / 2, u, -v / 2, -v / 2, v)
    period = 6.32591398292621
    return Problem(
        "three bodies", H, z0, (0.0, period), "Chenciner & Montgomery 2000", None, period
    )
