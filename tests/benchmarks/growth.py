"""How the cost of a march grows with the dimension and with the span.

Dimension: a chain of n coupled oscillators at tol 1e-9, the march alone and the whole solve, plain
and compiled, and scipy's DOP853 with the right-hand side K @ q. That one is vectorised numpy with
a matrix, since a scalar one would be silly for many masses; it is run at 1e-11, where its true
error is below the tolerance of the march, but above its true error. Times are minima over
interleaved repeats, without compilation.

Span: the paper's oscillator at tol 1e-8, plain and then compiled. A long plain march may go on in
compiled code by itself, and the column says so. The estimate is the largest over components of
what is estimated, over what was allowed; errors are 2-norms at 4,001 times.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import hamsym
from hamsym import systems

TIMES = 4_001


def clocked(function: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    result = function()
    return time.perf_counter() - began, result


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """b of the power law a n^b that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def error_of(states: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(states - truth, axis=1).max())


# -- dimension ---------------------------------------------------------------------------------


def chain(n: int, coupling: float = 0.5) -> Callable:
    """The equations of the chain as numpy would have them."""
    stiffness = (1 + 2 * coupling) * np.eye(n) - coupling * (np.eye(n, k=1) + np.eye(n, k=-1))

    def rates(t, z):
        return np.concatenate((z[n:], -(stiffness @ z[:n])))

    return rates


def dimension_row(n: int, repeats: int) -> tuple[list[float], list[float], bool]:
    """Seconds of march and solve plain, march and solve compiled, DOP853; errors; success."""
    problem = systems.coupled_oscillators(n)
    t = np.linspace(*problem.span, TIMES)
    truth = problem.exact(t)
    rates = chain(n)

    def own() -> list[float]:
        seconds, solution = clocked(
            lambda: hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
        )
        kept["own"] = solution
        return [solution.training.seconds, seconds]

    def rival() -> list[float]:
        seconds, kept["rival"] = clocked(
            lambda: solve_ivp(
                rates,
                problem.span,
                problem.z0,
                method="DOP853",
                dense_output=True,
                rtol=1e-11,
                atol=1e-11,
            )
        )
        return [seconds]

    kept: dict[str, Any] = {}
    plain = np.min([own() + rival() for _ in range(repeats)], axis=0)
    problem.H.compile("numba")
    compiled = np.min([own() for _ in range(2 * repeats)], axis=0)
    errors = [error_of(kept["own"](t), truth), error_of(kept["rival"].sol(t).T, truth)]
    return [*plain[:2], *compiled, plain[2]], errors, kept["own"].success


def dimension(sizes: Sequence[int], repeats: int) -> None:
    print("coupled oscillators, t = 4 pi, tol 1e-9; DOP853 with K @ q at 1e-11; ms")
    print(
        f"{'':>6}{'plain':>11}{'':>11}{'compiled':>11}{'':>11}{'DOP853':>11}{'true error':>13}\n"
        f"{'n':>6}{'march':>11}{'solve':>11}{'march':>11}{'solve':>11}{'':>11}"
        f"{'hamsym':>13}{'DOP853':>10}"
    )
    columns = []
    for n in sizes:
        seconds, errors, success = dimension_row(n, repeats)
        columns.append(seconds)
        times = "".join(f"{1e3 * value:>11.2f}" for value in seconds)
        note = "" if success else "  NOT met"
        print(f"{n:>6}{times}{errors[0]:>13.1e}{errors[1]:>10.1e}{note}", flush=True)
    powers = [exponent(sizes, column) for column in zip(*columns, strict=True)]
    half = len(sizes) // 2
    ends = [exponent(sizes[half:], column[half:]) for column in zip(*columns, strict=True)]
    for first, row in ((sizes[0], powers), (sizes[half], ends)):
        cells = "".join(f"{power:>11.2f}" for power in row)
        print(f"{'n^':>6}{cells}   from n = {first}")


# -- span --------------------------------------------------------------------------------------


def megabytes(solution: hamsym.Solution) -> float:
    """Of the arrays that a solution holds: the march and the estimate of its error."""
    found = solution.training, solution.march_error
    arrays = [a for part in found for a in vars(part).values() if isinstance(a, np.ndarray)]
    tensors = [tensor.numpy() for tensor in solution.trial.state_dict().values()]
    unique = {array.__array_interface__["data"][0]: array.nbytes for array in arrays + tensors}
    return sum(unique.values()) / 1e6


def span_rows(problem: systems.Problem, counts: Sequence[int], tol: float) -> None:
    columns = []
    for count in counts:
        span = (0.0, count * problem.period)
        repeats = 3 if count <= 100 else 1
        runs = [
            clocked(lambda span=span: hamsym.solve(problem.H, problem.z0, span, tol=tol))
            for _ in range(repeats)
        ]
        seconds, solution = min(runs, key=lambda run: run[0])
        t = np.linspace(solution.span[0], solution.span[1], TIMES)
        windows = solution.training
        allowed = tol * windows.scale
        estimate = float((solution.march_error.largest / allowed).max())
        error = error_of(solution(t), problem.exact(t))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        columns.append((len(windows.readouts), windows.seconds, seconds))
        print(
            f"{count:>8,}{'yes' if windows.compiled else 'no':>9}{columns[-1][0]:>9,}"
            f"{windows.seconds:>9.3f}{seconds:>9.3f}{estimate:>12.1e}{error:>12.1e}"
            f"{megabytes(solution):>9.1f}{peak:>9,.0f}  {'yes' if solution.success else 'NO'}",
            flush=True,
        )
        if not solution.success:
            print(f"          {solution.message}")
    powers = [exponent(counts, column) for column in zip(*columns, strict=True)]
    print(f"{'T^':>8}{'':>9}{powers[0]:>9.2f}{powers[1]:>9.2f}{powers[2]:>9.2f}")


def span(counts: Sequence[int], tol: float = 1e-8) -> None:
    problem = systems.nonlinear_oscillator()
    print(f"\nthe paper's oscillator over many periods of {problem.period:.3f}, tol {tol:.0e}")
    print(
        f"{'periods':>8}{'compiled':>9}{'windows':>9}{'march s':>9}{'solve s':>9}"
        f"{'estim./all.':>12}{'true error':>12}{'arrays':>9}{'process':>9}  met\n"
        f"{'':>68}{'MB':>9}{'peak MB':>9}"
    )
    span_rows(problem, counts, tol)
    problem.H.compile("numba")
    span_rows(problem, counts, tol)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer sizes and shorter spans")
    quick = parser.parse_args().quick
    dimension([2**k for k in range(4 if quick else 6)], 2 if quick else 5)
    sys.stdout.flush()
    span([10**k for k in range(1, 3 if quick else 5)])


if __name__ == "__main__":
    main()
