"""Hamilton's equations as functions of arrays, for the march of random features."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.symplectic import generators
from hamsym.random_features import window_loop
from hamsym.random_features.compiled_loop import compiled_loop, compiled_rates
from hamsym.symbolic import derivatives

__all__ = ["Flow", "flow_of", "has_rounded_numbers"]

NarrowArguments: TypeAlias = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Flow:
    """The equation z' = F(z, t) and the functions of H that the march and its checks evaluate.

    Attributes
    ----------
    vector_field : callable
        (z, t) -> F, shapes (n, dim), (n,) -> (n, dim).
    jacobian : callable
        (z, t) -> dF/dz, shape (n, dim, dim).
    rates : callable
        (z, t, out), F written to out.
    energy : callable, optional
        (z, t) -> H, shape (n,), where H is conserved.
    narrow_arguments : callable, optional
        (z, t) -> arguments of the functions in H that may act briefly, shape (n, k), and their
        kinds (:class:`~hamsym.symbolic.derivatives.Narrow`), shape (k,).
    rounded : bool
        Whether H has numbers that float64 cannot represent.
    loop : callable
        :func:`~hamsym.random_features.window_loop.march_windows`, plain or compiled.
    compiled : bool
        Whether ``rates`` and ``loop`` are compiled.
    compile : callable, optional
        Returns the flow with compiled ``rates`` and ``loop``; None if ``compiled`` is not "auto".
    """

    vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray]
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], None]
    energy: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    narrow_arguments: Callable[[np.ndarray, np.ndarray], NarrowArguments] | None = None
    rounded: bool = False
    loop: Callable[..., int] = window_loop.march_windows
    compiled: bool = False
    compile: Callable[[], Flow] | None = None


def flow_of(H: Hamiltonian, compiled: bool | Literal["auto"] = False) -> Flow:
    """Make the flow of H: compiled, plain, or with ``"auto"`` plain until compiling pays."""
    system = H.compile("numpy")

    def vector_field(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(system.vector_field(*system.arguments(z, t)))

    def jacobian(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return generators(system.hessian(*system.arguments(z, t)))

    def rates(z: np.ndarray, t: np.ndarray, out: np.ndarray) -> None:
        out[:] = vector_field(z, t)

    def energy(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(system.energy(*system.arguments(z, t)))

    plain = Flow(
        vector_field,
        jacobian,
        rates,
        energy=energy if H.time is None else None,
        narrow_arguments=_narrow_arguments(H),
        rounded=has_rounded_numbers(H.expr),
        compile=(lambda: _compiled(H, plain)) if compiled == "auto" else None,
    )
    return _compiled(H, plain) if compiled is True else plain


def _compiled(H: Hamiltonian, plain: Flow) -> Flow:
    rates = compiled_rates(H.compile("numba"))
    return replace(plain, rates=rates, loop=compiled_loop(), compiled=True, compile=None)


@functools.lru_cache(maxsize=64)
def _narrow_arguments(
    H: Hamiltonian,
) -> Callable[[np.ndarray, np.ndarray], NarrowArguments] | None:
    """Compile the arguments of functions in H that may act briefly; None without such functions.

    They are the arguments of exp, tanh, erf and similar functions, of abs and of Max, and the bases
    of negative and fractional powers.
    """
    equations = H.real_equations
    given = {symbol: value for symbol, value in equations.parameters.values() if value is not None}
    variables = [*equations.z, *([] if equations.time is None else [equations.time])]
    found = derivatives.narrow_arguments(equations.expr.xreplace(given), variables)
    if not found:
        return None
    arguments = compile_expressions([argument for argument, _ in found], equations)
    kinds = np.array([kind for _, kind in found])
    return lambda z, t: (arguments(z, t), kinds)


def has_rounded_numbers(expr: sympy.Expr) -> bool:
    """Return whether a formula has numbers that float64 cannot represent: pi, sqrt(2), 0.1."""
    return any(
        not isinstance(number, sympy.Rational) or number.q & (number.q - 1)
        for number in expr.atoms(sympy.Number, sympy.NumberSymbol)
        if not isinstance(number, sympy.Float)
    ) or any(power.is_number for power in expr.atoms(sympy.Pow))
