"""Generated loops of splitting methods over numba loops written by hand, on one long trajectory.

By hand: scalars, a step as one writes it down, the coefficients as constants. hamsym.integrate as a
whole; all but the stepping is negligible over so many steps. Both give the same states, to 1e-9.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

import hamsym
from hamsym import systems

from . import markdown
from .measuring import in_turns, median
from .results import Section

Function = Callable[..., Any]

# Forest & Ruth: drifts by C1, C2, C2, C1 and kicks by D1, D2, D1, in turns, in units of a step.
D1 = 1 / (2 - 2 ** (1 / 3))
D2 = 1 - 2 * D1
C1, C2 = D1 / 2, (D1 + D2) / 2


@njit
def oscillator_drift(z, h):  # type: ignore[no-untyped-def]
    x, p = z
    return x + h * p, p


@njit
def oscillator_kick(z, h):  # type: ignore[no-untyped-def]
    x, p = z
    return x, p - h * (x + x**3)


@njit
def henon_heiles_drift(z, h):  # type: ignore[no-untyped-def]
    x, y, px, py = z
    return x + h * px, y + h * py, px, py


@njit
def henon_heiles_kick(z, h):  # type: ignore[no-untyped-def]
    x, y, px, py = z
    return x, y, px - h * (x + 2 * x * y), py - h * (y + x * x - y * y)


def euler(drift: Function, kick: Function) -> Function:
    @njit
    def step(z, h):  # type: ignore[no-untyped-def]
        return kick(drift(z, h), h)

    return step  # type: ignore[no-any-return]


def verlet(drift: Function, kick: Function) -> Function:
    @njit
    def step(z, h):  # type: ignore[no-untyped-def]
        return drift(kick(drift(z, h / 2), h), h / 2)

    return step  # type: ignore[no-any-return]


def forest_ruth(drift: Function, kick: Function) -> Function:
    @njit
    def step(z, h):  # type: ignore[no-untyped-def]
        z = kick(drift(z, C1 * h), D1 * h)
        z = kick(drift(z, C2 * h), D2 * h)
        z = kick(drift(z, C2 * h), D1 * h)
        return drift(z, C1 * h)

    return step  # type: ignore[no-any-return]


def loop(step: Function) -> Function:
    @njit
    def run(z, h, saves, save_every, out):  # type: ignore[no-untyped-def]
        for i in range(1, saves + 1):
            for _ in range(save_every):
                z = step(z, h)
            for k in range(len(z)):
                out[i, k] = z[k]

    return run  # type: ignore[no-any-return]


_FLOWS = {
    "nonlinear_oscillator": (oscillator_drift, oscillator_kick),
    "henon_heiles": (henon_heiles_drift, henon_heiles_kick),
}
_STEPS = {"symplectic_euler": euler, "stormer_verlet": verlet, "forest_ruth": forest_ruth}


def measure(quick: bool) -> Section:
    steps, turns = (100_000, 3) if quick else (4_000_000, 9)
    pairs = [(name, method) for name in _FLOWS for method in _STEPS]
    rows = []
    for name, method in pairs[2:3] if quick else pairs:
        times = _times(
            systems.CATALOGUE[name](), method, loop(_STEPS[method](*_FLOWS[name])), steps, turns
        )
        ratios = [own / hand for own, hand in zip(times["hamsym"], times["by hand"], strict=True)]
        rows.append(
            {
                "system": name,
                "method": method,
                "by hand": median(times["by hand"]) / steps,
                "hamsym": median(times["hamsym"]) / steps,
                "ratio": median(ratios),
                "range": [min(ratios), max(ratios)],
            }
        )
    return {"repeats": turns, "steps": steps, "rows": rows}


def _times(
    problem: systems.Problem, method: str, run: Function, steps: int, turns: int
) -> dict[str, list[float]]:
    save_every = 1_000
    saves, (start, end) = steps // save_every, problem.span
    out = np.empty((saves + 1, len(problem.z0)))
    out[0] = problem.z0
    hand = partial(run, tuple(problem.z0), (end - start) / steps, saves, save_every, out)
    own = partial(
        hamsym.integrate,
        problem.H,
        problem.z0,
        problem.span,
        method,
        steps=steps,
        save_every=save_every,
    )
    times = in_turns({"by hand": hand, "hamsym": own}, turns)
    if not np.allclose(own().z, out, rtol=0, atol=1e-9):
        raise AssertionError(f"{method} and the loop by hand differ on {problem.name}")
    return times


def table(section: Section) -> str:
    rows = [
        [
            row["system"],
            row["method"],
            f"{1e9 * row['by hand']:.2f}",
            f"{1e9 * row['hamsym']:.2f}",
            f"{row['ratio']:.2f}",
            "{:.2f} to {:.2f}".format(*row["range"]),
        ]
        for row in section["rows"]
    ]
    head = ["system", "method", "by hand, ns", "hamsym, ns", "ratio", "range"]
    return markdown.table(head, rows, left=2)
