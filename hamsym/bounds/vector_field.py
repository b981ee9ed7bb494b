"""Hamilton's equations in the arithmetic of models."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from hamsym.bounds.models import ARITHMETIC, PLACES, Models
from hamsym.codegen.functions import compile_straight_line
from hamsym.codegen.straight_line import inserted_parameters
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.exact import rational
from hamsym.symbolic.variables import TIME

_SHORT_POLYNOMIAL = 8  # degree of a vector field that hides nothing between the places of a march


@dataclass(frozen=True)
class ModelField:
    """The vector field of H in models.

    Attributes
    ----------
    varied : list of int
        Numbers of the parameters that are arguments; the others are in exponents.
    is_short_polynomial : bool
        Whether the rates are polynomials of low degree, which are resolved wherever z^ is.
    """

    varied: list[int]
    is_short_polynomial: bool
    _run: Callable[..., list[Any]]

    def __call__(self, z: list[Models], t: Models, parameters: np.ndarray) -> list[Models]:
        """Bound the rates on intervals.

        Parameters
        ----------
        z : list of Models
            Components of the state.
        t : Models
        parameters : numpy.ndarray
            Of H, or for each interval, shape (k,) or (n, k).
        """
        given = (parameters[..., k] for k in self.varied)
        rates = self._run(ARITHMETIC, *z, t, *given)
        return [rate if isinstance(rate, Models) else _constant(rate, t) for rate in rates]


def _constant(value: Any, like: Models) -> Models:
    count = len(like.error)
    values = np.broadcast_to(np.asarray(value, dtype=float).reshape(-1, 1), (count, PLACES))
    return Models.of_values(values)


@functools.lru_cache(maxsize=64)
def model_field(H: Hamiltonian) -> ModelField:
    """Compile the vector field of H for models."""
    form = H.real_equations
    inserted = inserted_parameters(form)
    values = {form.parameters[name][0]: rational(value) for name, value in inserted.items()}
    exact = (form.exact.with_fractions(rate, values) for rate in form.exact.vector_field)
    rates = [_with_numbers(rate.xreplace(values)) for rate in exact]
    varied = [k for k, name in enumerate(form.parameters) if name not in inserted]
    own = [symbol for symbol, _ in form.parameters.values()]
    time = form.time or sympy.Symbol(TIME, real=True)
    symbols = [*form.z, time, *(own[k] for k in varied)]
    return ModelField(
        varied, _is_short_polynomial(form, rates), compile_straight_line(rates, symbols)
    )


def _with_numbers(rate: sympy.Expr) -> sympy.Expr:
    """Insert the values of constants that straight-line code has no name for."""
    constants = rate.atoms(sympy.NumberSymbol) - {sympy.pi, sympy.E}
    return rate.xreplace({constant: rational(float(constant)) for constant in constants})


def _is_short_polynomial(form: Equations, rates: list[sympy.Expr]) -> bool:
    variables = [*form.z, *([] if form.time is None else [form.time])]
    if not all(rate.is_polynomial(*variables) for rate in rates):
        return False
    return all(
        sum(exponent for exponent in sympy.Poly(term, *variables).degree_list())
        <= _SHORT_POLYNOMIAL
        for rate in rates
        for term in sympy.Add.make_args(rate)
        if term.free_symbols & set(variables)
    )
