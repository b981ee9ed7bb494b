"""The command that searches for invariants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from hamsym.cli.command import Command, Report
from hamsym.cli.options import hamiltonian_options
from hamsym.support.text_tables import wrapped

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian

__all__ = ["invariants"]


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
def invariants(H: Hamiltonian, degree: int, basis: tuple[str, ...], time_limit: float) -> Report:
    """Find polynomials of the state, and of the functions in H, that are conserved beside H."""
    found = H.invariants(degree, basis=basis, time_limit=time_limit)
    beside = "" if H.time is not None else " beside H"
    message = (
        f"each is proven; others may exist beyond degree {degree}"
        if found
        else f"no invariant of degree at most {degree} was found{beside}; "
        "others may exist, and this is no proof of chaos"
    )
    lines = [wrapped(str(one), "" if one.independent else "dependent: ") for one in found]
    values = {
        "message": message,
        "invariants": [
            {"formula": one.formula, "degree": one.degree, "independent": one.independent}
            for one in found
        ],
    }
    return Report("\n".join([*lines, wrapped(message)]), values)
