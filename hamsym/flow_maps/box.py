"""Boxes of initial states and parameters.

Input:  a Hamiltonian, initial states and parameters, some of them intervals (low, high).
Output: a :class:`Box`, which converts between its inputs and initial states with parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.flow_maps.expansion import plain
from hamsym.formula.parser import canonical_name, parse_expression
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.record_fields import floats
from hamsym.support.suggestions import did_you_mean, unknown
from hamsym.support.validation import checked_mapping, checked_numbers
from hamsym.symbolic.checks import name_of
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.states import by_component

_SLACK = 1e-12  # of the width of an interval, by which round-off may leave it


@dataclass(frozen=True)
class Box:
    """Initial states and parameters, of which some vary in intervals.

    The quantities that vary are called inputs: components of z0, then parameters.
    """

    #: With a value for every parameter; those that vary have the centre of their interval.
    H: Hamiltonian
    #: The inputs.
    names: tuple[str, ...]
    #: low, high: Ends of their intervals.
    low: Annotated[np.ndarray, floats("inputs")]
    high: Annotated[np.ndarray, floats("inputs")]
    #: Components of z0 that do not vary.
    fixed: Mapping[str, float]
    #: Components of z0 that are functions of parameters.
    expressions: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def components(self) -> tuple[str, ...]:
        """Components of z0 that are inputs."""
        return tuple(name for name in self.names if name in self.H.names)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Inputs that are not components of z0; some may occur only in the expressions of z0."""
        return self.names[len(self.components) :]

    @property
    def is_whole(self) -> bool:
        """Whether every component of z0 varies."""
        return len(self.components) == self.H.dim

    def check(self) -> None:
        """Raise ValueError unless it is a box as :func:`checked_box` makes them."""
        names, components = self.names, self.components
        distinct = len(set(names)) == len(names) == len(self.low) > 0
        if not (distinct and (self.low < self.high).all()):
            raise ValueError("its box has no intervals")
        if names[: len(components)] != components:
            raise ValueError("its box has components of z0 after parameters")
        if sorted([*components, *self.fixed, *self.expressions]) != sorted(self.H.names):
            raise ValueError("its box does not give every component of z0 once")
        known = {*map(canonical_name, self.H.parameter_names), *_names_in(self.expressions)}
        if not {*map(canonical_name, self.parameters)} <= known:
            raise ValueError("its box varies what neither H nor an expression contains")
        self.states(self.at(np.zeros((1, len(self)))))  # raises for expressions of other symbols

    def at(self, y: np.ndarray) -> np.ndarray:
        """Return the inputs of scaled ones; within the box for y in [-1, 1]."""
        inputs = 0.5 * ((1 - y) * self.low + (1 + y) * self.high)
        return np.clip(inputs, self.low, self.high) if np.abs(y).max(initial=0) <= 1 else inputs

    def states(self, inputs: np.ndarray) -> np.ndarray:
        """Return the initial states of inputs of shape (n, d); shape (n, dim)."""
        found = np.empty((len(inputs), self.H.dim))
        for i, name in enumerate(self.H.names):
            if name in self.fixed:
                found[:, i] = self.fixed[name]
            elif name in self.components:
                found[:, i] = inputs[:, self.names.index(name)]
        if self.expressions:
            places = [self.H.names.index(name) for name in self.expressions]
            with np.errstate(all="ignore"):
                found[:, places] = self._curves(inputs)
        return found

    def values(self, inputs: np.ndarray) -> dict[str, np.ndarray]:
        """Return the parameters of H that vary, each of shape (n,)."""
        return {
            name: inputs[:, self.names.index(name)]
            for name in self.parameters
            if name in self.H.parameter_names
        }

    @property
    def symbols(self) -> list[sympy.Symbol]:
        """Symbols of the inputs in ``formulas``."""
        return [sympy.Symbol(name, real=True) for name in self.names]

    @cached_property
    def formulas(self) -> dict[str, sympy.Expr]:
        """The expressions, by component."""
        known = {
            canonical_name(name): symbol
            for name, symbol in zip(self.names, self.symbols, strict=True)
        }
        parsed = {}
        for component, text in self.expressions.items():
            expr = parse_expression(text)
            swap = {}
            for symbol in expr.free_symbols:
                found = known.get(canonical_name(symbol.name))
                if found is None or found.name not in self.parameters:
                    raise VariableError(
                        f"'{symbol.name}' in the expression of '{component}' is not a parameter "
                        f"that varies; give it an interval in parameters"
                    )
                swap[symbol] = found
            parsed[component] = expr.xreplace(swap)
        return parsed

    @cached_property
    def _curves(self) -> Callable[..., np.ndarray]:
        """The expressions as a function of the inputs."""
        return compiled_in([*self.formulas.values()], self.symbols)

    # -- conversion of queries ------------------------------------------------------------------

    def inputs_of(self, z0: Any, parameters: Mapping[Any, Any] | None) -> dict[str, Any]:
        """Return the given values of all inputs by name, as they were given.

        Raise InputError if one is missing or unknown, or a component that does not vary has another
        value.
        """
        given = self._components_of(z0)
        found = {}
        for name in self.components:
            if name not in given:
                raise VariableError(f"'{name}' is missing in z0; give {', '.join(self.components)}")
            found[name] = given.pop(name)
        for name, value in given.items():
            if name in self.expressions:
                raise VariableError(
                    f"'{name}' is given by the parameters, {self.expressions[name]}; leave it out "
                    "of z0"
                )
            if not np.all(checked_numbers(name, plain(value)) == self.fixed[name]):
                raise VariableError(
                    f"'{name}' is {self.fixed[name]:g} for all starts of this map; leave it out of "
                    "z0, or build a map in which it varies"
                )
        values = checked_mapping("parameters", parameters, '{"k": 1.0}')
        own = {canonical_name(name_of(key)): value for key, value in values.items()}
        for name in self.parameters:
            key = canonical_name(name)
            if key not in own:
                raise ParameterError(f"'{name}' is missing in parameters; give a value for it")
            found[name] = own.pop(key)
        if own:
            listed = ", ".join(self.parameters) or "none"
            raise ParameterError(
                f"'{min(own)}' is not a parameter that varies in this map"
                f"{did_you_mean(min(own), self.parameters)}; those are {listed}"
            )
        return found

    def _components_of(self, z0: Any) -> dict[str, Any]:
        names = self.H.names
        if z0 is None:
            return {}
        if isinstance(z0, Mapping):
            known = {canonical_name(name): name for name in names}
            found = {}
            for key, value in z0.items():
                name = known.get(canonical_name(name_of(key)))
                if name is None:
                    raise VariableError(unknown(name_of(key), names, "a component of z", "z0 has"))
                found[name] = value
            return found
        array = z0 if hasattr(z0, "detach") else checked_numbers("z0", z0)
        if not array.ndim or array.shape[-1] != self.H.dim:
            raise VariableError(
                f"z0 has shape {tuple(array.shape)}; its last axis must have the {self.H.dim} "
                f"components {', '.join(names)}"
            )
        return {name: array[..., i] for i, name in enumerate(names) if name not in self.expressions}

    def outside(self, inputs: np.ndarray) -> np.ndarray:
        """Return for inputs of shape (n, d) whether each is outside its interval or nan."""
        slack = _SLACK * (self.high - self.low)
        return ~((inputs >= self.low - slack) & (inputs <= self.high + slack))

    def described(self, inputs: np.ndarray) -> str:
        """Return inputs of shape (d,) as text."""
        return ", ".join(
            f"{name} = {value:.6g}" for name, value in zip(self.names, inputs, strict=True)
        )


