"""Programs: formulas as rows of operations on registers, for compiled loops.

A recorder takes the place of the arguments of a formula and notes what is done with them.
Operations on numbers alone are done in Arb once. Functions become the operations of
:mod:`hamsym.kernel.enclosures` by identities that hold wherever the function is smooth.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb

from hamsym.kernel import enclosures as operations
from hamsym.kernel.enclosures import Models, enclosures
from hamsym.numerics.collocation import chebyshev_tables
from hamsym.proof.arithmetic import functions
from hamsym.proof.arithmetic.balls import number_of, working
from hamsym.proof.arithmetic.directed import up
from hamsym.proof.arithmetic.functions import Arithmetic

BITS = 240  # of numbers


class Program:
    """Operations on registers, of which the first hold the variables.

    - steps, still: Rows (operation, target, first, second); ``still`` are those that do not depend
      on the state, to be run first.
    - still_places: Registers that they set.
    - constants: Registers of numbers, shape (c,), and ``numbers`` their balls (high, low, radius),
      (c, 3).
    - results: Registers of the results.
    """

    def __init__(self, recorder: Recorder, results: Sequence[Any]) -> None:
        places = [recorder.place(result) for result in results]
        self.results = np.array(places, dtype=np.int64)
        steps = np.array(recorder.steps, dtype=np.int64).reshape(-1, 4)
        still = np.isin(steps[:, 1], list(recorder.still))
        self.steps, self.still = steps[~still], steps[still]
        pairs = self.still[self.still[:, 0] == operations.SINE_COSINE]
        self.still_places = np.concatenate([self.still[:, 1], pairs[:, 3]])
        known = recorder.constants
        self.constants = np.array([place for place, _ in known], dtype=np.int64)
        self.numbers = np.array([number_of(value) for _, value in known]).reshape(-1, 3)
        self.registers = recorder.count


class Recorder:
    """Records the operations of formulas in variables, which stand for its first registers.

    - state: Number of the first ones, which are the state; by default all. Of the sum of an angle
      of the state and of one that time turns, the latter is taken modulo 2 pi before they are
      added.
    """

    def __init__(self, variables: int, state: int | None = None) -> None:
        self.count = variables
        self.variables = [_Value(self, k) for k in range(variables)]
        self.steps: list[tuple[int, int, int, int]] = []
        self.constants: list[tuple[int, arb]] = []
        #: Registers that depend on variables, but not on the state.
        self.still = set(range(variables if state is None else state, variables))
        self._made: dict[int, tuple[int, _Value, _Value]] = {}
        self._pairs: dict[int, tuple[_Value, _Value]] = {}
        self._numbers: dict[str, int] = {}

    @property
    def arithmetic(self) -> Arithmetic:
        """The arithmetic whose operations are recorded."""
        return Arithmetic(self.apply)

    def place(self, value: Any) -> int:
        """The register of a value, a new one for a number."""
        if isinstance(value, _Value):
            return value.place
        with working(BITS):
            value = arb(value)
            key = value.str(80, more=True)
        if key not in self._numbers:
            self._numbers[key] = self._new()
            self.constants.append((self._numbers[key], value))
        return self._numbers[key]

    def _new(self) -> int:
        self.count += 1
        return self.count - 1

    def add_step(self, operation: int, first: Any, second: Any = None) -> _Value:
        a = self.place(first)
        b = 0 if second is None else self.place(second)
        target = self._new()
        self.steps.append((operation, target, a, b))
        operands = {a} if second is None else {a, b}
        if operands & self.still and operands <= self.still | self._known:
            self.still.add(target)
        self._made[target] = operation, _Value(self, a), _Value(self, b)
        return _Value(self, target)

    @property
    def _known(self) -> set[int]:
        return set(self._numbers.values())

    def apply(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """A function of values or numbers."""
        if not any(isinstance(argument, _Value) for argument in arguments):
            with working(BITS):
                return function(*arguments)
        if function in _OPERATORS:
            return self.add_step(_OPERATORS[function], *arguments)
        return _RULES[function](self, *arguments)

    # -- rules --------------------------------------------------------------------------------

    def sine_cosine(self, x: _Value) -> tuple[_Value, _Value]:
        if x.place not in self._pairs:
            angle = self._reduced(x)
            sine, cosine = self._new(), self._new()
            self.steps.append((operations.SINE_COSINE, sine, angle.place, cosine))
            if angle.place in self.still:
                self.still |= {sine, cosine}
            self._pairs[x.place] = _Value(self, sine), _Value(self, cosine)
        return self._pairs[x.place]

    def _reduced(self, angle: _Value) -> _Value:
        """The angle, whose part that depends on time alone is taken modulo 2 pi."""
        moving, still = self._parts(angle)
        if still is None:
            return angle
        reduced = self.add_step(operations.REDUCED_ANGLE, still)
        return reduced if moving is None else self.add_step(operations.ADD, moving, reduced)

    def _parts(self, value: _Value) -> tuple[_Value | None, _Value | None]:
        """A value as the sum of two, of which the second depends on time and not on the state."""
        if value.place in self.still:
            return None, value
        operation, a, b = self._made.get(value.place, (None, value, value))
        if operation in (operations.ADD, operations.SUBTRACT):
            first, second = self._parts(a), self._parts(b)
            if first[1] is not None or second[1] is not None:
                moving, still = (
                    self._joined(operation, *pair) for pair in zip(first, second, strict=True)
                )
                return moving, still
        elif operation == operations.NEGATE:
            moving, still = self._parts(a)
            if still is not None:
                return None if moving is None else -moving, -still
        elif operation == operations.MULTIPLY and {a.place, b.place} & self._known:
            number, other = (a, b) if a.place in self._known else (b, a)
            moving, still = self._parts(other)
            if still is not None:
                return None if moving is None else number * moving, number * still
        return value, None

    def _joined(self, operation: int, a: _Value | None, b: _Value | None) -> _Value | None:
        if a is None or b is None:
            return a if b is None else b if operation == operations.ADD else -b
        return self.add_step(operation, a, b)

    def angle(self, y: Any, x: Any) -> _Value:
        """2 atan(y / (r + x)), the same angle away from the negative half of the x axis."""
        squares = self.apply(operator.mul, x, x) + self.apply(operator.mul, y, y)
        below = squares * _reciprocal_root(squares) + x
        half = self.apply(functions.FUNCTIONS["atan"], y * _reciprocal(below))
        return half + half

    def power(self, base: Any, exponent: Any) -> Any:
        logarithm = self.apply(functions.logarithm, base)
        return self.apply(functions.FUNCTIONS["exp"], self.apply(operator.mul, exponent, logarithm))


def _recorded(function: Callable[..., Any], swapped: bool = False) -> Callable[..., Any]:
    """A method that records an operation."""
    return lambda self, *others: self.recorder.apply(
        function, *((*others, self) if swapped else (self, *others))
    )


class _Value:
    """A register of a recorder."""

    def __init__(self, recorder: Recorder, place: int) -> None:
        self.recorder, self.place = recorder, place

    __add__, __radd__ = _recorded(operator.add), _recorded(operator.add, swapped=True)
    __sub__, __rsub__ = _recorded(operator.sub), _recorded(operator.sub, swapped=True)
    __mul__, __rmul__ = _recorded(operator.mul), _recorded(operator.mul, swapped=True)
    __neg__ = _recorded(operator.neg)


def _reciprocal(x: _Value) -> _Value:
    return x.recorder.add_step(operations.RECIPROCAL, x)


def _reciprocal_root(x: _Value) -> _Value:
    return x.recorder.add_step(operations.RECIPROCAL_ROOT, x)


def _exponential(x: _Value) -> _Value:
    return x.recorder.add_step(operations.EXPONENTIAL, x)


def _tangent(recorder: Recorder, x: _Value) -> _Value:
    sine, cosine = recorder.sine_cosine(x)
    return sine * _reciprocal(cosine)


def _hyperbolic(add: Callable[..., Any]) -> Callable[..., Any]:
    """The rule of cosh or sinh, half the sum or the difference of two exponentials."""

    def rule(_: Recorder, x: _Value) -> _Value:
        growth = _exponential(x)
        return 0.5 * add(growth, _reciprocal(growth))

    return rule


def _bell(x: _Value) -> _Value:
    with working(BITS):
        return 2 / arb.pi().sqrt() * _exponential(-(x * x))


def _integral(operation: int, slope: Callable[[_Value], _Value]) -> Callable[..., Any]:
    """The rule of a function whose operation also takes its derivative."""
    return lambda recorder, x: recorder.add_step(operation, x, slope(x))


_OPERATORS: dict[Any, int] = {
    operator.add: operations.ADD,
    operator.sub: operations.SUBTRACT,
    operator.mul: operations.MULTIPLY,
    operator.neg: operations.NEGATE,
    functions.reciprocal: operations.RECIPROCAL,
    functions.reciprocal_root: operations.RECIPROCAL_ROOT,
    functions.FUNCTIONS["exp"]: operations.EXPONENTIAL,
}
_INTEGRALS: dict[str, tuple[int, Callable[[_Value], _Value]]] = {
    "log": (operations.LOGARITHM, _reciprocal),
    "atan": (operations.ARCTANGENT, lambda x: _reciprocal(1 + x * x)),
    "asin": (operations.ARCSINE, lambda x: _reciprocal_root(1 - x * x)),
    "acos": (operations.ARCCOSINE, lambda x: -_reciprocal_root(1 - x * x)),
    "asinh": (operations.ARSINH, lambda x: _reciprocal_root(1 + x * x)),
    "acosh": (operations.ARCOSH, lambda x: _reciprocal_root((x - 1) * (1 + x))),
    "atanh": (operations.ARTANH, lambda x: _reciprocal((1 - x) * (1 + x))),
    "erf": (operations.ERROR_FUNCTION, _bell),
}
_RULES: dict[Any, Callable[..., Any]] = {
    functions.root: lambda _, x: x * _reciprocal_root(x),
    functions.general_power: Recorder.power,
    functions.FUNCTIONS["sin"]: lambda recorder, x: recorder.sine_cosine(x)[0],
    functions.FUNCTIONS["cos"]: lambda recorder, x: recorder.sine_cosine(x)[1],
    functions.FUNCTIONS["tan"]: _tangent,
    functions.FUNCTIONS["sinh"]: _hyperbolic(operator.sub),
    functions.FUNCTIONS["cosh"]: _hyperbolic(operator.add),
    functions.FUNCTIONS["tanh"]: lambda _, x: 1 - 2 * _reciprocal(1 + _exponential(x + x)),
    functions.FUNCTIONS["atan2"]: Recorder.angle,
    **{functions.FUNCTIONS[name]: _integral(*rule) for name, rule in _INTEGRALS.items()},
}


@dataclass(frozen=True, eq=False)
class Rows:
    """Some models: arrays of shape (n, terms), (n, terms), (n,) and (n,)."""

    high: np.ndarray
    low: np.ndarray
    radius: np.ndarray
    length: np.ndarray

    def __getitem__(self, part: slice) -> Rows:
        return Rows(self.high[part], self.low[part], self.radius[part], self.length[part])


class ModelRows:
    """The registers of a program as models."""

    def __init__(self, program: Program, terms: int) -> None:
        self.program = program
        rows = program.registers
        self.high, self.low = np.zeros((rows, terms)), np.zeros((rows, terms))
        self.radius, self.length = np.zeros(rows), np.ones(rows, dtype=np.int64)
        guesses = chebyshev_tables(terms)
        #: The same arrays for the library.
        self.models = Models(
            *(guesses.values, guesses.series),
            *(self.high, self.low, self.radius, self.length),
        )
        self._set_constants()

    def _set_constants(self) -> None:
        places, numbers = self.program.constants, self.program.numbers
        self.high[places, 0], self.low[places, 0] = numbers[:, 0], numbers[:, 1]
        self.radius[places], self.length[places] = numbers[:, 2], 1

    def set_line(
        self, row: int, middle: tuple[float, float, float], slope: tuple[float, float, float]
    ) -> None:
        """Put middle + slope x, of balls, into a register."""
        self.high[row, :2] = middle[0], slope[0]
        self.low[row, :2] = middle[1], slope[1]
        self.radius[row] = up(middle[2] + slope[2])
        self.length[row] = 2

    def set_number(self, row: int, number: tuple[float, float, float]) -> None:
        """Put a ball into a register."""
        self.high[row, 0], self.low[row, 0], self.radius[row] = number
        self.length[row] = 1

    def set_models(self, first: int, models: Rows) -> None:
        """Put models into consecutive registers."""
        part = slice(first, first + len(models.radius))
        terms = models.high.shape[1]
        self.high[part, :terms], self.low[part, :terms] = models.high, models.low
        self.radius[part], self.length[part] = models.radius, models.length

    def run(self, *, double: bool) -> None:
        """Run the program, in twice float64 or, but for what is still, in float64."""
        self.run_still()
        if not double:
            self.radius += up(np.abs(self.low).sum(axis=1))
            self.low[:] = 0.0
        enclosures().run_models(self.program.steps, self.models, double)

    def run_still(self) -> None:
        """Run what does not depend on the state, in twice float64."""
        self._set_constants()
        if len(self.program.still):
            enclosures().run_models(self.program.still, self.models, twice=True)

    def taken(self, places: np.ndarray) -> Rows:
        """Some registers."""
        return Rows(self.high[places], self.low[places], self.radius[places], self.length[places])
