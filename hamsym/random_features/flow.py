"""Hamilton's equations as the march of random features takes them: functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.symplectic import generators
from hamsym.random_features import window_loop
from hamsym.random_features.compiled_loop import compiled_loop, compiled_rates

__all__ = ["Flow", "flow_of"]

NarrowArguments: TypeAlias = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Flow:
    """The equation z' = F(z, t), with what the march and its checks take of H.

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
        (z, t) -> arguments of the functions in H that may act briefly, shape (n, k), and what
        each belongs to, shape (k,); see :attr:`hamsym.Hamiltonian.narrow_arguments`.
    rounded : bool
        Whether H has numbers that float64 does not hold.
    loop : callable
        :func:`~hamsym.random_features.window_loop.march_windows`, or the same compiled.
    compiled : bool
        Whether ``rates`` and ``loop`` are compiled.
    compile : callable, optional
        Returns the same with compiled ``rates`` and ``loop``; None where that is not wanted.
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
    """The equations of H; with ``"auto"`` they can still be compiled."""
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
        narrow_arguments=H.narrow_arguments,
        rounded=H.has_rounded_numbers,
        compile=(lambda: _compiled(H, plain)) if compiled == "auto" else None,
    )
    return _compiled(H, plain) if compiled is True else plain


def _compiled(H: Hamiltonian, plain: Flow) -> Flow:
    rates = compiled_rates(H.compile("numba"))
    return replace(plain, rates=rates, loop=compiled_loop(), compiled=True, compile=None)
