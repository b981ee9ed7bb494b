"""Time for a true error: hamsym's march against scipy's DOP853, both interpreted, in one run.

DOP853 has dense output and the leanest right-hand side that Python allows, written by hand; it is
run at several tolerances, and the fastest run whose true error is no larger than hamsym's counts.
Errors are 2-norms at 4,001 times, against exact solutions or a march with other features at 1e-12.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import cos, sin

import numpy as np
from scipy.integrate import solve_ivp

import hamsym
from hamsym import systems


def oscillator(t, z):
    x, p = z
    return [p, -x - x * x * x]


def pendulum(t, z):
    theta, p = z
    return [p, -sin(theta)]


def henon_heiles(t, z):
    x, y, px, py = z
    return [px, py, -x - 2 * x * y, -y - x * x + y * y]


def kepler(t, z):
    x, y, px, py = z
    cube = (x * x + y * y) ** 1.5
    return [px, py, -x / cube, -y / cube]


def double_pendulum(t, z):
    a, b, p, q = z
    s, c = sin(a - b), cos(a - b)
    d = 1 + s * s
    top = p * p + 2 * q * q - 2 * p * q * c
    common = (p * q * s * d - top * s * c) / (d * d)
    return [(p - q * c) / d, (2 * q - p * c) / d, -common - 2 * sin(a), common - sin(b)]


PROBLEMS = (
    ("oscillator, 20 pi", "nonlinear_oscillator", 20 * np.pi, oscillator),
    ("pendulum, t = 50", "pendulum", 50.0, pendulum),
    ("Henon-Heiles, t = 300", "henon_heiles", 300.0, henon_heiles),
    ("Kepler e = 0.6, 2 periods", "kepler", 4 * np.pi, kepler),
    ("double pendulum, t = 20", "double_pendulum", 20.0, double_pendulum),
)


def best(function: Callable[[], object], repeats: int = 5) -> tuple[float, object]:
    times, result = [], None
    for _ in range(repeats):
        began = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - began)
    return min(times), result


def main() -> None:
    print(
        f"{'problem':<26}{'tol':>7}{'true error':>11}{'march ms':>10}{'solve ms':>10}"
        f"{'DOP853':>9}{'ratios':>13}"
    )
    for label, name, end, field in PROBLEMS:
        problem = systems.CATALOGUE[name]()
        H, z0, span = problem.H, np.array(problem.z0), (0.0, end)
        t = np.linspace(*span, 4_001)
        truth = (
            problem.exact(t) if problem.exact else hamsym.solve(H, z0, span, tol=1e-12, seed=9)(t)
        )
        rivals = []
        for exponent in np.arange(5, 13.6, 0.5):
            options = {"rtol": 10.0**-exponent, "atol": 10.0**-exponent}
            seconds, run = best(
                lambda options=options, field=field, span=span, z0=z0: solve_ivp(
                    field, span, z0, method="DOP853", dense_output=True, **options
                ),
                3,
            )
            rivals.append((np.linalg.norm(run.sol(t).T - truth, axis=1).max(), seconds))
        for tol in (1e-6, 1e-9, 1e-11):
            seconds, solution = best(
                lambda tol=tol, H=H, z0=z0, span=span: hamsym.solve(H, z0, span, tol=tol)
            )
            error = np.linalg.norm(solution(t) - truth, axis=1).max()
            march = solution.training.seconds
            equal = [s for e, s in rivals if e <= error] or [min(rivals)[1]]
            note = "" if solution.success else "  NOT met"
            print(
                f"{label:<26}{tol:>7.0e}{error:>11.1e}{1e3 * march:>10.1f}{1e3 * seconds:>10.1f}"
                f"{1e3 * min(equal):>9.1f}{march / min(equal):>6.2f},"
                f"{seconds / min(equal):>6.2f}{note}"
            )
    print("ratios: march alone and whole solve, over DOP853 at equal true error")


if __name__ == "__main__":
    main()
