"""Discontinuities of H or of its gradient along a trajectory.

The linear equation of the error does not hold across a jump of the force, for example that of
abs(x). Where H itself jumps, as sign(x) does, the force contains a pulse that the derivative of H
lacks. The error estimate is therefore valid up to the first discontinuity only.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.hamiltonian import Hamiltonian
from hamsym.solution.times import shown_time
from hamsym.symbolic import derivatives
from hamsym.symbolic.equations import Equations

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

_RESOLVED = 1e-2  # residual, relative to the largest rate of the component
_MOST_PLACES = 20  # places of a trained network that are searched for a jump
_SAMPLES = 400  # of the rates between two suspect times
_STEEP = 0.05  # change between samples of a resolved force at most, relative to all of them
_BISECTIONS = 24


def first_jump(
    solution: Solution, times: np.ndarray, suspects: Sequence[tuple[float, float]]
) -> str | None:
    """Describe the first discontinuity of H or grad H along a trajectory.

    - times: Times at which the arguments of abs, sign, Min and Max are evaluated; a jump lies where
      one of them changes its sign.
    - suspects: Intervals in which the residual is large relative to the rates. The rates are
      sampled there, to find the jump of sqrt((x - 1)**2), and steps that are too steep for the
      tolerance.
    - returns: The kind of the discontinuity, its time and the remedy, for a message.
    """
    # Both searches find a jump of abs, sign, Min or Max; the first is more accurate.
    found = list(_symbolic_jumps(solution, times)) or list(_hidden_jumps(solution, suspects))
    if not found:
        return None
    remedy = "solve up to this time, and again from it"
    if solution.H.time is not None:
        remedy += ", or give the times at which t switches H as breakpoints"
    first = _first(found, times[0], times[-1])
    return f"{first}, beyond which the error cannot be estimated; {remedy}"


def parameter_jump(solution: Solution, names: Sequence[str]) -> str | None:
    """Describe why the derivatives of a trajectory in parameters do not follow from its equations.

    A derivative of the force in a parameter does not exist, as that of abs(k) at k = 0, or the
    force jumps along the trajectory: a change of the parameter changes the time of the jump, or the
    state at it.

    - returns: The reason and the remedy, for a message.
    """
    times = solution.scan_times
    for name in names:
        for formula, switch in _corners(solution.H, name):
            z = solution(times)
            zero = switch.argument(z, times)[..., 0] == 0
            lasting = np.flatnonzero(zero[1:] & zero[:-1])
            if len(lasting) and not (switch.jumps(z[lasting], times[lasting]) == 0).all():
                value = solution.H.parameters[name]
                return (
                    f"the force has no derivative in '{name}' at {name} = {value:.6g}, where "
                    f"{formula} = 0 inside abs, sign, min or max; give another value"
                )
    found = list(_symbolic_jumps(solution, times, tuple(names)))
    if not found:
        return None
    return (
        f"{_first(found, *solution.span)}, beyond which derivatives in parameters are not "
        "computed; solve up to this time"
    )


def _first(found: Sequence[tuple[float, str]], start: float, end: float) -> str:
    """Describe the first of some jumps on the way from a start to an end."""
    time, kind = min(found, key=lambda entry: math.copysign(1.0, end - start) * entry[0])
    return f"{kind} at t = {shown_time(time, start, end)}"


def unresolved(solution: Solution) -> list[tuple[float, float]]:
    """Intervals in which the residual of a solution is large relative to the rates.

    At most 20, those with the largest residual: near a jump, a smooth trial solution has a large
    residual.
    """
    times = solution.scan_times
    z, dz = solution.evaluate(times)
    rates = solution.H.compile("numpy").at("vector_field", z, times)
    with np.errstate(all="ignore"):
        ratios = (np.abs(dz - rates) / np.abs(rates).max(axis=0))[:-1].max(axis=1)
    ratios = np.where(np.isnan(ratios), np.inf, ratios)
    places = np.argsort(ratios)[-_MOST_PLACES:]
    places = np.sort(places[ratios[places] > _RESOLVED])
    return list(zip(times[np.maximum(places - 1, 0)], times[places + 1], strict=True))


def _symbolic_jumps(
    solution: Solution, times: np.ndarray, parameters: tuple[str, ...] = ()
) -> Iterator[tuple[float, str]]:
    """The first crossing of each switch of H in the state or the parameters, with its kind."""
    H = solution.H
    switches = _switches(H, parameters)
    if not switches:
        return
    system = H.compile("numpy")
    z = solution(times)
    with np.errstate(all="ignore"):
        # A jump is compared with the largest rate of the same component.
        # The rates are the slopes with their halves exchanged, up to signs.
        rates = np.abs(system.at("vector_field", z, times)).max(axis=0)
        sizes = np.roll(rates, H.dof)
        sizes = np.append(sizes, np.abs(system.at("energy", z, times)).max())
        for switch in switches:
            values = switch.argument(z, times)[..., 0]
            signed = np.flatnonzero(values)
            for before, after in itertools.pairwise(signed):
                if not values[before] * values[after] < 0:
                    continue
                at = scipy.optimize.brentq(
                    lambda t, switch=switch: float(switch.argument(solution(t), t)[0]),
                    *times[[before, after]],
                    xtol=1e-12 * abs(times[after] - times[before]) + 1e-300,
                )
                # A jump of H counts for H of any size: the zero of H is arbitrary.
                allowed = np.append(1e-6 * sizes[:-1], 1e-14 * sizes[-1])
                small = np.abs(switch.jumps(solution(at), at)) <= allowed
                if not small.all():
                    yield at, "the force jumps" if small[-1] else "H jumps"
                    break


def has_switches(H: Hamiltonian) -> bool:
    """Return whether H or a force has functions at which it or its derivative may jump."""
    return bool(_switches(H))


def has_time_switches(H: Hamiltonian) -> bool:
    """Return whether functions of the time alone switch H."""
    if H.time is None:
        return False
    equations = H.real_equations
    return bool(
        derivatives.switch_arguments(
            sympy.Tuple(*equations.formulas), {equations.time}, {*equations.z}
        )
    )


class _Switch(NamedTuple):
    """A function of (z, t) at whose zeros the gradient or H may jump."""

    #: Shapes (..., dim), (...) -> (..., 1); for H = p**2/2 + abs(x) it is x.
    argument: Callable[..., np.ndarray]
    #: Jumps of the gradient, then of H, at a zero: (..., dim), (...) -> (..., dim + 1).
    jumps: Callable[..., np.ndarray]


@functools.lru_cache(maxsize=64)
def _switches(H: Hamiltonian, parameters: tuple[str, ...] = ()) -> tuple[_Switch, ...]:
    equations = H.real_equations
    variables = [*equations.z, *(equations.parameters[name][0] for name in parameters)]
    found = []
    for argument, jumps in equations.switches(variables):
        if not argument.free_symbols & set(equations.z):
            jumps[-1] = sympy.Integer(0)  # H jumps everywhere at once, without a force
        found.append(_switch(argument, jumps, equations))
    return tuple(found)


@functools.lru_cache(maxsize=64)
def _corners(H: Hamiltonian, parameter: str) -> tuple[tuple[sympy.Expr, _Switch], ...]:
    """Switches in a parameter, of the gradient and of its derivative in the parameter."""
    equations = H.real_equations
    forces = [*equations.slopes_in(parameter), *equations.slopes]
    symbols = [equations.parameters[parameter][0]]
    return tuple(
        (argument, _switch(argument, jumps, equations))
        for argument, jumps in derivatives.switches(sympy.Integer(0), forces, symbols)
    )


def _switch(argument: sympy.Expr, jumps: Sequence[sympy.Expr], equations: Equations) -> _Switch:
    return _Switch(
        compile_expressions([argument], equations), compile_expressions(jumps, equations)
    )


def _hidden_jumps(
    solution: Solution, suspects: Sequence[tuple[float, float]]
) -> Iterator[tuple[float, str]]:
    """Find the first jump of the sampled rates."""
    system = solution.H.compile("numpy")

    def rates(t: Any) -> np.ndarray:
        return system.at("vector_field", solution(t), t)

    with np.errstate(all="ignore"):
        for start, end in suspects:
            # Inside: at a joint of windows the equations may change.
            t = np.linspace(start, end, _SAMPLES + 2)[1:-1]
            values = rates(t)
            for component in range(values.shape[1]):
                at = _steepest(rates, t, values, component)
                if at is not None:
                    yield at, "the force jumps, or is too steep for this accuracy,"
                    return


def _steepest(
    function: Callable[[float], np.ndarray], t: np.ndarray, samples: np.ndarray, component: int
) -> float | None:
    """Locate the largest change of a component between samples; None if it is resolved."""
    values = samples[:, component]
    spread = np.abs(values - values.mean()).max()
    changes = np.abs(np.diff(values))
    place = int(np.argmax(np.nan_to_num(changes, nan=np.inf)))
    if changes[place] <= _STEEP * spread:
        return None
    low, high = float(t[place]), float(t[place + 1])
    at_low, at_high = float(values[place]), float(values[place + 1])
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        at_middle = float(function(middle)[component])
        if abs(at_middle - at_low) <= abs(at_high - at_middle):
            low, at_low = middle, at_middle
        else:
            high, at_high = middle, at_middle
    return (low + high) / 2
