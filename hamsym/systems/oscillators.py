"""Oscillators in one and two degrees of freedom."""

from __future__ import annotations

import math

import numpy as np
import scipy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_number
from hamsym.systems.catalogue import Problem, check_positive, check_start, listed


@listed
def harmonic_oscillator(omega: float = 1.0) -> Problem:
    """The harmonic oscillator H = (p^2 + omega^2 x^2)/2, from (1, 0).

    Raises
    ------
    InputError
        If omega is not positive.

    Examples
    --------
    >>> problem = harmonic_oscillator(omega=2.0)
    >>> problem.exact(np.array([problem.period])).round(12) + 0.0
    array([[1., 0.]])
    """
    check_positive(omega=omega)

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


@listed
def nonlinear_oscillator(x: float = 1.3, p: float = 1.0) -> Problem:
    """The paper's oscillator H = p^2/2 + x^2/2 + x^4/4, from (1.3, 1).

    Exactly, x = A cn(Omega t + phase | m) with E = A^2/2 + A^4/4, Omega^2 = 1 + A^2 and
    m = A^2 / (2 Omega^2).

    Raises
    ------
    InputError
        If it starts at rest, or not from finite numbers.

    Examples
    --------
    >>> nonlinear_oscillator().exact(np.array([0.0])).round(12)
    array([[1.3, 1. ]])
    """
    energy = p * p / 2 + x * x / 2 + x * x * x * x / 4
    if not 0 < energy < math.inf:
        raise InputError(f"x={x!r}, p={p!r} cannot be used; give a start of energy above 0")
    amplitude = math.sqrt(4 * energy / (1 + math.sqrt(1 + 4 * energy)))
    rate = math.sqrt(1 + amplitude**2)
    m = amplitude**2 / (2 * rate**2)
    # The angle whose cosine is x/A, from both functions: near a turning point p is more accurate.
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


@listed
def morse_oscillator(depth: float = 1.0, a: float = 1.0, x: float = 1.5, p: float = 0.0) -> Problem:
    """The Morse oscillator H = p^2/2 + D (1 - exp(-a x))^2, bound, from (x, p).

    Exactly, exp(a x) = (D + sqrt(D E) cos(Omega t + phase)) / (D - E) with
    Omega^2 = 2 a^2 (D - E).

    Raises
    ------
    InputError
        If the depth D or a is not positive, or the energy E is not below D.

    Examples
    --------
    >>> morse_oscillator(depth=8.0, a=0.5, x=0.0).period / math.pi
    1.0
    """
    check_positive(depth=depth, a=a)
    decay = math.exp(min(-a * x, 700.0))
    binding = depth * decay * (2 - decay) - p * p / 2  # D - E, without the cancellation
    if not 0 < binding < math.inf:
        raise InputError(f"x={x!r}, p={p!r} cannot be used; give a start of energy below {depth!r}")
    rate = a * math.sqrt(2 * binding)
    swing = math.sqrt(depth * (p**2 / 2 + depth * (1 - decay) ** 2))
    phase = math.atan2(-p * rate / (2 * a), depth * (1 - decay) * decay - p**2 / 2)
    # D - sqrt(D E) = D (D - E) / (D + sqrt(D E)), without cancellation at the inner turning point.
    inner, width = depth / (depth + swing), 2 * swing / binding

    def exact(t: np.ndarray) -> np.ndarray:
        half = (rate * np.asarray(t) + phase) / 2
        growth = inner + width * np.cos(half) ** 2
        slope = -width * rate * np.sin(half) * np.cos(half)
        return np.stack((np.log(growth) / a, slope / (a * growth)), axis=-1)

    return Problem(
        "Morse oscillator",
        Hamiltonian("p**2/2 + D*(1 - exp(-a*x))**2", parameters={"D": depth, "a": a}),
        (x, p),
        (0.0, 20.0),
        "Morse 1929",
        exact,
        2 * math.pi / rate,
    )


