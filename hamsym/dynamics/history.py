"""Times that a short history of a quantity has."""

from __future__ import annotations

import numpy as np


def history_rows(t: np.ndarray, start: float) -> np.ndarray:
    """Return the rows of times of equal ratios: two for each of three decades, and the end.

    Examples
    --------
    >>> t = np.linspace(0.1, 100, 1000)
    >>> t[history_rows(t, 0.0)].round(1)
    array([  0.1,   0.4,   1. ,   3.2,  10. ,  31.7, 100. ])
    """
    elapsed = np.abs(t - start)
    wanted = np.append(elapsed[-1] * 10.0 ** np.arange(-3, 0, 0.5), elapsed[-1] * (1 - 1e-12))
    rows = np.unique(np.searchsorted(elapsed, wanted))
    return rows[rows < len(t)]
