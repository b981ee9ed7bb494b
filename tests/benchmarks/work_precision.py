"""Time for a true error: hamsym's march against other integrators, and trained networks.

Three parts, each of which can be run alone (``--part``):

march     six problems at three tolerances. True errors are 2-norms at 4,001 times, against the
          exact solution where the catalogue has one and a march with other features at 1e-12
          elsewhere. Times are minima over interleaved repeats, without compilation. A ratio is
          the time of a row over that of the fastest run of a rival whose true error is no larger;
          rivals are run at tolerances half a decade apart.
training  deep networks beside the features, in CPU seconds and in epochs of Adam written the usual
          way (see training_epoch.py), on one torch thread.
first     the first call in a fresh process, imports done, against scipy's DOP853.

The rivals have continuous output and, of what Python allows, the leanest right-hand side written by
hand; compiled rivals have the same text compiled by numba. Radau runs at two tolerances only.
odeint writes the 4,001 states instead. numbalsoda has no continuous output: it is timed with the
state at the end alone, which favours it. heyoka makes its equations from sympy's; it is timed with
continuous output, which compiles its evaluation anew in every call, and with a grid of the 4,001
times. Where a kind of rival has two rows, the faster one counts.

The march is also run with 24 Chebyshev polynomials in place of the sines: columns f(s) T_k(2s - 1),
with f of the trial form, orthonormalised and collocated the same way.
"""

from __future__ import annotations

import argparse
import importlib
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import cos, sin
from typing import Any

import numba
import numpy as np
import torch
from numba import types
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.polynomial import chebyshev
from scipy.integrate import odeint, solve_ivp
from training_epoch import usual

import hamsym
from hamsym import systems
from hamsym.random_features.basis import FeatureBasis, feature_basis, march
from hamsym.random_features.method import _flow
from hamsym.random_features.trial import FeatureTrial

ASKED = (1e-6, 1e-9, 1e-11)
TIMES = 4_001
PLAIN, COMPILED = "features, plain", "features, compiled"
DOP853, HEYOKA, FORTRAN, CPP = "DOP853 (scipy)", "heyoka", "DOP853 (numbalsoda)", "DOP853 (CyRK)"
COMPILED_DOP853, HEYOKAS = (FORTRAN, CPP), (HEYOKA, "heyoka, grid")


# -- problems ----------------------------------------------------------------------------------


def oscillator(t, z):
    x, p = z
    return p, -x - x * x * x


def pendulum(t, z):
    theta, p = z
    return p, -sin(theta)


def henon_heiles(t, z):
    x, y, px, py = z
    return px, py, -x - 2 * x * y, -y - x * x + y * y


def kepler(t, z):
    x, y, px, py = z
    cube = (x * x + y * y) ** 1.5
    return px, py, -x / cube, -y / cube


def double_pendulum(t, z):
    a, b, p, q = z
    s, c = sin(a - b), cos(a - b)
    d = 1 + s * s
    top = p * p + 2 * q * q - 2 * p * q * c
    common = (p * q * s * d - top * s * c) / (d * d)
    return (p - q * c) / d, (2 * q - p * c) / d, -common - 2 * sin(a), common - sin(b)


def three_bodies(t, z):
    x1, x2, x3, y1, y2, y3, u1, u2, u3, v1, v2, v3 = z
    xa, xb, xc, ya, yb, yc = x1 - x2, x1 - x3, x2 - x3, y1 - y2, y1 - y3, y2 - y3
    a = (xa * xa + ya * ya) ** -1.5
    b = (xb * xb + yb * yb) ** -1.5
    c = (xc * xc + yc * yc) ** -1.5
    xa, ya, xb, yb, xc, yc = a * xa, a * ya, b * xb, b * yb, c * xc, c * yc
    return u1, u2, u3, v1, v2, v3, -xa - xb, xa - xc, xb + xc, -ya - yb, ya - yc, yb + yc


