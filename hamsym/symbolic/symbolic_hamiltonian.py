"""What follows from the formula of a Hamiltonian alone, as sympy objects.

Input:  H and its forces, with the roles of the symbols (:mod:`hamsym.symbolic.variables`).
Output: texts and units, Hamilton's equations, derivatives, brackets and invariants, in the symbols
        that the user gave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import sympy

from hamsym.errors import InputError
from hamsym.formula.notation import Notation
from hamsym.formula.parser import Written
from hamsym.formula.printer import FormulaPrinter, ordered_terms
from hamsym.support.shown import Shown
from hamsym.support.validation import require_positive, require_whole
from hamsym.symbolic import brackets, derivatives
from hamsym.symbolic.equations import Equations, Formulas, free_symbols
from hamsym.symbolic.invariant import Invariants
from hamsym.symbolic.invariants import find_invariants, is_conserved, suggested_basis
from hamsym.symbolic.pairing import natural_order
from hamsym.symbolic.variables import TIME

# Sums that were written, up to which those in derivatives are compared with each of them.
_MOST_SUMS = 100


class SymbolicHamiltonian(Shown):
    """The symbolic part of :class:`hamsym.Hamiltonian`, which sets the attributes."""

    expr: sympy.Expr
    q: tuple[sympy.Symbol, ...]
    p: tuple[sympy.Symbol, ...]
    z: tuple[sympy.Symbol, ...]
    #: Values of the parameters that have a value, by name.
    parameters: Mapping[str, float]
    #: The symbol t if H or a force depends on time explicitly, else None.
    time: sympy.Symbol | None
    #: Forces beyond those of H that do not vanish, by the names of the momenta.
    forces: Mapping[str, sympy.Expr]
    #: Terms of sums in H in the order in which they were written, by the sum.
    written: Written
    #: Units by name, with that of the time, ``t``; empty if none were given.
    units: Mapping[str, str]

    def labelled(self, name: str) -> str:
        """Return a name with its unit, for an axis: ``x [m]``; the name alone without units.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> units = {"x": "m", "p": "kg*m/s", "m": "kg", "g": "m/s**2"}
        >>> H = Hamiltonian("p**2/(2*m) + m*g*x", units=units)
        >>> H.labelled("p"), H.labelled("t")
        ('p [kg*m/s]', 't [s]')
        """
        unit = self.units.get(name, "1")
        return name if unit == "1" else f"{name} [{unit}]"

    def quantity(self, name: str, value: float, form: str = ".1e") -> str:
        """Return a value of a component or parameter with its unit, as text.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> units = {"x": "m", "p": "kg*m/s", "m": "kg"}
        >>> H = Hamiltonian("p**2/(2*m)", q=["x"], p=["p"], units=units)
        >>> H.quantity("x", 0.25), H.quantity("m", 1.5, "g")
        ('2.5e-01 m', '1.5 kg')
        """
        unit = self.units.get(name, "1")
        return format(value, form) + ("" if unit == "1" else f" {unit}")

    # -- identity and text -------------------------------------------------------------------

    @cached_property
    def _identity(self) -> tuple[Any, ...]:
        real = self.real_equations
        values = sorted(self.parameters.items())
        return (*real.formulas, *(symbol.name for symbol in self.z), *values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SymbolicHamiltonian):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __str__(self) -> str:
        return self.formula

    def __repr__(self) -> str:
        pairs = ", ".join(f"({q}, {p})" for q, p in zip(self.q, self.p, strict=True))
        values = "".join(f", {name}={value:g}" for name, value in self.parameters.items())
        texts = self.force_texts.items()
        forces = "".join(f", force of {name} {text!r}" for name, text in texts)
        return f"Hamiltonian({self.formula!r}, pairs {pairs}{forces}{values})"

    def _repr_latex_(self) -> str:
        write = self.notation.latex
        arguments = ", ".join(sympy.latex(symbol) for symbol in self.z)
        forces = "".join(
            rf", \quad F_{{{sympy.latex(symbol)}}} = {write(self.forces[symbol.name])}"
            for symbol in self.p
            if symbol.name in self.forces
        )
        return rf"$\displaystyle H({arguments}) = {write(self.expr)}{forces}$"

    @cached_property
    def formula(self) -> str:
        """H as text, with the terms in conventional order; parsing it gives H again."""
        return FormulaPrinter()(self.expr)

    @cached_property
    def notation(self) -> Notation:
        """Order of the terms in all that is displayed of H, as they were written.

        The terms of the equations of motion are in the order of the terms of H that they come from.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> H = Hamiltonian("p_r**2/(2*m) + k*(r - l)**2/2 + r*a", q=["r"], p=["p_r"])
        >>> H.notation.text(H.vector_field[1])
        '-k*(r - l) - a'
        """
        notation, real = Notation(self.written), self.real_equations
        terms = notation.terms(real.expr)
        orders = derivatives.term_places(terms, real.z)
        sources = (*orders[self.dof :], *orders[: self.dof])
        for rate, places in zip(self.vector_field, sources, strict=True):
            if rate.is_Add and rate not in notation.written:
                known = {self._own(term): place for term, place in places.items()}
                # Forces come last.
                place = {t: known.get(t.as_coeff_Mul()[1], len(terms)) for t in rate.args}
                notation.written[rate] = sorted(ordered_terms(rate), key=place.__getitem__)
        self._order_inner_sums(notation)
        return notation

    def _order_inner_sums(self, notation: Notation) -> None:
        """Add the order of sums within the equations of motion: of the sum that they come from."""
        found = {total for rate in self.vector_field for total in rate.atoms(sympy.Add)}
        left = {s for s in found if s not in notation.written and -s not in notation.written}
        if not left or len(self.written) > _MOST_SUMS:
            return
        for terms in self.written.values():
            for places in derivatives.term_places(terms, self.z):
                for total in left - notation.derived.keys():
                    place = {t: places.get(t.as_coeff_Mul()[1], -1) for t in total.args}
                    if min(place.values()) >= 0:
                        notation.derived[total] = sorted(
                            ordered_terms(total), key=place.__getitem__
                        )

    @property
    def formulas(self) -> str:
        """H as text, with the forces if there are any: ``p**2/2, force of p = -c*p``."""
        forces = (f", force of {name} = {text}" for name, text in self.force_texts.items())
        return self.formula + "".join(forces)

    @property
    def force_texts(self) -> dict[str, str]:
        """The forces as text, by the names of the momenta."""
        return {name: FormulaPrinter()(force) for name, force in self.forces.items()}

    # -- dimensions and parameters -----------------------------------------------------------

    @property
    def dof(self) -> int:
        """Degrees of freedom d, the number of pairs."""
        return len(self.q)

    @property
    def dim(self) -> int:
        """Dimension 2 d of phase space."""
        return len(self.z)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the components of z."""
        return tuple(symbol.name for symbol in self.z)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all parameters, with a value or without, in natural order."""
        known = {*self.z, self.time}
        symbols = free_symbols((self.expr, *self.forces.values()))
        names = {symbol.name for symbol in symbols if symbol not in known}
        return tuple(sorted(names, key=natural_order))

    @cached_property
    def unbound_parameters(self) -> tuple[str, ...]:
        """Names of the parameters without a value."""
        return tuple(name for name in self.parameter_names if name not in self.parameters)

    # -- equations of motion -----------------------------------------------------------------

    @cached_property
    def real_equations(self) -> Equations:
        """H, the forces and their derivatives in real symbols, for code generation and proofs."""
        values = {name: self.parameters.get(name) for name in self.parameter_names}
        forces = [self.forces.get(symbol.name, sympy.Integer(0)) for symbol in self.p]
        return Equations(self.expr, self.z, self.time, values, forces if self.forces else [])

    def _own(self, expr: sympy.Expr) -> sympy.Expr:
        """Convert an expression from real symbols to the symbols of H.expr."""
        back = self.real_equations.back
        return expr.xreplace(back) if back else expr

    def _column(self, entries: Sequence[sympy.Expr]) -> sympy.ImmutableDenseMatrix:
        return sympy.ImmutableDenseMatrix([self._own(entry) for entry in entries])

    def _matrix(self, entries: Mapping[tuple[int, int], sympy.Expr]) -> sympy.ImmutableDenseMatrix:
        own = {index: self._own(entry) for index, entry in entries.items()}
        return sympy.ImmutableDenseMatrix(sympy.SparseMatrix(self.dim, self.dim, own))

    @cached_property
    def gradient(self) -> sympy.ImmutableDenseMatrix:
        """Gradient of H, a column of length dim."""
        return self._column(self.real_equations.gradient)

    @cached_property
    def hessian(self) -> sympy.ImmutableDenseMatrix:
        """Matrix of second derivatives, dim x dim."""
        return self._matrix(self.real_equations.hessian)

    @cached_property
    def poisson_matrix(self) -> sympy.ImmutableDenseMatrix:
        """Poisson matrix J = [[0, 1], [-1, 0]], dim x dim (the paper's symplectic notation)."""
        unit = {(i, i): sympy.Integer(1) for i in range(self.dim)}
        return self._matrix(derivatives.poisson_rows(unit, self.dof))

    @cached_property
    def jacobian(self) -> sympy.ImmutableDenseMatrix:
        """Derivatives of the vector field by the state, J Hess without forces, dim x dim."""
        return self._matrix(self.real_equations.jacobian)

    @cached_property
    def vector_field(self) -> sympy.ImmutableDenseMatrix:
        """Right-hand side J grad H + (0, F) of the equations of motion, a column of length dim."""
        return self._column(self.real_equations.vector_field)

    @cached_property
    def equations(self) -> Formulas:
        """Hamilton's equations, one per component of z (the paper's eq. hamEqs).

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> Hamiltonian("p**2/2 + x**2/2").equations
        [Eq(Derivative(x, t), p), Eq(Derivative(p, t), -x)]
        """
        used = set(self.names) | set(self.parameter_names)
        time = self.time or sympy.Symbol(TIME if TIME not in used else "time", real=True)
        equations = (
            sympy.Eq(sympy.Derivative(component, time, evaluate=False), rate, evaluate=False)
            for component, rate in zip(self.z, self.vector_field, strict=True)
        )
        return Formulas(equations, self.notation)

    @cached_property
    def power(self) -> sympy.Expr:
        """Rate dH/dt of the energy along trajectories, F . dH/dp + (partial H)/(partial t).

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> Hamiltonian("p**2/(2*m) + x**2/2", forces={"p": "-c*p/m"}).power
        -c*p**2/m**2
        """
        return self._own(self.real_equations.power)

    @property
    def conserves_energy(self) -> bool:
        """Whether H is constant along every trajectory: it has no explicit time and no forces."""
        return self.real_equations.conserves_energy

    @property
    def is_separable(self) -> bool:
        """Whether H = T(p) + V(q), with forces that do not depend on momenta, if there are any.

        dq/dt is then a function of p only, and dp/dt of q only.
        """
        return self.real_equations.is_separable

    @cached_property
    def _split(self) -> tuple[sympy.Expr, sympy.Expr] | None:
        if not self.real_equations.has_separable_energy:
            return None
        real = self.real_equations
        parts = derivatives.split(real.expr, real.z[: self.dof], real.z[self.dof :])
        return self._own(parts[0]), self._own(parts[1])

    @property
    def kinetic(self) -> sympy.Expr | None:
        """Kinetic energy T(p) if H = T(p) + V(q), else None."""
        return None if self._split is None else self._split[0]

    @property
    def potential(self) -> sympy.Expr | None:
        """Potential V(q) if H = T(p) + V(q), all terms without p, else None."""
        return None if self._split is None else self._split[1]

    @cached_property
    def cyclic_coordinates(self) -> tuple[sympy.Symbol, ...]:
        """Coordinates on which H does not depend; their momenta, without forces, are conserved.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r").cyclic_coordinates
        (phi,)
        """
        gradient = self.real_equations.gradient[: self.dof]
        return tuple(
            q
            for q, p, slope in zip(self.q, self.p, gradient, strict=True)
            if p.name not in self.forces and derivatives.vanishes(slope)
        )

    def poisson_bracket(self, f: str | sympy.Expr, g: str | sympy.Expr) -> sympy.Expr:
        """Poisson bracket {f, g} = sum_i df/dq_i dg/dp_i - df/dp_i dg/dq_i.

        Parameters
        ----------
        f, g : str or sympy.Expr
            Functions of the state, the parameters and the time.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> H = Hamiltonian("p**2/2 + x**2/2")
        >>> H.poisson_bracket("x", "p"), H.poisson_bracket("x", H.expr)
        (1, p)
        """
        z = self.real_equations.z
        return self._own(brackets.poisson_bracket(self.function(f), self.function(g), z))

    def is_conserved(self, f: str | sympy.Expr, *, every: Sequence[str] = ()) -> bool:
        """Whether f is constant along every trajectory: {f, H} + F . df/dp + df/dt = 0.

        As long as f is smooth there: ``atan(p/x)`` jumps where x is zero.

        Parameters
        ----------
        f : str or sympy.Expr
        every : sequence of str
            Parameters for all values of which f must be conserved, not only for that in H.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.is_conserved("x*p_y - y*p_x"), H.is_conserved("p_x")
        (True, False)
        """
        return is_conserved(self.function(f), self.real_equations, self._time_symbol, every)

    def invariants(
        self,
        degree: int = 2,
        *,
        basis: str | sympy.Expr | Sequence[str | sympy.Expr] = (),
        time_limit: float = 60.0,
    ) -> Invariants:
        """Find first integrals that are polynomials in the state and in basis functions.

        Each is proven by exact arithmetic before it is returned, with floating-point numbers of H
        as the binary fractions that they are. The list has generators: H, constants and
        polynomials of degree ``degree`` in H and in earlier invariants are left out. That none is
        found proves nothing about others, and is no sign of chaos.

        Parameters
        ----------
        degree : int
            Largest total degree in the state and the basis functions, each of which counts as 1.
            In an explicitly time-dependent H the time counts as well.
        basis : sequence of str or sympy.Expr
            Further basis functions. Those in H that are not polynomial, e.g. 1/r, are always used
            (:func:`hamsym.symbolic.invariants.suggested_basis`).
        time_limit : float
            Seconds.

        Returns
        -------
        Invariants
            A list of :class:`~hamsym.Invariant`, printed as a table. First those that hold for all
            parameters, then those that hold for the values of H, whose ``holds_for`` names these
            values.

        Raises
        ------
        InputError
            If the degree or a basis function is invalid, there are too many monomials, the time is
            over, H has a function without exact rules, or there are forces.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/(2*m) - k/sqrt(x**2 + y**2)")
        >>> for invariant in H.invariants(degree=3):
        ...     print(invariant)
        p_x*y - p_y*x
        p_x**2*y - p_x*p_y*x - k*m*y/sqrt(x**2 + y**2)
        p_x*p_y*y - p_y**2*x + k*m*x/sqrt(x**2 + y**2)
        """
        real = self.real_equations
        if self.forces:
            raise InputError(
                "invariants are found from the bracket with H, which forces do not obey; test a "
                "function with H.is_conserved"
            )
        require_whole("degree", degree)
        require_positive("time_limit", time_limit)
        functions = []
        for given in [basis] if isinstance(basis, str | sympy.Expr) else basis:
            function = self.function(given)
            if not function.free_symbols & {*real.z, self._time_symbol}:
                raise InputError(
                    f"the basis function '{given}' does not depend on the state; leave it out"
                )
            functions.append(function)
        found = find_invariants(
            real.expr,
            real.z,
            self._time_symbol,
            real.values,
            degree,
            [*suggested_basis(real.expr, real.z), *functions],
            time_limit,
        )
        own = (replace(invariant, expr=self._own(invariant.expr)) for invariant in found)
        return Invariants(own, degree, self.time is None)

    @property
    def _time_symbol(self) -> sympy.Symbol | None:
        """The time in real symbols, in H or not; None if its name is taken."""
        taken = TIME in {*self.names, *self.parameters}
        return None if taken else sympy.Symbol(TIME, real=True)

    def function(self, f: str | sympy.Expr) -> sympy.Expr:
        """Convert a function of the state, the parameters and the time to real symbols."""
        return brackets.phase_function(f, (*self.names, *self.parameter_names, TIME))

    @cached_property
    def variational_equations(self) -> list[sympy.Eq]:
        """Linear equations of a small deviation, d(delta)/dt = J Hess(z) delta without forces.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> Hamiltonian("p**2/2 + x**2/2 + x**4/4").variational_equations[1]
        Eq(Derivative(delta_p, t), delta_x*(-3*x**2 - 1))
        """
        time = self.equations[0].lhs.args[1][0]
        taken = [symbol.name for symbol in free_symbols((self.expr, *self.forces.values()))]
        return brackets.variational_equations(self.jacobian, self.names, time, taken)

    @cached_property
    def sigma_min(self) -> sympy.Expr | None:
        """Smallest singular value of the Hessian in closed form, in real symbols, or None.

        The Hessian is symmetric, so its singular values are the magnitudes of its eigenvalues.
        They have a closed form if the Hessian falls into blocks of at most 2 x 2 (after a
        permutation). With forces it is None: the bound that it serves does not hold then.

        Examples
        --------
        >>> from hamsym import Hamiltonian
        >>> H = Hamiltonian("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
        >>> H.sigma_min
        Min(1, Abs(2*sqrt(x**2 + y**2) - 1))
        """
        if self.forces:
            return None
        return derivatives.smallest_singular_value(self.real_equations.hessian, self.dim)
