"""Tables of quantities over time: a few rows at times of equal ratios."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hamsym.support.text_tables import table


def history(t: np.ndarray, start: float, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Return the lines of a table with two rows for each of three decades of time, and the end.

    Examples
    --------
    >>> t = np.linspace(0.1, 100, 1000)
    >>> print("\\n".join(history(t, 0.0, {"growth": 1 / t})[-2:]))
    31.7      3.1546e-02
    100       1.0000e-02
    """
    elapsed = np.abs(t - start)
    wanted = np.append(elapsed[-1] * 10.0 ** np.arange(-3, 0, 0.5), elapsed[-1] * (1 - 1e-12))
    rows = np.unique(np.searchsorted(elapsed, wanted))
    listed = [
        [f"{t[row]:.6g}", *(f"{values[row]:.4e}" for values in columns.values())]
        for row in rows[rows < len(t)]
    ]
    return table(["t", *columns], listed)