def compiled_in(
    expressions: Sequence[sympy.Expr],
    symbols: Sequence[sympy.Symbol],
    time: sympy.Symbol | None = None,
) -> Callable[..., np.ndarray]:
    """Compile expressions to a function of values of symbols, shape (n, k), and of times."""
    # The equations only name the arguments; an even number of them is a state.
    extra = len(symbols) % 2
    named = [*symbols, *[sympy.Symbol("_unused", real=True)] * extra]
    dummy = Equations(sympy.Add(*(symbol**2 for symbol in named)), named, time, {})
    function = compile_expressions(expressions, dummy)
    return lambda values, *t: function(np.pad(values, ((0, 0), (0, extra))), *t)


def checked_box(H: HamiltonianLike, z0: Any, parameters: Mapping[Any, Any] | None) -> Box:
    """Return the box of intervals in z0 and parameters.

    Raise InputError if a value is not usable, or nothing varies.

    - z0: For each component of z an interval (low, high), a number, or an expression of parameters
      as text.
    - parameters: For parameters of H, and for symbols in the expressions of z0, an interval or a
      number.

    Examples
    --------
    >>> box = checked_box("p**2/2 + k*x**2/2", {"x": (1, 2), "p": 0}, {"k": (0.5, 1.5)})
    >>> box.names, box.low, box.high
    (('x', 'k'), array([1. , 0.5]), array([2. , 1.5]))
    >>> box.states(box.at(np.array([[0.0, 0.0]])))
    array([[1.5, 0. ]])
    """
    H = Hamiltonian.of(H, bound=False)
    given = _by_component(z0, H.names)
    intervals: dict[str, tuple[float, float]] = {}
    fixed: dict[str, float] = {}
    expressions: dict[str, str] = {}
    for name, value in given.items():
        if isinstance(value, str | sympy.Expr) and not isinstance(value, sympy.Number):
            expressions[name] = str(value)
        else:
            _sort(name, value, intervals, fixed)
    own = {canonical_name(name): name for name in H.parameter_names}
    numbers: dict[str, float] = {}
    varied: dict[str, tuple[float, float]] = {}
    used = _names_in(expressions)
    for key, value in checked_mapping("parameters", parameters, '{"k": (0.5, 2)}').items():
        name = own.get(canonical_name(name_of(key)), name_of(key))
        if canonical_name(name) not in own and canonical_name(name) not in used:
            listed = ", ".join(H.parameter_names) or "none"
            raise ParameterError(
                f"'{name}' is not a parameter of H or of an expression in z0"
                f"{did_you_mean(name, H.parameter_names)}; H has {listed}"
            )
        _sort(name, value, varied, numbers)
    unnamed = sorted(used - {canonical_name(name) for name in (*varied, *numbers)})
    if unnamed:
        raise ParameterError(
            f"'{unnamed[0]}' in an expression of z0 has no interval; give one in parameters"
        )
    for name in numbers:
        if canonical_name(name) not in own:
            raise ParameterError(
                f"'{name}' occurs only in z0 and is a number; write the number into the expression"
            )
    centres = {
        name: 0.5 * (low + high) for name, (low, high) in varied.items() if name in own.values()
    }
    H = Hamiltonian.of(H.with_parameters(**numbers, **centres) if numbers or centres else H)
    names = (*(name for name in H.names if name in intervals), *varied)
    if not names:
        raise InputError(
            "nothing varies; give an interval (low, high) for a component of z0 or a parameter, or "
            "use solve for one trajectory"
        )
    ends = np.array([intervals.get(name) or varied[name] for name in names])
    box = Box(H, names, ends[:, 0].copy(), ends[:, 1].copy(), fixed, expressions)
    box.check()  # raises for symbols that do not vary
    return box


