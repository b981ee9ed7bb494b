"""Commands of dynamics: lyapunov, section, orbit, equilibria."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Report, command, report_of
from hamsym.cli.options import (
    Draw,
    Output,
    figure_options,
    hamiltonian_options,
    integrator_options,
    output_options,
    rows_option,
    start_options,
)
from hamsym.cli.texts import NUMBER, SECONDS, STATE, TIME, Parsed, intervals, joined, texts_by_name
from hamsym.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from hamsym.hamiltonian import Hamiltonian

_METHODS = "hamsym integrate --list shows the methods."


@command(
    "Compute Lyapunov exponents, MEGNO and SALI.",
    'hamsym lyapunov "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3" '
    "--z0 0.3,-0.3,0.3,0.15 --t-end 1000",
    'hamsym lyapunov "p**2/2 - cos(x)" --z0 1,0 --t-end 1000 --indicators',
    epilog=_METHODS,
)
@hamiltonian_options
@start_options(several=True)
@integrator_options
@click.option("--count", default=1, show_default=True, help="Number of exponents.")
@click.option("--seed", default=0, show_default=True, help="Seed of the tangent vectors.")
@click.option("--indicators", is_flag=True, help="MEGNO and SALI in place of the exponents.")
@output_options("History, or exponents of several starts, as .csv or .npz.")
@rows_option
def lyapunov(
    H: Hamiltonian,
    z0: Any,
    span: tuple[float, float],
    indicators: bool,
    rows: int | None,
    **options: Any,
) -> Output:
    """Compute finite-time Lyapunov exponents and judge whether the trajectory is chaotic.

    Of several starts, the exponents at the end are computed.
    """
    if indicators:
        return _indicators(H, z0, span, **options)

    from hamsym.dynamics.lyapunov import LyapunovExponents
    from hamsym.dynamics.lyapunov import lyapunov as run

    found: Any = run(H, z0, span, **options)
    names = [f"exponent {k + 1}" for k in range(found.exponents.shape[-1])]
    if isinstance(found, LyapunovExponents):
        columns = [("t", found.t), *zip(names, found.exponents.T, strict=True)]
        arrays = {"t": found.t, "exponents": found.exponents}
        return found, report_of(found, rows), columns, arrays
    columns = [*zip(H.names, found.z0.T, strict=True), *zip(names, found.exponents.T, strict=True)]
    arrays = {"z0": found.z0, "exponents": found.exponents, "success": found.success}
    return found, report_of(found, rows), columns, arrays


def _indicators(
    H: Hamiltonian, z0: Any, span: tuple[float, float], count: int, **options: Any
) -> Output:
    """Compute the chaos indicators of one trajectory over time."""
    from hamsym.dynamics.chaos_indicators import chaos_indicators as run

    if count != 1:
        raise InputError(f"--count {count} has no meaning with --indicators; leave one of them out")
    found = run(H, z0, span, **options)
    arrays: dict[str, np.ndarray] = {
        "t": found.t,
        "megno": found.megno,
        "mean_megno": found.mean_megno,
        "sali": found.sali,
    }
    columns = [(name.replace("_", " "), values) for name, values in arrays.items()]
    return found, report_of(found), columns, arrays


@command(
    "Compute a Poincare section.",
    'hamsym section "p**2/2 - cos(x)" --z0 1,0 --t-end 50 --at "x = 0, p > 0"',
    'hamsym section "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3" '
    '--z0 x=0,y=0.1,p_y=0 --energy 1/8 --t-end 500 --at "x = 0, p_x > 0" --plot section.png',
    epilog=_METHODS,
)
@hamiltonian_options
@start_options(several=True)
@click.option("--at", "surface", required=True, metavar="SURFACE", help='"x = 0, p_x > 0"')
@click.option("--energy", type=NUMBER, help="Energy of states that lack one component.")
@integrator_options
@click.option("--crossings", type=int, help="Stop at this number for each trajectory.")
@click.option("--prove", is_flag=True, help="Prove that these are all, and how exact they are.")
@output_options("Crossings as .csv or .npz.")
@rows_option
def section(
    H: Hamiltonian, z0: Any, span: tuple[float, float], rows: int | None, **options: Any
) -> Output:
    """Compute a Poincare section: crossings of a surface, to round-off."""
    from hamsym.dynamics.sections import section as run

    found = run(H, z0, span, **options)
    columns = [("trajectory", found.trajectory), ("t", found.t)]
    columns += zip(H.names, found.z.T, strict=True)
    arrays = {"trajectory": found.trajectory, "t": found.t, "z": found.z, "z0": found.z0}
    return found, report_of(found, rows), columns, arrays


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
@rows_option
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
@rows_option
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
