"""Solution of many members on the workers of a cluster.

Input:  a family, the members, the numbers of those to solve.
Output: blocks of members, as they come; with a store that the workers reach, written by them.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hamsym.families.blocks import Block, BlockSolver
from hamsym.families.parts import write_part
from hamsym.families.solutions import Family
from hamsym.parallel.cluster import members_on_cluster
from hamsym.problems.ensemble import Ensemble

if TYPE_CHECKING:  # an optional package
    from distributed import Client


class StorePlace(NamedTuple):
    """A store: its path, and a text in it by which a worker recognises it."""

    path: Path
    token: str

    def is_reached(self) -> bool:
        """Whether this process reaches the store."""
        try:
            return self.token in (self.path / "zarr.json").read_text("utf-8")
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
    """Yield the blocks of the chosen members, as :func:`members_on_cluster` computes them."""
    found = members_on_cluster(client, _solved, (family, store), members, chosen, retries=retries)
    with closing(found):
        for _, block in found:
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
