"""The command orbit: a periodic orbit, its stability, its family and its proof."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, command, report_of
from hamsym.cli.options import Draw, figure_options, hamiltonian_options, rows_option
from hamsym.cli.texts import NUMBER, STATE, TIME, Parsed, texts_by_name
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian

_FURTHER = ("family", "proven")


@command(
    "Find a periodic orbit, its stability and family.",
    'hamsym orbit "p**2/2 - cos(x)" --z0 x=2,p=0 --symmetry p=-p',
    'hamsym orbit "p**2/2 + x**2/2 + x**4/4" --z0 1,0 --to-energy 2 --prove',
)
@hamiltonian_options
@click.option("--z0", "start", type=STATE, required=True, help="A state near it, e.g. x=1.3,p=1.")
@click.option("--near", type=TIME, help="Guess of the period; by default the first return.")
@click.option("--energy", type=NUMBER, help="Its energy; by default that of the state.")
@click.option("--period", metavar="FORMULA", help="Its period, e.g. 2*pi/omega, and no energy.")
@click.option(
    *("--symmetry", "maps"),
    type=Parsed("map", texts_by_name),
    multiple=True,
    metavar="MAP",
    help="For example y=-y,p_x=-p_x; twice for a pair that reverses time.",
)
@click.option("--tol", type=NUMBER, default="1e-10", show_default=True)
@click.option("--to-energy", type=NUMBER, help="Follow its family to this energy.")
@click.option("--prove", is_flag=True, help="Prove that it exists, and its stability.")
@figure_options
@rows_option(ROWS)
def orbit(
    H: Hamiltonian,
    start: Any,
    near: float | None,
    maps: tuple[dict[str, str], ...],
    to_energy: float | None,
    prove: bool,
    draw: Draw,
    rows: int | None,
    **options: Any,
) -> Report:
    """Find a periodic orbit near a state; exit 1 if that failed."""
    import hamsym

    guess = start if near is None else (start, near)
    symmetry = maps if len(maps) > 1 else next(iter(maps), None)
    found = hamsym.periodic_orbit(H, guess, symmetry=symmetry, **options)
    reports = {"orbit": report_of(found, rows)}
    family = None
    if found.success and to_energy is not None:
        family = found.family(energy=to_energy)
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
