"""Hamilton's equations, with forces or without, in real symbols, derived once for all users."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import sympy

from hamsym.formula.notation import Notation
from hamsym.support.shown import Shown
from hamsym.symbolic import derivatives
from hamsym.symbolic.checks import real_symbols
from hamsym.symbolic.exact import ExactDerivatives, rational


class Equations(Shown):
    """H with its gradient and Hessian, forces, and the derivatives of the rates, in real symbols.

    The equations are dz/dt = J grad H + (0, F), with no forces F by default. With the vector g =
    -J dz/dt, which is grad H without forces, they are dz/dt = J g, and small deviations obey
    d(delta)/dt = J (dg/dz) delta. Code that applies J needs g (``slopes``) and dg/dz
    (``curvature``) only. The latter is the Hessian, a symmetric matrix, if there are no forces.

    For symbols that are not declared real, sympy differentiates abs(x) into derivatives of re(x)
    and im(x). Code generation, proofs and the search for discontinuities use these derivatives.

    - expr: H.
    - z: The state, coordinates first.
    - dof: Degrees of freedom.
    - parameters: Parameters with their values, None for a parameter without a value.
    - forces: A force for each momentum; empty without forces.
    - back: The caller's symbols, by the real symbols that replace them.
    """

    def __init__(
        self,
        expr: sympy.Expr,
        z: Sequence[sympy.Symbol],
        time: sympy.Symbol | None,
        parameters: Mapping[str, float | None],
        forces: Sequence[sympy.Expr] = (),
    ) -> None:
        forward = real_symbols({*expr.free_symbols, *z, *free_symbols(forces)})
        self.expr: sympy.Expr = expr.xreplace(forward) if forward else expr
        self.z = tuple(forward.get(symbol, symbol) for symbol in z)
        self.time = None if time is None else forward.get(time, time)
        self.dof = len(z) // 2
        self.parameters = {
            name: (sympy.Symbol(name, real=True), value) for name, value in parameters.items()
        }
        self.forces = tuple(force.xreplace(forward) if forward else force for force in forces)
        self.back = {real: own for own, real in forward.items()}
        self._effort = self._new_effort()
        self._identity = (
            self.expr,
            self.z,
            self.time,
            tuple(self.parameters.values()),
            self.forces,
        )

    def __repr__(self) -> str:
        return f"Equations({str(self.expr)!r}, {self.z})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Equations):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: value for name, (_, value) in self.parameters.items()}
        return Equations, (self.expr, self.z, self.time, values, self.forces)

    def _repr_latex_(self) -> str:
        rates = zip(self.z, self.vector_field, strict=True)
        lines = [(rf"\dot{{{sympy.latex(symbol)}}}", rate) for symbol, rate in rates]
        return aligned([("H", self.expr), *lines], Notation())

    def with_values(self, values: Mapping[str, float | None]) -> Equations:
        """Return the same equations with other values of the parameters."""
        return Equations(self.expr, self.z, self.time, values, self.forces)

    @cached_property
    def free(self) -> Equations:
        """The same equations without values of the parameters: equal for all values."""
        return self.with_values(dict.fromkeys(self.parameters))

    def _new_effort(self) -> derivatives.Effort:
        return derivatives.Effort(
            sympy.Tuple(self.expr, *self.forces) if self.forces else self.expr
        )

    @cached_property
    def values(self) -> dict[sympy.Symbol, float]:
        """Values of the parameters that have one."""
        return {symbol: value for symbol, value in self.parameters.values() if value is not None}

    @cached_property
    def fractions(self) -> dict[sympy.Symbol, sympy.Rational]:
        """These values, exactly."""
        return {symbol: rational(value) for symbol, value in self.values.items()}

    @property
    def formulas(self) -> tuple[sympy.Expr, ...]:
        """H and the forces."""
        return (self.expr, *self.forces)

    def has(self, *kinds: Any) -> bool:
        """Whether H or a force contains one of some functions."""
        return any(formula.has(*kinds) for formula in self.formulas)

    @property
    def conserves_energy(self) -> bool:
        """Whether H is constant along trajectories: it does not depend on time, without forces."""
        return self.time is None and not self.forces

    @property
    def has_conserved_values(self) -> bool:
        """Whether values of H are constant along trajectories: no cut of an angle is in them."""
        return self.conserves_energy and not self.has_angle_cut

    @cached_property
    def gradient(self) -> list[sympy.Expr]:
        return [self.exact.rounded(entry) for entry in self.exact.gradient]

    @cached_property
    def hessian(self) -> dict[tuple[int, int], sympy.Expr]:
        return self._rounded(self.exact.hessian)

    def _rounded(self, exact: dict[tuple[int, int], sympy.Expr]) -> dict[Any, sympy.Expr]:
        entries = {index: self.exact.rounded(entry) for index, entry in exact.items()}
        return {index: entry for index, entry in entries.items() if entry != 0}

    @cached_property
    def exact(self) -> ExactDerivatives:
        """H, gradient and Hessian with a symbol for each floating-point number."""
        return ExactDerivatives(self.expr, self.z, self._effort, self.forces)

    @cached_property
    def vector_field(self) -> list[sympy.Expr]:
        """dz/dt, in the order of z."""
        return [*self.slopes[self.dof :], *(-slope for slope in self.slopes[: self.dof])]

    @cached_property
    def slopes(self) -> list[sympy.Expr]:
        """g = -J dz/dt: (dH/dq - F, dH/dp), the gradient without forces."""
        return [self.exact.rounded(entry) for entry in self.exact.slopes]

    @cached_property
    def curvature(self) -> dict[tuple[int, int], sympy.Expr]:
        """Nonzero derivatives of ``slopes`` by (i, j): the Hessian without forces."""
        return self._rounded(self.exact.curvature) if self.forces else self.hessian

    @cached_property
    def stored_curvature(self) -> dict[tuple[int, int], sympy.Expr]:
        """The entries of ``curvature`` that determine it: the upper triangle without forces."""
        if self.forces:
            return self.curvature
        return {(i, j): entry for (i, j), entry in self.hessian.items() if i <= j}

    @cached_property
    def jacobian(self) -> dict[tuple[int, int], sympy.Expr]:
        """Nonzero derivatives of the rates by the state, by (i, j)."""
        return derivatives.poisson_rows(self.curvature, self.dof)

    @cached_property
    def power(self) -> sympy.Expr:
        """dH/dt along trajectories: the power of the forces, and the explicit time derivative."""
        velocity = self.gradient[self.dof :]
        terms = [force * rate for force, rate in zip(self.forces, velocity, strict=False)]
        if self.time is not None:
            terms += derivatives.gradient(self.expr, (self.time,))
        return sympy.Add(*terms)

    def slopes_in(self, parameter: str) -> list[sympy.Expr]:
        """Derivative of ``slopes`` with respect to a parameter, in the order of z.

        Delta distributions, at steps of functions of the parameter, are left out.

        Examples
        --------
        >>> x, p, k = sympy.symbols("x p k", real=True)
        >>> Equations(p**2/2 + k*x**2/2, [x, p], None, {"k": 3.0}).slopes_in("k")
        [x, 0]
        """
        symbol, effort = self.parameters[parameter][0], self._new_effort()
        slope = derivatives.gradient(self.exact.expr, (symbol,), effort)[0]
        mixed = derivatives.gradient(slope, self.z, effort)
        for i, force in enumerate(self.exact.forces):
            mixed[i] -= derivatives.gradient(force, (symbol,), effort)[0]
        return [
            self.exact.rounded(entry).replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
            for entry in mixed
        ]

    def switches(
        self, symbols: Sequence[sympy.Symbol]
    ) -> list[tuple[sympy.Expr, list[sympy.Expr]]]:
        """Discontinuities in some symbols: pairs (function, jumps of ``slopes`` and H at zeros)."""
        return derivatives.switches(self.expr, self.slopes, symbols)

    @cached_property
    def has_angle_cut(self) -> bool:
        """Whether H jumps at the cut of an angle atan2, at which the equations are smooth.

        Examples
        --------
        >>> x, p = sympy.symbols("x p", real=True)
        >>> angle = sympy.atan2(p, x)
        >>> [Equations(H, [x, p], None, {}).has_angle_cut for H in (angle, angle**2, x + p)]
        [True, False, False]
        """
        jumps = (each for _, each in derivatives.angle_jumps(self.expr, self.slopes, self.z))
        return any(jump != 0 and all(slope == 0 for slope in slopes) for *slopes, jump in jumps)

    def resting(self, z: Sequence[float], candidates: Iterable[int]) -> list[int]:
        """Components that keep exactly their values in a state, among candidates.

        Their rates vanish identically where they have these values, whatever the other components
        and the time are.

        Examples
        --------
        >>> x, y, px, py = sympy.symbols("x y px py", real=True)
        >>> H = Equations((px**2 + py**2)/2 + x**2/2 + (y**2 - 1)**2, [x, y, px, py], None, {})
        >>> H.resting([0.0, 1.0, 0.5, 0.0], range(4))
        [1, 3]
        """
        left = set(candidates)
        while left:
            at = self.fractions | {self.z[i]: sympy.Rational(float(z[i])) for i in left}
            moving = {i for i in left if not self._rate_vanishes(i, at)}
            if not moving:
                break
            left -= moving
        return sorted(left)

    def _rate_vanishes(self, component: int, at: Mapping[sympy.Symbol, sympy.Expr]) -> bool:
        rate = self.vector_field[component]
        numbers = {number: sympy.Rational(number) for number in rate.atoms(sympy.Float)}
        return derivatives.vanishes(rate.xreplace({**at, **numbers}))

    @cached_property
    def has_linear_velocity(self) -> bool:
        """Whether H is separable and dq/dt is a constant matrix times p."""
        d, momenta = self.dof, set(self.z[self.dof :])
        varying = {*self.z, self.time}
        rates = {k: entry for k, entry in self.curvature.items() if k[0] >= d}
        constant = all(
            j >= d and not entry.free_symbols & varying for (_, j), entry in rates.items()
        )
        at_rest = dict.fromkeys(momenta, 0)
        return (
            self.is_separable
            and constant
            and all(slope.xreplace(at_rest) == 0 for slope in self.slopes[d:])
        )

    @cached_property
    def is_separable(self) -> bool:
        """Whether dq/dt depends on p only, and dp/dt on q only, beside the time."""
        momenta = set(self.z[self.dof :])
        return self.has_separable_energy and not free_symbols(self.forces) & momenta

    @cached_property
    def has_separable_energy(self) -> bool:
        """Whether H = T(p) + V(q): all mixed second derivatives vanish identically."""
        q, p = set(self.z[: self.dof]), set(self.z[self.dof :])
        terms = sympy.Add.make_args(self.expr)
        coupled = [term for term in terms if term.free_symbols & q and term.free_symbols & p]
        slopes = derivatives.gradient(sympy.Add(*coupled), self.z[: self.dof], self._effort)
        mixed = [derivatives.gradient(s, self.z[self.dof :], self._effort) for s in slopes]
        return all(derivatives.vanishes(entry) for row in mixed for entry in row)


def free_symbols(formulas: Iterable[sympy.Expr]) -> set[sympy.Symbol]:
    """Symbols that occur in formulas."""
    return {symbol for formula in formulas for symbol in formula.free_symbols}


class Formulas(Shown, list[sympy.Eq]):
    """A list of equations, one below the other in notebooks.

    - notation: Order of the terms of sums.

    Examples
    --------
    >>> x, p = sympy.symbols("x p")
    >>> print(Formulas([sympy.Eq(x, p)])._repr_latex_())
    $\\displaystyle \\begin{aligned}x &= p\\end{aligned}$
    """

    def __init__(
        self, equations: Iterable[sympy.Eq] = (), notation: Notation | None = None
    ) -> None:
        super().__init__(equations)
        self.notation = notation or Notation()

    def _repr_latex_(self) -> str:
        return aligned(((self.notation.latex(each.lhs), each.rhs) for each in self), self.notation)


def aligned(equations: Iterable[tuple[str, sympy.Expr]], notation: Notation) -> str:
    """Return pairs of a left side in LaTeX and an expression as lines in MathJax."""
    lines = r" \\ ".join(f"{left} &= {notation.latex(right)}" for left, right in equations)
    return rf"$\displaystyle \begin{{aligned}}{lines}\end{{aligned}}$"