@listed
def driven_oscillator(omega: float = 1.0, drive: float = 0.8, force: float = 0.5) -> Problem:
    """A driven oscillator, H = p^2/2 + omega^2 x^2/2 - F x cos(Omega t), from (1, 0).

    Exactly, x = cos(omega t) + F (cos(Omega t) - cos(omega t)) / (omega^2 - Omega^2), and
    x = cos(omega t) + F t sin(omega t) / (2 omega) in resonance, where Omega = omega. H is
    conserved only for Omega = 0, the energy of the deviation from one forced motion always.

    Raises
    ------
    InputError
        If omega is not positive, or the frequency Omega of the drive is negative.
    """
    check_positive(omega=omega)
    require(0 <= drive < math.inf, "drive", drive, "a frequency from 0")
    mean, beat = (omega + drive) / 2, (omega - drive) / 2

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        # sin(mean t)/mean and sin(beat t)/beat; their product has no cancellation near resonance.
        fast, slow = (t * np.sinc(rate * t / math.pi) for rate in (mean, beat))
        x = np.cos(omega * t) + force * fast * slow / 2
        change = np.cos(mean * t) * slow + fast * np.cos(beat * t)
        return np.stack((x, -omega * np.sin(omega * t) + force * change / 2), axis=-1)

    if drive == omega:
        x, p = "F*t*sin(omega*t)/(2*omega)", "F*(sin(omega*t)/omega + t*cos(omega*t))/2"
    else:
        x = "F*cos(Omega*t)/(omega**2 - Omega**2)"
        p = "-F*Omega*sin(Omega*t)/(omega**2 - Omega**2)"
    return Problem(
        "driven oscillator",
        Hamiltonian(
            "p**2/2 + omega**2*x**2/2 - F*x*cos(Omega*t)",
            parameters={"omega": omega, "Omega": drive, "F": force},
        ),
        (1.0, 0.0),
        (0.0, 8 * math.pi),
        "Landau & Lifshitz 1976, section 22",
        exact,
        conserved=(f"(p - ({p}))**2/2 + omega**2*(x - ({x}))**2/2",) if drive else (),
    )


_HENON_HEILES = {
    "E = 0.128, the paper": None,
    "E = 1/12, regular": (1 / 12, 0.2),
    "E = 1/8, regular": (1 / 8, 0.2),
    "E = 1/8, chaotic": (1 / 8, -0.2),
    "E = 1/6, regular": (1 / 6, 0.2),
    "E = 1/6, chaotic": (1 / 6, -0.2),
}


@listed
def henon_heiles(start: str = "E = 0.128, the paper") -> Problem:
    """The Henon-Heiles system, H = (p_x^2 + p_y^2)/2 + (x^2 + y^2)/2 + x^2 y - y^3/3.

    The starts are that of the paper, which is regular, and starts with x = p_y = 0 at the three
    energies of Henon and Heiles: the share of chaotic orbits grows from nearly none at 1/12 to
    nearly all at 1/6, where the surface of the energy is no longer closed.

    Raises
    ------
    InputError
        If there is no such start.

    Examples
    --------
    >>> problem = henon_heiles(start="E = 1/6, chaotic")
    >>> float(problem.H.compile("numpy").energy(problem.z0).round(15))
    0.166666666666667
    """
    check_start(start, _HENON_HEILES)
    z0 = (0.3, -0.3, 0.3, 0.15)
    if (chosen := _HENON_HEILES[start]) is not None:
        energy, y = chosen
        z0 = (0.0, y, math.sqrt(2 * energy - y**2 + 2 * y**3 / 3), 0.0)
    return Problem(
        "Henon-Heiles",
        Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3"),
        z0,
        (0.0, 6 * math.pi),
        "Henon & Heiles 1964; start of Mattheakis et al. 2022, section III.B",
        start=start,
        starts=tuple(_HENON_HEILES),
    )


@listed
def driven_duffing(force: float = 0.3, drive: float = 1.0) -> Problem:
    """A particle in a double well, driven: H = p^2/2 - x^2/2 + x^4/4 - F x cos(Omega t).

    From (1, 0), the bottom of the right well. With the default drive, without friction, the motion
    is chaotic.

    Raises
    ------
    InputError
        If the force F is not finite, or the frequency Omega of the drive is not positive.
    """
    require_number("force", force)
    check_positive(drive=drive)
    return Problem(
        "driven Duffing oscillator",
        Hamiltonian(
            "p**2/2 - x**2/2 + x**4/4 - F*x*cos(Omega*t)", parameters={"F": force, "Omega": drive}
        ),
        (1.0, 0.0),
        (0.0, 30.0),
        "Duffing 1918; Guckenheimer & Holmes 1983, section 2.2, without friction",
    )
