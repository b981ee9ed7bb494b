"""Stepping in blocks, with progress and interruption."""

from __future__ import annotations

from collections.abc import Callable

from hamsym.support.progress import stepping_progress


def advance_in_blocks(
    steps: int, block: int, show: bool | None, advance: Callable[[int, int], bool]
) -> bool:
    """Advance block by block to the last step, and return whether Ctrl-C interrupted.

    - steps, block: Number of steps, in total and in a block.
    - show: Show progress; by default on a terminal.
    - advance: (steps done before, steps of this block) -> whether to continue.
    """
    with stepping_progress(steps, show) as report:
        try:
            for done in range(0, steps, block):
                count = min(block, steps - done)
                goes_on = advance(done, count)
                report(count)
                if not goes_on:
                    break
        except KeyboardInterrupt:
            return True
    return False
