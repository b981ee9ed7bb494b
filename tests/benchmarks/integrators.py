"""Fixed-step integrators beside loops written by hand, and beside other packages.

Five tables, each of which can be printed alone (``--part``); a minute for all of them. What is
compared runs in turns, and times are medians over the turns, on the wall clock, without
compilation. A ratio is the median of those within a turn, so that a machine that is slow for a
while does not matter. A peer that is not installed is left out, with a line that says so.

loops      One long trajectory of the generated loops, over numba loops as one writes them by hand:
           scalars, the coefficients as constants.
pyhamsys   Forest & Ruth's method at the same steps, over pyhamsys.
ensemble   10,000 trajectories in one call, beside a loop over calls, and beside what their steps
           alone would take one after the other.
heyoka     Time for a true error: methods of a fixed step and ``hamsym.solve``, over heyoka.
implicit   Methods for an H that cannot be split, to know what their steps cost.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numba
import numpy as np
import torch
from numba import njit
from scipy.integrate import solve_ivp
from work_precision import clocked, henon_heiles, interpreted, optional, oscillator

import hamsym
from hamsym import systems


def say(text: str) -> None:
    """Prose under a table, as wide as the table."""
    print(textwrap.fill(text, 80))


def in_turns(functions: dict[str, Callable[[], Any]], turns: int) -> dict[str, list[float]]:
    """Seconds of each function in each turn, after a turn that compiles and is not counted."""
    for function in functions.values():
        function()
    times = [{name: seconds(f) for name, f in functions.items()} for _ in range(turns)]
    return {name: [turn[name] for turn in times] for name in functions}


def seconds(function: Callable[[], Any]) -> float:
    """Of a call; of a short one the least in 20 ms, since what ran before it slows the first."""
    least = spent = clocked(function)[0]
    while spent < 0.02:
        value = clocked(function)[0]
        least, spent = min(least, value), spent + value
    return least


def ratios(above: list[float], below: list[float]) -> list[float]:
    return [a / b for a, b in zip(above, below, strict=True)]


# -- loops -------------------------------------------------------------------------------------

# Forest & Ruth: x moves by C1, C2, C2, C1 and p by D1, D2, D1, in turns, in units of a step.
D1 = 1 / (2 - 2 ** (1 / 3))
D2 = 1 - 2 * D1
C1, C2 = D1 / 2, (D1 + D2) / 2


@njit
def oscillator_euler(z0, h, saves, save_every, out):
    x, p = z0
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += h * p
            p -= h * (x + x**3)
        out[i, 0] = x
        out[i, 1] = p


@njit
def oscillator_verlet(z0, h, saves, save_every, out):
    x, p = z0
    half = h / 2
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += half * p
            p -= h * (x + x**3)
            x += half * p
        out[i, 0] = x
        out[i, 1] = p


@njit
def oscillator_forest_ruth(z0, h, saves, save_every, out):
    x, p = z0
    c1, c2, d1, d2 = C1 * h, C2 * h, D1 * h, D2 * h
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += c1 * p
            p -= d1 * (x + x**3)
            x += c2 * p
            p -= d2 * (x + x**3)
            x += c2 * p
            p -= d1 * (x + x**3)
            x += c1 * p
        out[i, 0] = x
        out[i, 1] = p


@njit
def henon_heiles_euler(z0, h, saves, save_every, out):
    x, y, px, py = z0
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


@njit
def henon_heiles_verlet(z0, h, saves, save_every, out):
    x, y, px, py = z0
    half = h / 2
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += half * px
            y += half * py
            px -= h * (x + 2 * x * y)
            py -= h * (y + x * x - y * y)
            x += half * px
            y += half * py
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = px
        out[i, 3] = py


@njit
def henon_heiles_forest_ruth(z0, h, saves, save_every, out):
    x, y, px, py = z0
    c1, c2, d1, d2 = C1 * h, C2 * h, D1 * h, D2 * h
    for i in range(1, saves + 1):
        for _ in range(save_every):
            x += c1 * px
            y += c1 * py
            px -= d1 * (x + 2 * x * y)
            py -= d1 * (y + x * x - y * y)
            x += c2 * px
            y += c2 * py
            px -= d2 * (x + 2 * x * y)
            py -= d2 * (y + x * x - y * y)
            x += c2 * px
            y += c2 * py
            px -= d1 * (x + 2 * x * y)
            py -= d1 * (y + x * x - y * y)
            x += c1 * px
            y += c1 * py
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = px
        out[i, 3] = py


BY_HAND = (
    ("nonlinear_oscillator", "symplectic_euler", oscillator_euler),
    ("nonlinear_oscillator", "stormer_verlet", oscillator_verlet),
    ("nonlinear_oscillator", "forest_ruth", oscillator_forest_ruth),
    ("henon_heiles", "symplectic_euler", henon_heiles_euler),
    ("henon_heiles", "stormer_verlet", henon_heiles_verlet),
    ("henon_heiles", "forest_ruth", henon_heiles_forest_ruth),
)


def loops_part(quick: bool) -> None:
    steps, save_every = (1_000_000 if quick else 4_000_000), 1_000
    print(f"loops: ns per step, {steps:,} steps, one state in {save_every:,} kept\n")
    print(f"{'system':<21}{'method':<17}{'by hand':>9}{'hamsym':>9}{'ratio':>8}  (range)")
    for name, method, loop in BY_HAND:
        times = loop_times(systems.CATALOGUE[name](), method, loop, steps, save_every, quick)
        found = ratios(times["hamsym"], times["by hand"])
        hand, own = (1e9 / steps * statistics.median(column) for column in times.values())
        print(
            f"{name:<21}{method:<17}{hand:>9.2f}{own:>9.2f}{statistics.median(found):>8.2f}"
            f"  ({min(found):.2f} to {max(found):.2f})",
            flush=True,
        )
    print()
    say(
        "hamsym.integrate as a whole; what is not stepping is negligible over so many steps. "
        "The target is a ratio of at most 1.1. Both give the same states, to 1e-9."
    )


def loop_times(
    problem: systems.Problem,
    method: str,
    loop: Callable[..., None],
    steps: int,
    save_every: int,
    quick: bool,
) -> dict[str, list[float]]:
    z0, (start, end) = np.array(problem.z0), problem.span
    saves = steps // save_every
    out = np.empty((saves + 1, len(z0)))
    out[0] = z0
    own = partial(
        hamsym.integrate, problem.H, z0, problem.span, method, steps=steps, save_every=save_every
    )
    hand = partial(loop, tuple(problem.z0), (end - start) / steps, saves, save_every, out)
    times = in_turns({"by hand": hand, "hamsym": own}, 5 if quick else 9)
    assert np.allclose(own().z, out, rtol=0, atol=1e-9)
    return times


# -- pyhamsys ----------------------------------------------------------------------------------


def chi_arrays(h, t, y):
    """A drift, then a kick: what pyhamsys composes, with numpy as its documentation does."""
    q = y[:2] + h * y[2:]
    a, b = q
    return np.concatenate((q, y[2:] - h * np.array((a + 2 * a * b, b + a * a - b * b))))


def chi_star_arrays(h, t, y):
    """A kick, then a drift."""
    a, b = y[:2]
    p = y[2:] - h * np.array((a + 2 * a * b, b + a * a - b * b))
    return np.concatenate((y[:2] + h * p, p))


def chi_floats(h, t, y):
    """The same with Python's floats, which are faster than arrays of four."""
    a, b, u, v = y.tolist()
    a += h * u
    b += h * v
    return np.array((a, b, u - h * (a + 2 * a * b), v - h * (b + a * a - b * b)))