def _names_in(expressions: Mapping[str, str]) -> set[str]:
    """Return the names in expressions, spelled out."""
    found = (parse_expression(text).free_symbols for text in expressions.values())
    return {canonical_name(symbol.name) for symbols in found for symbol in symbols}


def _by_component(z0: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return the entries of z0 by component, in the order of z."""
    if isinstance(z0, Mapping):
        return by_component(z0, names)
    try:
        entries = list(z0)
    except TypeError:
        entries = []
    if isinstance(z0, str) or len(entries) != len(names):
        raise VariableError(
            f"z0={z0!r} cannot be used; give an interval or a number for each of {', '.join(names)}"
        )
    return dict(zip(names, entries, strict=True))


def _sort(
    name: str, value: Any, intervals: dict[str, tuple[float, float]], numbers: dict[str, float]
) -> None:
    """Enter an interval or a number."""
    try:
        entries = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        entries = np.array(np.nan)
    if entries.shape == () and np.isfinite(entries):
        numbers[name] = float(entries)
        return
    if entries.shape != (2,) or not np.isfinite(entries).all():
        raise InputError(
            f"{name}={value!r} cannot be used; give a number or an interval (low, high)"
        )
    low, high = entries.tolist()
    width = high - low
    if not (low < high and np.isfinite(width) and width > 1e-13 * max(abs(low), abs(high))):
        raise InputError(
            f"{name}={value!r} is not an interval; give (low, high) with low below high"
        )
    intervals[name] = (low, high)
