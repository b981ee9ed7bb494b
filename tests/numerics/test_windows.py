"""Location of times in windows."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym.numerics.call_limit import TooManyCallsError, limited
from hamsym.numerics.windows import locate


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_times_lie_in_their_windows(direction: float) -> None:
    edges = direction * np.array([0.0, 0.5, 2.0, 2.25])
    t = direction * np.linspace(0, 2.25, 91)[:-1]
    window, s = locate(edges, t)
    assert ((s >= 0) & (s < 1)).all()
    np.testing.assert_allclose(edges[window] + s * np.diff(edges)[window], t, atol=1e-15)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_outside_times_belong_to_end_windows(direction: float) -> None:
    window, s = locate(direction * np.array([0.0, 1.0, 3.0]), direction * np.array([-1.0, 3.0, 5]))
    assert window.tolist() == [0, 1, 1]
    assert s.tolist() == [-1.0, 1.0, 2.0]


def test_calls_beyond_the_limit_raise() -> None:
    function = limited(np.exp, 3)
    assert [float(function(0.0)) for _ in range(3)] == [1.0] * 3
    with pytest.raises(TooManyCallsError):
        function(0.0)
