"""Features of a formula between the samples of a trajectory, which none of them shows.

H is extended by a pair (u, v) to H + v f: where v = 0, the motion is that of H, and du/dt = f. So
the search for features of the force (:mod:`hamsym.integrators.hidden_features`) finds those of f.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
import sympy

from hamsym.codegen.observable import Observable
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.energy_drift import work_of
from hamsym.integrators.hidden_features import Path, hidden_features


def follows(
    H: Hamiltonian,
    signals: Sequence[Observable],
    t: np.ndarray,
    z: np.ndarray,
    parameters: np.ndarray,
    error: float,
) -> bool:
    """Whether formulas along a trajectory have no features between its samples.

    - t, z: Equal steps, shape (n,), and the states, shape (n, dim).
    - parameters: Values of those of H, shape (k,).
    - error: What features may change in the mean of each formula. In the states they may change as
      large a share of their sizes.

    Examples
    --------
    >>> H, t = Hamiltonian("p**2/2 + x**2/2"), np.linspace(0, 20, 1001)
    >>> z = np.stack((np.cos(t), -np.sin(t)), axis=-1)
    >>> narrow = "exp(-((x - 0.3)/1e-6)**2)"
    >>> [follows(H, [H.observable(f)], t, z, np.empty(0), 1e-9) for f in ("cos(x)", narrow)]
    [True, False]
    """
    parameters = parameters[None]

    def is_followed(f: Observable) -> bool:
        with np.errstate(all="ignore"):
            values = np.broadcast_to(np.asarray(f(z, t, parameters), dtype=float), t.shape)
        if not np.isfinite(values).all():
            return False
        try:
            features = hidden_features(_extended(H, f.function))
        except InputError:  # f jumps
            return False
        if features is None:
            return True
        size = float(np.abs(values).max())
        share = error / size if size else 0.0
        q, p = np.split(z, 2, axis=1)
        zero, sizes = np.zeros((len(t), 1)), np.abs(z).max(axis=0)
        states = np.concatenate((q, work_of(t, values)[:, None], p, zero), axis=1)
        half = len(sizes) // 2
        allowed = np.array(
            [*share * sizes[:half], error * abs(t[-1] - t[0]), *share * sizes[half:], np.inf]
        )
        found = features.search(Path(states[None], t), parameters, lambda _: allowed)
        return bool(np.isnan(found.times).all())

    return not error < np.inf or all(map(is_followed, signals))  # if anything is claimed


@functools.lru_cache(maxsize=64)
def _extended(H: Hamiltonian, f: sympy.Expr) -> Hamiltonian:
    form = H.real_equations
    u, v = sympy.symbols("u_signal v_signal", real=True)
    momenta = form.z[form.dof :]
    return Hamiltonian(
        form.expr + v * f,
        q=[*form.z[: form.dof], u],
        p=[*momenta, v],
        parameters=H.parameters,
        forces=dict(zip(momenta, form.forces, strict=True)) if form.forces else None,
    )
