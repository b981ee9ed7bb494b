"""Runs of hamsym and of other packages on one case, each to a tolerance.

Opponents have continuous output and the leanest right-hand side that can be written by hand;
compiled opponents have the same text compiled by numba, heyoka and diffrax equations from sympy.
odeint writes the states at the common times. numbalsoda has no continuous output: it is timed
with the state at the end alone, which favours it. heyoka is timed with continuous output, which
compiles its evaluation anew in every call, and with a grid of the common times.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numba
import numpy as np
import sympy
from numba import types
from numba.np.unsafe.ndarray import to_fixed_tuple
from scipy.integrate import odeint, solve_ivp

import hamsym

from .measuring import cpu, largest_error, median, short_cpu
from .problems import Case

INSTALLATION = {
    "numbalsoda": "numbalsoda (needs gfortran)",
    "neurodiffeq": "neurodiffeq (and remove the package `tests` that it installs)",
}


def optional(name: str, skipped: list[str]) -> Any:
    """Import a package; if it is not installed, say so, add it to ``skipped`` and return None."""
    try:
        return importlib.import_module(name)
    except ImportError:
        if name not in skipped:
            print(f"{name} is not installed: skipped; pip install {INSTALLATION.get(name, name)}")
            skipped.append(name)
        return None


@dataclass
class Run:
    """A method at one setting.

    Attributes
    ----------
    method : str
    asked : float
        Tolerance, or number of steps.
    call : callable
        What is timed.
    states : callable
        (result of ``call``, times) -> states; not timed.
    seconds : list of float
        CPU seconds of each repeat.
    """

    method: str
    asked: float
    call: Callable[[], Any]
    states: Callable[[Any, np.ndarray], np.ndarray]
    once: bool = False
    seconds: list[float] = field(default_factory=list)
    error: float = float("inf")
    note: str = ""

    def repeat(self, case: Case) -> None:
        """Time more calls, short ones several in a row; judge the states of the first one."""
        if self.seconds:
            self.seconds.append(short_cpu(self.call))
            return
        seconds, result = cpu(self.call)
        self.seconds.append(seconds)
        with np.errstate(all="ignore"):
            self.error = largest_error(np.asarray(self.states(result, case.t)), case.truth)
        if isinstance(result, hamsym.Solution) and not result.success:
            self.note = "tolerance not met"

    def row(self, problem: str) -> dict[str, Any]:
        """The result, with the median of the repeats."""
        return {
            "problem": problem,
            "method": self.method,
            "asked": self.asked,
            "error": self.error,
            "seconds": median(self.seconds),
            "note": self.note,
        }


def compare(case: Case, runs: Iterable[Run], repeats: int) -> list[dict[str, Any]]:
    """Rows of all runs, repeated in turns."""
    runs = list(runs)
    for repeat in range(repeats):
        for run in runs:
            if not (repeat and run.once):
                run.repeat(case)
    return [run.row(case.label) for run in runs]


# -- hamsym ------------------------------------------------------------------------------------


def hamsym_runs(case: Case, tolerances: Iterable[float]) -> list[Run]:
    """Run solve, and solve with the states at the common times."""

    def made(tol: float) -> list[Run]:
        def solved() -> hamsym.Solution:
            return hamsym.solve(case.H, case.z0, case.span, tol=tol)

        return [
            Run("hamsym", tol, solved, lambda found, t: found(t)),
            Run("hamsym, grid", tol, lambda: solved()(case.t), lambda found, t: found),
        ]

    return [run for tol in tolerances for run in made(tol)]


# -- scipy -------------------------------------------------------------------------------------


def interpreted(field: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Arithmetic with Python's floats is faster than with numpy's."""
    return lambda t, z: field(t, z.tolist())


