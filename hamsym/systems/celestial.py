"""Celestial mechanics: point masses under gravity, in the plane."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require, require_number
from hamsym.systems.catalogue import Problem, check_start, listed
from hamsym.systems.planar import planar_hamiltonian, planar_integrals


@listed
def kepler(eccentricity: float = 0.6) -> Problem:
    """The Kepler problem H = |p|^2/2 - 1/r in the plane, from the pericentre; semi-axis 1.

    Exactly, by Kepler's equation t = E - e sin(E).

    Raises
    ------
    InputError
        If the eccentricity is not from 0 to below 1.
    """
    require(0 <= eccentricity < 1, "eccentricity", eccentricity, "0 <= e < 1")
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


def _planar_bodies(masses: Sequence[float]) -> Hamiltonian:
    """Point masses that attract each other, G = 1, with coordinates x1, x2, ..., y1, y2, ..."""
    n = range(1, len(masses) + 1)
    weights = ["" if mass == 1 else f"{mass}*" for mass in masses]
    kinetic = " + ".join(
        f"(px{i}**2 + py{i}**2)/({weight}2)" for i, weight in zip(n, weights, strict=True)
    )
    potential = " - ".join(
        f"{weights[i - 1]}{weights[j - 1]}1/sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)"
        for i, j in itertools.combinations(n, 2)
    )
    return planar_hamiltonian(len(masses), f"{kinetic} - {potential}")


@listed
def three_bodies() -> Problem:
    """Three equal masses that follow each other along a figure of eight, in the plane.

    H = (|p_1|^2 + |p_2|^2 + |p_3|^2)/2 - 1/r_12 - 1/r_13 - 1/r_23. Found by Moore (1993), proved
    by Chenciner & Montgomery (2000). The start is that of Simo's computation, continued to all
    digits of float64 by Newton's method on the symmetry after a quarter of the period, with the
    moment of inertia |q_1|^2 + |q_2|^2 + |q_3|^2 = 2 at the start.
    """
    x, y, u, v = 0.9700043566973334, -0.24308753153584886, -0.9324073714410523, -0.864731460921006
    z0 = (x, -x, 0.0, y, -y, 0.0, -u / 2, -u / 2, u, -v / 2, -v / 2, v)
    period = 6.325913982926212
    return Problem(
        "three bodies",
        _planar_bodies([1, 1, 1]),
        z0,
        (0.0, period),
        "Chenciner & Montgomery 2000",
        None,
        period,
        planar_integrals(3),
    )


@listed
def pleiades() -> Problem:
    """Seven stars of masses 1 to 7 in the plane, with close encounters.

    The IVP test set publishes the state at t = 3 to 16 digits.
    """
    masses = [1, 2, 3, 4, 5, 6, 7]
    x, y = (3, 3, -1, -3, 2, -2, 2), (3, -3, 2, 0, 0, -4, 4)
    vx, vy = (0, 0, 0, 0, 0, 1.75, -1.5), (0, 0, 0, -1.25, 1, 0, 0)
    momenta = (m * v for v_axis in (vx, vy) for m, v in zip(masses, v_axis, strict=True))
    return Problem(
        "Pleiades",
        _planar_bodies(masses),
        tuple(float(value) for value in (*x, *y, *momenta)),
        (0.0, 3.0),
        "Hairer, Norsett & Wanner 1993, section II.10; IVP test set (Bari), plei",
        conserved=planar_integrals(7),
    )


# -- the restricted problem of three bodies ------------------------------------------------------


def _rotating(mu: float, axes: str = "xy") -> Hamiltonian:
    kinetic = " + ".join(f"p_{axis}**2" for axis in axes)
    across = " + ".join(f"{axis}**2" for axis in axes[1:])
    return Hamiltonian(
        f"({kinetic})/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + {across})"
        f" - mu/sqrt((x - 1 + mu)**2 + {across})",
        q=list(axes),
        p=[f"p_{axis}" for axis in axes],
        parameters={"mu": mu},
    )


@listed
def restricted_three_bodies(mu: float = 0.01) -> Problem:
    """A small body in the plane of two large ones on circles, in the frame that rotates with them.

    H = (p_x^2 + p_y^2)/2 + y p_x - x p_y - (1 - mu)/r_1 - mu/r_2, with the masses 1 - mu at
    (-mu, 0) and mu at (1 - mu, 0); the momenta are the velocities in the frame at rest,
    p_x = x' - y, p_y = y' + x. The start is at rest in the rotating frame, 0.01 to the right of
    the Lagrange point L4, which is stable for mu below 0.0385.

    Raises
    ------
    InputError
        If mu is not above 0 and at most 1/2.
    """
    require_number("mu", mu)
    require(0 < mu <= 0.5, "mu", mu, "a mass above 0 and up to 1/2")
    x, y = 0.51 - mu, math.sqrt(3) / 2
    return Problem(
        "restricted three-body problem",
        _rotating(mu),
        (x, y, -y, x),
        (0.0, 40.0),
        "Szebehely 1967; start chosen here",
    )


# mass of the moon, x and y' at the start, period
_ARENSTORF = {
    "period 17.07": (
        *(0.012277471, 0.994, -2.00158510637908252240537862224),
        17.0652165601579625588917206249,
    ),
    "period 11.12": (
        *(0.012277471, 0.994, -2.0317326295573368357302057924),
        11.124340337266085134999734047,
    ),
    "period 6.19": (1 / 82.45, 1.2, -1.04935750983031990726, 6.19216933131963970674),
}


@listed
def arenstorf(start: str = "period 17.07") -> Problem:
    """Periodic orbits of a spacecraft around the earth and the moon, found by Arenstorf.

    H is that of :func:`restricted_three_bodies` with mu = 0.012277471, or 1/82.45 in the shortest
    orbit. They begin on the line through both, at right angles to it; the two longer ones 0.006
    from the moon.

    Raises
    ------
    InputError
        If there is no such start.

    Examples
    --------
    >>> problem = arenstorf(start="period 11.12")
    >>> problem.z0, problem.period
    ((0.994, 0.0, 0.0, -1.0377326295573368), 11.124340337266085)
    """
    check_start(start, _ARENSTORF)
    mu, x, velocity, period = _ARENSTORF[start]
    return Problem(
        "Arenstorf orbit",
        _rotating(mu),
        (x, 0.0, 0.0, x + velocity),
        (0.0, period),
        "Arenstorf 1963; Hairer, Norsett & Wanner 1993, section II.0; Shampine & Gordon 1975",
        period=period,
        start=start,
        starts=tuple(_ARENSTORF),
    )


# x, z and y' at the start, period
_HALO = {
    "L1": (-0.41456184803140111, 0.90753120433295065, 1.4076145460136695, 3.1233143922761588),
    "L2, near the moon": (0.987400731008972, 0.008100357035379353, 1.702808084855773, 1.5),
}


@listed
def halo_orbits(start: str = "L2, near the moon") -> Problem:
    """Periodic orbits of a spacecraft in space about the Lagrange points of the earth and the moon.

    H = (p_x^2 + p_y^2 + p_z^2)/2 + y p_x - x p_y - (1 - mu)/r_1 - mu/r_2 with mu =
    0.01215058560962404, as :func:`restricted_three_bodies` in space. Orbits begin in the plane y =
    0, at right angles to it, and are their own images under y -> -y with the time reversed; their
    families leave those of the planar Lyapunov orbits (Howell 1984). That of L1 is far along its
    family, out of the plane; that of L2, a northern one, passes the moon at 0.0084, 3,200 km.

    Raises
    ------
    InputError
        If there is no such start.

    Examples
    --------
    >>> problem = halo_orbits(start="L1")
    >>> problem.period
    3.123314392276159
    """
    check_start(start, _HALO)
    x, z, velocity, period = _HALO[start]
    return Problem(
        "halo orbit",
        _rotating(0.01215058560962404, "xyz"),
        (x, 0.0, z, 0.0, x + velocity, 0.0),
        (0.0, period),
        "L1: JPL, catalogue of periodic orbits of three bodies; L2: Howell 1984, start found here",
        period=period,
        start=start,
        starts=tuple(_HALO),
    )
