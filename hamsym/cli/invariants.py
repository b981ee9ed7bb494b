"""The command that searches for invariants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hamsym.cli.command import Command, Report, report_of
from hamsym.cli.options import hamiltonian_options, rows_option
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


@click.command(
    cls=Command,
    short_help="Find conserved functions.",
    examples=[
        'hamsym invariants "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)" --degree 3',
        'hamsym invariants "p_r**2/2 + p_phi**2/(2*r**2) - 1/r" --basis "cos(phi)"',
    ],
)
@hamiltonian_options
@click.option("--degree", type=int, default=2, show_default=True, help="Largest total degree.")
@click.option(
    "--basis",
    multiple=True,
    metavar="FORMULA",
    help="A further function, e.g. cos(phi); repeat it.",
)
@click.option("--time-limit", type=float, default=60.0, show_default=True, metavar="SECONDS")
@rows_option(ROWS)
def invariants(
    H: Hamiltonian, degree: int, basis: tuple[str, ...], time_limit: float, rows: int | None
) -> Report:
    """Find polynomials of the state, and of the functions in H, that are conserved beside H."""
    found = H.invariants(degree, basis=basis, time_limit=time_limit)
    return report_of(found, rows)
