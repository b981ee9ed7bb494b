"""The command that finds equilibria."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, command, report_of
from hamsym.cli.options import hamiltonian_options, rows_option
from hamsym.cli.texts import SECONDS, STATE, intervals, joined
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


@command(
    "Find equilibria, with proof in a box.",
    'hamsym equilibria "p**2/2 - x**2/2 + x**4/4" --box x=-2:2,p=-1:1',
    'hamsym equilibria "p**2/2 - k*cos(x)" -P k=2 --guess 0.1,0',
)
@hamiltonian_options
@click.option(
    "--box",
    multiple=True,
    callback=joined(intervals),
    metavar="NAME=LOW:HIGH",
    help="Find all in a box, with proof; an interval for each component of z.",
)
@click.option(*("--guess", "guesses"), type=STATE, multiple=True, help="Start of Newton's method.")
@click.option("--max-boxes", type=int, default=100_000, show_default=True)
@click.option("--time-limit", type=SECONDS, help="Of the search of a box.")
@rows_option(ROWS)
def equilibria(
    H: Hamiltonian,
    box: dict[str, tuple[float, float]] | None,
    guesses: tuple[Any, ...],
    rows: int | None,
    **options: Any,
) -> Report:
    """Show equilibria with their types, frequencies and Krein signatures.

    With --box the exit status is 0 if the table is proven to be complete, else 1.
    """
    import numpy as np

    guess = np.array([H.state_from(each) for each in guesses]) if guesses else None
    found = H.equilibria(guess, box, **options)
    return report_of(found, rows, box is None or found.complete)
