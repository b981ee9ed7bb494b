"""The Poisson matrix J applied to vectors and Hessians."""

from __future__ import annotations

import numpy as np

__all__ = ["generators"]


def generators(hessians: np.ndarray) -> np.ndarray:
    """Return J Hess, which moves tangent vectors, from Hessians of shape (..., dim, dim)."""
    half = hessians.shape[-1] // 2
    return np.concatenate((hessians[..., half:, :], -hessians[..., :half, :]), axis=-2)


def poisson_product(vectors: np.ndarray) -> np.ndarray:
    """Return J v for v with the components along the first axis."""
    half = len(vectors) // 2
    return np.concatenate((vectors[half:], -vectors[:half]))
