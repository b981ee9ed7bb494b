"""Objective of a training: the residual of the equations, and regularizers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

__all__ = ["Objective", "Regularizer"]


@dataclass(frozen=True)
class Regularizer:
    """A term weight * mean(function(t, z, dz)) of the loss; the function returns shape (K,)."""

    weight: float
    function: Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Objective:
    """The objective that a training minimises.

    Attributes
    ----------
    residual : callable
        (t, z, dz) -> shape (K, dim), zero on a solution.
    loss : callable, optional
        (t, z, dz) -> scalar; by default the mean over points of the squared 2-norm of the
        residual.
    regularizers : tuple of Regularizer
        Further terms.
    rows : callable, optional
        (t, z, dz) -> shape (K, m); the loss without regularizers is the mean of its squared 2-norm
        over the points; by default the residual. For least-squares methods.
    slopes : callable, optional
        (t, z, dz) -> derivatives of the rows in z and in dz, each of shape (K, m, dim); by default
        from automatic differentiation.
    """

    residual: Callable[[Tensor, Tensor, Tensor], Tensor]
    loss: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None
    regularizers: tuple[Regularizer, ...] = ()
    rows: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None
    slopes: Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]] | None = None

    def __call__(self, t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        """Return the loss with all its terms, a scalar."""
        if self.loss is not None:
            value = self.loss(t, z, dz)
        else:
            value = self.residual(t, z, dz).square().sum(-1).mean()
        for term in self.regularizers:
            value = value + term.weight * term.function(t, z, dz).mean()
        return value
