"""Equilibria of a Hamiltonian: in closed form, by Newton's method, all of them in a box.

Input:  a Hamiltonian; guesses, or a box.
Output: :class:`~hamsym.dynamics.equilibrium.Equilibria`.

Closed forms come from :mod:`hamsym.symbolic.stationary_points`, approximate points from
:mod:`hamsym.dynamics.newton_starts`, complete sets from :mod:`hamsym.dynamics.equilibria_in_box`.
Each equilibrium is proven and classified by :mod:`hamsym.dynamics.equilibrium_points`.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from hamsym.dynamics.equilibria_in_box import all_in_box
from hamsym.dynamics.equilibrium import Equilibria, Equilibrium
from hamsym.dynamics.equilibrium_points import Finder, add_points, counted, is_known, ordered
from hamsym.dynamics.newton_starts import converged_points, default_starts
from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.formula.parser import canonical_name
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.numerics.scales import equilibrium_sizes
from hamsym.proof.limits import Deadline
from hamsym.support.suggestions import checked_keywords, did_you_mean
from hamsym.support.validation import require_positive, require_whole
from hamsym.symbolic.checks import name_of
from hamsym.symbolic.stationary_points import periods, stationary_points

_DIGITS = 60  # of closed forms

_Values = list[sympy.Expr]  # of the components; those that are free have their symbols


@checked_keywords
def equilibria(
    H: HamiltonianLike,
    guess: Any = None,
    box: Mapping[Any, tuple[float, float]] | Sequence[tuple[float, float]] | None = None,
    *,
    max_boxes: int = 100_000,
    time_limit: float | None = None,
) -> Equilibria:
    """Find equilibria, grad H = 0, and their linear stability.

    Without ``guess`` and ``box``: closed forms where sympy finds them with limited effort, and
    Newton's method from fixed starts at several scales around the origin. There may be further
    equilibria. With ``box``: all of them in it, by interval subdivision.

    Every equilibrium with a regular Hessian is proven to exist (Krawczyk's test in ball
    arithmetic) and has an ``enclosure``. Its type holds for all Hamiltonians whose numbers round to
    those of H, else it is ``"degenerate"``.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        Without explicit time. Parameters without a value are allowed where sympy finds a closed
        form.
    guess : state or array of states, optional
        Starts of Newton's method, shape (..., dim), or numbers and lists by name. A pair
        (low, high) is an interval, of ``box``.
    box : mapping of name to (low, high), or sequence of (low, high), optional
        An interval for each component of z, in its units.
    max_boxes : int
        Number of boxes after which the rest of the box remains undecided, as it also does after
        1,000 zeros, of which there may be infinitely many.
    time_limit : float, optional
        Seconds after which the rest of the box remains undecided.

    Returns
    -------
    Equilibria
        A sequence of :class:`~hamsym.dynamics.equilibrium.Equilibrium`, with ``complete``,
        ``message`` and ``undecided``. A continuum of equilibria is represented by one point, with
        a ``family`` that describes it.

    Raises
    ------
    InputError
        If H depends on time, or an argument cannot be used.
    ParameterError
        If a parameter has no value and no closed form is found.
    CertificationError
        With ``box``, if H contains a function that has no enclosure.

    Notes
    -----
    A. Neumaier, Interval Methods for Systems of Equations, Cambridge 1990; E. Hansen & G. W.
    Walster, Global Optimization Using Interval Analysis, 2nd ed., Dekker 2004. Krein signatures:
    J. E. Howard & R. S. MacKay, J. Math. Phys. 28 (1987) 1036.

    Examples
    --------
    >>> found = equilibria("p**2/2 - x**2/2 + x**4/4", box={"x": (-2, 2), "p": (-1, 1)})
    >>> print(found)
    all 3 equilibria in the box, proven
    <BLANKLINE>
       type     x  p  energy  linearly stable
    1  centre  -1  0   -0.25              yes
       frequencies 1.4142136 (+)
    2  centre   1  0   -0.25              yes
       frequencies 1.4142136 (+)
    3  saddle   0  0       0               no
       exponents +-1
    """
    H = Hamiltonian.of(H, bound=False)
    if H.time is not None:
        raise InputError(
            f"H depends on the time {H.time}, so that it has no equilibria; give an H without it"
        )
    if H.forces:
        raise InputError(
            "equilibria are found as zeros of the gradient of H, which they are not with forces; "
            "give H without forces, or with those of q as a part of H"
        )
    if isinstance(guess, Mapping):
        for name, value in guess.items():
            if isinstance(value, tuple) and len(value) == 2:
                raise InputError(
                    f"the value {value!r} of {name} in guess is a pair; give box={{'{name}': "
                    f"{value!r}, ...}} for all equilibria in a box, or {list(value)!r} for two "
                    "guesses"
                )
    if guess is not None and box is not None:
        raise InputError("guess and box are given together; give one of them")
    require_whole("max_boxes", max_boxes)
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    began = time.perf_counter()
    if box is not None:
        H.require_parameters()
        low, high = _checked_box(H, box)
        result = all_in_box(H, low, high, max_boxes, Deadline.after(time_limit))
    elif guess is not None:
        H.require_parameters()
        result = _from_guesses(H, np.atleast_2d(H.states_from(guess)).reshape(-1, H.dim))
    else:
        result = _by_default(H)
    return dataclasses.replace(result, seconds=time.perf_counter() - began)


def _checked_box(H: Hamiltonian, box: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends of a box, in the order of z."""
    if isinstance(box, Mapping):
        known = {canonical_name(name): name for name in H.names}
        given = {}
        for key, ends in box.items():
            name = known.get(canonical_name(name_of(key)))
            if name is None:
                raise VariableError(
                    f"'{name_of(key)}' in box is not a component of z"
                    f"{did_you_mean(name_of(key), H.names)}; give {', '.join(H.names)}"
                )
            given[name] = ends
        missing = [name for name in H.names if name not in given]
        if missing:
            raise VariableError(
                f"box has no interval for {', '.join(missing)}; give (low, high) for each of "
                f"{', '.join(H.names)}"
            )
        intervals = [given[name] for name in H.names]
    else:
        try:
            intervals = list(box)
        except TypeError:
            intervals = []
        if len(intervals) != H.dim:
            raise InputError(
                f"box must have an interval (low, high) for each of {', '.join(H.names)}"
            )
    corners = []
    for name, ends in zip(H.names, intervals, strict=True):
        try:
            a, b = (float(end) for end in ends)
        except (TypeError, ValueError, OverflowError):
            a = b = math.nan
        if not (math.isfinite(a) and math.isfinite(b) and a < b):
            raise InputError(
                f"the interval {ends!r} of {name} cannot be used; give (low, high) with low < high"
            )
        corners.append((a, b))
    low, high = np.array(corners).T
    return low, high


