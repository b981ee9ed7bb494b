"""Recognition of polar coordinates, and of the angles of pendula, in a Hamiltonian.

Input:  a Hamiltonian with coordinates such as r, theta or theta1, theta2.
Output: pairs (distance, angle) of bodies in a plane, and where their angles are counted from.
"""

from __future__ import annotations

import itertools
import re

import numpy as np
import sympy

from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic import derivatives

ANGLE = re.compile(r"(theta|phi|psi|varphi|vartheta|alpha)(_?\d+)?")
RADIUS = re.compile(r"(r|rho|R)(_?\d+)?")

#: Directions of the angle zero; angles grow counterclockwise.
RIGHT, DOWN, UP = 0.0, -np.pi / 2, np.pi / 2


def is_angle(H: Hamiltonian, place: int) -> bool:
    """Whether a coordinate has the name of an angle, or H depends on it with the period 2 pi."""
    symbol = H.q[place]
    if ANGLE.fullmatch(H.names[place]):
        return True
    if RADIUS.fullmatch(H.names[place]) or not H.expr.has(symbol):
        return False
    turned = H.expr.xreplace({symbol: symbol + 2 * sympy.pi})
    return bool(derivatives.vanishes(turned - H.expr))


def coupled(H: Hamiltonian, chosen: list[int]) -> bool:
    """Whether the kinetic energy couples each coordinate to the next, as where one carries it."""
    return all(H.expr.diff(H.p[i], H.p[j]) != 0 for i, j in itertools.pairwise(chosen))


def polar_pairs(H: Hamiltonian) -> list[tuple[int, int]]:
    """Pairs of all coordinates, distance and angle of one body each; empty if they are others.

    Names such as r, theta must be confirmed by H: the inertia of the angle is proportional to r**2.
    """
    radii = {m[2] or "": i for i, n in enumerate(H.names[: H.dof]) if (m := RADIUS.fullmatch(n))}
    angles = {m[2] or "": i for i, n in enumerate(H.names[: H.dof]) if (m := ANGLE.fullmatch(n))}
    if radii.keys() != angles.keys() or 2 * len(radii) != H.dof:
        return []
    pairs = [(radii[number], angles[number]) for number in radii]
    for i, j in pairs:
        inertia = H.expr.diff(H.p[j], 2) * H.q[i] ** 2
        if derivatives.vanishes(inertia) or not derivatives.vanishes(inertia.diff(H.q[i])):
            return []
    return pairs


def direction_of_zero(H: Hamiltonian, pairs: list[tuple[int, int]]) -> float:
    """The direction of the angle zero: down or up if a weight acts along it, else to the right."""
    found = {_weighed(H, *pair) for pair in pairs}
    return found.pop() if len(found) == 1 else RIGHT


def _weighed(H: Hamiltonian, i: int, j: int) -> float:
    z = np.ones((4, H.dim))
    z[:, H.dof :] = 0.0
    z[:, i], z[:, j] = [1.0, 1.0, 2.0, 2.0], [0.0, np.pi, 0.0, np.pi]
    near, near_back, far, far_back = H.compile("numpy").at("energy", z, np.zeros(4))
    weight, twice = near_back - near, far_back - far
    size = 1e-9 * max(abs(near), abs(near_back))
    if not abs(weight) > size or not abs(twice - 2 * weight) <= 1e-9 * abs(weight):
        return RIGHT
    return DOWN if weight > 0 else UP
