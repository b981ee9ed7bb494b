"""The generated functions of one backend, as callables."""

from __future__ import annotations

import functools
import hashlib
import inspect
import linecache
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from hamsym.codegen import numba_cache
from hamsym.codegen.names import FUNCTIONS

__all__ = ["System", "load"]


@dataclass(frozen=True, eq=False)
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
        return load, (self.source, self.backend, self.names)

    def arguments(self, z: Any, t: Any) -> tuple[Any, ...]:
        """The positional arguments of the functions: z, and t where H depends on time."""
        return (z, t) if self.time_dependent else (z,)


_STEP_LOOPS = (
    *(f"splitting{kind}" for kind in ("", "_compensated", "_ensemble", "_ensemble_compensated")),
    *("splitting_tangent", "symplectic_euler", "symplectic_euler_p", "implicit", "doubled"),
)


@functools.lru_cache(maxsize=256)
def load(source: str, backend: str, names: tuple[str, ...]) -> System:
    """Run a generated module and collect its functions; the same text is loaded once."""
    module = (
        numba_cache.load_module(source, backend) if backend == "numba" else _run(source, backend)
    )
    functions: dict[str, Any] = {name: getattr(module, name) for name in FUNCTIONS}
    loops = {name: getattr(module, name) for name in _STEP_LOOPS if hasattr(module, name)}
    return System(
        backend=backend,
        names=names,
        source=source,
        step_loops=loops,
        rates=getattr(module, "rates", None),
        time_dependent="t" in inspect.signature(functions["energy"]).parameters,
        **functions,
    )


def _run(source: str, backend: str) -> ModuleType:
    """A module without a file; tracebacks show its source all the same."""
    digest = hashlib.sha256(source.encode()).hexdigest()[:12]
    filename = f"<hamsym {backend} {digest}>"
    # With mtime None the entry outlives linecache.checkcache.
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
    module = ModuleType(f"hamsym_{backend}_{digest}")
    exec(compile(source, filename, "exec"), module.__dict__)
    return module
