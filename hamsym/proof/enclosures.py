"""H, its vector field and its Hessian in ball arithmetic.

Input:  a Hamiltonian; its derivatives are those of :class:`~hamsym.symbolic.equations.Equations`,
        with floating-point numbers as the exact binary fractions that they are.
Output: functions of balls (``arb``) or of truncated Taylor series with ball coefficients
        (``arb_series``).

A result contains the value, or each Taylor coefficient, for every choice of numbers in the
arguments. Where the arguments contain a point at which a function is not smooth, there is no
result: :class:`~hamsym.proof.functions.SingularityError` names the subexpression.
"""

from __future__ import annotations

from collections.abc import Sequence

from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.functions import BALLS, Enclosed
from hamsym.proof.generated import GeneratedFunctions

__all__ = ["Enclosures"]


class Enclosures:
    """H, its vector field and its Hessian in ball arithmetic.

    Parameters
    ----------
    H : Hamiltonian
        With a value for every parameter.

    Raises
    ------
    CertificationError
        If H contains a function that is not smooth or has no enclosure.

    Examples
    --------
    >>> from flint import arb
    >>> H = Enclosures(Hamiltonian("p**2/2 + x**2/2 + x**4/4"))
    >>> rate = H.vector_field([arb(2), arb(1)], arb(0))
    >>> [entry.str(5) for entry in rate]
    ['1.0000', '-10.000']
    """

    def __init__(self, H: Hamiltonian) -> None:
        H.require_parameters()
        self.dim, self.time_dependent = H.dim, H.time is not None
        self._functions = GeneratedFunctions(H, BALLS)

    def energy(self, z: Sequence[Enclosed], t: Enclosed) -> Enclosed:
        """H at balls, or along series, of the components of z and of t."""
        return self._functions("energy", z, t)

    def vector_field(self, z: Sequence[Enclosed], t: Enclosed) -> list[Enclosed]:
        """J grad H, dim entries."""
        return list(self._functions("vector_field", z, t))

    def hessian(self, z: Sequence[Enclosed], t: Enclosed) -> dict[tuple[int, int], Enclosed]:
        """The entries (i, j), i <= j, of the second derivatives that do not vanish."""
        return dict(self._functions("hessian", z, t))
