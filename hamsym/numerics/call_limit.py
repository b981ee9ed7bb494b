"""A limit on the evaluations of a function."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np


class TooManyCallsError(Exception):
    """A function was called more often than allowed."""


def limited(function: Callable[..., np.ndarray], calls: int) -> Callable[..., np.ndarray]:
    """Return the function, which raises :class:`TooManyCallsError` after this many calls.

    Examples
    --------
    >>> once = limited(np.sin, 1)
    >>> float(once(0.0))
    0.0
    >>> once(0.0)
    Traceback (most recent call last):
    ...
    hamsym.numerics.call_limit.TooManyCallsError: 1 calls
    """
    count = 0

    @functools.wraps(function)
    def counted(*arguments: object) -> np.ndarray:
        nonlocal count
        count += 1
        if count > calls:
            raise TooManyCallsError(f"{calls:,} calls")
        return function(*arguments)

    return counted
