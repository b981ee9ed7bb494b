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

from hamsym.codegen.generate import generate
from hamsym.codegen.names import Names
from hamsym.codegen.straight_line import described, inserted_parameters, without_arithmetic
from hamsym.codegen.system import load
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError


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
        self._arithmetic = arithmetic
        self._system = load(generate(form, "balls"))
        self._functions: dict[str, Callable[..., Any]] = {}

    def __call__(self, name: str, state: Sequence[Any], t: Any, **varied: Any) -> Any:
        """A function of the generated module.

        Raise SingularityError if the arguments contain a point where H is not smooth.
        """
        if name not in self._functions:
            function = self._system.function(name)
            self._functions[name] = partial(evaluated, function, self._arithmetic)
        number = self._arithmetic.number
        for keyword, value in self._values.items():
            varied[keyword] = number(value.numerator, value.denominator)
        return self._functions[name](*state, t, **varied)


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
