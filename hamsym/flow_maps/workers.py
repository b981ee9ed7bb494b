"""The processes of a data-parallel training, as torchrun starts them; one process otherwise."""

from __future__ import annotations

import atexit
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor

from hamsym.errors import InputError

__all__ = ["Interruption", "Workers"]


class Workers:
    """All processes of a training.

    The group is that of torch.distributed. It is made from the environment variables that torchrun
    sets (WORLD_SIZE and others), unless the program has made one, and lasts until the program ends.

    Parameters
    ----------
    device : {"cpu", "cuda"}
        With "cuda" each process uses the GPU of its LOCAL_RANK.

    Attributes
    ----------
    rank, count : int
        Number of this process, and how many there are.
    device : torch.device
    """

    def __init__(self, device: str = "cpu") -> None:
        if device == "cuda" and not torch.cuda.is_available():
            raise InputError('device="cuda" cannot be used; torch finds no GPU; give "cpu"')
        self.device = torch.device(device)
        if device == "cuda":
            self.device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0)))
            torch.cuda.set_device(self.device)
        if not _has_group() and _world_size() > 1:
            dist.init_process_group("nccl" if device == "cuda" else "gloo")
            atexit.register(_end)
        self.rank, self.count = 0, 1
        if _has_group():
            self.rank, self.count = dist.get_rank(), dist.get_world_size()

    @property
    def is_first(self) -> bool:
        """Whether this process writes files and lines about the progress."""
        return self.rank == 0

    def sum(self, *tensors: Tensor) -> None:
        """Replace tensors by their sums over all processes."""
        if self.count > 1:
            for tensor in tensors:
                dist.all_reduce(tensor)

    def largest(self, *values: float) -> list[float]:
        """Return the largest of each value over all processes."""
        if self.count == 1:
            return list(values)
        tensor = torch.tensor(values, dtype=torch.float64, device=self.device)
        dist.all_reduce(tensor, dist.ReduceOp.MAX)
        return tensor.tolist()

    def share(self, tensor: Tensor) -> None:
        """Replace a tensor by that of the first process."""
        if self.count > 1:
            dist.broadcast(tensor, 0)

    def of_first(self, function: Callable[[], Any]) -> Any:
        """Return what a function returns in the first process; the others do not call it."""
        if self.count == 1:
            return function()
        found = [function() if self.is_first else None]
        dist.broadcast_object_list(found, 0, device=self.device)
        return found[0]


class Interruption:
    """Ctrl-C as a flag: the iteration that runs is completed. The second one raises as usual."""

    def __init__(self) -> None:
        self.came = False

    @contextmanager
    def awaited(self) -> Iterator[None]:
        """Set the flag in place of raising KeyboardInterrupt."""
        before = signal.getsignal(signal.SIGINT)
        # Only the main thread receives signals; None is a handler that is not Python's.
        if threading.current_thread() is not threading.main_thread() or before is None:
            yield
            return

        def note(number: int, frame: FrameType | None) -> None:
            self.came = True
            signal.signal(signal.SIGINT, before)

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


def _has_group() -> bool:
    return dist.is_available() and dist.is_initialized()


def _world_size() -> int:
    text = os.environ.get("WORLD_SIZE", "1")
    if not text.isdecimal():
        raise InputError(f"the environment variable WORLD_SIZE={text!r} is not a whole number")
    return int(text)


def _end() -> None:
    if dist.is_initialized():
        dist.destroy_process_group()