def _by_default(H: Hamiltonian) -> Equilibria:
    form = H.real_equations
    closed = stationary_points(form)
    solutions = [[each.get(symbol, symbol) for symbol in form.z] for each in closed or ()]
    if H.unbound_parameters:
        if closed is None:
            listed = ", ".join(H.unbound_parameters)
            raise ParameterError(
                f"no closed form was found with {listed} as symbols; give values, by "
                "H.with_parameters or --param NAME=VALUE at the command line"
            )
        return _symbolic_only(H, solutions)
    turns = {i: float(period) for i, period in periods(form).items()}
    finder = Finder(H)
    found: list[Equilibrium] = []
    for values in solutions:
        each = _at_solution(finder, values)
        if each is not None and not is_known(each, found, finder, turns):
            found.append(each)
    starts = default_starts(H.dim)
    for i, turn in turns.items():
        starts[1:, i] = np.random.default_rng(i).uniform(-turn / 2, turn / 2, len(starts) - 1)
    add_points(found, finder, converged_points(finder.candidates, starts), turns)
    count = counted(found) if found else "no equilibria found"
    message = f"{count}; there may be others: give box="
    if turns:
        each_period = ", ".join(f"{period} in {H.names[i]}" for i, period in periods(form).items())
        message += f"; all repeat with the period {each_period}"
    return Equilibria(H, ordered(found), False, message)


def _symbolic_only(H: Hamiltonian, solutions: Sequence[_Values]) -> Equilibria:
    """Closed forms with symbols of parameters: neither values nor stability."""
    nothing = np.full(H.dim, np.nan)
    found = [
        Equilibrium(H.names, nothing, math.nan, "symbolic", **_closed_form(H, values))
        for values in solutions
    ]
    missing = ", ".join(H.unbound_parameters)
    message = (
        f"{counted(found)}, real where the expressions are; {missing} without a value, so that "
        "their stability is not known"
    )
    return Equilibria(H, tuple(found), False, message)


def _closed_form(H: Hamiltonian, values: _Values) -> dict[str, Any]:
    """What an :class:`Equilibrium` tells of it: a column in the caller's symbols, and a family."""
    form = H.real_equations
    known = {"exact": sympy.ImmutableDenseMatrix([v.xreplace(form.back) for v in values])}
    names = dict(zip(form.z, H.names, strict=True))
    free = [symbol for symbol in form.z if any(value.has(symbol) for value in values)]
    if not free:
        return known
    others = [
        f"{names[symbol]} = {value}"
        for symbol, value in zip(form.z, values, strict=True)
        if symbol != value and value.has(*free)
    ]
    text = f"any {', '.join(names[symbol] for symbol in free)}"
    return {**known, "family": f"{text}, with {', '.join(others)}" if others else text}


def _at_solution(finder: Finder, values: _Values) -> Equilibrium | None:
    """The equilibrium at a closed form; of a continuum, at one point of it."""
    free = sorted({s for value in values for s in value.free_symbols}, key=str)
    for sample in (0, 1, sympy.Rational(1, 2), -1, sympy.Rational(-1, 2), 2):
        numbers = [
            complex(value.subs(dict.fromkeys(free, sample)).evalf(_DIGITS)) for value in values
        ]
        if all(math.isfinite(abs(x)) and not abs(x.imag) > 1e-15 * abs(x) for x in numbers):
            break
        if not free:
            return None
    else:
        return None
    z = np.array([x.real for x in numbers]) + 0.0
    return finder.point(z, **_closed_form(finder.H, values))


def _from_guesses(H: Hamiltonian, starts: np.ndarray) -> Equilibria:
    sizes = np.abs(starts).max(axis=0)
    natural = equilibrium_sizes(H.compile("numpy").at("hessian", starts[0]), sizes)
    finder = Finder(H, np.where(sizes > 0, sizes, natural))
    found: list[Equilibrium] = []
    failed = 0
    for start in starts:
        points = converged_points(finder.candidates, start[None])
        failed += not add_points(found, finder, points, {})
    message = f"{counted(found)} from {len(starts):,} guess{'es' if len(starts) > 1 else ''}"
    if failed:
        message += f"; Newton's method did not converge from {failed:,} of them"
    return Equilibria(H, ordered(found), False, message)
