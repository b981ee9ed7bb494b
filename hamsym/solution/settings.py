"""What was asked of a solution: the arguments of solve beside H, z0 and the method, as data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

import hamsym
from hamsym.problems.problem import InitialValueProblem
from hamsym.solution.window_error import allowed_errors
from hamsym.support.method_object import Method
from hamsym.support.record_fields import Count, Limit, Size

_MOST_OPTIONS = 100
_LONGEST_TEXT = 10_000
_Names = Annotated[tuple[str, ...], Limit(most=_MOST_OPTIONS)]


@dataclass(frozen=True)
class Settings:
    """Arguments with which :func:`hamsym.solve` was called, beside H, z0 and the method's name."""

    #: The times that were asked for; a solution that had to stop spans fewer.
    span: tuple[float, float]
    #: Relative tolerance, given or by default.
    tol: float
    #: Whether it was given: a training then stops when it is met.
    tol_given: bool = True
    #: Absolute tolerance, one, or one for each component, in the units of the components.
    atol: tuple[Size, ...] = (0.0,)
    #: Times at which a window ends.
    breakpoints: tuple[float, ...] = ()
    seed: Count = 0
    prove: bool = False
    invariants: _Names = ()
    #: Options of the method that were given: numbers, texts, None, and lists of them.
    options: Mapping[str, Any] = field(default_factory=dict)
    #: Names of further options, with values that are not data, for example a network of one's own.
    missing: _Names = ()
    #: Version of hamsym that solved.
    version: str = field(default_factory=lambda: hamsym.__version__)

    @classmethod
    def of(cls, problem: InitialValueProblem, method: Method) -> Settings:
        """Record what is asked of the solution of a problem by a method."""
        plain: dict[str, Any] = {}
        for name, value in method.given.items():
            try:
                plain[name] = _plain(value)
            except ValueError:
                continue
        return cls(
            problem.span,
            problem.tol,
            problem.tol_given,
            problem.atol,
            problem.breakpoints,
            problem.seed,
            problem.prove,
            problem.invariants.formulas if problem.invariants else (),
            plain,
            tuple(sorted({*method.given} - {*plain})),
        )

    def allowed(self, scale: np.ndarray) -> np.ndarray:
        """Return the error that is allowed of components of these sizes, shape (dim,).

        Examples
        --------
        >>> Settings((0.0, 1.0), 1e-6).allowed(np.array([1.0, 100.0])).round(8)
        array([1.e-06, 1.e-04])
        """
        return allowed_errors(self.tol, self.atol, scale)

    def check(self) -> None:
        """Raise ValueError unless its numbers and texts are those of a call."""
        if not 0 < self.tol < 1:
            raise ValueError("its tol is out of range")
        if not all(min(self.span) < stop < max(self.span) for stop in self.breakpoints):
            raise ValueError("a breakpoint is not inside its span")
        for text in (*self.invariants, *self.missing, self.version):
            _text("settings", text)
        if {name: _plain(value) for name, value in self.options.items()} != self.options:
            raise ValueError("its options are not data")

    def require_method(self, names: set[str], dim: int, span: tuple[float, float]) -> None:
        """Raise ValueError unless it belongs to a method with these options and to this span."""
        if not {*self.options, *self.missing} <= names:
            raise ValueError("it was asked for an option that its method has not")
        if len(self.missing) > len({*self.missing} - {*self.options}):
            raise ValueError("it was asked for an option twice")
        if len(self.atol) not in (1, dim):
            raise ValueError("its atol is not one tolerance, or one for each component")
        (start, end), (first, last) = self.span, span
        if start != first or not (start < last <= end or start > last >= end):
            raise ValueError("it does not lie in the span that was asked for")


def _plain(value: Any) -> Any:
    """Return a value as JSON has it, lists for tuples and arrays.

    Raise ValueError if it is not data.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if type(value).__name__ in ("dtype", "device") and type(value).__module__ == "torch":
        value = str(value).removeprefix("torch.")
    if isinstance(value, list | tuple):
        if len(value) > _MOST_OPTIONS * 100:
            raise ValueError("an option has too many parts")
        return [_single(part) for part in value]
    return _single(value)


def _single(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return _text("option", value)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("an option is not finite")
    if isinstance(value, int) and abs(value) >= 2**63:
        raise ValueError("an option is too large")
    if type(value) not in (bool, int, float, type(None)):
        raise ValueError("an option is not data")
    return value


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT:
        raise ValueError(f"'{name}' is not a text of at most {_LONGEST_TEXT:,} characters")
    return value
