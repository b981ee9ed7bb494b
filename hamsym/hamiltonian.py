"""The Hamiltonian as a symbolic object.

Input:  a formula or a sympy expression, pairs of coordinates and momenta, parameter values.
Output: Hamilton's equations, the Hessian and quantities derived from them, as sympy objects;
        source text and callables for each backend, by :mod:`hamsym.codegen.generate`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NoReturn, TypeAlias

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.codegen.generate import generate
from hamsym.codegen.names import Names
from hamsym.codegen.system import System, load
from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.formula.parser import canonical_name
from hamsym.formula.printer import FormulaPrinter
from hamsym.support.validation import require, require_number
from hamsym.symbolic import brackets, derivatives
from hamsym.symbolic.checks import name_of
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.pairing import natural_order
from hamsym.symbolic.states import parameter_arrays, state_array, states_array
from hamsym.symbolic.variables import TIME, assign_variables

__all__ = ["Hamiltonian", "HamiltonianLike"]


class Hamiltonian:
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

    Raises
    ------
    ParseError
        If the text is not a formula.
    VariableError
        If the pairs are ambiguous, missing, or do not fit the expression.
    ParameterError
        If a value is not a finite real number or belongs to no symbol of H.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    >>> H.q, H.p
    ((x,), (p,))
    >>> list(H.vector_field)
    [p, -x**3 - x]
    >>> H.is_separable, H.sigma_min
    (True, 1)
    """

    def __init__(
        self,
        expression: str | sympy.Expr,
        *,
        q: Sequence[str | sympy.Symbol] | None = None,
        p: Sequence[str | sympy.Symbol] | None = None,
        parameters: Mapping[Any, float] | None = None,
    ) -> None:
        # __setattr__ raises.
        self.__dict__.update(assign_variables(expression, q, p, parameters)._asdict())

    expr: sympy.Expr
    q: tuple[sympy.Symbol, ...]
    p: tuple[sympy.Symbol, ...]
    z: tuple[sympy.Symbol, ...]
    #: Values of the parameters that have a value, by name.
    parameters: Mapping[str, float]
    #: The symbol t if H depends on time explicitly, else None.
    time: sympy.Symbol | None

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
        return (real.expr, *(symbol.name for symbol in self.z), *sorted(self.parameters.items()))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Hamiltonian):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = (self.expr, self.q, self.p, dict(self.parameters))
        return (_rebuild, arguments)

    def __str__(self) -> str:
        return self.formula

    def __repr__(self) -> str:
        pairs = ", ".join(f"({q}, {p})" for q, p in zip(self.q, self.p, strict=True))
        values = "".join(f", {name}={value:g}" for name, value in self.parameters.items())
        return f"Hamiltonian({self.formula!r}, pairs {pairs}{values})"

    def _repr_latex_(self) -> str:
        arguments = ", ".join(sympy.latex(symbol) for symbol in self.z)
        return rf"$\displaystyle H({arguments}) = {sympy.latex(self.expr)}$"

    @cached_property
    def formula(self) -> str:
        """H as text, with the terms in conventional order; parsing it gives H again."""
        return FormulaPrinter()(self.expr)

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
        names = {symbol.name for symbol in self.expr.free_symbols if symbol not in known}
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
        return Hamiltonian(self.expr, q=self.q, p=self.p, parameters=merged)

    @classmethod
    def of(cls, H: HamiltonianLike) -> Hamiltonian:
        """Convert a Hamiltonian or a formula to a Hamiltonian with a value for every parameter.

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
        """H and its derivatives in real symbols, for code generation and proofs."""
        values = {name: self.parameters.get(name) for name in self.parameter_names}
        return Equations(self.expr, self.z, self.time, values)

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
        """Right-hand side J grad H of Hamilton's equations, a column of length dim."""
        return sympy.ImmutableDenseMatrix([self._own(e) for e in self.real_equations.vector_field])

    @cached_property
    def equations(self) -> list[sympy.Eq]:
        """Hamilton's equations, one per component of z (the paper's eq. hamEqs).

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2").equations
        [Eq(Derivative(x, t), p), Eq(Derivative(p, t), -x)]
        """
        used = set(self.names) | set(self.parameter_names)
        time = self.time or sympy.Symbol(TIME if TIME not in used else "time", real=True)
        return [
            sympy.Eq(sympy.Derivative(component, time, evaluate=False), rate, evaluate=False)
            for component, rate in zip(self.z, self.vector_field, strict=True)
        ]

    @property
    def is_separable(self) -> bool:
        """Whether H = T(p) + V(q): all mixed second derivatives vanish identically."""
        return self.real_equations.is_separable

    @cached_property
    def _split(self) -> tuple[sympy.Expr, sympy.Expr] | None:
        if not self.is_separable:
            return None
        return derivatives.split(
            self.real_equations.expr,
            self.real_equations.z[: self.dof],
            self.real_equations.z[self.dof :],
        )

    @property
    def kinetic(self) -> sympy.Expr | None:
        """Kinetic energy T(p) of a separable H = T(p) + V(q), else None."""
        return None if self._split is None else self._own(self._split[0])

    @property
    def potential(self) -> sympy.Expr | None:
        """Potential V(q) of a separable H = T(p) + V(q), all terms without p, else None."""
        return None if self._split is None else self._own(self._split[1])

    @cached_property
    def cyclic_coordinates(self) -> tuple[sympy.Symbol, ...]:
        """Coordinates on which H does not depend; their momenta are conserved.

        Examples
        --------
        >>> Hamiltonian("p_r**2/2 + p_phi**2/(2*r**2) - 1/r").cyclic_coordinates
        (phi,)
        """
        gradient = self.real_equations.gradient[: self.dof]
        return tuple(
            q for q, slope in zip(self.q, gradient, strict=True) if derivatives.vanishes(slope)
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
        return self._own(brackets.poisson_bracket(self._function(f), self._function(g), z))

    def is_conserved(self, f: str | sympy.Expr) -> bool:
        """Whether f is constant along every trajectory: {f, H} + df/dt = 0.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.is_conserved("x*p_y - y*p_x"), H.is_conserved("p_x")
        (True, False)
        """
        real, function = self.real_equations, self._function(f)
        is_state = TIME in {*self.names, *self.parameters}
        time = None if is_state else sympy.Symbol(TIME, real=True)
        return derivatives.vanishes(brackets.evolution(function, real.expr, real.z, time))

    def _function(self, f: str | sympy.Expr) -> sympy.Expr:
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
            If f has a symbol that does not occur in H.
        ParameterError
            If f has a parameter without a value.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.observable("x*p_y - y*p_x")([0.4, 0.0, 0.0, 2.0])
        np.float64(0.8)
        """
        expr = self._function(f)
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

    @cached_property
    def variational_equations(self) -> list[sympy.Eq]:
        """Linear equations of a small deviation, d(delta)/dt = J Hess(z) delta.

        Examples
        --------
        >>> Hamiltonian("p**2/2 + x**2/2 + x**4/4").variational_equations[1]
        Eq(Derivative(delta_p, t), delta_x*(-3*x**2 - 1))
        """
        time = self.equations[0].lhs.args[1][0]
        taken = [symbol.name for symbol in self.expr.free_symbols]
        generator = self.poisson_matrix * self.hessian
        return brackets.variational_equations(generator, self.names, time, taken)

    @cached_property
    def sigma_min(self) -> sympy.Expr | None:
        """Smallest singular value of the Hessian in closed form, in real symbols, or None.

        The Hessian is symmetric, so its singular values are the magnitudes of its eigenvalues.
        They have a closed form if the Hessian falls into blocks of at most 2 x 2 (after a
        permutation).

        Examples
        --------
        >>> H = Hamiltonian("(px**2 + py**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
        >>> H.sigma_min
        Min(1, Abs(2*sqrt(x**2 + y**2) - 1))
        """
        return derivatives.smallest_singular_value(self.real_equations.hessian, self.dim)

    # -- generated code ----------------------------------------------------------------------

    def source(self, backend: str = "torch", part: str | None = None) -> str:
        """Generate the module, or one of its functions, as text.

        :meth:`compile` executes this text. As a file it depends only on its backend. The functions
        of ``"balls"``, which proofs execute, depend on nothing: their first argument is an
        arithmetic, of balls for example.

        Parameters
        ----------
        backend : {"torch", "numpy", "numba", "balls"}
        part : str, optional
            The name of one function, such as ``"loss"``. The module of balls does not contain
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
        backend : {"torch", "numpy", "numba"}

        Raises
        ------
        InputError
            If the backend is unknown, or ``"balls"``.

        Examples
        --------
        >>> H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
        >>> H.compile("numpy").vector_field([1.0, 2.0])
        array([ 2., -2.])
        """
        if backend == "balls":
            raise InputError(
                "functions of 'balls' have no arrays, but an arithmetic as their first argument; "
                'show them by H.source("balls"), or compile torch, numpy or numba'
            )
        return load(generate(self.real_equations, backend))

    @cached_property
    def kernels(self) -> System:
        """The numba module of H with parameters as arguments: the same code for all values."""
        values = dict.fromkeys(self.parameter_names)
        return load(generate(Equations(self.expr, self.z, self.time, values), "numba"))


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
) -> Hamiltonian:
    return Hamiltonian(expr, q=q, p=p, parameters=parameters)
