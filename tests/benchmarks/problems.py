"""Problems with their true states, and their vector fields as one writes them by hand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np

import hamsym
from hamsym import systems


def chain(n: int, alpha: float = 0.25, beta: float = 0.3) -> str:
    """H of the Fermi-Pasta-Ulam-Tsingou chain of n masses as text."""
    q = ["0", *(f"q{i}" for i in range(1, n + 1)), "0"]
    kinetic = " + ".join(f"p{i}**2/2" for i in range(1, n + 1))
    bonds = (
        f"({b} - {a})**2/2 + {alpha}*({b} - {a})**3/3 + {beta}*({b} - {a})**4/4"
        for a, b in itertools.pairwise(q)
    )
    return f"{kinetic} + {' + '.join(bonds)}"


def oscillator(t: Any, z: Any) -> Any:
    x, p = z
    return p, -x - x * x * x


def pendulum(t: Any, z: Any) -> Any:
    theta, p = z
    return p, -sin(theta)


def henon_heiles(t: Any, z: Any) -> Any:
    x, y, px, py = z
    return px, py, -x - 2 * x * y, -y - x * x + y * y


def kepler(t: Any, z: Any) -> Any:
    x, y, px, py = z
    cube = (x * x + y * y) ** 1.5
    return px, py, -x / cube, -y / cube


def double_pendulum(t: Any, z: Any) -> Any:
    a, b, p, q = z
    s, c = sin(a - b), cos(a - b)
    d = 1 + s * s
    top = p * p + 2 * q * q - 2 * p * q * c
    common = (p * q * s * d - top * s * c) / (d * d)
    return (p - q * c) / d, (2 * q - p * c) / d, -common - 2 * sin(a), common - sin(b)


def three_bodies(t: Any, z: Any) -> Any:
    x1, x2, x3, y1, y2, y3, u1, u2, u3, v1, v2, v3 = z
    xa, xb, xc, ya, yb, yc = x1 - x2, x1 - x3, x2 - x3, y1 - y2, y1 - y3, y2 - y3
    a = (xa * xa + ya * ya) ** -1.5
    b = (xb * xb + yb * yb) ** -1.5
    c = (xc * xc + yc * yc) ** -1.5
    xa, ya, xb, yb, xc, yc = a * xa, a * ya, b * xb, b * yb, c * xc, c * yc
    return u1, u2, u3, v1, v2, v3, -xa - xb, xa - xc, xb + xc, -ya - yb, ya - yc, yb + yc


#: Label, name in the catalogue, end of the span, and vector field of each problem.
PROBLEMS: tuple[tuple[str, str, float, Callable[[Any, Any], Any]], ...] = (
    ("oscillator, 20 pi", "nonlinear_oscillator", 20 * math.pi, oscillator),
    ("pendulum, t = 50", "pendulum", 50.0, pendulum),
    ("Henon-Heiles, t = 300", "henon_heiles", 300.0, henon_heiles),
    ("Kepler e = 0.6, 2 periods", "kepler", 4 * math.pi, kepler),
    ("double pendulum, t = 20", "double_pendulum", 20.0, double_pendulum),
    ("three bodies, 1 period", "three_bodies", 6.32591398292621, three_bodies),
)


@dataclass(frozen=True)
class Case:
    """An initial-value problem with its true states at equally spaced times.

    The truth is the exact solution where the catalogue has one, and elsewhere a march with other
    features at a tolerance of 1e-12.
    """

    label: str
    H: hamsym.Hamiltonian
    z0: np.ndarray
    t: np.ndarray
    field: Callable[[Any, Any], Any]
    truth: np.ndarray

    @property
    def span(self) -> tuple[float, float]:
        return float(self.t[0]), float(self.t[-1])

    @classmethod
    def of(
        cls, label: str, name: str, end: float, field: Callable[[Any, Any], Any], times: int
    ) -> Case:
        problem = systems.CATALOGUE[name]()
        t = np.linspace(0.0, end, times)
        if problem.exact:
            truth = problem.exact(t)
        else:
            solution = hamsym.solve(problem.H, problem.z0, (0.0, end), tol=1e-12, seed=9)
            if not solution.success:
                print(f"reference of {label}: {solution.message}")
            truth = solution(t)
        return cls(label, problem.H, np.array(problem.z0), t, field, truth)