PROBLEMS = (
    ("oscillator, 20 pi", "nonlinear_oscillator", 20 * math.pi, oscillator),
    ("pendulum, t = 50", "pendulum", 50.0, pendulum),
    ("Henon-Heiles, t = 300", "henon_heiles", 300.0, henon_heiles),
    ("Kepler e = 0.6, 2 periods", "kepler", 4 * math.pi, kepler),
    ("double pendulum, t = 20", "double_pendulum", 20.0, double_pendulum),
    ("three bodies, 1 period", "three_bodies", 6.32591398292621, three_bodies),
)
QUICK = ("nonlinear_oscillator", "kepler")


@dataclass
class Case:
    """A problem with its reference and all its runs."""

    label: str
    H: hamsym.Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    field: Callable
    t: np.ndarray
    truth: np.ndarray
    runs: dict[str, list[Run]] = field(default_factory=dict)

    @classmethod
    def of(cls, label: str, name: str, end: float, field: Callable) -> Case:
        problem = systems.CATALOGUE[name]()
        t = np.linspace(0.0, end, TIMES)
        return cls(
            label,
            problem.H,
            np.array(problem.z0),
            (0.0, end),
            field,
            t,
            reference(problem, t),
        )


def reference(problem: systems.Problem, t: np.ndarray) -> np.ndarray:
    """States at times t, exact or from a march with other features."""
    if problem.exact:
        return problem.exact(t)
    solution = hamsym.solve(problem.H, problem.z0, (t[0], t[-1]), tol=1e-12, seed=9)
    if not solution.success:
        print(f"reference of {problem.name}: {solution.message}")
    return solution(t)


# -- methods -----------------------------------------------------------------------------------


@dataclass
class Run:
    """A method at one tolerance: a call gives seconds, one of each name, and what evaluates."""

    names: tuple[str, ...]
    tol: float
    call: Callable[[], tuple[tuple[float, ...], Callable[[np.ndarray], np.ndarray]]]
    once: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    error: float = math.inf
    note: str = ""


