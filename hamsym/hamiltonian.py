"""The Hamiltonian: what follows from its formula, states and numbers, and generated code.

Input:  a formula or a sympy expression, pairs of coordinates and momenta, parameter values.
Output: Hamilton's equations, the Hessian and quantities derived from them, as sympy objects, by
        :mod:`hamsym.symbolic.symbolic_hamiltonian`; source text and callables for each backend, by
        :mod:`hamsym.codegen.generate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

import numpy as np
import sympy

from hamsym.codegen.backends import BACKENDS, runnable
from hamsym.codegen.energy_levels import states_at_energy
from hamsym.codegen.generate import generate
from hamsym.codegen.observable import Observable, observable_of
from hamsym.codegen.system import System, load
from hamsym.errors import InputError, ParameterError
from hamsym.support.suggestions import checked_keywords, require_known, suggest_attributes
from hamsym.support.validation import require
from hamsym.symbolic.states import parameter_arrays, state_array, states_array
from hamsym.symbolic.symbolic_hamiltonian import SymbolicHamiltonian
from hamsym.symbolic.variables import TIME, assign_variables

if TYPE_CHECKING:
    from hamsym import Equilibria, Regularization, Transformation


@suggest_attributes
class Hamiltonian(SymbolicHamiltonian):
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
            If L is not quadratic in the velocities, or the mass matrix is singular; the message
            names them.

        Examples
        --------
        >>> Hamiltonian.from_lagrangian("m*xdot**2/2 - k*x**2/2")
        Hamiltonian('p_x**2/(2*m) + k*x**2/2', pairs (x, p_x))
        """
        from hamsym.symbolic.lagrangian import read_lagrangian

        read = read_lagrangian(expression, q, velocities, p, parameters)
        return cls(read.hamiltonian, q=read.q, p=read.p, parameters=read.parameters)

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

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(
            f"a Hamiltonian is immutable; make a new one instead of setting {name!r}"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise AttributeError(
            f"a Hamiltonian is immutable; make a new one instead of deleting {name!r}"
        )

    def _arguments(self) -> dict[str, Any]:
        """Keyword arguments that make this Hamiltonian of its expression."""
        mappings = {"units": dict(self.units), "forces": dict(self.forces)}
        return {"q": self.q, "p": self.p, "parameters": dict(self.parameters), **mappings}

    def __reduce__(self) -> tuple[Any, ...]:
        written = {"written": self.written}
        return partial(Hamiltonian, self.expr, **self._arguments()), (), written

    # -- states and parameters ---------------------------------------------------------------

    def with_parameters(self, /, **values: float) -> Hamiltonian:
        """Return the same Hamiltonian with other parameter values.

        Examples
        --------
        >>> H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1.0})
        >>> dict(H.with_parameters(m=2.0, k=4.0).parameters)
        {'k': 4.0, 'm': 2.0}
        """
        given = self._arguments()
        given["parameters"] |= values
        found = Hamiltonian(self.expr, **given)
        found.__dict__["written"] = self.written
        return found

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
        require(missing in ("raise", "nan"), "missing", missing, '"raise" or "nan"')
        given = parameter_arrays(parameters, self.parameter_names) if parameters else {}
        self._require_values([name for name in self.unbound_parameters if name not in given])
        return states_at_energy(self.real_equations, energy, z0, t, given, missing == "raise")

    def observable(self, f: str | sympy.Expr) -> Observable:
        """Compile a component or a formula with numpy, with its texts for labels.

        Figures, tables, animations, events and sweeps take the same names and formulas.

        Parameters
        ----------
        f : str or sympy.Expr
            A component, or a formula in the components of z, the parameters of H and the time t,
            parsed with the limits of a formula of H. ``H`` in it is the energy, unless H has a
            symbol of this name.

        Returns
        -------
        callable
            (z, t=0.0, parameters=None) of shapes (..., dim) and (...) -> (...). Parameters of
            shape (..., k), in the order of ``parameter_names``, replace the values of H. Its method
            ``values`` gives nan where there is no finite number; it has ``text``, ``latex`` and
            ``unit``.

        Raises
        ------
        InputError
            If f is neither text nor a sympy expression.
        ParseError
            If the text is not a formula.
        VariableError
            If f has a symbol that occurs neither in H nor in a force.
        ParameterError
            If f has a parameter without a value.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> momentum = H.observable("x*p_y - y*p_x")
        >>> momentum([0.4, 0.0, 0.0, 2.0])
        np.float64(0.8)
        >>> momentum.latex
        'p_{y} x - p_{x} y'
        """
        found = observable_of(self, f)
        used = {symbol.name for symbol in found.function.free_symbols}
        self._require_values([name for name in self.unbound_parameters if name in used])
        return found

    def equilibria(self, guess: Any = None, box: Any = None, **options: Any) -> Equilibria:
        """Find equilibria and their linear stability; see :func:`hamsym.equilibria`.

        Examples
        --------
        >>> [each.type for each in Hamiltonian("p**2/2 - x**2/2 + x**4/4").equilibria()]
        ['centre', 'centre', 'saddle']
        """
        import hamsym

        return hamsym.equilibria(self, guess, box, **options)

    def transformed(
        self,
        formulas: Mapping[Any, Any] | None = None,
        *,
        new: Sequence[str] | Mapping[str, str] | None = None,
        positive: str | Sequence[str] = (),
        **generating: str | sympy.Expr,
    ) -> Transformation:
        """Write H in other coordinates and momenta, by a canonical transformation.

        That it is canonical is decided by the Poisson brackets of the formulas, never by numbers.
        Units are not carried over.

        Parameters
        ----------
        formulas : mapping of name to str or sympy.Expr, optional
            Old variables in the new ones, in parameters of H and the time t: coordinates alone,
            whose momenta follow, or coordinates and momenta. Pairs without a formula stay.
        new : sequence of str, or mapping of coordinates to momenta, optional
            Names of the new variables; by default the further names in the formulas, and ``p_r``
            for ``r``.
        positive : str or sequence of str
            New variables that stay above zero, so that sqrt(r**2) is r; ``to_old`` refuses states
            in which they are not. A trajectory that comes back from below zero is not that of the
            old H any more, which no single state tells: look for events, as ``"r = 0"``.
        F1, F2, F3, F4 : str or sympy.Expr, optional
            A generating function of (q, Q), (q, P), (p, Q) or (p, P) in place of formulas.

        Returns
        -------
        Transformation
            With the new Hamiltonian ``H``, ``to_new`` and ``to_old``.

        Raises
        ------
        InputError
            If the transformation is not canonical, or this is not decided, or the new Hamiltonian
            is not found.
        VariableError
            If names do not fit.

        Examples
        --------
        >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> H.transformed({"x": "r*cos(phi)", "y": "r*sin(phi)"}, positive="r").H
        Hamiltonian('-1/r + p_phi**2/(2*r**2) + p_r**2/2', pairs (phi, p_phi), (r, p_r))
        >>> Hamiltonian("p**2/2 + x**2/2").transformed({"x": "2*X", "p": "P"})
        Traceback (most recent call last):
        ...
        hamsym.errors.InputError: the transformation is not canonical: {x, p} is 2 in the new \
variables, not 1
        """
        import hamsym

        return hamsym.transform(self, formulas, new=new, positive=positive, **generating)

    def regularized(
        self,
        kind: str | None = None,
        *,
        sundman: str | sympy.Expr | None = None,
        coordinates: Sequence[Any] | None = None,
        about: Mapping[str, Any] | None = None,
    ) -> Regularization:
        """Remove collisions: another Hamiltonian in extended phase space, and the way back.

        Parameters
        ----------
        kind : {"levi-civita", "kustaanheimo-stiefel", "heggie"}, optional
            For a collision in the plane or in space, or for those of three bodies in either.
        sundman : str or sympy.Expr, optional
            dt/ds > 0 in the variables of H, without other coordinates, in place of a kind.
        coordinates : sequence of str or of lists of str, optional
            The two or three coordinates that meet in the collision; by default all of H. Of three
            bodies a list for each, by default by the numbers at the ends of their names.
        about : mapping of str to number or str, optional
            Its place, by coordinate, also in parameters of H; by default the origin.

        Returns
        -------
        Regularization
            With the new Hamiltonian ``H``, ``start`` for its states, and ``to_old`` for times and
            states of this one.

        Raises
        ------
        InputError
            If H has forces, or another form than the kind needs.

        Examples
        --------
        >>> kepler = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> kepler.regularized(sundman="sqrt(x**2 + y**2)").H.names
        ('x', 'y', 'time', 'p_x', 'p_y', 'p_time')
        """
        import hamsym

        return hamsym.regularize(self, kind, sundman=sundman, coordinates=coordinates, about=about)

    # -- generated code ----------------------------------------------------------------------

    def source(self, backend: str = "torch", part: str | None = None) -> str:
        """Generate the module, or one of its functions, as text.

        :meth:`compile` executes this text. As a file it depends only on its backend. The functions
        of ``"balls"``, which proofs execute, depend on nothing: their first argument is an
        arithmetic, of balls for example.

        Parameters
        ----------
        backend : {"torch", "numpy", "numba", "jax", "c", "julia", "javascript", "balls"}
            ``"c"`` is C99, ``"julia"`` for DifferentialEquations.jl, ``"javascript"`` an ES module.
        part : str, optional
            The name of one function, such as ``"loss"``. C, Julia and JavaScript have no residual
            and no loss, but ``"jacobian"``, that of the vector field. The module of balls does not
            contain ``"third_derivatives"``, which proofs over boxes use.

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
        return load(generate(self.real_equations.free, "numba"))


#: Type of the argument H of the solvers; see :meth:`Hamiltonian.of`.
HamiltonianLike: TypeAlias = Hamiltonian | str | sympy.Expr
