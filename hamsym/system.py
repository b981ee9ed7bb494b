"""The generated functions of one backend, as callables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["System"]


@dataclass(frozen=True)
class System:
    """Callables of a generated module; nothing symbolic is left in them.

    Each takes the state ``z`` of shape (..., dim) first, then ``t`` if H depends on time, then
    the parameters as keywords whose defaults are the values bound in the Hamiltonian.

    Attributes
    ----------
    backend : str
    names : tuple of str
        Components of z.
    source : str
        The text that was run.
    energy : callable
        z -> H, shape (...).
    gradient : callable
        z -> grad H, shape (..., dim).
    vector_field : callable
        z -> J grad H, shape (..., dim).
    hessian : callable
        z -> second derivatives, shape (..., dim, dim).
    residual : callable
        (z, dz) -> dz - J grad H(z), shape (..., dim).
    loss : callable
        (z, dz, energy_0, energy_weight=0.0) -> scalar, the paper's eq. (Loss); without the last
        two arguments if H depends on time.
    step_loops : mapping
        Compiled integrators by name (numba only).
    rates : callable, optional
        (z, t, out) of shapes (n, dim), (n,), (n, dim), for compiled callers (numba only, and only
        where every parameter has a value).
    time_dependent : bool
        Whether the functions take ``t``.
    """

    backend: str
    names: tuple[str, ...]
    source: str = field(repr=False)
    energy: Callable[..., Any] = field(repr=False)
    gradient: Callable[..., Any] = field(repr=False)
    vector_field: Callable[..., Any] = field(repr=False)
    hessian: Callable[..., Any] = field(repr=False)
    residual: Callable[..., Any] = field(repr=False)
    loss: Callable[..., Any] = field(repr=False)
    step_loops: Mapping[str, Callable[..., Any]] = field(repr=False, default_factory=dict)
    rates: Callable[..., None] | None = field(repr=False, default=None)
    time_dependent: bool = False

    def __reduce__(self) -> tuple[Any, ...]:
        from hamsym.codegen import load

        return load, (self.source, self.backend, self.names)

    def arguments(self, z: Any, t: Any) -> tuple[Any, ...]:
        """The positional arguments of the functions: z, and t where H depends on time."""
        return (z, t) if self.time_dependent else (z,)
