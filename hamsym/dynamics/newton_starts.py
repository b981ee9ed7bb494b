"""Newton's method for zeros of the gradient of H, from many starts at once.

Input:  a Hamiltonian with a value for every parameter, starts, sizes of the components.
Output: points at which the iteration converges, in float64; nothing is proven.
"""

from __future__ import annotations

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import equilibrating

_ROUNDS = 100
_CONVERGED = 1e-13  # of |z| and the size: last step of a simple zero
_SINGULAR = 1e-15  # share of the largest eigenvalue of the scaled Hessian that counts as zero
_NULL = 1e-5  # the same, for directions of a continuum
_RESIDUAL = 1e-9  # of the terms of its own row: |g| that counts as zero
_ASIDE = 0.25  # of the size: distance at which a continuum is looked for
_MOST, _LEAST = 256, 16  # starts


class Candidates:
    """Energy, gradient and Hessian of H at many points, and Newton's method on them.

    - sizes: Sizes of the components, shape (dim,), to which steps are compared.
    """

    def __init__(self, H: Hamiltonian, sizes: np.ndarray) -> None:
        self._system, self.sizes = H.compile("numpy"), sizes

    def derivatives(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._system.at("gradient", z), self._system.at("hessian", z)

    def steps(self, z: np.ndarray, cut: float = _SINGULAR) -> tuple[np.ndarray, np.ndarray]:
        """Newton steps, shape (n, dim), and residuals, shape (n,); NaN where H is not finite.

        The Hessian is scaled by rows and columns, so that units do not matter, and directions in
        which it is singular are left out.
        """
        slopes, hessians = self.derivatives(z)
        steps, residuals = np.full(z.shape, np.nan), np.full(len(z), np.nan)
        finite = np.isfinite(slopes).all(axis=-1) & np.isfinite(hessians).all(axis=(-2, -1))
        if finite.any():
            g, h = slopes[finite], hessians[finite]
            scale = equilibrating(h)
            values, vectors = np.linalg.eigh(h * scale[:, :, None] * scale[:, None, :])
            largest = np.abs(values).max(axis=-1, keepdims=True)
            regular = np.abs(values) > cut * largest
            inverse = np.where(regular, 1 / np.where(regular, values, 1.0), 0.0)
            along = (vectors * (scale * g)[:, :, None]).sum(axis=-2)
            steps[finite] = scale * (vectors * (inverse * along)[:, None, :]).sum(axis=-1)
            sizes = np.maximum(self.sizes, np.abs(z[finite]))
            terms = (np.abs(h) * sizes[:, None, :]).sum(axis=-1)
            with np.errstate(all="ignore"):
                residuals[finite] = np.nan_to_num(np.abs(g) / terms, nan=0.0).max(axis=-1)
        return steps, residuals

    def null_vectors(self, z: np.ndarray) -> np.ndarray:
        """Directions in which the Hessian at one point is singular, columns of shape (dim, k)."""
        hessian = self.derivatives(z)[1]
        scale = self.sizes
        scaled = hessian * scale[:, None] * scale
        balance = equilibrating(scaled[None])[0]
        values, vectors = np.linalg.eigh(scaled * balance[:, None] * balance)
        null = vectors[:, np.abs(values) <= _NULL * np.abs(values).max()]
        columns = (scale * balance)[:, None] * null
        return columns / np.abs(columns / scale[:, None]).max(axis=0, initial=1e-300)


def converged_points(candidates: Candidates, starts: np.ndarray) -> np.ndarray:
    """Iterate from each start, shape (n, dim); return the points that converged, shape (k, dim).

    Also points to which the iteration converges slowly, as it does where the Hessian is singular.
    """
    z = np.array(starts, dtype=float)
    limit = 1e6 * (np.abs(starts).max(axis=0, initial=0) + candidates.sizes)
    active = np.arange(len(z))
    last = np.full(len(z), np.inf)
    for _ in range(_ROUNDS):
        steps, _ = candidates.steps(z[active])
        sizes = candidates.sizes + np.abs(z[active])
        last[active] = (np.abs(steps) / sizes).max(axis=-1)
        z[active] -= steps
        with np.errstate(invalid="ignore"):
            going = (last[active] > _CONVERGED) & (np.abs(z[active]) <= limit).all(axis=-1)
        active = active[going]
        if not len(active):
            break
    _, residuals = candidates.steps(z)
    with np.errstate(invalid="ignore"):
        good = (last <= 1e-3) & (residuals <= _RESIDUAL) & (np.abs(z) <= limit).all(axis=-1)
    return z[good]


def continues(candidates: Candidates, z: np.ndarray) -> bool:
    """Whether a zero seems to be part of a continuum: there are others in a null direction."""
    for direction in candidates.null_vectors(z).T:
        aside = (z + _ASIDE * direction)[None]
        for _ in range(20):
            steps, residuals = candidates.steps(aside, _NULL)
            if not np.isfinite(steps).all():
                break
            aside = aside - steps
        else:
            away = (np.abs(aside[0] - z) / candidates.sizes).max()
            if residuals[0] <= _RESIDUAL and away > 0.5 * _ASIDE:
                return True
    return False


def default_starts(dim: int) -> np.ndarray:
    """Starts around the origin at several scales, always the same; shape (n, dim)."""
    generator = np.random.default_rng(0)
    count = int(np.clip(2_000 // dim, _LEAST, _MOST))
    unit = generator.normal(size=(count, dim))
    scales = 10.0 ** generator.uniform(-3, 3, size=count)
    scales[: count // 2] = 1.0
    return np.concatenate((np.zeros((1, dim)), unit * scales[:, None]))