def clocked(function: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = function()
    return time.perf_counter() - began, result


def features(case: Case, name: str, tol: float) -> Run:
    def call():
        seconds, solution = clocked(lambda: hamsym.solve(case.H, case.z0, case.span, tol=tol))
        if not solution.success:
            run.note = "  NOT met"
        return (solution.training.seconds, seconds), solution

    run = Run((f"{name}: march", f"{name}: solve"), tol, call)
    return run


class ChebyshevBasis(FeatureBasis):
    """Columns f(s) T_k(2 s - 1) W; the tables know no difference."""

    def columns(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, rates = chebyshev_columns(s, len(self.mixing))
        return (values @ self.mixing).astype(float), (rates @ self.mixing).astype(float)


def chebyshev_columns(s: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """f T_k and its derivative in s, in extended precision."""
    s = np.asarray(s, dtype=np.longdouble)
    unit = np.eye(count, dtype=np.longdouble)
    values = chebyshev.chebval(2 * s - 1, unit).T
    slopes = chebyshev.chebval(2 * s - 1, chebyshev.chebder(unit, scl=2)).T
    f = -np.expm1(-s)[:, None]
    return f * values, (1 - f) * values + f * slopes


def chebyshev_basis(count: int = 24) -> ChebyshevBasis:
    like = feature_basis(0)
    angles = (2 * np.arange(160) + 1) * math.pi / 320
    raw = np.vstack(chebyshev_columns((1 - np.cos(angles)) / 2, count)).astype(float)
    _, sizes, right = np.linalg.svd(raw, full_matrices=False)
    mixing = right.T / sizes
    at_nodes, rates_at_nodes, to_between, rates_between = (
        (part @ mixing).astype(float)
        for s in (like.nodes, like.between)
        for part in chebyshev_columns(s, count)
    )
    fit = np.linalg.pinv(rates_at_nodes, rcond=1e-14)
    series = np.zeros((len(like.series), count))
    series[:count] = mixing
    return ChebyshevBasis(
        inner=like.inner,
        shift=like.shift,
        mixing=mixing,
        nodes=like.nodes,
        between=like.between,
        fit=fit,
        integration=at_nodes @ fit,
        to_between=to_between,
        rates_between=rates_between,
        end=(chebyshev_columns(np.ones(1), count)[0] @ mixing)[0],
        series=series,
    )


def chebyshev_march(case: Case, name: str, tol: float, basis: ChebyshevBasis) -> Run:
    equations = _flow(case.H)
    local = max(0.1 * tol, 1e-13)

    def call():
        with np.errstate(all="ignore"):
            windows = march(equations, case.z0, case.span, local, basis)
        run.note = f"  {windows.reason}" if windows.reason else ""
        trial = FeatureTrial.of_march(windows, basis)
        return (windows.seconds,), lambda t: trial.value(torch.from_numpy(t)).numpy()

    run = Run((name,), tol, call)
    return run


def scipy_run(case: Case, name: str, method: str, field: Callable, tol: float) -> Run:
    def call():
        seconds, result = clocked(
            lambda: solve_ivp(
                field, case.span, case.z0, method=method, dense_output=True, rtol=tol, atol=tol
            )
        )
        return (seconds,), lambda t: result.sol(t).T

    return Run((name,), tol, call, once=method == "Radau")


def odeint_run(case: Case, field: Callable, tol: float) -> Run:
    def call():
        seconds, (values, info) = clocked(
            lambda: odeint(
                field,
                case.z0,
                case.t,
                tfirst=True,
                rtol=tol,
                atol=tol,
                mxstep=100_000,
                full_output=True,
            )
        )
        done = info["message"] == "Integration successful."
        return (seconds,), lambda t: values if done else np.full_like(values, np.inf)

    return Run(("LSODA (odeint)",), tol, call)


def interpreted(field: Callable) -> Callable:
    """Arithmetic with Python's floats is faster than with numpy's."""
    return lambda t, z: field(t, z.tolist())


def jitted(field: Callable, dim: int) -> Callable:
    """The same for scipy, compiled."""
    kernel = numba.njit(field, error_model="numpy")

    @numba.njit
    def rates(t, z):
        values = kernel(t, to_fixed_tuple(z, dim))
        out = np.empty(dim)
        for i in range(dim):
            out[i] = values[i]
        return out

    rates(0.0, np.full(dim, 0.5) + np.arange(dim))
    return rates


def callback(field: Callable, dim: int, order: str) -> Any:
    """The same as a C function; ``order`` of t, the state z and its rates d."""
    kernel = numba.njit(field, error_model="numpy")
    pointer = types.CPointer(types.float64)

    @numba.njit(inline="always")
    def fill(t, z, out):
        values = kernel(t, to_fixed_tuple(numba.carray(z, (dim,)), dim))
        for i in range(dim):
            out[i] = values[i]

    if order == "tzd":
        return numba.cfunc(types.void(types.float64, pointer, pointer, pointer))(
            lambda t, z, out, data: fill(t, z, out)
        )
    return numba.cfunc(types.void(pointer, types.float64, pointer, pointer))(
        lambda out, t, z, data: fill(t, z, out)
    )


def optional(name: str) -> Any:
    """A rival's module, or None with a line that says what to install."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        needs = " (which needs gfortran)" if name == "numbalsoda" else ""
        print(f"no rows of {name}: {error}; pip install {name}{needs}")
        return None


def numbalsoda_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    function = callback(case.field, len(case.z0), "tzd")
    ends = np.array(case.span)

    def made(tol: float) -> Run:
        def solve(t):
            return package.dop853(
                function.address, case.z0, t, rtol=tol, atol=tol, mxstep=10_000_000
            )

        def call():
            seconds, _ = clocked(lambda: solve(ends))

            def values(t):
                states, done = solve(t)
                return states if done else np.full_like(states, np.inf)

            return (seconds,), values

        return Run((FORTRAN,), tol, call)

    return [made(tol) for tol in tolerances]


def cyrk_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    function = callback(case.field, len(case.z0), "dtz")
    solver = package.nbsolve2_ivp

    @numba.njit
    def solve(address, start, end, z0, tol):
        return solver(
            address, (start, end), z0, method="DOP853", dense_output=True, rtol=tol, atol=tol
        )

    def made(tol: float) -> Run:
        def call():
            seconds, result = clocked(lambda: solve(function.address, *case.span, case.z0, tol))

            def values(t):
                states = result.call_vectorize(t).T.copy()
                return states if result.success else np.full_like(states, np.inf)

            if run.seconds:  # evaluated already, and it does not free itself
                result.free()
            return (seconds,), values

        run = Run((CPP,), tol, call)
        return run

    return [made(tol) for tol in tolerances]


def heyoka_runs(case: Case, hy: Any, tolerances: Iterable[float]) -> list[Run]:
    H = case.H
    names = [hy.expression(symbol.name) for symbol in H.z]
    known = {s: H.parameters[s.name] for s in H.expr.free_symbols if s.name in H.parameters}
    symbols = dict(zip(H.z, names, strict=True))
    equations = [
        (name, hy.from_sympy(equation.rhs.subs(known), symbols))
        for name, equation in zip(names, H.equations, strict=True)
    ]

    def made(tol: float) -> list[Run]:
        integrator = hy.taylor_adaptive(equations, list(case.z0), tol=tol)

        def restart():
            integrator.time = case.span[0]
            integrator.state[:] = case.z0

        def continuous():
            restart()
            seconds, result = clocked(
                lambda: integrator.propagate_until(case.span[1], c_output=True)
            )
            return (seconds,), lambda t: result[4](t).copy()

        def grid():
            restart()
            seconds, result = clocked(lambda: integrator.propagate_grid(case.t))
            return (seconds,), lambda t: result[-1]

        return [
            Run((name,), tol, call) for name, call in zip(HEYOKAS, (continuous, grid), strict=True)
        ]

    return [run for tol in tolerances for run in made(tol)]


# -- measuring ---------------------------------------------------------------------------------


def measure(case: Case, runs: list[Run], repeats: int) -> None:
    """Times of interleaved repeats, and errors."""
    for repeat in range(repeats):
        for run in runs:
            if repeat and run.once:
                continue
            seconds, evaluate = run.call()
            for name, value in zip(run.names, seconds, strict=True):
                run.seconds[name] = min(value, run.seconds.get(name, math.inf))
            if repeat == 0:
                values = np.asarray(evaluate(case.t))
                with np.errstate(all="ignore"):
                    error = np.linalg.norm(values - case.truth, axis=1).max()
                run.error = float(error) if math.isfinite(error) else math.inf
    for run in runs:
        for name in run.names:
            case.runs.setdefault(name, []).append(run)


def fastest(case: Case, names: Iterable[str], error: float) -> tuple[float, bool]:
    """Seconds of the fastest run no less accurate; else of the most accurate one, and False."""
    runs = [(run.error, run.seconds[name]) for name in names for run in case.runs.get(name, [])]
    if not runs:
        return math.nan, True
    equal = [seconds for found, seconds in runs if found <= error]
    return (min(equal), True) if equal else (min(runs)[1], False)


def ratio(case: Case, run: Run, name: str, rivals: Iterable[str]) -> str:
    seconds, equal = fastest(case, rivals, run.error)
    if math.isnan(seconds):
        return "-"
    value = run.seconds[name] / seconds
    return (f"{value:.3f}" if value < 0.1 else f"{value:.2f}") + ("" if equal else "*")


def measured(case: Case, packages: dict[str, Any], quick: bool, figure: bool) -> Case:
    """All methods: what is interpreted first, because compiled code stays once it is there."""
    repeats = 2 if quick else 3
    step = 1.0 if quick else 0.5
    tolerances = [float(10.0**-exponent) for exponent in np.arange(5, 13.6, step)]
    finest = [float(10.0**-exponent) for exponent in np.arange(14, 15.6, step)]
    own = [10.0**-k for k in range(5, 13)] if figure else ASKED
    dim, basis = len(case.z0), chebyshev_basis()
    lean, fast = interpreted(case.field), jitted(case.field, dim)
    runs = [features(case, PLAIN, tol) for tol in own]
    runs += [chebyshev_march(case, "Chebyshev, plain: march", tol, basis) for tol in own]
    runs += [scipy_run(case, DOP853, "DOP853", lean, tol) for tol in tolerances]
    runs += [scipy_run(case, "DOP853 (scipy, jitted)", "DOP853", fast, tol) for tol in tolerances]
    runs += [odeint_run(case, lean, tol) for tol in tolerances]
    if not quick:
        runs += [scipy_run(case, "Radau (scipy)", "Radau", lean, tol) for tol in ASKED[:2]]
    measure(case, runs, repeats)

    case.H.compile("numba")
    runs = [features(case, COMPILED, tol) for tol in own]
    runs += [chebyshev_march(case, "Chebyshev, compiled: march", tol, basis) for tol in own]
    if packages["numbalsoda"]:
        runs += numbalsoda_runs(case, packages["numbalsoda"], tolerances)
    if packages["CyRK"]:
        runs += cyrk_runs(case, packages["CyRK"], tolerances)
    if packages["heyoka"]:
        runs += heyoka_runs(case, packages["heyoka"], tolerances + finest)
    measure(case, runs, 5 * repeats)
    return case


def rows(case: Case) -> None:
    print(f"\n{case.label}")
    for name, runs in case.runs.items():
        for run in runs:
            if min(abs(run.tol / asked - 1) for asked in ASKED) > 1e-6:
                continue
            over = ratio(case, run, name, (DOP853,)) if name != DOP853 else ""
            print(
                f"  {name:<32}{run.tol:>8.0e}{run.error:>12.1e}{1e3 * run.seconds[name]:>13.3f}"
                f"{over:>10}{run.note}"
            )


def summary(cases: list[Case]) -> None:
    print(
        "\nratios at equal true error, march and whole solve each"
        "\n(* no run of the rival was as accurate; the most accurate one counts)"
    )
    print(
        f"{'':<34}{'plain':>15}{'compiled':>16}{'compiled':>16}{'compiled':>16}\n"
        f"{'problem':<26}{'asked':>8}{'DOP853':>15}{'DOP853':>16}{'its DOP853':>16}"
        f"{'heyoka':>16}"
    )
    pairs = (
        (PLAIN, (DOP853,)),
        (COMPILED, (DOP853,)),
        (COMPILED, COMPILED_DOP853),
        (COMPILED, HEYOKAS),
    )
    for case in cases:
        for asked in ASKED:
            cells = ""
            for own, rivals in pairs:
                for part in ("march", "solve"):
                    name = f"{own}: {part}"
                    run = next(r for r in case.runs[name] if abs(r.tol / asked - 1) < 1e-6)
                    cells += f"{ratio(case, run, name, rivals):>8}"
            print(f"{case.label:<26}{asked:>8.0e}{cells[1:]}")
    print("plain over DOP853 interpreted; compiled over it, over compiled DOP853, over heyoka")


def march_part(arguments: argparse.Namespace) -> None:
    packages = {name: optional(name) for name in ("numbalsoda", "CyRK", "heyoka")}
    print(
        f"{'method':<34}{'asked':>8}{'true error':>12}{'time ms':>13}{'ratio':>10}"
        "   (over interpreted DOP853)"
    )
    cases = []
    for label, name, end, right_hand_side in PROBLEMS:
        if arguments.quick and name not in QUICK:
            continue
        case = Case.of(label, name, end, right_hand_side)
        cases.append(measured(case, packages, arguments.quick, bool(arguments.figure)))
        rows(case)
        sys.stdout.flush()
    summary(cases)
    if arguments.figure:
        draw(cases, arguments.figure)
        print(f"drawn: {arguments.figure}")


# -- figure ------------------------------------------------------------------------------------

# Colours that the colour-blind can tell apart (Okabe & Ito 2008); dashes are marches alone.
LINES = {
    f"{PLAIN}: solve": ("hamsym, plain", "#0072B2", "o-"),
    f"{PLAIN}: march": ("hamsym, plain, march alone", "#0072B2", "o:"),
    f"{COMPILED}: solve": ("hamsym, compiled", "#D55E00", "s-"),
    f"{COMPILED}: march": ("hamsym, compiled, march alone", "#D55E00", "s:"),
    DOP853: ("DOP853, scipy", "#56B4E9", "^-"),
    "DOP853 (scipy, jitted)": ("DOP853, scipy, jitted equations", "#56B4E9", "^:"),
    "LSODA (odeint)": ("LSODA, odeint", "#009E73", "v-"),
    "Radau (scipy)": ("Radau, scipy", "#000000", "x-"),
    FORTRAN: ("DOP853, numbalsoda", "#CC79A7", "D-"),
    CPP: ("DOP853, CyRK", "#CC79A7", "D:"),
    HEYOKA: ("heyoka, continuous output", "#E69F00", "P-"),
    "heyoka, grid": ("heyoka, on a grid", "#E69F00", "P:"),
}


def draw(cases: list[Case], path: str) -> None:
    """Time against true error, a panel a problem."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = min(3, len(cases))
    count = math.ceil(len(cases) / columns)
    figure, axes = plt.subplots(
        count,
        columns,
        figsize=(16, 4.3 * count + 1.4),
        dpi=100,
        squeeze=False,
        layout="constrained",
    )
    lines: dict[str, Any] = {}
    for axis, case in zip(axes.flat, cases, strict=False):
        for name, (label, colour, style) in LINES.items():
            runs = [run for run in case.runs.get(name, []) if math.isfinite(run.error)]
            if runs:
                (lines[label],) = axis.loglog(
                    [run.error for run in runs],
                    [1e3 * run.seconds[name] for run in runs],
                    style,
                    color=colour,
                    markersize=4.5,
                    linewidth=1.6,
                    label=label,
                )
        axis.set_xlim(1e-1, 1e-14)  # more accurate to the right
        axis.set_title(case.label, fontsize=13, loc="left")
        axis.grid(color="0.9", linewidth=0.8)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=11)
    for axis in axes.flat[len(cases) :]:
        axis.set_visible(False)
    for axis in axes[-1]:
        axis.set_xlabel("largest true error", fontsize=12)
    for axis in axes[:, 0]:
        axis.set_ylabel("time, ms", fontsize=12)
    figure.legend(
        lines.values(), lines, loc="outside lower center", ncols=4, fontsize=12, frameon=False
    )
    figure.savefig(path)
    plt.close(figure)


# -- training ----------------------------------------------------------------------------------

TRAINED = (
    ("oscillator, 4 pi", "nonlinear_oscillator"),
    ("Henon-Heiles, 6 pi", "henon_heiles"),
)
BARS = ((1e-7, 37_000), (1e-6, 9_000))  # true error, usual epochs


def trained(problem: systems.Problem, t: np.ndarray, truth: np.ndarray, **options: Any) -> tuple:
    """The solution, its largest true error in any component, and CPU seconds of the whole call."""
    began = time.process_time()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, progress=False, **options)
    seconds = time.process_time() - began
    return solution, float(np.abs(solution(t) - truth).max()), seconds


def training_part(arguments: argparse.Namespace) -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    epoch = [usual(300, torch.float64) for _ in range(3)]
    quick = arguments.quick
    methods = (
        ("features", {"tol": 1e-6}),
        ("levenberg-marquardt", {"target_error": 1e-6}),
        ("lbfgs", {"iterations": 100 if quick else 1_000}),
        ("adam", {"epochs": 300 if quick else 10_000}),
    )
    results, table = [], []
    for label, name in TRAINED:
        problem = systems.CATALOGUE[name]()
        t = np.linspace(*problem.span, TIMES)
        truth = reference(problem, t)
        for method, options in methods:
            if method == "adam" and name != "nonlinear_oscillator":
                continue
            _, error, seconds = trained(problem, t, truth, method=method, **options)
            epoch.append(usual(300, torch.float64))
            results.append((label, method, options, error, seconds))
        for settings in ({"target_error": 2e-7},) if quick else ({"target_error": 2e-7}, {}):
            for seed in range(2 if quick else 10):
                solution, error, seconds = trained(
                    problem, t, truth, method="levenberg-marquardt", seed=seed, **settings
                )
                epoch.append(usual(300, torch.float64))
                table.append((label, settings, seed, solution.training, error, seconds))
    torch.set_num_threads(threads)

    unit = min(epoch)
    print(
        f"\ndeep networks: largest true error of a component, CPU seconds of the whole call, and "
        f"the same\nin usual Adam epochs of {1e3 * unit:.2f} ms (least of {len(epoch)} interleaved "
        f"measurements, up to {1e3 * max(epoch):.2f} ms)"
    )
    print(f"{'problem':<20}{'method':<21}{'':<22}{'true error':>11}{'CPU s':>9}{'epochs':>9}")
    for label, method, options, error, seconds in results:
        settings = ", ".join(
            f"{key}={value:,}" if isinstance(value, int) else f"{key}={value:g}"
            for key, value in options.items()
        )
        print(
            f"{label:<20}{method:<21}{settings:<22}{error:>11.1e}{seconds:>9.3f}"
            f"{seconds / unit:>9,.0f}"
        )
    print(
        f"\nLevenberg-Marquardt, seed by seed\n{'problem':<20}{'stopping':<19}{'seed':>4}"
        f"{'iterations':>12}{'restarts':>10}{'true error':>12}{'CPU s':>8}{'epochs':>9}  bar"
    )
    for label, settings, seed, training, error, seconds in table:
        stopping = "target_error 2e-07" if settings else "default"
        reached = [f"{e:.0e} in {n:,}" for e, n in BARS if error <= e and seconds / unit <= n]
        print(
            f"{label:<20}{stopping:<19}{seed:>4}{training.iterations:>12,}{training.restarts:>10}"
            f"{error:>12.1e}{seconds:>8.2f}{seconds / unit:>9,.0f}  {(reached or ['none'])[0]}"
        )


# -- first call --------------------------------------------------------------------------------

FIRST = {
    "hamsym": """
from hamsym import solve
from hamsym.systems import henon_heiles
began = time.perf_counter()
problem = henon_heiles()
derived = time.perf_counter()
solve(problem.H, problem.z0, (0, 300.0), tol=1e-9)
""",
    "DOP853": """
from scipy.integrate import solve_ivp
def field(t, z):
    x, y, px, py = z.tolist()
    return px, py, -x - 2*x*y, -y - x*x + y*y
began = derived = time.perf_counter()
solve_ivp(field, (0, 300.0), (0.3, -0.3, 0.3, 0.15), method="DOP853", dense_output=True, {options})
""",
}


def first_part(arguments: argparse.Namespace) -> None:
    repeats = 2 if arguments.quick else 5
    rows = {
        "hamsym, tol 1e-9": FIRST["hamsym"],
        "DOP853, rtol = atol = 1e-9": FIRST["DOP853"].format(options="rtol=1e-9, atol=1e-9"),
        "DOP853, rtol = atol = 1e-12": FIRST["DOP853"].format(options="rtol=1e-12, atol=1e-12"),
    }
    ending = "\nprint(derived - began, time.perf_counter() - began)"
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in rows}
    for _ in range(repeats):
        for name, text in rows.items():
            output = subprocess.run(
                [sys.executable, "-c", "import time" + text + ending],
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            found[name].append(tuple(float(word) for word in output.split()))
    least = {name: min(times, key=lambda pair: pair[1]) for name, times in found.items()}
    print("\nfirst call in a fresh process, imports done: Henon-Heiles, t = 300")
    own = least["hamsym, tol 1e-9"]
    for name, (derived, total) in least.items():
        print(
            f"  {name:<30}{1e3 * total:>9.1f} ms"
            + (
                f" ({1e3 * derived:.1f} ms of it from text to Hamiltonian)"
                if derived
                else f"   hamsym's is {1e3 * (own[1] - total):+.1f} ms"
            )
        )


PARTS = {"march": march_part, "training": training_part, "first": first_part}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two problems, fewer repeats")
    parser.add_argument("--figure", metavar="FILE", help="draw the work-precision figure")
    parser.add_argument("--part", choices=list(PARTS), action="append", help="this part only")
    arguments = parser.parse_args()
    for part in arguments.part or PARTS:
        PARTS[part](arguments)


if __name__ == "__main__":
    main()
