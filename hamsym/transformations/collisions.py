"""Collisions of two bodies, in coordinates in which they are regular.

With r = |u|^2 and the matrix L(u), a place is L(u) u and a momentum L(u) P/(2 r): in the plane
those of Levi-Civita (1920), in space those of Kustaanheimo & Stiefel (1965).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy


@dataclass(frozen=True)
class Collision:
    """A place where bodies meet: new variables u and P, and what they are of the old ones.

    place, momentum: L(u) u and L(u) P/(2 r), formulas in the old variables.
    """

    u: tuple[str, ...]
    place: tuple[sympy.Expr, ...]
    momentum: tuple[sympy.Expr, ...]

    @property
    def P(self) -> tuple[str, ...]:
        return tuple(f"p_{name}" for name in self.u)


def turning(u: Sequence[Any]) -> list[list[Any]]:
    """The matrix L(u), with L L^T = |u|^2, row by row."""
    if len(u) == 2:
        return [[u[0], -u[1]], [u[1], u[0]]]
    return [[u[0], -u[1], -u[2], u[3]], [u[1], u[0], -u[3], -u[2]], [u[2], u[3], u[0], u[1]]]


def lifted(
    place: Sequence[np.ndarray], momentum: Sequence[np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The variables u and P of a collision: L(u) u is its place, and P = 2 L^T p."""
    x, size = place[0], functools.reduce(np.hypot, place)
    first = np.sqrt((size + np.abs(x)) / 2)
    beside = [value / (2 * first) for value in place[1:]]
    # of the two halves of the circle the one without a difference of near numbers
    right, left = [first, beside[0]], [beside[0], first]
    if len(place) == 3:
        right, left = [*right, beside[1], 0 * x], [*left, 0 * x, beside[1]]
    u = [np.where(x >= 0, *pair) for pair in zip(right, left, strict=True)]
    columns = zip(*turning(u), strict=True)
    return u, [2 * sum(a * p for a, p in zip(own, momentum, strict=True)) for own in columns]
