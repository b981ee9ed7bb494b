"""Generated symplectic Euler, once compiled, against a numba loop written by hand."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
from numba import njit

from hamsym import systems

STEPS, SAVE_EVERY = 20_000_000, 1_000


@njit
def oscillator_by_hand(x, p, h, saves, save_every, out):
    out[0, 0] = x
    out[0, 1] = p
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += h * p
            p -= h * (x + x**3)
        out[i, 0] = x
        out[i, 1] = p


@njit
def henon_heiles_by_hand(x, y, px, py, h, saves, save_every, out):
    out[0] = np.array([x, y, px, py])
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += h * px
            y += h * py
            px -= h * (x + 2 * x * y)
            py -= h * (y + x * x - y * y)
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = px
        out[i, 3] = py


def seconds(function: Callable[[], object]) -> float:
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def main() -> None:
    saves = STEPS // SAVE_EVERY
    by_hand = {
        "nonlinear_oscillator": oscillator_by_hand,
        "henon_heiles": henon_heiles_by_hand,
    }
    print(f"{STEPS:,} steps, ns per step by hand and generated, median over interleaved repeats")
    for name, loop in by_hand.items():
        problem = systems.CATALOGUE[name]()
        h = (problem.span[1] - problem.span[0]) / STEPS
        generated = problem.H.compile("numba").step_loops["symplectic_euler"]
        z0 = np.array(problem.z0)
        first, second = np.empty((saves + 1, len(z0))), np.empty((saves + 1, len(z0)))

        def hand(saves: int = saves, loop=loop, z0=z0, h=h, out=first) -> None:
            loop(*z0, h, saves, SAVE_EVERY, out)

        def ours(saves: int = saves, loop=generated, z0=z0, h=h, out=second) -> None:
            loop(z0, out, 0.0, h, saves, SAVE_EVERY)

        hand(1)
        ours(1)  # compiled
        times = [(seconds(hand), seconds(ours)) for _ in range(9)]
        assert np.allclose(first, second, atol=1e-9)
        ratios = [own / theirs for theirs, own in times]
        theirs, own = (1e9 / STEPS * statistics.median(c) for c in zip(*times, strict=True))
        print(
            f"{name}: {theirs:.2f} ns, {own:.2f} ns, ratio {statistics.median(ratios):.2f} "
            f"(from {min(ratios):.2f} to {max(ratios):.2f})"
        )


if __name__ == "__main__":
    main()
