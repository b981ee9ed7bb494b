"""Lattices of complex amplitudes: the discrete nonlinear Schroedinger equations."""

from __future__ import annotations

import itertools
import math

import numpy as np
import scipy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require_number, require_whole
from hamsym.systems.catalogue import Problem, listed, numbered


def _ring(names: list[str]) -> list[tuple[str, str]]:
    """Neighbours on a ring; two sites have one bond."""
    closed = [*names, names[0]] if len(names) > 2 else names
    return list(itertools.pairwise(closed))


@listed
def discrete_nls(n: int = 3, coupling: float = 1.0, strength: float = 2.0) -> Problem:
    """The discrete nonlinear Schroedinger equation on a ring of n sites; two sites are a dimer.

    i psi_k' = -C (psi_k+1 + psi_k-1) - gamma |psi_k|^2 psi_k with psi_k = (q_k + i p_k)/sqrt(2),
    H = -C sum (q_k q_k+1 + p_k p_k+1) - gamma sum (q_k^2 + p_k^2)^2/8. At first only the first site
    is excited, |psi_1| = 1. In the dimer |psi_1|^2 - |psi_2|^2 = cn(2 C t | m),
    m = (gamma/(4 C))^2, and the excitation stays where it is for gamma > 4 C.

    Raises
    ------
    InputError
        If n is not a whole number from 2, or C or gamma is not finite.
    """
    require_whole("n", n, 2)
    require_number("coupling", coupling)
    require_number("strength", strength)
    q, p = numbered("q", n), numbered("p", n)
    hops = zip(_ring(q), _ring(p), strict=True)
    bonds = " + ".join(f"{a}*{b} + {c}*{d}" for (a, b), (c, d) in hops)
    onsite = " + ".join(f"({a}**2 + {b}**2)**2" for a, b in zip(q, p, strict=True))
    return Problem(
        "discrete nonlinear Schroedinger",
        Hamiltonian(
            f"-C*({bonds}) - gamma*({onsite})/8", parameters={"C": coupling, "gamma": strength}
        ),
        (math.sqrt(2), *[0.0] * (2 * n - 1)),
        (0.0, 10.0),
        "Eilbeck, Lomdahl & Scott 1985; dimer: Kenkre & Campbell 1986",
        conserved=(" + ".join(f"{a}**2 + {b}**2" for a, b in zip(q, p, strict=True)),),
    )


@listed
def ablowitz_ladik(n: int = 5, m: float = 0.9) -> Problem:
    """The integrable discrete nonlinear Schroedinger equation of Ablowitz and Ladik on a ring.

    i psi_k' = -(1 + |psi_k|^2) (psi_k+1 + psi_k-1). With psi_k = sqrt(exp(J_k) - 1) exp(i theta_k)
    it has the canonical form
    H = 2 sum sqrt((exp(J_k) - 1) (exp(J_k+1) - 1)) cos(theta_k+1 - theta_k), coordinates theta and
    momenta J. The start is on a travelling wave. Exactly,
    psi_k = (sn b/cn b) dn(b k + V t | m) exp(i (kappa k - w t)) with b = 2 K(m)/n,
    kappa = 2 pi/n, w = -2 cos(kappa) dn b/(cn b)^2 and V = -2 sin(kappa) sn b/cn b.

    Raises
    ------
    InputError
        If n is not a whole number from 3, or m is not from 0 to below 1.
    """
    require_whole("n", n, 3)
    if not 0 <= m < 1:
        raise InputError(f"m={m!r} cannot be used; give a number from 0 to below 1")
    step, turn = 2 * float(scipy.special.ellipk(m)) / n, 2 * math.pi / n
    sn, cn, dn, _ = (float(value) for value in scipy.special.ellipj(step, m))
    height, frequency = sn / cn, -2 * math.cos(turn) * dn / cn**2
    speed = -2 * math.sin(turn) * sn / cn
    sites = np.arange(n)

    def exact(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)[..., None]
        amplitude = height * scipy.special.ellipj(step * sites + speed * t, m)[2]
        return np.concatenate((turn * sites - frequency * t, np.log1p(amplitude**2)), axis=-1)

    theta, J = numbered("theta", n), numbered("J", n)
    pairs = list(zip(_ring(theta), _ring(J), strict=True))
    roots = [f"sqrt((exp({a}) - 1)*(exp({b}) - 1))" for _, (a, b) in pairs]
    hops, currents = (
        " + ".join(
            f"{root}*{function}({b} - {a})" for root, ((a, b), _) in zip(roots, pairs, strict=True)
        )
        for function in ("cos", "sin")
    )
    return Problem(
        "Ablowitz-Ladik lattice",
        Hamiltonian(f"2*({hops})", q=theta, p=J),
        tuple(exact(np.array(0.0)).tolist()),
        (0.0, 10.0),
        "Ablowitz & Ladik 1976; Scharf & Bishop 1991",
        exact,
        conserved=(" + ".join(J), currents),
    )
