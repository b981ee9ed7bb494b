"""Catalogue of Hamiltonian systems: default initial state and span, exact solutions, integrals.

Each function returns a :class:`Problem`; :data:`CATALOGUE` lists them all, and a new system is
one more function with the decorator.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.special
import sympy
from sympy.polys.matrices import DomainMatrix

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require_positive, require_whole

__all__ = [
    "CATALOGUE",
    "Problem",
    "calogero_moser",
    "charged_particle",
    "coupled_oscillators",
    "double_pendulum",
    "driven_oscillator",
    "fermi_pasta_ulam_tsingou",
    "harmonic_oscillator",
    "henon_heiles",
    "kepler",
    "morse_oscillator",
    "nonlinear_oscillator",
    "pendulum",
    "spring_pendulum",
    "three_bodies",
    "toda_chain",
]

# Largest number of particles for formulas of 2**n terms, or for n formulas of n terms.
_MANY = 12


@dataclass(frozen=True)
class Problem:
    """An initial-value problem of the catalogue.

    Attributes
    ----------
    name : str
    H : Hamiltonian
        With values for all parameters.
    z0 : tuple of float
        Default initial state, in the order of H.z.
    span : (float, float)
        Default time span.
    source : str
        Reference for the system and its initial state.
    exact : callable, optional
        Exact solution, t of shape (n,) -> states of shape (n, dim); None if unknown.
    period : float, optional
        Period of the motion; None if unknown.
    conserved : tuple of str
        Formulas of first integrals other than H, in the names of H and the time t, valid for these
        values of the parameters.

    Examples
    --------
    >>> problem = charged_particle()
    >>> problem.conserved
    ('p_x - B*y/2', 'p_y + B*x/2', 'x*p_y - y*p_x')
    >>> all(map(problem.H.is_conserved, problem.conserved))
    True
    """

    name: str
    H: Hamiltonian
    z0: tuple[float, ...]
    span: tuple[float, float]
    source: str
    exact: Callable[[np.ndarray], np.ndarray] | None = field(default=None, repr=False)
    period: float | None = None
    conserved: tuple[str, ...] = ()


#: The functions of the catalogue, by name; each works without arguments.
CATALOGUE: dict[str, Callable[..., Problem]] = {}


def _listed(function: Callable[..., Problem]) -> Callable[..., Problem]:
    CATALOGUE[function.__name__] = function
    return function


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        require_positive(name, value)


@_listed
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
    _check_positive(omega=omega)

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


@_listed
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
    _check_positive(depth=depth, a=a)
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


@_listed
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
    _check_positive(omega=omega)
    if not 0 <= drive < math.inf:
        raise InputError(f"drive={drive!r} cannot be used; give a frequency from 0")
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
        # Between 0 and pi E - e sin(E) is convex: from above, Newton's method cannot overshoot.
        anomaly = np.sign(mean) * np.minimum(np.abs(mean) + e, math.pi)
        for _ in range(100):
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
        (
            "x*p_y - y*p_x",
            "p_y*(x*p_y - y*p_x) - x/sqrt(x**2 + y**2)",
            "-p_x*(x*p_y - y*p_x) - y/sqrt(x**2 + y**2)",
        ),
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


def _names(letter: str, n: int) -> list[str]:
    return [f"{letter}{i}" for i in range(1, n + 1)]


def _kinetic(n: int) -> str:
    return " + ".join(f"{p}**2/2" for p in _names("p", n))


def _bonds(n: int) -> list[str]:
    """Formulas of the stretch of each bond of a chain with fixed ends."""
    return [f"({b} - {a})" for a, b in itertools.pairwise(["0", *_names("q", n), "0"])]


def _chain_motion(
    start: np.ndarray, local: float, coupling: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Solve q_i'' = -local q_i + coupling (q_i+1 - 2 q_i + q_i-1), ends fixed, from rest.

    The modes are sin(pi i k/(n+1)), of frequencies local + 4 coupling sin(pi k/(2n+2))^2, squared.
    """
    n = len(start)
    k = np.arange(1, n + 1)
    modes = math.sqrt(2 / (n + 1)) * np.sin(math.pi * np.outer(k, k) / (n + 1))
    frequencies = np.sqrt(local + 4 * coupling * np.sin(math.pi * k / (2 * n + 2)) ** 2)
    amplitudes = modes @ start

    def exact(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(np.asarray(t), frequencies)
        q = (amplitudes * np.cos(phase)) @ modes
        p = (-amplitudes * frequencies * np.sin(phase)) @ modes
        return np.concatenate((q, p), axis=-1)

    return exact


def _mode_energies(n: int, local: str, coupling: str) -> tuple[str, ...]:
    """Formulas of the energies of all normal modes but the last; the sum of all of them is H."""
    formulas = []
    for k in range(1, n):
        q, p = (
            " + ".join(f"sin(pi*{i * k}/{n + 1})*{name}" for i, name in enumerate(names, 1))
            for names in (_names("q", n), _names("p", n))
        )
        square = f"({local} + 4*{coupling}*sin(pi*{k}/{2 * n + 2})**2)"
        formulas.append(f"(({p})**2 + {square}*({q})**2)/{n + 1}")
    return tuple(formulas) if n <= _MANY else ()


@_listed
def coupled_oscillators(n: int = 3, coupling: float = 0.5) -> Problem:
    """A chain of n oscillators, q_i'' = -q_i + coupling (q_i+1 - 2 q_i + q_i-1), ends fixed.

    Only the first mass is displaced. The exact solution is a sum of normal modes.

    Raises
    ------
    InputError
        If n is not a whole number from 1.
    """
    require_whole("n", n, 1)
    local = " + ".join(f"{q}**2/2" for q in _names("q", n))
    bonds = " + ".join(f"c*{stretch}**2/2" for stretch in _bonds(n))
    start = np.eye(n)[0]
    return Problem(
        "coupled oscillators",
        Hamiltonian(f"{_kinetic(n)} + {local} + {bonds}", parameters={"c": coupling}),
        (*start.tolist(), *[0.0] * n),
        (0.0, 4 * math.pi),
        "textbooks",
        _chain_motion(start, 1.0, coupling),
        conserved=_mode_energies(n, "1", "c"),
    )


@_listed
def fermi_pasta_ulam_tsingou(n: int = 5, alpha: float = 0.25, beta: float = 0.0) -> Problem:
    """The chain of Fermi, Pasta, Ulam & Tsingou: n masses, n+1 weakly nonlinear springs.

    H = sum p_i^2/2 + sum (d^2/2 + alpha d^3/3 + beta d^4/4) over the stretches d = q_i+1 - q_i,
    ends fixed, from rest in the lowest normal mode, q_i = sin(pi i/(n+1)). With
    alpha = beta = 0 the motion stays in that mode.

    Raises
    ------
    InputError
        If n is not a whole number from 2.

    Examples
    --------
    >>> problem = fermi_pasta_ulam_tsingou(n=2, alpha=0.0)
    >>> problem.exact(np.array([problem.period / 2])).round(3) + 0.0
    array([[-0.866, -0.866,  0.   ,  0.   ]])
    """
    require_whole("n", n, 2)
    springs = " + ".join(f"{d}**2/2 + alpha*{d}**3/3 + beta*{d}**4/4" for d in _bonds(n))
    start = np.sin(math.pi * np.arange(1, n + 1) / (n + 1))
    linear = alpha == beta == 0
    return Problem(
        "Fermi-Pasta-Ulam-Tsingou chain",
        Hamiltonian(f"{_kinetic(n)} + {springs}", parameters={"alpha": alpha, "beta": beta}),
        (*start.tolist(), *[0.0] * n),
        (0.0, 40.0),
        "Fermi, Pasta, Ulam & Tsingou 1955",
        _chain_motion(start, 0.0, 1.0) if linear else None,
        math.pi / math.sin(math.pi / (2 * n + 2)) if linear else None,
        _mode_energies(n, "0", "1") if linear else (),
    )


def _lax_traces(n: int) -> tuple[str, ...]:
    """Formulas of tr L and tr L^3 .. tr L^n of the Toda chain, to the sixth power; tr L^2 = 2 H."""
    q, p = (sympy.symbols(_names(letter, n), real=True) for letter in "qp")
    forces = sympy.symbols(_names("f", n - 1))
    # Similar to the symmetric matrix, without its square roots.
    L = sympy.diag(*p)
    for i, force in enumerate(forces):
        L[i, i + 1], L[i + 1, i] = 1, force
    meaning = {f: sympy.exp(a - b) for f, (a, b) in zip(forces, itertools.pairwise(q), strict=True)}
    powers = itertools.accumulate([DomainMatrix.from_Matrix(L)] * min(n, 6), operator.mul)
    traces = [sum(power[i, i].element for i in range(n)).as_expr() for power in powers]
    return tuple(str(trace.xreplace(meaning)) for trace in (traces[0], *traces[2:]))


def _toda_motion(q: np.ndarray, p: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Moser's solution: q_k = q_k(0) + log(tau_k-1/tau_k), tau_k the leading minors of exp(-t L).

    tau_k is a sum over all sets of k eigenvalues, of positive terms: the squares of the first
    components of their eigenvectors times those of their differences times exp(-t sum).
    """
    n = len(q)
    bonds = np.exp((q[:-1] - q[1:]) / 2)
    eigenvalues, vectors = np.linalg.eigh(np.diag(p) + np.diag(bonds, 1) + np.diag(bonds, -1))
    distances = np.abs(eigenvalues[:, None] - eigenvalues) + np.eye(n)
    members = np.array(list(itertools.product((0.0, 1.0), repeat=n)))
    weights = members @ np.log(vectors[0] ** 2) + ((members @ np.log(distances)) * members).sum(1)
    sums = members @ eigenvalues
    levels = [members.sum(1) == k for k in range(n + 1)]

    def minors(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the logarithms of tau_0 .. tau_n, and minus their rates."""
        logs, means = [], []
        for level in levels:
            terms = weights[level] - np.multiply.outer(t, sums[level])
            logs.append(scipy.special.logsumexp(terms, axis=-1))
            means.append(scipy.special.softmax(terms, axis=-1) @ sums[level])
        return np.stack(logs, axis=-1), np.stack(means, axis=-1)

    start = minors(np.array(0.0))[0]

    def exact(t: np.ndarray) -> np.ndarray:
        logs, means = minors(np.asarray(t, dtype=float))
        return np.concatenate((q - np.diff(logs - start), np.diff(means)), axis=-1)

    return exact


@_listed
def toda_chain(n: int = 3) -> Problem:
    """The open Toda chain, H = sum p_i^2/2 + sum_i<n exp(q_i - q_i+1).

    The first of n particles hits the others, which are at rest. For up to 12 particles the exact
    solution follows from the eigenvalues and eigenvectors of the matrix L with L_ii = p_i and
    L_i,i+1 = L_i+1,i = exp((q_i - q_i+1)/2); the traces of its powers are conserved.

    Raises
    ------
    InputError
        If n is not a whole number from 2.

    Examples
    --------
    >>> toda_chain().conserved[1]
    'p1**3 + 3*p1*exp(q1 - q2) + p2**3 + 3*p2*exp(q1 - q2) + 3*p2*exp(q2 - q3) + ...'
    """
    require_whole("n", n, 2)
    bonds = " + ".join(f"exp({a} - {b})" for a, b in itertools.pairwise(_names("q", n)))
    q, p = 2.0 * np.arange(n), 1.5 * np.eye(n)[0]
    return Problem(
        "Toda chain",
        Hamiltonian(f"{_kinetic(n)} + {bonds}"),
        (*q.tolist(), *p.tolist()),
        (0.0, 10.0),
        "Toda 1967; Flaschka 1974; Moser 1975",
        _toda_motion(q, p) if n <= _MANY else None,
        conserved=_lax_traces(n),
    )


def _calogero_moser_integrals(n: int, trapped: bool) -> tuple[str, ...]:
    """First integrals of the centre of mass and across the radius |q|; tr L^3 without a trap."""
    q, p = _names("q", n), _names("p", n)
    pairs = list(itertools.combinations(range(n), 2))
    squares = " + ".join(f"{b}**2" for b in p)
    repulsion = " + ".join(f"2*g**2/({q[i]} - {q[j]})**2" for i, j in pairs)
    radius = " + ".join(f"{a}**2" for a in q)
    radial = " + ".join(f"{a}*{b}" for a, b in zip(q, p, strict=True))
    across = f"({squares} + {repulsion})*({radius}) - ({radial})**2"
    if trapped:
        return (f"(({' + '.join(p)})**2 + omega**2*({' + '.join(q)})**2)/{2 * n}", across)
    cubes = " + ".join(f"{b}**3" for b in p)
    mixed = " + ".join(f"3*g**2*({p[i]} + {p[j]})/({q[i]} - {q[j]})**2" for i, j in pairs)
    return (" + ".join(p), across, f"{cubes} + {mixed}")


@_listed
def calogero_moser(n: int = 3, g: float = 1.0, omega: float = 1.0) -> Problem:
    """Particles on a line, H = sum (p_i^2 + omega^2 q_i^2)/2 + sum_i<j g^2/(q_i - q_j)^2.

    All are at rest but the first. Exactly, the q_i are the eigenvalues of
    Q cos(omega t) + L sin(omega t)/omega, of Q + L t without the trap, where Q is diagonal with
    the q_i at the start, L_jj = p_j there, and L_jk = i g/(q_j - q_k).

    Raises
    ------
    InputError
        If n is not a whole number from 2, g is not positive or omega is negative.
    """
    require_whole("n", n, 2)
    _check_positive(g=g)
    if not 0 <= omega < math.inf:
        raise InputError(f"omega={omega!r} cannot be used; give a frequency from 0")
    q, p = 1.5 * (np.arange(n) - (n - 1) / 2), np.eye(n)[0]
    Q, L = np.diag(q), np.diag(p) + 1j * g * (1 - np.eye(n)) / (q[:, None] - q + np.eye(n))

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)[..., None, None]
        cosine, sine = np.cos(omega * t), t * np.sinc(omega * t / math.pi)  # sin(omega t)/omega
        positions, vectors = np.linalg.eigh(Q * cosine + L * sine)
        # The particles never pass each other; the rate of an eigenvalue is v^* (dM/dt) v.
        rates = (vectors.conj() * ((L * cosine - omega**2 * sine * Q) @ vectors)).real.sum(axis=-2)
        return np.concatenate((positions, rates), axis=-1)

    trap = " + ".join(f"omega**2*{name}**2/2" for name in _names("q", n))
    pairs = list(itertools.combinations(range(1, n + 1), 2))
    repulsion = " + ".join(f"g**2/(q{i} - q{j})**2" for i, j in pairs)
    return Problem(
        "Calogero-Moser particles",
        Hamiltonian(f"{_kinetic(n)} + {trap} + {repulsion}", parameters={"g": g, "omega": omega}),
        (*q.tolist(), *p.tolist()),
        (0.0, 4 * math.pi / omega if omega else 10.0),
        "Calogero 1971; Moser 1975; Olshanetsky & Perelomov 1981",
        exact,
        2 * math.pi / omega if omega else None,
        _calogero_moser_integrals(n, omega > 0),
    )


@_listed
def charged_particle(field: float = 1.0) -> Problem:
    """A charged particle in a uniform magnetic field, symmetric gauge: not separable.

    H = ((p_x + B y/2)^2 + (p_y - B x/2)^2)/2 in units of charge and mass; exactly, circles of
    angular frequency B.

    Raises
    ------
    InputError
        If the field B is zero, or not finite.
    """
    if not 0 < abs(field) < math.inf:
        raise InputError(f"field={field!r} cannot be used; give a number other than 0")
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
def spring_pendulum(stiffness: float = 4.0, length: float = 0.75, gravity: float = 1.0) -> Problem:
    """A unit mass on an elastic spring that swings in the plane, y upwards.

    H = (p_x^2 + p_y^2)/2 + k (sqrt(x^2 + y^2) - l)^2/2 + g y. By default the spring hangs down to
    y = -1 and oscillates twice per swing: both motions are in resonance.

    Raises
    ------
    InputError
        If the stiffness k, the length l at rest or the gravity g is not positive.
    """
    _check_positive(stiffness=stiffness, length=length, gravity=gravity)
    H = Hamiltonian(
        "(p_x**2 + p_y**2)/2 + k*(sqrt(x**2 + y**2) - l)**2/2 + g*y",
        parameters={"k": stiffness, "l": length, "g": gravity},
    )
    z0 = (0.1, -1.2, 0.0, 0.0)
    return Problem("spring pendulum", H, z0, (0.0, 20.0), "Vitt & Gorelik 1933; Lynch 2002")


@_listed
def three_bodies() -> Problem:
    """Three equal masses that follow each other along a figure of eight, in the plane.

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
    spin = " + ".join(f"x{i}*py{i} - y{i}*px{i}" for i in (1, 2, 3))
    return Problem(
        "three bodies",
        H,
        z0,
        (0.0, period),
        "Chenciner & Montgomery 2000",
        None,
        period,
        ("px1 + px2 + px3", "py1 + py2 + py3", spin),
    )
