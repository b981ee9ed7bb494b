"""Options of the method "features"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hamsym.support.option_fields import option

#: Windows of a span, so that a short event in a long rest is sampled.
FEWEST_WINDOWS = 8


@dataclass(frozen=True)
class FeatureOptions:
    """Options of the method "features"; see :func:`hamsym.solve`."""

    tol: float = option(1e-9, "Tolerance, relative to the largest value of each component.")
    atol: float | Sequence[float] = option(
        0.0, "Absolute tolerance, one or one for each component.", unit="NUMBERS"
    )
    breakpoints: Sequence[float] = option((), "Times at which a window ends.", unit="TIMES")
    max_window: float | None = option(
        None, "Longest window.", default_text=f"span/{FEWEST_WINDOWS}", unit="TIME"
    )
