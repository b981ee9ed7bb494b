"""The command orbit: a periodic orbit, its stability, its family and its proof."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Command, Report, report_of
from hamsym.cli.options import Draw, figure_options, hamiltonian_options, rows_option
from hamsym.cli.texts import number, state, texts_by_name
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian

_FURTHER = ("family", "proven")


@click.command(
    cls=Command,
    short_help="Find a periodic orbit, its stability and family.",
    examples=[
        'hamsym orbit "p**2/2 - cos(x)" --z0 x=2,p=0 --symmetry p=-p',
        'hamsym orbit "p**2/2 + x**2/2 + x**4/4" --z0 1,0 --to-energy 2 --prove',
    ],
)
@hamiltonian_options
@click.option(
    "--z0", "start", required=True, metavar="STATE", help="A state near it, e.g. x=1.3,p=1."
)
@click.option("--near", metavar="PERIOD", help="Guess of the period; by default the first return.")
@click.option("--energy", metavar="VALUE", help="Its energy; by default that of the state.")
@click.option("--period", metavar="FORMULA", help="Its period, e.g. 2*pi/omega, and no energy.")
@click.option(
    "--symmetry",
    "symmetries",
    multiple=True,
    metavar="MAP",
    help="For example y=-y,p_x=-p_x; twice for a pair that reverses time.",
)
@click.option("--tol", metavar="VALUE", default="1e-10", show_default=True)
@click.option("--to-energy", metavar="VALUE", help="Follow its family to this energy.")
@click.option("--prove", is_flag=True, help="Prove that it exists, and its stability.")
@figure_options
@rows_option(ROWS)
def orbit(
    H: Hamiltonian,
    start: str,
    near: str | None,
    energy: str | None,
    period: str | None,
    symmetries: tuple[str, ...],
    tol: str,
    to_energy: str | None,
    prove: bool,
    draw: Draw,
    rows: int | None,
) -> Report:
    """Find a periodic orbit near a state; exit 1 if that failed."""
    import hamsym

    guess: Any = state(start)
    if near is not None:
        guess = (guess, number(near))
    maps: list[dict[str, str]] = [texts_by_name(text, "--symmetry") for text in symmetries]
    found = hamsym.periodic_orbit(
        H,
        guess,
        energy=None if energy is None else number(energy),
        period=period,
        symmetry=None if not maps else maps[0] if len(maps) == 1 else tuple(maps),
        tol=number(tol),
    )
    reports = {"orbit": report_of(found, rows)}
    family = None
    if found.success and to_energy is not None:
        family = found.family(energy=number(to_energy))
        reports["family"] = report_of(family, rows)
    if found.success and prove:
        reports["proven"] = report_of(found.certify(), rows)
    report = Report(
        "\n\n".join(each.text for each in reports.values()),
        {
            **reports.pop("orbit").values,
            **{name: reports[name].values if name in reports else None for name in _FURTHER},
        },
        found.success and (family is None or family.success),
    )
    draw(family or found, report)
    return report