def jitted(field: Callable[[Any, Any], Any], dim: int) -> Callable[..., Any]:
    """Compile a right-hand side for scipy."""
    kernel = numba.njit(field, error_model="numpy")

    @numba.njit
    def rates(t, z):  # type: ignore[no-untyped-def]
        values = kernel(t, to_fixed_tuple(z, dim))
        out = np.empty(dim)
        for i in range(dim):
            out[i] = values[i]
        return out

    rates(0.0, np.full(dim, 0.5) + np.arange(dim))
    return rates  # type: ignore[no-any-return]


def scipy_runs(
    case: Case,
    name: str,
    method: str,
    rates: Callable[..., Any],
    tolerances: Iterable[float],
    *,
    grid: bool = False,
) -> list[Run]:
    """Run solve_ivp with continuous output, or with output on the grid of the common times."""

    def made(tol: float) -> Run:
        def call() -> Any:
            return solve_ivp(
                rates,
                case.span,
                case.z0,
                method,
                case.t if grid else None,
                dense_output=not grid,
                rtol=tol,
                atol=tol,
            )

        def states(found: Any, t: np.ndarray) -> np.ndarray:
            return np.asarray(found.y.T if grid else found.sol(t).T)

        return Run(name, tol, call, states, once=method == "Radau")

    return [made(tol) for tol in tolerances]


def odeint_runs(case: Case, rates: Callable[..., Any], tolerances: Iterable[float]) -> list[Run]:
    def made(tol: float) -> Run:
        def call() -> Any:
            return odeint(
                rates,
                case.z0,
                case.t,
                tfirst=True,
                rtol=tol,
                atol=tol,
                mxstep=100_000,
                full_output=True,
            )

        def states(found: Any, t: np.ndarray) -> np.ndarray:
            values, report = found
            done = report["message"] == "Integration successful."
            return values if done else np.full_like(values, np.inf)

        return Run("LSODA (odeint)", tol, call, states)

    return [made(tol) for tol in tolerances]


# -- compiled packages -------------------------------------------------------------------------


def callback(field: Callable[[Any, Any], Any], dim: int, order: str) -> Any:
    """Compile a right-hand side to a C function of t, the state z and its rates d, in ``order``."""
    kernel = numba.njit(field, error_model="numpy")
    pointer = types.CPointer(types.float64)

    @numba.njit(inline="always")
    def fill(t, z, out):  # type: ignore[no-untyped-def]
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


def numbalsoda_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    function = callback(case.field, len(case.z0), "tzd")

    def made(tol: float) -> Run:
        def solve(t: np.ndarray) -> Any:
            return package.dop853(
                function.address, case.z0, t, rtol=tol, atol=tol, mxstep=10_000_000
            )

        def states(found: Any, t: np.ndarray) -> np.ndarray:
            values, done = solve(t)
            return np.asarray(values) if done else np.full((len(t), len(case.z0)), np.inf)

        return Run("DOP853 (numbalsoda)", tol, lambda: solve(np.array(case.span)), states)

    return [made(tol) for tol in tolerances]


def cyrk_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    function = callback(case.field, len(case.z0), "dtz")
    solver = package.nbsolve2_ivp

    @numba.njit
    def solve(address, start, end, z0, tol):  # type: ignore[no-untyped-def]
        return solver(
            address, (start, end), z0, method="DOP853", dense_output=True, rtol=tol, atol=tol
        )

    def made(tol: float) -> Run:
        def call() -> Any:
            found = solve(function.address, *case.span, case.z0, tol)
            if run.seconds:  # judged already, and it does not free itself
                found.free()
            return found

        def states(found: Any, t: np.ndarray) -> np.ndarray:
            values = found.call_vectorize(t).T.copy()
            values = values if found.success else np.full_like(values, np.inf)
            found.free()
            return np.asarray(values)

        run = Run("DOP853 (CyRK)", tol, call, states)
        return run

    return [made(tol) for tol in tolerances]


