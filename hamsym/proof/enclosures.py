"""H, its vector field and its derivatives in ball arithmetic.

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
        self.dim, self.conserved = H.dim, H.conserves_energy
        self._forced = bool(H.forces)
        self._functions = GeneratedFunctions(H, BALLS)

    def energy(self, z: Sequence[Enclosed], t: Enclosed) -> Enclosed:
        """H at balls, or along series, of the components of z and of t."""
        return self._functions("energy", z, t)

    def vector_field(self, z: Sequence[Enclosed], t: Enclosed) -> list[Enclosed]:
        """J grad H with the forces, dim entries."""
        return list(self._functions("vector_field", z, t))

    def gradient(self, z: Sequence[Enclosed], t: Enclosed) -> list[Enclosed]:
        """Derivatives of H, up to their signs, dim entries."""
        if self._forced:
            return list(self._functions("gradient", z, t))
        # J grad H has the slopes in p first, then minus those in q.
        rates = self.vector_field(z, t)
        return rates[self.dim // 2 :] + rates[: self.dim // 2]

    def hessian(self, z: Sequence[Enclosed], t: Enclosed) -> dict[tuple[int, int], Enclosed]:
        """The entries (i, j), i <= j, of the second derivatives that do not vanish."""
        return dict(self._functions("hessian", z, t))

    def jacobian(self, z: Sequence[Enclosed], t: Enclosed) -> dict[tuple[int, int], Enclosed]:
        """The derivatives (i, j) of the vector field that do not vanish."""
        if self._forced:
            return dict(self._functions("jacobian", z, t))
        found, half = {}, self.dim // 2
        for (i, j), entry in self.hessian(z, t).items():
            for row, column in {(i, j), (j, i)}:
                # J grad H: the rates of q are the slopes in p, those of p are minus those in q.
                target = row - half if row >= half else row + half
                found[target, column] = entry if row >= half else -entry
        return found
