"""Generated functions of one backend as callables."""

from __future__ import annotations

import functools
import importlib.util
from collections.abc import Callable
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from hamsym.codegen.backends import BACKENDS
from hamsym.codegen.functions import execute, with_numbers_of_numpy
from hamsym.codegen.generate import Source, generate
from hamsym.errors import InputError
from hamsym.numerics.symplectic import generators
from hamsym.support.shown import Shown
from hamsym.symbolic.equations import Equations


def _on_first_use(name: str) -> Any:
    """An attribute that is the function of this name, loaded on first use."""
    return cached_property(lambda system: system.function(name))


class System(Shown):
    """Callables of a generated module, each generated on first use.

    Each takes the state ``z`` of shape (..., dim) first, then ``t`` if H depends on time, then
    the parameters as keywords whose defaults are the values bound in the Hamiltonian. Those of
    balls, which :meth:`function` returns, take an arithmetic, each component of the state and t.

    Attributes
    ----------
    backend : str
    names : tuple of str
        Components of z.
    source : str
        Text of the whole module, parts of which are executed.
    energy : callable
        z -> H, shape (...).
    gradient : callable
        z -> grad H, shape (..., dim).
    vector_field : callable
        z -> J grad H, with the forces added to the rates of the momenta, shape (..., dim).
    hessian : callable
        z -> second derivatives of H, shape (..., dim, dim).
    jacobian : callable
        z -> derivatives of the vector field, J Hess without forces, shape (..., dim, dim).
    power : callable
        z -> dH/dt along trajectories, shape (...); only of systems with forces.
    residual : callable
        (z, dz) -> dz - vector_field(z), shape (..., dim).
    loss : callable
        (z, dz, energy_0, energy_weight=0.0) -> scalar, the paper's eq. (Loss); without the last
        two arguments if H depends on time or there are forces.
    time_dependent : bool
        Whether the functions take ``t``.
    """

    def __init__(self, source: Source) -> None:
        package = BACKENDS[source.backend].package
        if package and importlib.util.find_spec(package) is None:
            raise InputError(
                f"functions of '{source.backend}' need the package {package}, which is not "
                f"installed; install it with pip install 'hamsym[{package}]'"
            )
        self._source = source
        self._module = ModuleType(f"hamsym_{source.backend}")  # not used by numba
        self._loaded: set[str] = set()
        # Loading a compiled function from the cache takes tens of milliseconds; a section calls
        # the same loop many times.
        self._compiled: dict[str, Callable[..., Any]] = {}
        self.backend = source.backend
        self.names = tuple(symbol.name for symbol in source.form.z)
        self.time_dependent = source.names.time
        source.part("energy")  # raises if the backend lacks a function of H

    def __repr__(self) -> str:
        return f"System({self.backend}, {', '.join(self.names)})"

    @property
    def source(self) -> str:
        return self._source.text

    @property
    def equations(self) -> Equations:
        """The equations of which these are the functions."""
        return self._source.form

    energy = _on_first_use("energy")
    gradient = _on_first_use("gradient")
    vector_field = _on_first_use("vector_field")
    hessian = _on_first_use("hessian")
    power = _on_first_use("power")
    residual = _on_first_use("residual")
    loss = _on_first_use("loss")

    @cached_property
    def jacobian(self) -> Callable[..., Any]:
        if self.equations.forces or self.backend == "jax":  # which traces functions
            return self.function("jacobian")
        hessian, product = self.hessian, generators
        if self.backend == "torch":
            product = _tensor_generators

        def jacobian(*arguments: Any, **parameters: Any) -> Any:
            return product(hessian(*arguments, **parameters))

        return jacobian

    def function(self, name: str) -> Callable[..., Any]:
        """Load a function by its name: also a function of rows, or with numba a loop."""
        if self.backend == "numba":
            if name not in self._compiled:
                from hamsym.codegen.checked_cache import load_compiled  # imports numba

                module = load_compiled(self._source.module(name), "numba")
                self._compiled[name] = getattr(module, name)
            return self._compiled[name]
        for part in self._source.needed(name):
            if part not in self._loaded:
                about = f"{self.backend} {part}"
                execute(self._source.part(part), about, self._module.__dict__)
                self._loaded.add(part)
                if self.backend == "numpy" and hasattr(self._module, part):
                    with_numbers_of_numpy(getattr(self._module, part))
        return getattr(self._module, name)  # type: ignore[no-any-return]

    @property
    def is_looped(self) -> bool:
        """Whether the kernels of the integrators loop over repeated terms (numba only)."""
        return self._source.is_looped

    def keywords(self, parameters: np.ndarray | None) -> dict[str, np.ndarray]:
        """Keyword arguments of the functions for values of the parameters, shape (..., k).

        Each has shape (...), which must broadcast with the states; empty for None.
        """
        if parameters is None:
            return {}
        names = [name for name, _ in self._source.names.parameters]
        return {name: parameters[..., i] for i, name in enumerate(names)}

    def at(
        self, name: str, z: np.ndarray, t: Any = 0.0, parameters: np.ndarray | None = None
    ) -> np.ndarray:
        """Evaluate a function of numpy at states and times; infinite and NaN without a warning.

        - parameters: As of :meth:`keywords`.
        """
        with np.errstate(all="ignore"):
            given = self.arguments(z, t)
            return np.asarray(getattr(self, name)(*given, **self.keywords(parameters)), dtype=float)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self._source.form, self.backend)

    def arguments(self, z: Any, t: Any) -> tuple[Any, ...]:
        """Positional arguments of the functions: z, and t if H depends on time."""
        return (z, t) if self.time_dependent else (z,)


@functools.lru_cache(maxsize=256)
def load(source: Source) -> System:
    """Make the functions of a module; cached for the same source."""
    return System(source)


def _tensor_generators(hessians: Any) -> Any:
    """Return J Hess from Hessians as tensors of shape (..., dim, dim)."""
    import torch  # slow to import, and loaded already by the functions of this backend

    half = hessians.shape[-1] // 2
    return torch.cat((hessians[..., half:, :], -hessians[..., :half, :]), -2)


def _restored(form: Equations, backend: str) -> System:
    return load(generate(form, backend))
