"""Clusters of atoms that attract each other weakly and repel each other at contact."""

from __future__ import annotations

import itertools
import math

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require_whole
from hamsym.systems.catalogue import Problem, listed
from hamsym.systems.planar import planar_hamiltonian, planar_integrals


def _cluster(n: int, **parameters: float) -> Hamiltonian:
    """Unit masses in the plane with the potential 4 epsilon ((sigma/r)^12 - (sigma/r)^6)."""
    every = range(1, n + 1)
    kinetic = " + ".join(f"(px{i}**2 + py{i}**2)/2" for i in every)
    pairs = []
    for i, j in itertools.combinations(every, 2):
        square = f"((x{i} - x{j})**2 + (y{i} - y{j})**2)"
        pairs.append(f"4*epsilon*(sigma**12/{square}**6 - sigma**6/{square}**3)")
    return planar_hamiltonian(n, f"{kinetic} + {' + '.join(pairs)}", **parameters)


@listed
def lennard_jones(n: int = 3) -> Problem:
    """A cluster of n atoms in the plane with Lennard-Jones forces, in reduced units.

    H = sum |p_i|^2/2 + 4 sum_i<j (r_ij^-12 - r_ij^-6). The atoms start from the n sites of a
    triangular lattice that are nearest to one of them, at the distance 2^(1/6) of the lowest energy
    of a pair, to four decimals, with momenta of size 0.3 in different directions.

    Raises
    ------
    InputError
        If n is not a whole number from 2 to 20.
    """
    require_whole("n", n, 2, 20)
    sites = []
    for i, j in itertools.product(range(-5, 6), repeat=2):
        x, y = i + j / 2, math.sqrt(0.75) * j
        sites.append((i * i + i * j + j * j, math.atan2(y, x) % (2 * math.pi), x, y))
    places = [site[2:] for site in sorted(sites)[:n]]
    distance = 2 ** (1 / 6)
    momenta = [(0.3 * math.cos(2 * k), 0.3 * math.sin(2 * k)) for k in range(n)]
    positions = [distance * place[axis] for axis in (0, 1) for place in places]
    speeds = [momentum[axis] for axis in (0, 1) for momentum in momenta]
    return Problem(
        "Lennard-Jones cluster",
        _cluster(n, epsilon=1.0, sigma=1.0),
        tuple(round(value, 4) for value in (*positions, *speeds)),
        (0.0, 5.0),
        "Lennard-Jones 1924; start chosen here",
        conserved=planar_integrals(n),
    )


@listed
def argon_crystal() -> Problem:
    """Seven argon atoms in the plane, a frozen crystal: one in the middle of six.

    Lengths are in nanometres, times in nanoseconds, and energies are divided by the mass of an
    atom, 66.34e-27 kg; epsilon is 119.8 K times Boltzmann's constant, sigma = 0.341 nm. At the
    start the energy is -1260.2 K.
    """
    x = (0.0, 0.02, 0.34, 0.36, -0.02, -0.35, -0.31)
    y = (0.0, 0.39, 0.17, -0.21, -0.4, -0.16, 0.21)
    px = (-30.0, 50.0, -70.0, 90.0, 80.0, -40.0, -80.0)
    py = (-20.0, -90.0, -60.0, 40.0, 90.0, 100.0, -60.0)
    epsilon = 119.8 * 1.380658e-23 / 66.34e-27  # m^2/s^2, or nm^2/ns^2
    return Problem(
        "frozen argon crystal",
        _cluster(7, epsilon=epsilon, sigma=0.341),
        (*x, *y, *px, *py),
        (0.0, 0.005),
        "Biesiadecki & Skeel 1993; Hairer, Lubich & Wanner 2006, section I.4",
        conserved=planar_integrals(7),
    )
