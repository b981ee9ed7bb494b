"""Energy, gradient and Hessian of H at balls, component by component.

Input:  a Hamiltonian with a value for every parameter; balls of the state.
Output: :class:`DerivativeBalls`. Where a term may not be smooth in the balls, the components that
        contain it are NaN, and the others are not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from flint import arb, fmpq

from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic import functions
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions

#: Balls of numbers (``arb``).
Balls = list[Any]

_ROUND_OFF = fmpq(1, 2**52)
_OF_POSITIVE = (
    functions.root,
    functions.reciprocal_root,
    functions.logarithm,
    functions.general_power,
)
_OF_UNIT_INTERVAL = (functions.arcsine, functions.arccosine, functions.inverse_hyperbolic_tangent)


class _OutsideError(Exception):
    """A function of real numbers has no value anywhere in the balls."""


def _or_nan(function: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except (SingularityError, ZeroDivisionError, ValueError):
        if _is_outside(function, arguments[0]):
            raise _OutsideError from None
        return arb.nan()


def _is_outside(function: Callable[..., Any], x: Any) -> bool:
    """Whether a ball is outside the domain of a function."""
    if function in _OF_POSITIVE:
        return bool(x < 0)
    if function in _OF_UNIT_INTERVAL:
        return bool(abs(x) > 1)
    return function is functions.inverse_hyperbolic_cosine and bool(x < 1)


class _Rounded(Arithmetic):
    """Balls in which each number that is not whole is known to round-off only."""

    @staticmethod
    def number(numerator: int, denominator: int = 1) -> arb:
        value = fmpq(numerator, denominator)
        if denominator == 1:
            return arb(value)
        size = arb(abs(value) * _ROUND_OFF)
        return arb(value) + (-size).union(size)


class DerivativeBalls:
    """Energy, gradient and Hessian of H at balls; NaN where they are not smooth.

    NaN in a result means that some term of it may not be smooth in the balls. Every operation on
    NaN gives NaN, so that a finite result proves that all of its terms are smooth there.

    Raise CertificationError if H contains a function that is not smooth or has no enclosure, or
    arithmetic does not round as IEEE 754 has it.

    - H: Without explicit time.
    - rounded: Take all numbers of H that are not whole as balls of relative radius 2**-52: results
      hold for every H that rounds to this one.

    Examples
    --------
    >>> balls = DerivativeBalls(Hamiltonian("p**2/2 - 1/x"))
    >>> [entry.str(3) for entry in balls.gradient([arb(0, 1), arb(2)])]
    ['nan', '2.00']
    """

    def __init__(self, H: Hamiltonian, rounded: bool = False) -> None:
        require_float64()  # of conversions, between balls and numbers
        H.require_parameters()
        self.dim, self._half = H.dim, H.dof
        self._functions = GeneratedFunctions(H, (_Rounded if rounded else Arithmetic)(_or_nan))

    def energy(self, z: Sequence[Any]) -> Any:
        """H at dim balls."""
        try:
            return self._functions("energy", z, arb(0))
        except _OutsideError:
            return arb.nan()

    def gradient(self, z: Sequence[Any]) -> Balls:
        """The dim components at dim balls."""
        return self.gradient_inside(z) or [arb.nan()] * self.dim

    def gradient_inside(self, z: Sequence[Any]) -> Balls | None:
        """The same; None if it has no value anywhere in the balls, as a root below zero."""
        try:
            rates = self._functions("vector_field", z, arb(0))
        except _OutsideError:
            return None
        return [-rate for rate in rates[self._half :]] + list(rates[: self._half])

    def hessian(self, z: Sequence[Any]) -> list[Balls]:
        """The dim rows at dim balls."""
        try:
            entries = self._functions("hessian", z, arb(0))
        except _OutsideError:
            return [[arb.nan()] * self.dim for _ in range(self.dim)]
        rows = [[arb(0)] * self.dim for _ in range(self.dim)]
        for (i, j), entry in entries.items():
            rows[i][j] = rows[j][i] = arb(entry)
        return rows
