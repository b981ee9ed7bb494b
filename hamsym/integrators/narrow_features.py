"""Features of H that are narrower than a time step: pulses, steps, poles and jumps.

Runs with different steps agree if all of them step over the same feature. Its place can be read
from the formula: near the zeros and extrema of the arguments of exp, tanh and similar functions,
and of the bases of negative and fractional powers
(:func:`hamsym.symbolic.derivatives.narrow_arguments`). These arguments vary slowly along a
trajectory, so that the states of successive steps show how far they change in a step near such a
place. Where a function like abs or sign switches, the force or H may jump.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.codegen.names import Names
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.step_scales import on_trajectories
from hamsym.symbolic.derivatives import Narrow, narrow_arguments

_POLE_EXCESS = 4.0  # factor by which a step beside a pole is too long for any method
_FORCE_JUMP, _ENERGY_JUMP = 1e-3, 1e-12  # smallest jumps that count, relative to the largest values


class NarrowFeatures:
    """Places on trajectories where H may have a feature narrower than a step."""

    def __init__(self, H: Hamiltonian) -> None:
        equations = H.real_equations
        names = Names(equations)
        self._identifiers = [name for name, _ in names.parameters]
        self._system = H.compile("numpy")
        variables = [*equations.z, *([] if equations.time is None else [equations.time])]
        found = _arguments(H)
        self._kinds = np.array([kind for _, kind in found], dtype=int)
        self._arguments = compile_expressions([argument for argument, _ in found], equations)
        switches = equations.switches(variables)
        self._jumps = [
            (compile_expressions([switch], equations), compile_expressions(jumps, equations))
            for switch, jumps in switches
        ]

    def unresolved(
        self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None, allowed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Largest factor by which the steps are too long, and its place.

        - z: States after successive steps, shape (n, times, dim).
        - t: Shape (times,).
        - parameters: Values of each trajectory, shape (n, k).
        - allowed: Errors that the tolerance allows, shape (n, dim).
        - returns excess, place: At most 1 where the steps resolve all features, infinite at a pole
          or a jump, and the index of the step, shape (n,) each.
        """
        with np.errstate(all="ignore"):
            g = on_trajectories(self._arguments, self._identifiers, z, t, parameters)
            excess = np.zeros((len(z), len(t) - 1))
            for k, kind in enumerate(self._kinds):
                if kind == Narrow.FUNCTION:
                    found = _function_excess(g[..., k])
                elif kind == Narrow.BASE:
                    found = _base_excess(g[..., k])
                else:
                    found = _touch_excess(g[..., k])
                # A value that is not finite is no sign of a resolved feature.
                excess = np.maximum(excess, np.where(np.isnan(found), np.inf, found))
            excess = np.maximum(excess, self._switched_twice(g))
            for argument, jumps in self._jumps:
                excess = np.maximum(excess, self._jump(argument, jumps, z, t, parameters, allowed))
        place = excess.argmax(axis=1)
        return excess[np.arange(len(z)), place], place

    def pole(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> float | None:
        """Time of the first step that is too long beside a pole or an end of the domain of H.

        The arguments are those of :meth:`unresolved`; None if there is no such step.
        """
        bases = np.flatnonzero(self._kinds == Narrow.BASE)
        if not len(bases):
            return None
        with np.errstate(all="ignore"):
            g = on_trajectories(self._arguments, self._identifiers, z, t, parameters)
            steps = [~(_base_excess(g[..., k]) <= _POLE_EXCESS).all(axis=0) for k in bases]
        crossed = np.flatnonzero(np.any(steps, axis=0))
        return float(t[crossed[0]]) if len(crossed) else None

    def _switched_twice(self, g: np.ndarray) -> np.ndarray:
        """Infinite in a step in which two switches change: what is between them is not seen."""
        switches = g[..., self._kinds == Narrow.SWITCH]
        if switches.shape[-1] < 2:
            return np.zeros((1, 1))
        changed = (np.sign(switches[:, 1:]) != np.sign(switches[:, :-1])).sum(axis=-1)
        unknown = np.isnan(switches).any(axis=-1)
        good = (changed <= 1) & ~unknown[:, 1:] & ~unknown[:, :-1]
        return np.where(good, 0.0, np.inf)

    def _jump(
        self,
        argument: Callable[..., np.ndarray],
        jumps: Callable[..., np.ndarray],
        z: np.ndarray,
        t: np.ndarray,
        parameters: np.ndarray | None,
        allowed: np.ndarray,
    ) -> np.ndarray:
        """Infinite in the steps in which H or its gradient jumps; else the error of small jumps.

        A step over a jump has no order: its error depends on where the jump lies in it, so that
        runs with different steps may agree by chance.
        """
        found = np.zeros((len(z), len(t) - 1))
        values = on_trajectories(argument, self._identifiers, z, t, parameters)[..., 0]
        rows, steps = np.nonzero(~(values[:, 1:] * values[:, :-1] > 0) & (values[:, 1:] != 0))
        if not len(rows):
            return found
        low, high = values[rows, steps], values[rows, steps + 1]
        share = np.nan_to_num(low / (low - high))
        at = z[rows, steps] + share[:, None] * (z[rows, steps + 1] - z[rows, steps])
        times = t[steps] + share * (t[steps + 1] - t[steps])
        some = None if parameters is None else parameters[rows]
        sizes = np.abs(
            on_trajectories(jumps, self._identifiers, at[:, None], times[:, None], some)[:, 0]
        )
        given = self._system.keywords(some)
        arguments = self._system.arguments(at, times)
        force = np.abs(self._system.vector_field(*arguments, **given)).max(axis=1)
        energy = np.abs(self._system.energy(*arguments, **given))
        small = (sizes[:, :-1] <= _FORCE_JUMP * force[:, None]).all(axis=1)
        small &= sizes[:, -1] <= _ENERGY_JUMP * energy
        changes = np.roll(sizes[:, :-1], z.shape[-1] // 2, axis=1)  # of the rates of (q, p)
        errors = changes * np.abs(t[steps + 1] - t[steps])[:, None]
        shares = np.where(errors == 0, 0.0, errors / allowed[rows]).max(axis=1)
        found[rows, steps] = np.where(small, shares, np.inf)
        return found


@functools.lru_cache(maxsize=64)
def narrow_features(H: Hamiltonian) -> NarrowFeatures | None:
    """Make the check of a Hamiltonian; None if its formula has no such features."""
    return NarrowFeatures(H) if _arguments(H) else None


def _arguments(H: Hamiltonian) -> list[tuple[sympy.Expr, Narrow]]:
    equations = H.real_equations
    variables = [*equations.z, *([] if equations.time is None else [equations.time])]
    return narrow_arguments(sympy.Tuple(*equations.formulas), variables)


def _function_excess(g: np.ndarray) -> np.ndarray:
    """Change of an argument in steps with a zero or an extremum, in units of 1."""
    change = np.diff(g, axis=1)
    size = np.abs(change)
    excess = np.where(g[:, 1:] * g[:, :-1] > 0, 0.0, size)
    turns = ~(change[:, 1:] * change[:, :-1] > 0)
    around = np.where(turns, np.maximum(size[:, 1:], size[:, :-1]), 0.0)
    excess[:, 1:] = np.maximum(excess[:, 1:], around)
    excess[:, :-1] = np.maximum(excess[:, :-1], around)
    return excess


def _base_excess(g: np.ndarray) -> np.ndarray:
    """Curvature of a base at the minima of its magnitude, in units of the minimum."""
    excess = np.where(g[:, 1:] * g[:, :-1] > 0, 0.0, np.inf)
    excess[:, 1:] = np.maximum(excess[:, 1:], _dips(np.abs(g)))
    return excess


def _touch_excess(g: np.ndarray) -> np.ndarray:
    """Curvature of a switch at minima of its magnitude where it keeps its sign.

    A switch that comes close to zero may pass it twice within a step: what is between the zeros, a
    pulse, is not seen.
    """
    signs = np.sign(g)
    kept = (signs[:, 2:] == signs[:, 1:-1]) & (signs[:, 1:-1] == signs[:, :-2])
    excess = np.zeros((len(g), g.shape[1] - 1))
    excess[:, 1:] = np.where(kept, _dips(np.abs(g)), 0.0)
    return excess


def _dips(size: np.ndarray) -> np.ndarray:
    """Curvature at the minima of a magnitude in units of the minimum, for each three states."""
    before, middle, after = size[:, :-2], size[:, 1:-1], size[:, 2:]
    curvature = before - 2 * middle + after
    lowest = middle - (after - before) ** 2 / (8 * curvature)
    found = np.where(lowest > 0, curvature / lowest, np.inf)
    return np.where((middle > before) | (middle > after) | (curvature <= 0), 0.0, found)
