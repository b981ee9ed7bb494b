"""Solution of many members on the workers of a cluster.

Input:  a family, the members, the numbers of those to solve.
Output: blocks of members, as they come; with a store that the workers reach, written by them.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hamsym.families.blocks import Block, BlockSolver
from hamsym.families.parts import write_part
from hamsym.families.solutions import Family
from hamsym.parallel.cluster import Task, ThreadCount, cluster_results
from hamsym.problems.ensemble import Ensemble

if TYPE_CHECKING:  # an optional package
    from distributed import Client

_FIRST, _MOST = 32, 65_536  # members of the first blocks, and of any
_SECONDS = 5.0  # that a block should take: long beside the millisecond of the scheduler
_SHARES = 4  # blocks for each thread, at least

#: The file of a store that tells what was asked, with the token.
BEGUN = "begun.json"


class StorePlace(NamedTuple):
    """A store: its path, and a text in it by which a worker recognises it."""

    path: Path
    token: str

    def is_reached(self) -> bool:
        """Whether this process reaches the store."""
        try:
            return self.token in (self.path / BEGUN).read_text("utf-8")
        except OSError:
            return False


def blocks_on_cluster(
    client: Client,
    family: Family,
    members: Ensemble,
    chosen: np.ndarray,
    store: StorePlace | None,
    retries: int,
) -> Generator[Block, None, None]:
    """Yield blocks of the chosen members, in the order in which they end.

    They are sized by the time that they take.
    """
    left, size, threads = chosen, _FIRST, ThreadCount(client)

    def tasks() -> Iterator[Task]:
        nonlocal left
        while len(left):
            fair = max(len(left) // (_SHARES * threads()), 1)
            chunk, left = np.split(left, [min(size, fair)])
            own = members.states[chunk], members.parameters[chunk]
            yield Task(chunk, (chunk, Ensemble(members.H, *own, chunk.shape, members.varied)))

    setup = family, store
    with closing(cluster_results(client, _solved, setup, tasks(), retries=retries)) as results:
        for _, block, seconds in results:
            size = int(min(max(_SECONDS * len(block.members) / seconds, 1), _MOST))
            yield block


def _solved(
    setup: tuple[Family, StorePlace | None], numbers: np.ndarray, members: Ensemble
) -> Block:
    """Solve members, on a worker, and write them to the store if it is reached."""
    family, store = setup
    block = BlockSolver(family, members).solved(np.arange(len(members)))
    block = block._replace(members=numbers)
    if store is not None and store.is_reached():
        write_part(store.path, block)
        block = block._replace(windows=None)
    return block
