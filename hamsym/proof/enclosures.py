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

import sympy

from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.formulas import Formulas, require_smooth
from hamsym.proof.functions import Enclosed

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
        equations = H.real_equations
        require_smooth(equations.expr)  # a kink of H may be absent from its derivatives
        values = {s: value for s, value in equations.parameters.values() if value is not None}

        def exact(expr: sympy.Expr) -> sympy.Expr:
            return equations.exact.with_fractions(expr, values)

        variables = (*equations.z, equations.time or sympy.Dummy("t"))
        slopes = [exact(entry) for entry in equations.exact.gradient]
        rates = [*slopes[H.dof :], *(-slope for slope in slopes[: H.dof])]
        entries = {
            index: exact(entry)
            for index, entry in equations.exact.hessian.items()
            if index[0] <= index[1]
        }
        self.dim, self.time_dependent = H.dim, H.time is not None
        self._energy = Formulas([exact(equations.exact.expr)], variables, values)
        self._vector_field = Formulas(rates, variables, values)
        self._indices = [index for index, entry in entries.items() if entry != 0]
        self._hessian = Formulas([entries[index] for index in self._indices], variables, values)

    def energy(self, z: Sequence[Enclosed], t: Enclosed) -> Enclosed:
        """H at balls, or along series, of the components of z and of t."""
        return self._energy([*z, t])[0]

    def vector_field(self, z: Sequence[Enclosed], t: Enclosed) -> list[Enclosed]:
        """J grad H, dim entries."""
        return self._vector_field([*z, t])

    def hessian(self, z: Sequence[Enclosed], t: Enclosed) -> dict[tuple[int, int], Enclosed]:
        """The entries (i, j), i <= j, of the second derivatives that do not vanish."""
        return dict(zip(self._indices, self._hessian([*z, t]), strict=True))
