"""Zeros along a path that touches zero within round-off."""

from __future__ import annotations

import numpy as np

from hamsym.numerics.intervals import Ranges
from hamsym.numerics.isolation import Cells, component_ranges, isolated_zeros

COUNT, WIDTH = 300, 0.1


def test_round_off_at_a_tangency_is_two_zeros_at_most() -> None:
    """Cells with the top of cos(t) - 1 + round-off."""
    random = np.random.default_rng(0)
    begin = -WIDTH * random.uniform(0.1, 0.9, COUNT)

    def value(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.cos(begin[index] + WIDTH * share) - 1 + 2e-16 * random.standard_normal(len(share))

    def sample(share: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rates = -np.sin(begin[index] + WIDTH * share)
        values = value(share, index)
        return values, 1 + values[:, None], rates[:, None]

    index = np.arange(COUNT)
    ends = [sample(np.full(COUNT, share), index) for share in (0.0, 1.0)]
    pairs = (np.stack(pair) for pair in zip(*ends, strict=True))
    cells = Cells.whole(np.full(COUNT, WIDTH), *pairs, bends=np.ones((COUNT, 1)))
    one = Ranges.constant(1.0)
    found = isolated_zeros(cells, lambda part: component_ranges(part, 0) - one, sample, value)
    assert len(found.index) > 0
    assert np.bincount(found.index).max() <= 2
    assert np.abs(begin[found.index] + WIDTH * found.share).max() < 1e-6