def chi_star_floats(h, t, y):
    a, b, u, v = y.tolist()
    u -= h * (a + 2 * a * b)
    v -= h * (b + a * a - b * b)
    return np.array((a + h * u, b + h * v, u, v))


@njit
def chi_compiled(h, t, y):
    """And compiled, which takes its author's knowledge of numba."""
    out = np.empty(4)
    a, b = y[0] + h * y[2], y[1] + h * y[3]
    out[0], out[1] = a, b
    out[2], out[3] = y[2] - h * (a + 2 * a * b), y[3] - h * (b + a * a - b * b)
    return out


@njit
def chi_star_compiled(h, t, y):
    out = np.empty(4)
    a, b = y[0], y[1]
    out[2], out[3] = y[2] - h * (a + 2 * a * b), y[3] - h * (b + a * a - b * b)
    out[0], out[1] = a + h * out[2], b + h * out[3]
    return out


CHIS = {
    "chi in numpy": (chi_arrays, chi_star_arrays),
    "chi in floats": (chi_floats, chi_star_floats),
    "chi in numba": (chi_compiled, chi_star_compiled),
}


def pyhamsys_part(quick: bool) -> None:
    package = optional("pyhamsys")
    if package is None:
        return
    steps, saves = 2_000 if quick else 10_000, 40
    problem = systems.henon_heiles()
    own = partial(hamsym.integrate, problem.H, problem.z0, problem.span, "forest_ruth", steps=steps)
    own = partial(own, save_every=steps // saves)
    calls: dict[str, Callable[[], Any]] = {"hamsym": own}
    for name, pair in CHIS.items():
        whole = partial(pyhamsys_run, package, problem, pair, steps, saves)
        states = whole()
        assert np.allclose(states, own().z, rtol=0, atol=1e-9)
        calls[name] = whole
        calls[f"{name}, steps alone"] = partial(pyhamsys_steps, package, problem, pair, steps)
    times = in_turns(calls, 3 if quick else 5)
    print(f"pyhamsys: Forest & Ruth on Henon-Heiles, {steps:,} steps, {saves} states kept\n")
    print(f"{'':<30}{'us per step':>12}{'over hamsym':>13}")
    for name, column in times.items():
        over = statistics.median(ratios(column, times["hamsym"]))
        print(f"{name:<30}{1e6 * statistics.median(column) / steps:>12.4f}{over:>13,.0f}")
    anew, cached, again = compiling()
    print()
    say(
        "The target is 20. hamsym.integrate as a whole. In every step of pyhamsys a search for "
        "the next output goes through all times, which is why its steps alone are timed too. Both "
        "give the same states, to 1e-9. The first call of hamsym.integrate in a process took "
        f"{anew:.1f} s where its loop was compiled, {cached:.2f} s where it was compiled once "
        f"before, the second {1e3 * again:.2f} ms."
    )


def pyhamsys_run(
    package: Any, problem: systems.Problem, pair: tuple, steps: int, saves: int
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
    assert math.isclose(solution.step, (end - start) / steps)
    return solution.y.T


def pyhamsys_steps(package: Any, problem: systems.Problem, pair: tuple, steps: int) -> None:
    start, end = problem.span
    integrator = package.pyhamsys.SymplecticIntegrator("FR", (end - start) / steps)
    t, y = start, np.array(problem.z0)
    for _ in range(steps):
        t, y = integrator._integrate_onestep(t, y, *pair)


FIRST_CALLS = """
import time
import numba
from hamsym import integrate
from hamsym.systems import henon_heiles
problem = henon_heiles()
for _ in range(2):
    began = time.perf_counter()
    integrate(problem.H, problem.z0, problem.span, "forest_ruth", steps=4_000, save_every=100)
    print(time.perf_counter() - began)
"""


def compiling() -> tuple[float, float, float]:
    """Seconds of the first call with an empty cache and with a full one, and of the second."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "HAMSYM_CACHE_DIR": folder}
        environment.pop("NUMBA_CACHE_DIR", None)
        outputs = [
            subprocess.run(
                [sys.executable, "-c", FIRST_CALLS],
                env=environment,
                check=True,
                capture_output=True,
                text=True,
            ).stdout.split()
            for _ in range(2)
        ]
    return float(outputs[0][0]), float(outputs[1][0]), float(outputs[1][1])


# -- ensemble ----------------------------------------------------------------------------------


def ensemble_part(quick: bool) -> None:
    batch, looped, steps, method = 10_000, (100 if quick else 500), 1_000, "blanes_moan4"
    problem = systems.henon_heiles()
    starts = np.random.default_rng(0).uniform(-0.2, 0.2, (batch, 4))  # all of them stay bound
    integrate = partial(
        hamsym.integrate, problem.H, span=(0.0, 100.0), method=method, save_every=steps
    )
    whole = partial(integrate, starts, steps=steps)
    calls = {
        "one call": whole,
        "one call, on one core": partial(on_one_core, whole),
        "a loop over calls": lambda: [integrate(z, steps=steps) for z in starts[:looped]],
        "steps alone, in turn": partial(
            hamsym.integrate,
            *(problem.H, problem.z0, (0.0, 100.0), method),
            steps=looped * steps,
            save_every=steps,
        ),
    }
    times = in_turns(calls, 3 if quick else 5)
    singles = np.stack([trajectory.z for trajectory in calls["a loop over calls"]()])
    assert np.allclose(singles, whole().z[:looped], rtol=0, atol=1e-9)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    print(
        f"ensemble: {batch:,} trajectories of {steps:,} steps of {method} on Henon-Heiles,\n"
        f"{cores} cores\n"
    )
    print(f"{'':<26}{'seconds':>10}{'us each':>10}{'ns per step':>13}{'over one call':>15}")
    for name, column in times.items():
        scale = 1.0 if "one call" in name else batch / looped
        scaled = [scale * value for value in column]
        over = statistics.median(ratios(scaled, times["one call"]))
        middle = statistics.median(scaled)
        print(
            f"{name:<26}{middle:>10.3f}{1e6 * middle / batch:>10.1f}"
            f"{1e9 * middle / batch / steps:>13.2f}{over:>15.2f}"
        )
    print()
    say(
        f"The loop is over {looped} calls, scaled; the steps alone are those of one trajectory of "
        f"{looped * steps:,} steps, scaled. The former over the latter is what calls cost, the "
        "latter over one core what is gained by taking trajectories together. Both give the same "
        "states, to 1e-9."
    )


def on_one_core(function: Callable[[], Any]) -> None:
    """Where the system can do so; elsewhere on all of them."""
    if not hasattr(os, "sched_setaffinity"):
        function()
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        function()
    finally:
        os.sched_setaffinity(0, cores)


# -- heyoka ------------------------------------------------------------------------------------

OUTPUTS, FEWEST = 960, 60
ASKED = (1e-6, 1e-9)
LARGEST, LEAST = 3e-4, 3e-12  # errors to look at
TOLERANCES = range(4, 17)
METHODS = ("forest_ruth", "blanes_moan4", "blanes_moan6", "yoshida6", "yoshida8", "gauss6")
SPANS = (
    ("Henon-Heiles, t = 300", "henon_heiles", 300.0, henon_heiles),
    ("oscillator, 20 pi", "nonlinear_oscillator", 20 * math.pi, oscillator),
)


@dataclass
class Case:
    """A problem with its true states at the common times."""

    H: hamsym.Hamiltonian
    z0: tuple[float, ...]
    t: np.ndarray
    field: Callable
    truth: np.ndarray

    @property
    def span(self) -> tuple[float, float]:
        return float(self.t[0]), float(self.t[-1])


@dataclass
class Run:
    """A method at one setting; a call gives the states at all common times, or at some of them."""

    name: str
    setting: str
    call: Callable[[], np.ndarray]
    error: float = math.inf
    seconds: float = math.inf

    def judge(self, truth: np.ndarray) -> None:
        states = self.call()
        every = (len(truth) - 1) // max(1, len(states) - 1)
        if states.shape == truth[::every].shape and np.abs(states).max() < 1e9:
            self.error = float(np.linalg.norm(states - truth[::every], axis=1).max())


def heyoka_part(quick: bool) -> None:
    package = optional("heyoka")
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # what reads solutions out would wait for a core that is busy
    for position, (label, name, end, field) in enumerate(SPANS[:1] if quick else SPANS):
        if position:
            print()
        problem = systems.CATALOGUE[name]()
        problem.H.compile("numba")
        t = np.linspace(0.0, end, OUTPUTS + 1)
        truth, source = true_states(problem, t, field, package)
        case = Case(problem.H, problem.z0, t, field, truth)
        runs = heyoka_runs(case, package) if package else []
        for method in METHODS:
            runs += stepping_runs(case, method)
        runs += [*solve_runs(case), *dop853_runs(case)]
        print(f"heyoka: {label}, {OUTPUTS + 1} states;\nlargest true error, against {source}\n")
        measure(runs, truth, 3 if quick else 5)
        work_precision([run for run in runs if LEAST < run.error < LARGEST])
        summary(runs)
        around = seconds(partial(stepping_call, case, "blanes_moan6", 1))
        say(
            "* is the least time of all, at a smaller error. hamsym.integrate and hamsym.solve as "
            f"a whole, from Python; a single step of blanes_moan6 takes {1e3 * around:.2f} ms, "
            "which is what surrounds steps. heyoka's integrators are made and compiled "
            "beforehand. All on one thread."
        )
    torch.set_num_threads(threads)


def measure(runs: list[Run], truth: np.ndarray, turns: int) -> None:
    """Errors, and times where the error is one to look at."""
    for run in runs:
        if not math.isfinite(run.error):
            run.judge(truth)
    looked_at = {f"{run.name} {run.setting}": run for run in runs if LEAST < run.error < LARGEST}
    times = in_turns({key: run.call for key, run in looked_at.items()}, turns)
    for key, column in times.items():
        looked_at[key].seconds = statistics.median(column)


def true_states(
    problem: systems.Problem, t: np.ndarray, field: Callable, hy: Any
) -> tuple[np.ndarray, str]:
    """Exact, or of errors far below those that are to be judged; and how they were found."""
    if problem.exact:
        return problem.exact(t), "its closed form"
    if hy:
        wide = np.longdouble
        start = [wide(value) for value in problem.z0]
        integrator = hy.taylor_adaptive(
            equations(hy, problem.H, field), start, tol=wide(1e-18), fp_type=wide
        )
        states = integrator.propagate_grid(t.astype(wide))[-1]
        return states.astype(float), "heyoka at 1e-18"
    steps = 100 * OUTPUTS
    span = (t[0], t[-1])
    trajectory = hamsym.integrate(
        problem.H, problem.z0, span, "yoshida8", steps=steps, save_every=100, compensated=True
    )
    return trajectory.z, f"{steps:,} steps of yoshida8"


def equations(hy: Any, H: hamsym.Hamiltonian, field: Callable) -> list[tuple]:
    names = hy.make_vars(*H.names)
    return list(zip(names, field(0.0, names), strict=True))


def heyoka_runs(case: Case, hy: Any) -> list[Run]:
    """Taylor's method in its default mode, on the grid of the common times."""
    runs = []
    for exponent in TOLERANCES:
        integrator = hy.taylor_adaptive(
            equations(hy, case.H, case.field), list(case.z0), tol=10.0**-exponent
        )
        call = partial(heyoka_call, case, integrator)
        runs.append(Run("heyoka", f"tol 1e-{exponent:02d}", call))
    return runs


def heyoka_call(case: Case, integrator: Any) -> np.ndarray:
    integrator.time = 0.0
    integrator.state[:] = case.z0
    return integrator.propagate_grid(case.t)[-1]


def stepping_runs(case: Case, method: str) -> Iterator[Run]:
    """Twice the steps each time, while the error falls and there is any use in that.

    Where there are fewer steps than common times, the states are those after each step.
    """
    steps, last = FEWEST, math.inf
    while last > 1e-10 and steps < 2_000 * OUTPUTS:
        run = Run(method, f"{steps:,} steps", partial(stepping_call, case, method, steps))
        run.judge(case.truth)
        yield run
        if steps > OUTPUTS and run.error > last / 2:
            break
        steps, last = 2 * steps, run.error


def stepping_call(case: Case, method: str, steps: int) -> np.ndarray:
    save_every = max(1, steps // OUTPUTS)
    return hamsym.integrate(
        case.H, case.z0, case.span, method, steps=steps, save_every=save_every
    ).z


def solve_runs(case: Case) -> Iterator[Run]:
    for exponent in range(4, 12):
        tol = 10.0**-exponent
        call = lambda tol=tol: hamsym.solve(case.H, case.z0, case.span, tol=tol)(case.t)
        yield Run("hamsym.solve", f"tol 1e-{exponent:02d}", call)


def dop853_runs(case: Case) -> Iterator[Run]:
    """scipy's, with the leanest right-hand side that Python allows."""
    rates = interpreted(case.field)
    for exponent in range(5, 14):
        call = lambda tol=10.0**-exponent: (
            solve_ivp(rates, case.span, case.z0, "DOP853", case.t, rtol=tol, atol=tol).y.T
        )
        yield Run("DOP853 (scipy)", f"tol 1e-{exponent:02d}", call)


def by_method(runs: list[Run]) -> dict[str, list[Run]]:
    methods: dict[str, list[Run]] = {}
    for run in runs:
        methods.setdefault(run.name, []).append(run)
    return methods


def work_precision(runs: list[Run]) -> None:
    print(f"{'method':<16}{'setting':<18}{'error':>9}{'ms':>10}")
    for name, rows in by_method(runs).items():
        for position, run in enumerate(rows):
            print(
                f"{'' if position else name:<16}{run.setting:<18}{run.error:>9.1e}"
                f"{1e3 * run.seconds:>10.3f}"
            )
    print()


def time_at(runs: list[Run], error: float) -> tuple[float, str]:
    """Seconds at an error, by a power law between runs, and a mark where all are more accurate."""
    front: list[Run] = []
    for run in sorted(runs, key=lambda run: (run.seconds, run.error)):
        if math.isfinite(run.seconds) and (not front or run.error < front[-1].error):
            front.append(run)
    if not front or front[-1].error > error:
        return math.nan, ""
    if front[0].error < error:
        return front[0].seconds, "*"
    errors, times = ([getattr(run, key) for run in front] for key in ("error", "seconds"))
    return math.exp(np.interp(-math.log(error), -np.log(errors), np.log(times))), ""


def summary(runs: list[Run]) -> None:
    methods = by_method(runs)
    peer = {error: time_at(methods.get("heyoka", []), error)[0] for error in ASKED}
    heads = (f"{error:>13.0e}{'over heyoka':>14}" for error in ASKED)
    print(f"{'ms at an error of':<20}{''.join(heads)}")
    for name, rows in methods.items():
        cells = ""
        for error in ASKED:
            value, mark = time_at(rows, error)
            cells += number(1e3 * value, 12, 3) + (mark or " ") + number(value / peer[error], 14, 2)
        print(f"{name:<20}{cells}")
    print()


def number(value: float, width: int, digits: int) -> str:
    return f"{'-':>{width}}" if math.isnan(value) else f"{value:>{width},.{digits}f}"


# -- implicit ----------------------------------------------------------------------------------


def implicit_part(quick: bool) -> None:
    end, steps = 100.0, 10_000
    problem = systems.double_pendulum()
    integrate = partial(hamsym.integrate, problem.H, problem.z0, (0.0, end))
    calls: dict[str, Callable[[], Any]] = {
        method: partial(integrate, method, steps=steps, save_every=100)
        for method in ("implicit_midpoint", "gauss4", "gauss6", "tao2", "tao4")
    }
    calls["dop853"] = partial(integrate, "dop853", steps=steps // 100, rtol=1e-10, atol=1e-10)
    times = in_turns(calls, 3 if quick else 5)
    print(f"implicit: double pendulum to t = {end:g}, {steps:,} steps\n")
    print(
        f"{'method':<20}{'order':>6}{'us per step':>13}{'evaluations':>13}{'ms':>10}"
        f"{'change of H':>13}"
    )
    for name, column in times.items():
        trajectory, middle = calls[name](), statistics.median(column)
        change = np.abs(trajectory.energy - trajectory.energy[0]).max()
        counted = math.nan if name == "dop853" else steps
        print(
            f"{name:<20}{hamsym.integrators.INTEGRATORS[name].order:>6}"
            f"{number(1e6 * middle / counted, 13, 3)}"
            f"{number(trajectory.evaluations / counted, 13, 1)}"
            f"{1e3 * middle:>10.2f}{change:>13.1e}"
        )
    print()
    say(
        "Evaluations of the vector field or the gradient in a step. dop853 is scipy's, at 1e-10, "
        "with steps of its own and the generated vector field in Python."
    )


PARTS = {
    "loops": loops_part,
    "pyhamsys": pyhamsys_part,
    "ensemble": ensemble_part,
    "heyoka": heyoka_part,
    "implicit": implicit_part,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer steps, fewer repeats")
    parser.add_argument("--part", choices=list(PARTS), action="append", help="this part only")
    arguments = parser.parse_args()
    print(f"Python {sys.version.split()[0]}, numba {numba.__version__}, {time.strftime('%F')}")
    for part in arguments.part or PARTS:
        print()
        PARTS[part](arguments.quick)


if __name__ == "__main__":
    main()
