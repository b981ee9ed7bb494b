"""Other solutions with the same data: by a change of signs, and at aliased frequencies."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import sympy

from hamsym.fitting.motions import MappedMotions, SolvedMotions, rates
from hamsym.fitting.search import Found, Model
from hamsym.fitting.unknowns import Unknowns
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.least_squares import minimize_squares

_MOST = 8  # quantities whose signs are tried together
_FASTEST = 3.0  # times as fast: motions with fewer than four data in a period
_POINTS = 64  # in a period, to find it
_RETURN = 0.05  # of the range of a component: distance from the start after a period
_SCALED = 0.1  # relative error of the response to a change of speed
_APART = 1e-3  # relative difference of other solutions
_STEP = 1e-4  # of the time: step of differences

#: Times -> states (times, dim).
Motion = Callable[[np.ndarray], np.ndarray]


def reflected(
    unknowns: Unknowns,
    changes: Sequence[np.ndarray],
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> list[str]:
    """Name the solutions that changes of signs make of one with its intervals, each shape (k,)."""
    texts: list[str] = []
    named = [np.ones(len(x))]
    for signs in changes:
        other, flipped = signs * x, signs < 0
        inside = ((other > unknowns.low) & (other < unknowns.high))[flipped].all()
        if not inside or any((signs == one).all() for one in named):
            continue
        named += [signs * one for one in named]
        names = [name for name, sign in zip(unknowns.names, signs, strict=True) if sign < 0]
        if ((low <= 0) & (high >= 0))[flipped].all():
            verb = "is" if len(names) == 1 else "are"
            interval = "its interval includes 0" if len(names) == 1 else "intervals include 0"
            texts.append(f"{_listed(names)} {verb} determined only up to sign, and {interval}")
        else:
            texts.append(
                f"another solution fits as well, by symmetry, {unknowns.text(other)}; give bounds "
                f"of {' or '.join(names)} that exclude it"
            )
    return texts


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def reflections(unknowns: Unknowns, observables: tuple[sympy.Expr, ...]) -> list[np.ndarray]:
    """Return signs of the free quantities, each of shape (k,), that change no observable."""
    H, names = unknowns.H, unknowns.names
    pairs = tuple(
        i
        for i in range(H.dof)
        if any(H.names[j] in names for j in (i, i + H.dof))
        and all(H.names[j] in names or unknowns.start[j] == 0 for j in (i, i + H.dof))
    )
    H = H.with_parameters(**dict.fromkeys(H.parameters, 1.0))
    found = _symmetries(H, observables, pairs, unknowns.free_parameters)
    return [np.array([-1.0 if name in flips else 1.0 for name in names]) for flips in found]


@functools.lru_cache(maxsize=64)
def _symmetries(
    H: Hamiltonian,
    observables: tuple[sympy.Expr, ...],
    pairs: tuple[int, ...],
    parameters: tuple[str, ...],
) -> tuple[frozenset[str], ...]:
    """Return the names that change sign in maps that leave H, forces and observables the same."""
    equations = H.real_equations
    parts = [frozenset((i, i + H.dof)) for i in pairs]
    items: list[dict[sympy.Expr, str]] = [
        {equations.z[j]: H.names[j] for j in sorted(part)} for part in parts
    ]
    items += [{equations.parameters[name][0]: name} for name in parameters]
    found = []
    for chosen in product((False, True), repeat=min(len(items), _MOST)):
        flipped = {
            s: n for item, one in zip(items, chosen, strict=False) if one for s, n in item.items()
        }
        change = {symbol: -symbol for symbol in flipped}
        if change and all(_same(e.xreplace(change), e) for e in (*observables, equations.expr)):
            signs = [-1 if equations.z[H.dof + i] in change else 1 for i in range(H.dof)]
            forces = zip(equations.forces, signs, strict=False)
            if all(_same(force.xreplace(change), sign * force) for force, sign in forces):
                found.append(frozenset(flipped.values()))
    return tuple(sorted(found, key=len))


def _same(one: sympy.Expr, other: sympy.Expr) -> bool:
    return bool(one == other or sympy.expand(one - other) == 0)


def aliased(model: Model, found: Found, variance: np.ndarray, k: int) -> list[str]:
    """Name a solution of set k at an aliased frequency, if data are few in a period.

    Data at times on a grid of step dt cannot tell a motion of period P from one that is
    |1 + n P/dt| times as fast, run backwards where 1 + n P/dt is negative.
    """
    unknowns, x, t = model.unknowns, found.unknowns[k], model.observed.t
    step = _grid(t[model.observed.present[k].any(axis=0)])
    fastest = float(rates(unknowns, x[None], model.span[0])[0])
    if not (step > 0 and fastest * step * _FASTEST > np.pi and found.converged[k]):
        return []

    def motion(times: np.ndarray) -> np.ndarray:
        if isinstance(model.motions, MappedMotions):
            return MappedMotions(model.motions.flow, unknowns, times).states(x[None])[0]
        return SolvedMotions(unknowns, times, model.span, model.tol).states(x[None])[0]

    period = _period(motion, model.span, fastest)
    powers = _powers(model, found, motion, k)
    if not period > 0 or powers is None:
        return []
    starts = []
    for n in range(-int(np.ceil(2 * step / period)) - 1, 2):
        speed = 1 + n * period / step
        start = x * abs(speed) ** powers
        if speed < 0:
            momenta = [j for j, i in unknowns.components.items() if i >= unknowns.H.dof]
            start[momenta] *= -1
        inside = (start >= unknowns.low) & (start <= unknowns.high)
        if n and _APART < abs(speed) <= 1.05 * _FASTEST and inside.all():
            starts.append((abs(speed), start))
    for speed, start in sorted(starts, key=lambda pair: pair[0]):
        other = minimize_squares(
            lambda values, rows: model.residuals(values, 0 * rows + k),
            start[None],
            unknowns.low,
            unknowns.high,
            lambda squares, rows: model.variance(squares, 0 * rows + k),
        )
        apart = np.abs(other.unknowns[0] - x) > _APART * np.maximum(np.abs(x), model.sizes)
        squares = float((other.residuals[0] ** 2).sum())
        if other.converged[0] and apart.any() and squares - found.chi_square[k] <= 4 * variance[k]:
            return [
                f"data at steps of {step:.6g} do not tell this motion from one {speed:.3g} times "
                f"as fast, {unknowns.text(other.unknowns[0])}; give bounds that exclude it"
            ]
    return []


def _grid(t: np.ndarray) -> float:
    """Return the step of a grid on which all times are, zero if they are on none."""
    gaps = np.diff(np.unique(t))
    gaps = gaps[gaps > 1e-9 * np.ptp(t)] if len(gaps) else gaps
    if not len(gaps):
        return 0.0
    steps = gaps / gaps.min()
    return float(gaps.min()) if (np.abs(steps - np.round(steps)) <= 1e-3).all() else 0.0


def _period(motion: Motion, span: tuple[float, float], fastest: float) -> float:
    """Return the time of the first return to the start, zero if there is none."""
    length = abs(span[1] - span[0])
    count = int(np.clip(_POINTS * length * fastest / (2 * np.pi), 256, 20_000))
    times = np.linspace(0, length, count)
    states = motion(span[0] + np.sign(span[1] - span[0]) * times)
    with np.errstate(all="ignore"):
        away = (states - states[0]) / np.ptp(states, axis=0)
        distance = np.nansum(away**2, axis=1)
    inner = distance[1:-1]
    lowest = (inner <= distance[:-2]) & (inner < distance[2:]) & (inner < _RETURN)
    left = np.maximum.accumulate(distance)[1:-1] > 0.5
    if not (lowest & left).any():
        return 0.0
    i = int(np.argmax(lowest & left)) + 1
    before, here, after = distance[i - 1 : i + 2]
    shift = 0.5 * (before - after) / (before - 2 * here + after)
    return float(times[i] + shift * (times[1] - times[0]))


def _powers(model: Model, found: Found, motion: Motion, k: int) -> np.ndarray | None:
    """Return the powers of the speed that free quantities follow, None if there are none."""
    unknowns, x, t = model.unknowns, found.unknowns[k], model.observed.t
    sigma, present = model.observed.sigma[k], model.observed.present[k]
    parameters = unknowns.parameter_rows(x[None])

    def observed(speed: float) -> np.ndarray:
        times = model.span[0] + speed * (t - model.span[0])
        values, _, _ = model.observables(motion(times)[None], times, parameters)
        return np.where(present, values[0] / sigma, 0.0).ravel()

    ends = [observed(1 - i * _STEP) for i in range(3)]
    slope = (3 * ends[0] - 4 * ends[1] + ends[2]) / (2 * _STEP)
    J = found.jacobian[k]
    if not (np.isfinite(slope).all() and np.isfinite(J).all()):
        return None
    lengths = np.where((size := np.linalg.norm(J, axis=0)) > 0, size, 1.0)
    change = np.linalg.lstsq(J / lengths, slope, rcond=None)[0] / lengths
    if not np.linalg.norm(J @ change - slope) <= _SCALED * np.linalg.norm(slope):
        return None
    return np.where(np.abs(x) > 1e-9 * model.sizes, change / np.where(x == 0, 1.0, x), 0.0)
