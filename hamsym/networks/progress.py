"""Progress bar of a training, drawn on terminals and in notebooks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hamsym.networks.record import TrainingState
from hamsym.support.progress import stepping_progress


@contextmanager
def training_progress(
    iterations: int, show: bool | Callable[[TrainingState], None] | None = None
) -> Iterator[Callable[[TrainingState], None]]:
    """Yield a function that draws loss, ell_max and the time left on standard error.

    - iterations: Largest number of iterations.
    - show: By default the bar is drawn if standard error is a terminal, and in notebooks. A
      callable replaces the bar.
    """
    if callable(show):
        yield show
        return
    with stepping_progress(iterations, show, "training") as advance:
        done = 0

        def update(state: TrainingState) -> None:
            nonlocal done
            note = f"loss {state.best_loss:.1e}, ell_max {state.ell_max:.1e}"
            advance(state.iteration - done, note)
            done = state.iteration

        yield update
