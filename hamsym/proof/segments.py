"""Smooth pieces of a trial solution in ball arithmetic, and the parts that both forms share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb, arb_mat, arb_series

__all__ = ["Segment", "exact_balls", "exact_matrix", "exponential"]

#: (centre, half width, terms) -> series of each component in the time since the centre
Series = Callable[[Fraction, Fraction, int], list[arb_series]]


@dataclass(frozen=True)
class Segment:
    """z^ on a closed interval of elapsed time on which it is smooth.

    Attributes
    ----------
    start, end : fractions.Fraction
    series : callable
        (centre, half, terms) -> for each component a series of so many terms whose k-th
        coefficient contains the k-th Taylor coefficient of z^ at every elapsed time from
        centre - half to centre + half.
    """

    start: Fraction
    end: Fraction
    series: Series


def exponential(s: arb_series) -> arb_series:
    """The envelope 1 - exp(-s)."""
    return 1 - (-s).exp()


def exact_balls(numbers: np.ndarray) -> list[arb]:
    """Numbers of an array of one dimension as balls without radius."""
    return [arb(value) for value in numbers.astype(np.float64).tolist()]


def exact_matrix(numbers: np.ndarray) -> arb_mat:
    """An array of two dimensions as a matrix of balls without radius."""
    rows, columns = numbers.shape
    return arb_mat(rows, columns, exact_balls(numbers.reshape(-1)))
