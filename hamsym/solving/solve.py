"""Solution of initial-value problems by one of several methods."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import CertificationError, InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.problems.conservation import InvariantLike, KnownInvariants
from hamsym.problems.problem import InitialValueProblem
from hamsym.solution.acceptance import judged_by_invariants
from hamsym.solution.solution import Solution
from hamsym.solving.methods import method_of, option_message
from hamsym.support.method_object import Method
from hamsym.support.suggestions import checked_keywords

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState


def _answer(name: str, arguments: Any, keywords: Mapping[str, Any]) -> str | None:
    """Return the sentence about a keyword that solve does not have; None for the usual one."""
    H = arguments[0] if arguments else keywords.get("H")
    if isinstance(H, Hamiltonian) and name in H.parameter_names:
        return f"'{name}' is a parameter; use H.with_parameters({name}=...)"
    known = inspect.signature(solve).parameters
    return option_message(name, keywords[name], keywords.get("method"), known)


def solve(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    *,
    tol: float | None = None,
    atol: float | Sequence[float] = 0.0,
    method: str | Method = "features",
    breakpoints: Sequence[float] = (),
    seed: int = 0,
    prove: bool = False,
    invariants: InvariantLike | Sequence[InvariantLike] = (),
    progress: bool | Callable[[TrainingState], None] | None = None,
) -> Solution:
    """Compute a neural trajectory z^(t) that satisfies Hamilton's equations over a time span.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        With a value for every parameter.
    z0 : sequence or mapping
        Initial state, in the order of H.z or by name.
    span : (float, float)
        Start and end time; the end may be the earlier one.
    tol : float, optional
        Tolerance: |z^_i(t) - z_i(t)| <= atol_i + tol s_i for every component and all t, with s_i
        the largest |z^_i|, or 1e-8 of the size that the terms of its own equation give it
        (:mod:`hamsym.numerics.scales`). By default 1e-9, and 1e-2 for networks that are trained
        jointly. If it is given, their training stops when it is met.
    atol : float or sequence
        Absolute tolerance, in the units of the components.
    method : str or a method
        :class:`~hamsym.Features`, :class:`~hamsym.NetworkChain`,
        :class:`~hamsym.LevenbergMarquardt`, :class:`~hamsym.SSBroyden`, :class:`~hamsym.LBFGS` or
        :class:`~hamsym.Adam` with its options; or its name, "features", "network-chain",
        "levenberg-marquardt", "ssbroyden", "lbfgs" or "adam", for its defaults.
    breakpoints : sequence of float
        Times at which a window must end, e.g. jumps of a force; for methods with windows.
    seed : int
        Seed of all random numbers: same seed, same machine, same result.
    prove : bool
        Prove that the error of each component is within the tolerance
        (:meth:`hamsym.Solution.certify`); ``solution.certificate`` is the proof.
    invariants : sequence of str, sympy.Expr or Invariant
        Functions that H conserves, which is checked first. ``success`` then needs that each changes
        by no more than the allowed errors of the components explain, to second order.
    progress : bool or callable, optional
        Draw progress on standard error; by default if that is a terminal. Methods that train call
        a callable with a :class:`~hamsym.networks.record.TrainingState` instead.

    Returns
    -------
    Solution
        ``success`` is true if the estimated error, round-off included, is within the tolerance,
        whatever the method, and the trajectory crosses no discontinuity of H or its gradient. A
        march or a chain that had to stop spans the time up to there.

    Raises
    ------
    InputError
        If an option, a name, the state or the span is invalid.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> solution = solve(H, [1.0, 0.0], (0, 100), tol=1e-9)
    >>> solution.success, bool(abs(solution(100.0)[0] - np.cos(100.0)) < 1e-9)
    (True, True)
    >>> solve(H, [1.0, 0.0], (0, 1), method=hamsym.Adam(epochs=400, points=20))(0.0)
    array([1., 0.])
    """
    chosen = method_of(method)
    problem = problem_of(
        *(H, z0, span, chosen, seed, tol, prove, invariants),
        atol=atol,
        breakpoints=breakpoints,
        progress=progress,
    )
    solution: Solution = chosen.solve(problem)
    known = problem.invariants
    if known:
        solution = judged_by_invariants(solution, known)
    return proven(solution) if prove else solution


def problem_of(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    method: Method,
    seed: int,
    tol: float | None = None,
    prove: bool = False,
    invariants: InvariantLike | Sequence[InvariantLike] = (),
    **further: Any,
) -> InitialValueProblem:
    """Return the problem that a method solves in a call of :func:`solve`.

    Raise InputError if an argument is invalid.
    """
    if not isinstance(prove, bool):
        raise InputError(f"prove={prove!r} is not a choice; give True or False")
    H = Hamiltonian.of(H)
    return InitialValueProblem.checked(
        H,
        z0,
        span,
        seed,
        tol=method.usual_tol if tol is None else tol,
        finite=not method.marches,  # a march finds that at its start
        tol_given=tol is not None,
        prove=prove,
        invariants=KnownInvariants(H, invariants),
        **further,
    )


solve = checked_keywords(solve, answer=_answer)


def proven(solution: Solution) -> Solution:
    """Return the solution with a proof that its errors are within the tolerance.

    Without a proof ``success`` is false and the message gives the reason. A solution that did not
    succeed is returned as it is.
    """
    if not solution.success:
        return solution
    allowed = solution.allowed_error.tolist()
    try:
        certificate = hamsym.certify(solution, progress=False, bound=allowed)
    except CertificationError as error:
        return solution.judged(False, f"{solution.message}; not proven: {error}")
    bounds = certificate.component_bounds
    shares = [bound / most if most else bound for bound, most in zip(bounds, allowed, strict=True)]
    worst = shares.index(max(shares))
    name = solution.H.names[worst]
    proven = f"the error of {name} is at most {solution.H.quantity(name, bounds[worst], '.2g')}"
    message = f"{solution.message}; proven: {proven}"
    return replace(solution, message=message, certificate=certificate)
