"""The Hamiltonian as a symbolic object.

Input:  a formula or a sympy expression, pairs of coordinates and momenta, parameter values.
Output: Hamilton's equations, the Hessian and quantities derived from them, as sympy objects;
        source text and callables for each backend, by :mod:`hamsym.codegen.generate`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import numpy as np
import sympy

from hamsym.codegen.backends import BACKENDS, runnable
from hamsym.codegen.functions import compile_expressions
from hamsym.codegen.generate import generate
from hamsym.codegen.names import Names
from hamsym.codegen.system import System, load
from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.formula.parser import canonical_name
from hamsym.formula.printer import FormulaPrinter
from hamsym.suggestions import checked_keywords, require_known, suggest_attributes
from hamsym.support.shown import Shown
from hamsym.support.validation import require, require_number, require_positive, require_whole
from hamsym.symbolic import brackets, derivatives
from hamsym.symbolic.checks import name_of
from hamsym.symbolic.equations import Equations, free_symbols
from hamsym.symbolic.exact import rational
from hamsym.symbolic.formulas import Formulas
from hamsym.symbolic.invariant import Invariants
from hamsym.symbolic.invariants import find_invariants, is_proven, suggested_basis
from hamsym.symbolic.pairing import natural_order
from hamsym.symbolic.states import parameter_arrays, state_array, states_array
from hamsym.symbolic.variables import TIME, assign_variables

if TYPE_CHECKING:
    from hamsym import Equilibria


@suggest_attributes
class Hamiltonian(Shown):
    """A Hamiltonian H(q, p), its equations of motion and its derivatives.

    The phase-space state is z = (q_1..q_d, p_1..p_d), of dimension 2 d. A symbol ``t`` is the time
    unless it is a coordinate, a momentum or a parameter with a value. All other symbols are
    parameters.

    Parameters
    ----------
    expression : str or sympy.Expr
        The Hamiltonian. Text is parsed by :func:`hamsym.formula.parser.parse_expression` and never
        evaluated as Python.
    q, p : sequence of str or sympy.Symbol, optional
        Coordinates and momenta, in the order of the state. By default the pairs are found from the
        names (:func:`hamsym.symbolic.pairing.find_pairs`), in natural order.
    parameters : mapping of name to number, optional
        Values of parameters, in the units of H. Numerical functions need a value for each.
    units : mapping of name to str, optional
        Units of the components and of parameters, for example ``{"x": "m", "p": "kg*m/s"}``:
        products of powers of units of SI and usual others. They are checked, shown on axes and
        kept; numbers are not converted. Parameters without a unit are plain numbers. Equality
        ignores units.
    forces : mapping of momentum to str or sympy.Expr, optional
        Forces beyond those of H, by the names or symbols of the momenta: dp_i/dt = -dH/dq_i + F_i.
        They are functions of the state, the time and parameters, in the units of H over those of
        q_i: friction, drive, radiation reaction. H is then not conserved (see ``power``), and the
        flow not symplectic.

    Raises
    ------
    ParseError
        If the text is not a formula.
    VariableError
        If the pairs are ambiguous, missing, or do not fit the expression, or a force belongs to no
        momentum.
    ParameterError
        If a value is not a finite real number or belongs to no symbol of H.
    InputError
        If units do not fit together, as in a sum of terms of different units.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    >>> H.q, H.p
    ((x,), (p,))
    >>> list(H.vector_field)
    [p, -x**3 - x]
    >>> H.is_separable, H.sigma_min
    (True, 1)
    >>> list(Hamiltonian("p**2/2 + x**2/2", forces={"p": "-c*p"}).vector_field)
    [p, -c*p - x]
    """

    @checked_keywords
    def __init__(
        self,
        expression: str | sympy.Expr,
        *,
        q: Sequence[str | sympy.Symbol] | None = None,
        p: Sequence[str | sympy.Symbol] | None = None,
        parameters: Mapping[Any, float] | None = None,
        units: Mapping[Any, str] | None = None,
        forces: Mapping[Any, str | sympy.Expr] | None = None,
    ) -> None:
        # __setattr__ raises.
        self.__dict__.update(assign_variables(expression, q, p, parameters, forces)._asdict())
        self.__dict__["units"] = MappingProxyType(self._checked_units(units))

    @classmethod
    def from_lagrangian(
        cls,
        expression: str | sympy.Expr,
        *,
        q: Sequence[str | sympy.Symbol] | None = None,
        velocities: Sequence[str | sympy.Symbol] | None = None,
        p: Sequence[str | sympy.Symbol] | None = None,
        parameters: Mapping[Any, float] | None = None,
    ) -> Hamiltonian:
        """Make the Hamiltonian of a Lagrangian L(q, v, t) by an exact Legendre transform.

        The mass matrix may depend on coordinates, parameters and the time, L may contain terms
        linear in the velocities, as those of a magnetic field, and the time. Where L is not
        quadratic in a velocity, the transform is searched for a bounded time and compared with
        p v - L at random points: the relativistic particle has one.

        Parameters
        ----------
        expression : str or sympy.Expr
            L. In text and symbols, the velocity of ``x`` is ``xdot``, ``x_dot`` or ``dx``
            (:func:`hamsym.symbolic.lagrangian.find_velocities`). In functions of time, as those of
            ``sympy.physics.mechanics.dynamicsymbols``, it is ``Derivative(x(t), t)``.
        q, velocities : sequence of str or sympy.Symbol, optional
            Coordinates and their velocities, in one order, for other names.
        p : sequence of str or sympy.Symbol, optional
            Names of the momenta; by default ``p_x`` for ``x``.
        parameters : mapping of name to number, optional
            Values of parameters, in the units of L.

        Raises
        ------
        ParseError
            If the text is not a formula.
        VariableError
            If velocities are ambiguous or missing, or names do not fit L.
        ParameterError
            If a value is not a finite real number or belongs to no symbol of L.
        InputError
            If the mass matrix is singular, or the velocities are not found; the message names them.

        Examples
        --------
        >>> Hamiltonian.from_lagrangian("m*xdot**2/2 - k*x**2/2")
        Hamiltonian('p_x**2/(2*m) + k*x**2/2', pairs (x, p_x))
        >>> Hamiltonian.from_lagrangian("-m*c**2*sqrt(1 - xdot**2/c**2)").expr
        c**2*m*sqrt(1 + p_x**2/(c**2*m**2))
        """
        from hamsym.symbolic.lagrangian import read_lagrangian

        read = read_lagrangian(expression, q, velocities, p, parameters)
        return cls(read.hamiltonian, q=read.q, p=read.p, parameters=read.parameters)

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
    #: Units by name, with that of the time, ``t``; empty if none were given.
    units: Mapping[str, str]

    def _checked_units(self, units: Mapping[Any, str] | None) -> dict[str, str]:
        if units is None or units == {}:
            return {}
        from hamsym.symbolic.units import checked_units

        taken = {*self.names, *self.parameter_names}
        # A force times its coordinate has the unit of H.
        works = [
            self.forces[p.name] * q
            for q, p in zip(self.q, self.p, strict=True)
            if p.name in self.forces
        ]
        time = "time" if TIME in taken else TIME
        return checked_units(units, sympy.Add(self.expr, *works), self.q, self.p, time)

    def labelled(self, name: str) -> str:
        """Return a name with its unit, for an axis: ``x [m]``; the name alone without units.

        Examples
        --------
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
        >>> units = {"x": "m", "p": "kg*m/s", "m": "kg"}
        >>> H = Hamiltonian("p**2/(2*m)", q=["x"], p=["p"], units=units)
        >>> H.quantity("x", 0.25), H.quantity("m", 1.5, "g")
        ('2.5e-01 m', '1.5 kg')
        """
        unit = self.units.get(name, "1")
        return format(value, form) + ("" if unit == "1" else f" {unit}")

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a Hamiltonian is immutable; make a new one instead of setting {name!r}"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(
            f"a Hamiltonian is immutable; make a new one instead of deleting {name!r}"
        )

    # -- identity --------------------------------------------------------------------------

    @cached_property
    def _identity(self) -> tuple[Any, ...]:
        real = self.real_equations
        values = sorted(self.parameters.items())
        return (*real.formulas, *(symbol.name for symbol in self.z), *values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Hamiltonian):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = (self.expr, self.q, self.p, dict(self.parameters), dict(self.units))
        return (_rebuild, (*arguments, dict(self.forces)))

    def __str__(self) -> str:
        return self.formula

    def __repr__(self) -> str:
        pairs = ", ".join(f"({q}, {p})" for q, p in zip(self.q, self.p, strict=True))
        values = "".join(f", {name}={value:g}" for name, value in self.parameters.items())
        texts = self.force_texts.items()
        forces = "".join(f", force of {name} {text!r}" for name, text in texts)
        return f"Hamiltonian({self.formula!r}, pairs {pairs}{forces}{values})"

    def _repr_latex_(self) -> str:
        arguments = ", ".join(sympy.latex(symbol) for symbol in self.z)
        forces = "".join(
            rf", \quad F_{{{sympy.latex(symbol)}}} = {sympy.latex(self.forces[symbol.name])}"
            for symbol in self.p
            if symbol.name in self.forces
        )
        return rf"$\displaystyle H({arguments}) = {sympy.latex(self.expr)}{forces}$"

    @cached_property
    def formula(self) -> str:
        """H as text, with the terms in conventional order; parsing it gives H again."""
        return FormulaPrinter()(self.expr)

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

    def with_parameters(self, /, **values: float) -> Hamiltonian:
        """Return the same Hamiltonian with other parameter values.

        Examples
        --------
        >>> H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1.0})
        >>> dict(H.with_parameters(m=2.0, k=4.0).parameters)
        {'k': 4.0, 'm': 2.0}
        """
        merged = {**self.parameters, **values}
        return Hamiltonian(
            self.expr,
            q=self.q,
            p=self.p,
            parameters=merged,
            units=self.units,
            forces=self.forces,
        )

    @classmethod
    def of(cls, H: HamiltonianLike, *, bound: bool = True) -> Hamiltonian:
        """Convert a Hamiltonian or a formula to a Hamiltonian with a value for every parameter.

        Without ``bound``, parameters may lack values.

        Raises
        ------
        InputError
            If the argument is neither, or a parameter has no value.

        Examples
        --------
        >>> Hamiltonian.of("p**2/2 + x**2/2").names
        ('x', 'p')
        """
        if isinstance(H, str | sympy.Expr):
            H = cls(H)
        if not isinstance(H, cls):
            raise InputError(
                f"H must be a Hamiltonian or a formula, not {type(H).__name__}; give for example "
                'Hamiltonian("p**2/2 + x**2/2")'
            )
        if bound:
            H.require_parameters()
        return H

    def require_parameters(self) -> None:
        """Require a value for every parameter.

        Raises
        ------
        ParameterError
            If a parameter has no value.
        """
        self._require_values(self.unbound_parameters)

    def _require_values(self, missing: Sequence[str]) -> None:
        if missing:
            verb, example = "has" if len(missing) == 1 else "have", "=1.0, ".join(missing)
            raise ParameterError(
                f"{', '.join(missing)} {verb} no value; use H.with_parameters({example}=1.0), or "
                "--param NAME=VALUE at the command line"
            )

    def state_from(self, z0: Sequence[float] | Mapping[Any, float] | np.ndarray) -> np.ndarray:
        """Convert a state to an array in the order of z.

        Parameters
        ----------
        z0 : sequence, mapping or array
            Numbers in the order of z, or values by name.

        Returns
        -------
        numpy.ndarray
            Shape (dim,), float64.

        Raises
        ------
        VariableError
            If a component is missing, unknown, not finite or not real.

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2").state_from({"p": 1, "x": 1.3})
        array([1.3, 1. ])
        """
        return state_array(z0, self.names)

    def states_from(self, z0: Any) -> np.ndarray:
        """Convert a state or an ensemble of states to an array in the order of z.

        Parameters
        ----------
        z0 : sequence, mapping or array
            As in :meth:`state_from`; or an array of shape (..., dim), or a mapping to arrays that
            broadcast.

        Returns
        -------
        numpy.ndarray
            Shape (..., dim), float64.

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2").states_from({"p": 1, "x": [1.3, 1.4]})
        array([[1.3, 1. ],
               [1.4, 1. ]])
        """
        return states_array(z0, self.names)

    def state_at_energy(
        self,
        energy: Any,
        z0: Mapping[Any, Any],
        t: Any = 0.0,
        parameters: Mapping[Any, Any] | None = None,
        *,
        missing: str = "raise",
    ) -> np.ndarray:
        """Complete a state, or each of an array of states, to a given energy.

        Parameters
        ----------
        energy : float or array
        z0 : mapping
            All components by name except one, as numbers or arrays. The missing component is set to
            the smallest number >= 0 for which H has this energy.
        t : float or array
            The time, if H depends on it.
        parameters : mapping of name to number or array, optional
            Values that replace those of H.
        missing : {"raise", "nan"}
            Raise an error if no number gives the energy, or return a state of nan.

        Returns
        -------
        numpy.ndarray
            Shape (..., dim), where all arguments are broadcast to (...).

        Raises
        ------
        VariableError
            If not exactly one component is missing, no number gives an energy, or the shapes do not
            broadcast.
        InputError
            If an energy is not a finite number.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
        >>> H.state_at_energy(1 / 6, {"x": 0, "y": -0.15, "p_y": 0}).round(6)
        array([ 0.      , -0.15    ,  0.555503,  0.      ])
        >>> H.state_at_energy(1 / 8, {"x": 0, "y": [0, 0.9], "p_y": 0}, missing="nan")
        array([[0. , 0. , 0.5, 0. ],
               [nan, nan, nan, nan]])
        """
        from hamsym.numerics.roots import first_zeros  # imports scipy.optimize, which is slow

        require(missing in ("raise", "nan"), "missing", missing, '"raise" or "nan"')
        given = parameter_arrays(parameters, self.parameter_names) if parameters else {}
        self._require_values([name for name in self.unbound_parameters if name not in given])
        system = self.compile("numpy")
        components = {canonical_name(name_of(name)) for name in z0}
        lacking = [name for name in self.names if canonical_name(name) not in components]
        if len(lacking) != 1:
            listed = ", ".join(lacking) or "none"
            raise VariableError(
                "z0 must lack exactly one component, which the energy determines; missing: "
                f"{listed}"
            )
        energies, times = _finite("energy", energy), _finite("t", t)
        states, where = self.states_from({**z0, lacking[0]: 0.0}), self.names.index(lacking[0])
        numbers = (energies, times, *given.values())
        try:
            shape = np.broadcast_shapes(states.shape[:-1], *(array.shape for array in numbers))
        except ValueError:
            shapes = ", ".join(str(array.shape) for array in (states[..., 0], *numbers))
            raise VariableError(
                f"z0, energy, t and parameters have shapes {shapes}, which do not broadcast; give "
                "arrays of one shape, or numbers"
            ) from None
        energies, times, *values = (np.broadcast_to(array, shape).ravel() for array in numbers)
        found = np.array(np.broadcast_to(states, (*shape, self.dim)).reshape(-1, self.dim))
        columns: dict[str, Any] = {**self.parameters, **dict(zip(given, values, strict=True))}
        every = [np.broadcast_to(columns[name], len(found)) for name in self.parameter_names]
        rows = np.array(every).T if given else None

        def excess(value: np.ndarray, index: np.ndarray) -> np.ndarray:
            z = np.empty((self.dim, *np.broadcast_shapes(value.shape, index.shape)))
            z[:] = found.T[:, index]
            z[where] = value
            of = system.keywords(None if rows is None else rows[index])
            with np.errstate(all="ignore"):
                at = system.arguments(np.moveaxis(z, 0, -1), times[index])
                return np.asarray(system.energy(*at, **of)) - energies[index]

        found[:, where] = first_zeros(excess, len(found))
        none = np.isnan(found[:, where])
        if missing == "raise" and none.any():
            first = int(np.argmax(none))
            which = f"the energy {energies[first]:g}; give another energy or start"
            if shape:
                index = ", ".join(map(str, np.unravel_index(first, shape)))
                which = (
                    f"the energy of {none.sum():,} of {none.size:,} states, the first of them "
                    f"[{index}] with energy {energies[first]:g}; give other energies or starts, or "
                    'missing="nan"'
                )
            raise VariableError(f"no {lacking[0]} >= 0 gives {which}")
        found[none] = np.nan
        return found.reshape(*shape, self.dim)

    # -- equations of motion -----------------------------------------------------------------

    @cached_property
    def real_equations(self) -> Equations:
        """H, the forces and their derivatives in real symbols, for code generation and proofs."""
        values = {name: self.parameters.get(name) for name in self.parameter_names}
        return Equations(self.expr, self.z, self.time, values, self._force_column)

    @property
    def _force_column(self) -> list[sympy.Expr]:
        """A force for each momentum; none if there are no forces."""
        if not self.forces:
            return []
        return [self.forces.get(symbol.name, sympy.Integer(0)) for symbol in self.p]

    def _own(self, expr: sympy.Expr) -> sympy.Expr:
        """Convert an expression from real symbols to the symbols of H.expr."""
        back = self.real_equations.back
        return expr.xreplace(back) if back else expr

    @cached_property
    def gradient(self) -> sympy.ImmutableDenseMatrix:
        """Gradient of H, a column of length dim."""
        return sympy.ImmutableDenseMatrix(
            [self._own(entry) for entry in self.real_equations.gradient]
        )

    @cached_property
    def hessian(self) -> sympy.ImmutableDenseMatrix:
        """Matrix of second derivatives, dim x dim."""
        entries = {index: self._own(entry) for index, entry in self.real_equations.hessian.items()}
        return sympy.ImmutableDenseMatrix(sympy.SparseMatrix(self.dim, self.dim, entries))

    @cached_property
    def poisson_matrix(self) -> sympy.ImmutableDenseMatrix:
        """Poisson matrix J = [[0, 1], [-1, 0]], dim x dim (the paper's symplectic notation)."""
        d = self.dof
        entries = {(i, d + i): 1 for i in range(d)} | {(d + i, i): -1 for i in range(d)}
        return sympy.ImmutableDenseMatrix(sympy.SparseMatrix(self.dim, self.dim, entries))

    @cached_property
    def vector_field(self) -> sympy.ImmutableDenseMatrix:
        """Right-hand side J grad H + (0, F) of the equations of motion, a column of length dim."""
        return sympy.ImmutableDenseMatrix([self._own(e) for e in self.real_equations.vector_field])

    @cached_property
    def equations(self) -> Formulas:
        """Hamilton's equations, one per component of z (the paper's eq. hamEqs).

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2").equations
        [Eq(Derivative(x, t), p), Eq(Derivative(p, t), -x)]
        """
        used = set(self.names) | set(self.parameter_names)
        time = self.time or sympy.Symbol(TIME if TIME not in used else "time", real=True)
        return Formulas(
            sympy.Eq(sympy.Derivative(component, time, evaluate=False), rate, evaluate=False)
            for component, rate in zip(self.z, self.vector_field, strict=True)
        )

    @cached_property
    def lagrangian(self) -> sympy.Expr:
        """Lagrangian L = p v - H in the coordinates and velocities; that of ``x`` is ``xdot``.

        Raises
        ------
        InputError
            If H has no Lagrangian, as where it is linear in a momentum, or none is found.

        Examples
        --------
        >>> Hamiltonian("p**2/(2*m) - cos(x)").lagrangian
        m*xdot**2/2 + cos(x)
        """
        from hamsym.symbolic.lagrangian import lagrangian_of

        real = self.real_equations
        given = {symbol: v for symbol, v in real.parameters.values() if v is not None}
        found, _ = lagrangian_of(real.expr, real.z[: self.dof], real.z[self.dof :], given)
        return self._own(found)

    @cached_property
    def jacobian(self) -> sympy.ImmutableDenseMatrix:
        """Derivatives of the vector field by the state, J Hess without forces, dim x dim."""
        entries = {index: self._own(e) for index, e in self.real_equations.jacobian.items()}
        return sympy.ImmutableDenseMatrix(sympy.SparseMatrix(self.dim, self.dim, entries))

    @cached_property
    def power(self) -> sympy.Expr:
        """Rate dH/dt of the energy along trajectories, F . dH/dp + (partial H)/(partial t).

        Examples
        --------
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
        return derivatives.split(
            self.real_equations.expr,
            self.real_equations.z[: self.dof],
            self.real_equations.z[self.dof :],
        )

    @property
    def kinetic(self) -> sympy.Expr | None:
        """Kinetic energy T(p) if H = T(p) + V(q), else None."""
        return None if self._split is None else self._own(self._split[0])

    @property
    def potential(self) -> sympy.Expr | None:
        """Potential V(q) if H = T(p) + V(q), all terms without p, else None."""
        return None if self._split is None else self._own(self._split[1])

    @cached_property
    def cyclic_coordinates(self) -> tuple[sympy.Symbol, ...]:
        """Coordinates on which H does not depend; their momenta, without forces, are conserved.

        Examples
        --------
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
        >>> H = Hamiltonian("p**2/2 + x**2/2")
        >>> H.poisson_bracket("x", "p"), H.poisson_bracket("x", H.expr)
        (1, p)
        """
        z = self.real_equations.z
        return self._own(brackets.poisson_bracket(self.function(f), self.function(g), z))

    def is_conserved(self, f: str | sympy.Expr, *, every: Sequence[str] = ()) -> bool:
        """Whether f is constant along every trajectory: {f, H} + F . df/dp + df/dt = 0.

        Parameters
        ----------
        f : str or sympy.Expr
        every : sequence of str
            Parameters for all values of which f must be conserved, not only for that in H.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.is_conserved("x*p_y - y*p_x"), H.is_conserved("p_x")
        (True, False)
        """
        real, function = self.real_equations, self.function(f)
        values = {
            sympy.Symbol(name, real=True): rational(value)
            for name, value in self.parameters.items()
            if name not in every
        }
        # Without the values first: their fractions are long.
        for given in ({}, values) if values else ({},):
            own, H = function.xreplace(given), real.expr.xreplace(given)
            forces = [force.xreplace(given) for force in real.forces]
            rate = brackets.evolution(own, H, real.z, self._time_symbol, forces)
            # Points first: most functions are not conserved. Sympy's simplification last: it is
            # slow, and it is needed for functions without exact rules only.
            if derivatives.is_zero_at_random_points(rate) and (
                (not forces and is_proven(own, H, real.z, self._time_symbol))
                or derivatives.vanishes(rate)
            ):
                return True
        return False

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
            {sympy.Symbol(name, real=True): value for name, value in self.parameters.items()},
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

    def observable(self, f: str | sympy.Expr) -> Callable[..., np.ndarray]:
        """Compile a function of the state with numpy.

        Parameters
        ----------
        f : str or sympy.Expr
            A function of the components of z, the parameters of H and the time.

        Returns
        -------
        callable
            (z, t=0.0, parameters=None) of shapes (..., dim) and (...) -> (...). Parameters of
            shape (..., k), in the order of ``parameter_names``, replace the values of H.

        Raises
        ------
        VariableError
            If f has a symbol that occurs neither in H nor in a force.
        ParameterError
            If f has a parameter without a value.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.observable("x*p_y - y*p_x")([0.4, 0.0, 0.0, 2.0])
        np.float64(0.8)
        """
        expr = self.function(f)
        used = {symbol.name for symbol in expr.free_symbols}
        self._require_values([name for name in self.unbound_parameters if name in used])
        function = compile_expressions([expr], self.real_equations)
        keywords = [keyword for keyword, _ in Names(self.real_equations).parameters]
        columns = {
            keyword: i
            for i, (name, keyword) in enumerate(zip(self.parameter_names, keywords, strict=True))
            if name in used
        }

        def values(z: Any, t: Any = 0.0, parameters: np.ndarray | None = None) -> np.ndarray:
            given = columns if parameters is not None else {}
            of = {keyword: parameters[..., i] for keyword, i in given.items()}  # type: ignore[index]
            return function(z, t, **of)[..., 0][()]

        return values

    def equilibria(self, guess: Any = None, box: Any = None, **options: Any) -> Equilibria:
        """Find equilibria and their linear stability; see :func:`hamsym.equilibria`.

        Examples
        --------
        >>> [each.type for each in Hamiltonian("p**2/2 - x**2/2 + x**4/4").equilibria()]
        ['centre', 'centre', 'saddle']
        """
        import hamsym

        return hamsym.equilibria(self, guess, box, **options)

    @cached_property
    def variational_equations(self) -> list[sympy.Eq]:
        """Linear equations of a small deviation, d(delta)/dt = J Hess(z) delta without forces.

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2 + x**4/4").variational_equations[1]
        Eq(Derivative(delta_p, t), delta_x*(-3*x**2 - 1))
        """
        time = self.equations[0].lhs.args[1][0]
        taken = [symbol.name for symbol in free_symbols((self.expr, *self.forces.values()))]
        generator = self.jacobian if self.forces else self.poisson_matrix * self.hessian
        return brackets.variational_equations(generator, self.names, time, taken)

    @cached_property
    def sigma_min(self) -> sympy.Expr | None:
        """Smallest singular value of the Hessian in closed form, in real symbols, or None.

        The Hessian is symmetric, so its singular values are the magnitudes of its eigenvalues.
        They have a closed form if the Hessian falls into blocks of at most 2 x 2 (after a
        permutation). With forces it is None: the bound that it serves does not hold then.

        Examples
        --------
        >>> H = Hamiltonian("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
        >>> H.sigma_min
        Min(1, Abs(2*sqrt(x**2 + y**2) - 1))
        """
        if self.forces:
            return None
        return derivatives.smallest_singular_value(self.real_equations.hessian, self.dim)

    # -- generated code ----------------------------------------------------------------------

    def source(self, backend: str = "torch", part: str | None = None) -> str:
        """Generate the module, or one of its functions, as text.

        :meth:`compile` executes this text. As a file it depends only on its backend. The functions
        of ``"balls"``, which proofs execute, depend on nothing: their first argument is an
        arithmetic, of balls for example.

        Parameters
        ----------
        backend : {"torch", "numpy", "numba", "jax", "c", "julia", "balls"}
            ``"c"`` is C99, ``"julia"`` for DifferentialEquations.jl.
        part : str, optional
            The name of one function, such as ``"loss"``. C and Julia have no residual and no loss,
            but ``"jacobian"``, that of the vector field. The module of balls does not contain
            ``"third_derivatives"``, which proofs over boxes use.

        Raises
        ------
        InputError
            If the backend or the part is unknown.
        CodeGenerationError
            If the backend lacks a function of H.

        Examples
        --------
        >>> H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
        >>> print(H.source("numpy", part="energy").splitlines()[0])
        def energy(z):
        """
        source = generate(self.real_equations, backend)
        return source.text if part is None else source.function(part)

    def compile(self, backend: str = "torch") -> System:
        """Make callables of the generated functions of one backend; cached.

        A function is derived and generated on first use. With ``"numba"`` it is compiled on its
        first call.

        Parameters
        ----------
        backend : {"torch", "numpy", "numba", "jax"}
            The functions of jax work in ``jit``, ``vmap`` and ``grad``; they compute in float64 if
            ``jax_enable_x64`` is set.

        Raises
        ------
        InputError
            If the backend is unknown, is only generated as text, or is not installed.

        Examples
        --------
        >>> H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
        >>> H.compile("numpy").vector_field([1.0, 2.0])
        array([ 2., -2.])
        """
        if backend in BACKENDS and not BACKENDS[backend].runs:
            raise InputError(
                f"'{backend}' is only generated, by H.source(\"{backend}\"); choose one of "
                f"{', '.join(runnable())} to compile"
            )
        require_known(backend, runnable(), "a backend")
        return load(generate(self.real_equations, backend))

    @cached_property
    def kernels(self) -> System:
        """The numba module of H with parameters as arguments: the same code for all values."""
        values = dict.fromkeys(self.parameter_names)
        equations = Equations(self.expr, self.z, self.time, values, self._force_column)
        return load(generate(equations, "numba"))


#: Type of the argument H of the solvers; see :meth:`Hamiltonian.of`.
HamiltonianLike: TypeAlias = Hamiltonian | str | sympy.Expr


def _finite(name: str, value: Any) -> np.ndarray:
    """Convert a finite number, or an array of finite numbers, to an array."""
    if np.ndim(value) == 0:
        require_number(name, value)
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array([])
    if not (array.size and np.isfinite(array).all()):
        raise InputError(f"{name} contains a value that is not a finite number; give numbers")
    return array


def _rebuild(
    expr: sympy.Expr,
    q: tuple[sympy.Symbol, ...],
    p: tuple[sympy.Symbol, ...],
    parameters: dict[str, float],
    units: dict[str, str],
    forces: dict[str, sympy.Expr],
) -> Hamiltonian:
    return Hamiltonian(expr, q=q, p=p, parameters=parameters, units=units, forces=forces)
