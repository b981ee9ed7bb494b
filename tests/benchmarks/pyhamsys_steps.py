"""Forest & Ruth's method on Henon-Heiles at the same steps, over pyhamsys.

pyhamsys composes the flows that its users write: in numpy as its documentation does, with Python's
floats, which are faster than arrays of four, or compiled by numba. In every step it searches all
output times for the next one, so its steps are timed alone too.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

import hamsym
from hamsym import systems

from . import markdown
from .measuring import in_turns, median, median_ratio
from .opponents import optional
from .results import Section


def chi_arrays(h: float, t: float, y: np.ndarray) -> np.ndarray:
    """A drift, then a kick."""
    q = y[:2] + h * y[2:]
    a, b = q
    return np.concatenate((q, y[2:] - h * np.array((a + 2 * a * b, b + a * a - b * b))))


def chi_star_arrays(h: float, t: float, y: np.ndarray) -> np.ndarray:
    """A kick, then a drift."""
    a, b = y[:2]
    p = y[2:] - h * np.array((a + 2 * a * b, b + a * a - b * b))
    return np.concatenate((y[:2] + h * p, p))


def chi_floats(h: float, t: float, y: np.ndarray) -> np.ndarray:
    a, b, u, v = y.tolist()
    a += h * u
    b += h * v
    return np.array((a, b, u - h * (a + 2 * a * b), v - h * (b + a * a - b * b)))


def chi_star_floats(h: float, t: float, y: np.ndarray) -> np.ndarray:
    a, b, u, v = y.tolist()
    u -= h * (a + 2 * a * b)
    v -= h * (b + a * a - b * b)
    return np.array((a + h * u, b + h * v, u, v))


@njit
def chi_compiled(h, t, y):  # type: ignore[no-untyped-def]
    out = np.empty(4)
    a, b = y[0] + h * y[2], y[1] + h * y[3]
    out[0], out[1] = a, b
    out[2], out[3] = y[2] - h * (a + 2 * a * b), y[3] - h * (b + a * a - b * b)
    return out


@njit
def chi_star_compiled(h, t, y):  # type: ignore[no-untyped-def]
    out = np.empty(4)
    a, b = y[0], y[1]
    out[2], out[3] = y[2] - h * (a + 2 * a * b), y[3] - h * (b + a * a - b * b)
    out[0], out[1] = a + h * out[2], b + h * out[3]
    return out


_FLOWS = {
    "flows in numpy": (chi_arrays, chi_star_arrays),
    "flows in floats": (chi_floats, chi_star_floats),
    "flows in numba": (chi_compiled, chi_star_compiled),
}


def measure(quick: bool) -> Section:
    missing: list[str] = []
    package = optional("pyhamsys", missing)
    if package is None:
        return {"rows": [], "skipped": missing}
    steps, saves, turns = (1_000, 40, 1) if quick else (10_000, 40, 5)
    problem = systems.henon_heiles()
    own = partial(
        hamsym.integrate,
        problem.H,
        problem.z0,
        problem.span,
        "forest_ruth",
        steps=steps,
        save_every=steps // saves,
    )
    calls: dict[str, Callable[[], Any]] = {"hamsym": own}
    for name, pair in _FLOWS.items():
        whole = partial(_run, package, problem, pair, steps, saves)
        if not np.allclose(whole(), own().z, rtol=0, atol=1e-9):
            raise AssertionError(f"pyhamsys with {name} and hamsym differ")
        calls[name] = whole
        calls[f"{name}, steps alone"] = partial(_steps, package, problem, pair, steps)
    times = in_turns(calls, turns)
    rows = [
        {
            "method": name,
            "seconds": median(column) / steps,
            "ratio": median_ratio(column, times["hamsym"]),
        }
        for name, column in times.items()
    ]
    first = None if quick else dict(zip(("empty", "filled", "second"), _first(), strict=True))
    return {"repeats": turns, "steps": steps, "rows": rows, "first": first, "skipped": missing}


def _run(
    package: Any, problem: systems.Problem, pair: tuple[Any, Any], steps: int, saves: int
) -> np.ndarray:
    """States at saves + 1 times, by steps that are as many as asked for."""
    start, end = problem.span
    system = package.HamSys(ndof=2, chi=pair[0], chi_star=pair[1])
    # It rounds the number of steps up to the next multiple of the outputs, beyond an equal one.
    parameters = package.Parameters(
        step=(end - start) / (steps - saves / 2), solver="FR", display=False
    )
    times = np.linspace(start, end, saves + 1)
    solution = system.integrate(np.array(problem.z0), times, parameters)
    if not math.isclose(solution.step, (end - start) / steps):
        raise AssertionError("pyhamsys took another number of steps")
    return np.asarray(solution.y.T)


def _steps(package: Any, problem: systems.Problem, pair: tuple[Any, Any], steps: int) -> None:
    start, end = problem.span
    integrator = package.pyhamsys.SymplecticIntegrator("FR", (end - start) / steps)
    t, y = start, np.array(problem.z0)
    for _ in range(steps):
        t, y = integrator._integrate_onestep(t, y, *pair)


_FIRST_CALLS = """
import time
import numba
from hamsym import integrate
from hamsym.systems import henon_heiles
problem = henon_heiles()
for _ in range(2):
    began = time.process_time()
    integrate(problem.H, problem.z0, problem.span, "forest_ruth", steps=4_000, save_every=100)
    print(time.process_time() - began)
"""


def _first() -> tuple[float, float, float]:
    """CPU seconds of the first call with an empty cache and a full one, and of the second call."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "HAMSYM_CACHE_DIR": folder}
        environment.pop("NUMBA_CACHE_DIR", None)
        outputs = [
            subprocess.run(
                [sys.executable, "-c", _FIRST_CALLS],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            ).stdout.split()
            for _ in range(2)
        ]
    return float(outputs[0][0]), float(outputs[1][0]), float(outputs[1][1])


def table(section: Section) -> str:
    rows = [
        [row["method"], f"{1e6 * row['seconds']:.3f}", markdown.number(row["ratio"])]
        for row in section["rows"]
    ]
    text = markdown.table(["", "us a step", "over hamsym"], rows)
    if first := section.get("first"):
        text += (
            f"\n\nThe first call of `hamsym.integrate` takes {first['empty']:.1f} s where its loop "
            f"is compiled,\n{first['filled']:.2f} s where the compiled loop is in the cache, and "
            f"the second call {1e3 * first['second']:.2f} ms."
        )
    return text + markdown.skipped(section["skipped"])
