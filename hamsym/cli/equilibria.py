"""The command that finds equilibria."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hamsym.cli.command import Command, Report, report_of
from hamsym.cli.options import hamiltonian_options, rows_option
from hamsym.cli.texts import listed, number, ranges, state
from hamsym.errors import InputError
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


@click.command(
    cls=Command,
    short_help="Find equilibria, with proof in a box.",
    examples=[
        'hamsym equilibria "p**2/2 - x**2/2 + x**4/4" --box x=-2:2,p=-1:1',
        'hamsym equilibria "p**2/2 - k*cos(x)" -P k=2 --guess 0.1,0',
    ],
)
@hamiltonian_options
@click.option(
    "--box",
    "intervals",
    multiple=True,
    metavar="NAME=LOW:HIGH",
    help="Find all in a box, with proof; an interval for each component of z.",
)
@click.option(
    "--guess", "guesses", multiple=True, metavar="STATE", help="Start of Newton's method."
)
@click.option("--max-boxes", type=int, default=100_000, show_default=True)
@click.option("--time-limit", metavar="SECONDS", help="Of the search of a box.")
@rows_option(ROWS)
def equilibria(
    H: Hamiltonian,
    intervals: tuple[str, ...],
    guesses: tuple[str, ...],
    max_boxes: int,
    time_limit: str | None,
    rows: int | None,
) -> Report:
    """Show equilibria with their types, frequencies and Krein signatures.

    With --box the exit status is 0 if the table is proven to be complete, else 1.
    """
    import numpy as np

    box = _box(intervals) if intervals else None
    guess = np.array([H.state_from(state(text)) for text in guesses]) if guesses else None
    limit = None if time_limit is None else number(time_limit)
    found = H.equilibria(guess, box, max_boxes=max_boxes, time_limit=limit)
    return report_of(found, rows, box is None or found.complete)


def _box(intervals: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return the intervals of NAME=LOW:HIGH parts, which may also be between commas."""
    box: dict[str, tuple[float, float]] = {}
    for name, (low, high) in ranges(listed(",".join(intervals)), "--box").items():
        if not (low and high):
            raise InputError(f"'{name}' in --box lacks an end; write e.g. {name}=-2:2")
        box[name] = number(low), number(high)
    return box