def diffrax_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    """Dopri8 of diffrax with continuous output, compiled once for all tolerances."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    H = case.H
    rates = sympy.lambdify(list(H.z), list(H.vector_field.subs(bound(H))), "jax", cse=True)
    term = package.ODETerm(lambda t, z, args: jnp.stack(rates(*z)))
    start, end = case.span

    def solve(tol: Any) -> Any:
        return package.diffeqsolve(
            term,
            package.Dopri8(),
            start,
            end,
            None,
            jnp.asarray(case.z0),
            saveat=package.SaveAt(dense=True),
            stepsize_controller=package.PIDController(rtol=tol, atol=tol),
            max_steps=16_384,
            throw=False,
        )

    compiled = jax.jit(solve)
    jax.block_until_ready(compiled(1e-3).ts)

    def made(tol: float) -> Run:
        def states(found: Any, t: np.ndarray) -> np.ndarray:
            values = np.array(jax.vmap(found.evaluate)(t))
            done = found.result == package.RESULTS.successful
            return values if done else np.full_like(values, np.inf)

        return Run("Dopri8 (diffrax)", tol, lambda: jax.block_until_ready(compiled(tol)), states)

    return [made(tol) for tol in tolerances]


def bound(H: hamsym.Hamiltonian) -> dict[sympy.Symbol, float]:
    """Parameters of H with their values."""
    return {s: H.parameters[s.name] for s in H.expr.free_symbols if s.name in H.parameters}


def heyoka_integrator(case: Case, package: Any, tol: float) -> Any:
    """A Taylor integrator of heyoka, in its default mode."""
    H = case.H
    names = [package.expression(symbol.name) for symbol in H.z]
    symbols = dict(zip(H.z, names, strict=True))
    known = bound(H)
    equations = [
        (name, package.from_sympy(equation.rhs.subs(known), symbols))
        for name, equation in zip(names, H.equations, strict=True)
    ]
    return package.taylor_adaptive(equations, list(case.z0), tol=tol)


def heyoka_grid(case: Case, integrator: Any) -> np.ndarray:
    """States of heyoka at the common times."""
    integrator.time = case.span[0]
    integrator.state[:] = case.z0
    return np.asarray(integrator.propagate_grid(case.t)[-1])


def heyoka_runs(case: Case, package: Any, tolerances: Iterable[float]) -> list[Run]:
    def made(tol: float) -> list[Run]:
        integrator = heyoka_integrator(case, package, tol)

        def continuous() -> Any:
            integrator.time = case.span[0]
            integrator.state[:] = case.z0
            return integrator.propagate_until(case.span[1], c_output=True)[4]

        def grid() -> np.ndarray:
            return heyoka_grid(case, integrator)

        return [
            Run("heyoka", tol, continuous, lambda found, t: found(t).copy()),
            Run("heyoka, grid", tol, grid, lambda found, t: found),
        ]

    return [run for tol in tolerances for run in made(tol)]


def opponent_runs(
    case: Case, tolerances: Iterable[float], skipped: list[str]
) -> tuple[list[Run], list[Run]]:
    """Runs of interpreted and of compiled opponents; heyoka also at finer tolerances."""
    tolerances = list(tolerances)
    dim = len(case.z0)
    lean = interpreted(case.field)
    plain = scipy_runs(case, "DOP853 (scipy)", "DOP853", lean, tolerances)
    plain += odeint_runs(case, lean, tolerances)
    compiled = scipy_runs(
        case, "DOP853 (scipy, jitted)", "DOP853", jitted(case.field, dim), tolerances
    )
    for name, runs, finer in (
        ("numbalsoda", numbalsoda_runs, []),
        ("CyRK", cyrk_runs, []),
        ("diffrax", diffrax_runs, []),
        ("heyoka", heyoka_runs, [1e-14, 10**-14.5, 1e-15]),
    ):
        if package := optional(name, skipped):
            compiled += runs(case, package, tolerances + finer)
    return plain, compiled
