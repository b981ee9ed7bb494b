"""Generated functions of H in an arithmetic: of balls, of Taylor series or of Taylor models.

Input:  a Hamiltonian; its derivatives are those of :class:`~hamsym.symbolic.equations.Equations`,
        with floating-point numbers as the exact binary fractions that they are.
Output: its functions for ``balls`` (:mod:`hamsym.codegen.straight_line`), with exact values of
        parameters, and with the name of a subexpression where one is not smooth.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from fractions import Fraction
from functools import partial
from typing import Any

import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.codegen.generate import generate
from hamsym.codegen.names import Names
from hamsym.codegen.straight_line import described, inserted_parameters, without_arithmetic
from hamsym.codegen.system import load
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError
from hamsym.symbolic.exact import rational


class GeneratedFunctions:
    """The functions of a Hamiltonian in an arithmetic.

    Raise CertificationError if H contains a function that is not smooth or has no enclosure.

    - H: With a value for every parameter that does not vary.
    - varied: Parameters that are arguments of the functions.
    - keywords: The arguments of the parameters that vary, in the order of ``varied``.
    """

    def __init__(
        self, H: Hamiltonian, arithmetic: Arithmetic, varied: Collection[str] = ()
    ) -> None:
        own = H.real_equations
        require_smooth(own.expr)  # a kink of H may be absent from its derivatives
        for force in own.forces:
            require_smooth(force, "a force or its derivatives contain")
        values = {
            name: None if name in varied else value for name, (_, value) in own.parameters.items()
        }
        form = own.with_values(values) if varied else own
        names = [keyword for keyword, _ in Names(form).parameters]
        keywords = dict(zip(form.parameters, names, strict=True))
        inserted = inserted_parameters(form)
        self.keywords = [keywords[name] for name in varied]
        self._values = {
            keywords[name]: Fraction(value)
            for name, value in values.items()
            if value is not None and name not in inserted
        }
        self._arithmetic, self._forced = arithmetic, bool(H.forces)
        self._system = load(generate(form, "balls"))
        self._functions: dict[str, Callable[..., Any]] = {}

    def __call__(self, name: str, state: Sequence[Any], t: Any, **varied: Any) -> Any:
        """A function of the generated module.

        Raise SingularityError if the arguments contain a point where H is not smooth.
        """
        if name == "jacobian" and not self._forced:
            return self._jacobian(state, t, **varied)
        if name not in self._functions:
            function = self._system.function(name)
            self._functions[name] = partial(evaluated, function, self._arithmetic)
        number = self._arithmetic.number
        for keyword, value in self._values.items():
            varied[keyword] = number(value.numerator, value.denominator)
        return self._functions[name](*state, t, **varied)

    def _jacobian(self, state: Sequence[Any], t: Any, **varied: Any) -> dict[tuple[int, int], Any]:
        """DF without forces, by row and column, where it is not zero everywhere."""
        found, dof = {}, len(state) // 2
        for (i, j), entry in self("hessian", state, t, **varied).items():
            for row, column in {(i, j), (j, i)}:
                if row >= dof:
                    found[row - dof, column] = entry
                else:
                    found[row + dof, column] = -entry
        return found


class ParameterSlopes:
    """The derivatives of the rates by parameters, in any arithmetic.

    - places: Component and number of the parameter, of those that do not vanish.
    """

    def __init__(self, H: Hamiltonian, unknown: Sequence[str]) -> None:
        own = H.real_equations
        values = {s: value for n, (s, value) in own.parameters.items() if n not in unknown}
        known = {s: value for s, value in values.items() if value is not None}
        rates = [own.exact.with_fractions(entry, known) for entry in own.exact.vector_field]
        found = {
            (i, k): slope
            for k, name in enumerate(unknown)
            for i, rate in enumerate(rates)
            if (slope := sympy.diff(rate, own.parameters[name][0])) != 0
        }
        self.places = list(found)
        exact = {s: rational(v) for s, v in known.items()}
        symbols = [
            *own.z,
            *(own.parameters[name][0] for name in unknown),
            own.time or sympy.Dummy("t"),
        ]
        entries = [entry.xreplace(exact) for entry in found.values()]
        self._function = compile_straight_line(entries, symbols) if found else None

    def __call__(
        self, arithmetic: Arithmetic, state: Sequence[Any], parameters: Sequence[Any], t: Any
    ) -> list[Any]:
        """The derivatives, in the order of the places.

        Raise SingularityError if the arguments contain a point where one is not smooth.
        """
        if self._function is None:
            return []
        return list(evaluated(self._function, arithmetic, *state, *parameters, t))


def evaluated(function: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
    """The result of a generated function.

    Raise SingularityError if an operation has no result; with the subexpression, in the caller's
    symbols.
    """
    try:
        return function(*arguments, **keywords)
    except (SingularityError, ZeroDivisionError, ValueError) as error:
        text, place = "", error.__traceback__
        while place is not None:
            if place.tb_frame.f_code is function.__code__:
                text = described(function.__code__.co_filename, place.tb_lineno)
            place = place.tb_next
        raise SingularityError(text or "a term") from None


def require_smooth(expression: sympy.Expr, where: str = "H or its derivatives contain") -> None:
    """Refuse an expression with a function that is not smooth or has no enclosure.

    Raises
    ------
    CertificationError
        Naming the function.
    """
    name = without_arithmetic(expression)
    if name is not None:
        raise CertificationError(
            f"{where} '{name}', which has no enclosure by Taylor series; a proof needs H in smooth "
            "functions"
        )
