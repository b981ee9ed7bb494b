"""Hamilton's equations in real symbols, derived once for all users."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import sympy

from hamsym.symbolic import derivatives
from hamsym.symbolic.checks import real_symbols
from hamsym.symbolic.exact import ExactDerivatives

__all__ = ["Equations"]


class Equations:
    """H with its gradient and Hessian, in real symbols.

    For symbols that are not declared real, sympy differentiates abs(x) into derivatives of re(x)
    and im(x). Code generation, proofs and the search for discontinuities use these derivatives.

    Attributes
    ----------
    expr : sympy.Expr
        H.
    z : tuple of sympy.Symbol
        The state, coordinates first.
    time : sympy.Symbol or None
    dof : int
        Degrees of freedom.
    parameters : dict of name to (sympy.Symbol, float or None)
        Parameters with their values, None for a parameter without a value.
    back : dict of sympy.Symbol to sympy.Symbol
        The caller's symbols, by the real symbols that replace them.
    """

    def __init__(
        self,
        expr: sympy.Expr,
        z: Sequence[sympy.Symbol],
        time: sympy.Symbol | None,
        parameters: Mapping[str, float | None],
    ) -> None:
        forward = real_symbols({*expr.free_symbols, *z})
        self.expr: sympy.Expr = expr.xreplace(forward) if forward else expr
        self.z = tuple(forward.get(symbol, symbol) for symbol in z)
        self.time = None if time is None else forward.get(time, time)
        self.dof = len(z) // 2
        self.parameters = {
            name: (sympy.Symbol(name, real=True), value) for name, value in parameters.items()
        }
        self.back = {real: own for own, real in forward.items()}
        self._effort = derivatives.Effort(self.expr)
        self._identity = (
            self.expr,
            self.z,
            self.time,
            tuple(self.parameters.values()),
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Equations):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: value for name, (_, value) in self.parameters.items()}
        return Equations, (self.expr, self.z, self.time, values)

    @cached_property
    def gradient(self) -> list[sympy.Expr]:
        return [self.exact.rounded(entry) for entry in self.exact.gradient]

    @cached_property
    def hessian(self) -> dict[tuple[int, int], sympy.Expr]:
        entries = {index: self.exact.rounded(entry) for index, entry in self.exact.hessian.items()}
        return {index: entry for index, entry in entries.items() if entry != 0}

    @cached_property
    def exact(self) -> ExactDerivatives:
        """H, gradient and Hessian with a symbol for each floating-point number."""
        return ExactDerivatives(self.expr, self.z, self._effort)

    @cached_property
    def vector_field(self) -> list[sympy.Expr]:
        return [*self.gradient[self.dof :], *(-slope for slope in self.gradient[: self.dof])]

    def gradient_in(self, parameter: str) -> list[sympy.Expr]:
        """Derivative of the gradient with respect to a parameter, in the order of z.

        Delta distributions, at steps of functions of the parameter, are left out.

        Examples
        --------
        >>> x, p, k = sympy.symbols("x p k", real=True)
        >>> Equations(p**2/2 + k*x**2/2, [x, p], None, {"k": 3.0}).gradient_in("k")
        [x, 0]
        """
        symbol, effort = self.parameters[parameter][0], derivatives.Effort(self.expr)
        slope = derivatives.gradient(self.exact.expr, (symbol,), effort)[0]
        mixed = derivatives.gradient(slope, self.z, effort)
        return [
            self.exact.rounded(entry).replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
            for entry in mixed
        ]

    @cached_property
    def narrow_arguments(self) -> list[tuple[sympy.Expr, derivatives.Narrow]]:
        """Arguments of functions in H that may act briefly, with the values of the parameters."""
        given = {symbol: value for symbol, value in self.parameters.values() if value is not None}
        variables = [*self.z, *([] if self.time is None else [self.time])]
        return derivatives.narrow_arguments(self.expr.xreplace(given), variables)

    @cached_property
    def is_separable(self) -> bool:
        """Whether all mixed second derivatives vanish identically."""
        q, p = set(self.z[: self.dof]), set(self.z[self.dof :])
        terms = sympy.Add.make_args(self.expr)
        coupled = [term for term in terms if term.free_symbols & q and term.free_symbols & p]
        slopes = derivatives.gradient(sympy.Add(*coupled), self.z[: self.dof], self._effort)
        mixed = [derivatives.gradient(s, self.z[self.dof :], self._effort) for s in slopes]
        return all(derivatives.vanishes(entry) for row in mixed for entry in row)
