"""Errors on windows: until when estimate and round-off together are allowed."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym.solution.window_error import WindowError


def error(series: float, floor: float) -> WindowError:
    """On windows from 5 to 6 and to 7, of constant size in the second one and zero before."""
    size = np.array([0.0, 1.0])
    return WindowError(
        edges=np.array([0.0, 1.0, 2.0]),
        series=size[:, None, None] * np.array([[[series], [0.0]]]),
        floors=size[:, None] * np.array([[floor]]),
        largest=np.array([series + floor]),
        scale=np.ones(1),
        origin=np.array(5.0),
    )


@pytest.mark.parametrize(("series", "floor"), [(3.0, 0.0), (0.0, 3.0), (1.5, 1.5), (-1.5, 1.5)])
def test_estimate_and_round_off_count_together(series: float, floor: float) -> None:
    found = error(series, floor)
    assert found.until(np.array([2.9])) == 6.0
    assert found.until(np.array([3.1])) == 7.0
