"""Objective of a training: the residual of the equations, and regularizers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from hamsym.support.validation import require, require_number


@dataclass(frozen=True)
class Regularizer:
    """A term weight * mean(function(t, z, dz)) of the loss, for methods "adam" and "lbfgs".

    Parameters
    ----------
    weight : float
        From 0; it carries the units that make the term comparable with the squared residual.
    function : callable
        Of the collocation points t, shape (K,), in the order in which they were drawn, and of z^
        and dz^/dt there, shape (K, dim), in the units of H. It returns a tensor, usually of shape
        (K,), of which the mean is taken, and through which gradients flow.

    Raises
    ------
    InputError
        If the weight is not a number from 0, or the function cannot be called.

    Examples
    --------
    The angular momentum of an orbit that starts with x p_y - y p_x = 1:

    >>> import hamsym
    >>> def change(t, z, dz):
    ...     x, y, p_x, p_y = z.unbind(-1)
    ...     return (x * p_y - y * p_x - 1) ** 2
    >>> orbit = hamsym.solve(
    ...     "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)",
    ...     [1, 0, 0, 1],
    ...     (0, 1),
    ...     method=hamsym.Adam(epochs=20, regularizers=[hamsym.Regularizer(0.5, change)]),
    ... )
    >>> orbit(1.0).shape
    (4,)
    """

    weight: float
    function: Callable[[Tensor, Tensor, Tensor], Tensor]

    def __post_init__(self) -> None:
        require_number("weight", self.weight, 0)
        require(callable(self.function), "function", self.function, "a function of t, z and dz")


@dataclass(frozen=True)
class Objective:
    """The objective that a training minimises."""

    #: (t, z, dz) -> shape (K, dim), zero on a solution.
    residual: Callable[[Tensor, Tensor, Tensor], Tensor]
    #: (t, z, dz) -> scalar, without the regularizers.
    loss: Callable[[Tensor, Tensor, Tensor], Tensor]
    #: (t, z, dz) -> shape (K, m); the loss is the mean over the points of its squared 2-norm.
    rows: Callable[[Tensor, Tensor, Tensor], Tensor]
    #: (t, z, dz) -> derivatives of the rows in z and in dz, each of shape (K, m, dim).
    slopes: Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
    #: Further terms.
    regularizers: tuple[Regularizer, ...] = ()

    def __call__(self, t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        """Return the loss with all its terms, a scalar."""
        value = self.loss(t, z, dz)
        for term in self.regularizers:
            value = value + term.weight * term.function(t, z, dz).mean()
        return value
