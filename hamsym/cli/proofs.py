"""Commands that prove: certify and verify."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hamsym.cli.output import CERTIFICATE, check_directory, echo_wrapped, write_certificate
from hamsym.cli.texts import saved_solution

__all__ = ["certify", "verify"]

_time_limit = click.option(
    "--time-limit", type=float, metavar="SECONDS", help="Refuse after this time."
)


@click.command()
@click.argument("file", type=click.Path())
@click.option("--rtol", default=0.02, show_default=True, help="Relative width of the bounds.")
@click.option("--bits", type=int, help="Working precision of ball arithmetic  [as needed]")
@click.option("--bound", type=float, help="Prove only that each component's error is below.")
@_time_limit
@click.option("-o", "--output", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
def certify(file: str, output: str | None, **options: Any) -> None:
    """Compute a rigorous error bound for a saved solution, and write the certificate.

    FILE is a solution saved by `hamsym solve -o FILE`. Exit 1 if nothing could be proven.
    """
    check_directory(output)
    solution = saved_solution(file)
    found = solution.certify(**options)
    echo_wrapped("", found.statement)
    names = ["|z|", *solution.H.names, "H", "ell_max"]
    lowers = [found.lower, *found.component_lowers, found.energy_lower, found.ell_max_lower]
    bounds = [found.bound, *found.component_bounds, found.energy_bound, found.ell_max_bound]
    width = max(map(len, names))
    click.echo(f"\n{'error of':<{max(width, 8)}}{'at least':>16}{'at most':>16}")
    for name, lower, bound in zip(names, lowers, bounds, strict=True):
        click.echo(f"{name:<{max(width, 8)}}{lower:>16.8e}{bound:>16.8e}")
    click.echo(f"proven in {found.seconds:.2f} s")
    click.echo(f"wrote {write_certificate(found, file, output)}")


@click.command()
@click.argument("file", type=click.Path())
@click.option("--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@_time_limit
def verify(file: str, certificate: str | None, time_limit: float | None) -> None:
    """Repeat the proof of a certificate from the saved solution.

    Exit 1 if a bound of the certificate is not proven.
    """
    from hamsym.proof.prove import verify as run

    path = Path(certificate or f"{file}{CERTIFICATE}")
    run(path.read_text(encoding="utf-8"), file, time_limit)
    click.echo("verified: every bound of the certificate is proven")
