"""Particles on a line: chains of springs, the Toda chain, the Calogero-Moser system."""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable

import numpy as np
import scipy
import sympy
from sympy.polys.matrices import DomainMatrix

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_whole
from hamsym.systems.catalogue import Problem, check_positive, kinetic, listed, numbered

# Largest number of particles for formulas of 2**n terms, or for n formulas of n terms.
_MANY = 12


def _bonds(n: int) -> list[str]:
    """Formulas of the stretch of each bond of a chain with fixed ends."""
    return [f"({b} - {a})" for a, b in itertools.pairwise(["0", *numbered("q", n), "0"])]


def _chain_motion(
    start: np.ndarray, local: float, coupling: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Solve q_i'' = -local q_i + coupling (q_i+1 - 2 q_i + q_i-1), ends fixed, from rest.

    The modes are sin(pi i k/(n+1)), of frequencies local + 4 coupling sin(pi k/(2n+2))^2, squared.
    Those of unstable modes are imaginary.
    """
    n = len(start)
    k = np.arange(1, n + 1)
    modes = math.sqrt(2 / (n + 1)) * np.sin(math.pi * np.outer(k, k) / (n + 1))
    frequencies = np.emath.sqrt(local + 4 * coupling * np.sin(math.pi * k / (2 * n + 2)) ** 2)
    amplitudes = modes @ start

    def exact(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(np.asarray(t), frequencies)
        q = (amplitudes * np.cos(phase)) @ modes
        p = (-amplitudes * frequencies * np.sin(phase)) @ modes
        return np.concatenate((q, p), axis=-1).real

    return exact


def _mode_energies(n: int, local: str, coupling: str) -> tuple[str, ...]:
    """Formulas of the energies of all normal modes but the last; the sum of all of them is H."""
    formulas = []
    for k in range(1, n):
        q, p = (
            " + ".join(f"sin(pi*{i * k}/{n + 1})*{name}" for i, name in enumerate(names, 1))
            for names in (numbered("q", n), numbered("p", n))
        )
        square = f"({local} + 4*{coupling}*sin(pi*{k}/{2 * n + 2})**2)"
        formulas.append(f"(({p})**2 + {square}*({q})**2)/{n + 1}")
    return tuple(formulas) if n <= _MANY else ()


@listed
def coupled_oscillators(n: int = 3, coupling: float = 0.5) -> Problem:
    """A chain of n oscillators, q_i'' = -q_i + coupling (q_i+1 - 2 q_i + q_i-1), ends fixed.

    Only the first mass is displaced. The exact solution is a sum of normal modes.

    Raises
    ------
    InputError
        If n is not a whole number from 1.
    """
    require_whole("n", n, 1)
    local = " + ".join(f"{q}**2/2" for q in numbered("q", n))
    bonds = " + ".join(f"c*{stretch}**2/2" for stretch in _bonds(n))
    start = np.eye(n)[0]
    return Problem(
        "coupled oscillators",
        Hamiltonian(f"{kinetic(n)} + {local} + {bonds}", parameters={"c": coupling}),
        (*start.tolist(), *[0.0] * n),
        (0.0, 4 * math.pi),
        "textbooks",
        _chain_motion(start, 1.0, coupling),
        conserved=_mode_energies(n, "1", "c"),
    )


@listed
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
        Hamiltonian(f"{kinetic(n)} + {springs}", parameters={"alpha": alpha, "beta": beta}),
        (*start.tolist(), *[0.0] * n),
        (0.0, 40.0),
        "Fermi, Pasta, Ulam & Tsingou 1955",
        _chain_motion(start, 0.0, 1.0) if linear else None,
        math.pi / math.sin(math.pi / (2 * n + 2)) if linear else None,
        _mode_energies(n, "0", "1") if linear else (),
    )


def _lax_traces(n: int) -> tuple[str, ...]:
    """Formulas of tr L and tr L^3 .. tr L^n of the Toda chain, to the sixth power; tr L^2 = 2 H."""
    q, p = (sympy.symbols(numbered(letter, n), real=True) for letter in "qp")
    forces = sympy.symbols(numbered("f", n - 1))
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


@listed
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
    bonds = " + ".join(f"exp({a} - {b})" for a, b in itertools.pairwise(numbered("q", n)))
    q, p = 2.0 * np.arange(n), 1.5 * np.eye(n)[0]
    return Problem(
        "Toda chain",
        Hamiltonian(f"{kinetic(n)} + {bonds}"),
        (*q.tolist(), *p.tolist()),
        (0.0, 10.0),
        "Toda 1967; Flaschka 1974; Moser 1975",
        _toda_motion(q, p) if n <= _MANY else None,
        conserved=_lax_traces(n),
    )


def _calogero_moser_integrals(n: int, trapped: bool) -> tuple[str, ...]:
    """First integrals of the centre of mass and across the radius |q|; tr L^3 without a trap."""
    q, p = numbered("q", n), numbered("p", n)
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


@listed
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
    check_positive(g=g)
    require(0 <= omega < math.inf, "omega", omega, "a frequency from 0")
    q, p = 1.5 * (np.arange(n) - (n - 1) / 2), np.eye(n)[0]
    Q, L = np.diag(q), np.diag(p) + 1j * g * (1 - np.eye(n)) / (q[:, None] - q + np.eye(n))

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)[..., None, None]
        cosine, sine = np.cos(omega * t), t * np.sinc(omega * t / math.pi)  # sin(omega t)/omega
        positions, vectors = np.linalg.eigh(Q * cosine + L * sine)
        # The particles never pass each other; the rate of an eigenvalue is v^* (dM/dt) v.
        rates = (vectors.conj() * ((L * cosine - omega**2 * sine * Q) @ vectors)).real.sum(axis=-2)
        return np.concatenate((positions, rates), axis=-1)

    trap = " + ".join(f"omega**2*{name}**2/2" for name in numbered("q", n))
    pairs = list(itertools.combinations(range(1, n + 1), 2))
    repulsion = " + ".join(f"g**2/(q{i} - q{j})**2" for i, j in pairs)
    return Problem(
        "Calogero-Moser particles",
        Hamiltonian(f"{kinetic(n)} + {trap} + {repulsion}", parameters={"g": g, "omega": omega}),
        (*q.tolist(), *p.tolist()),
        (0.0, 4 * math.pi / omega if omega else 10.0),
        "Calogero 1971; Moser 1975; Olshanetsky & Perelomov 1981",
        exact,
        2 * math.pi / omega if omega else None,
        _calogero_moser_integrals(n, omega > 0),
    )
