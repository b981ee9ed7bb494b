"""Commands that prove: certify and verify."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from hamsym.cli.command import Report, command, report_of
from hamsym.cli.options import rows_option
from hamsym.cli.output import CERTIFICATE, check_directory, write_certificate
from hamsym.cli.texts import saved_solution
from hamsym.support.text_tables import wrapped

_time_limit = click.option(
    "--time-limit", type=float, metavar="SECONDS", help="Refuse after this time."
)


@command(
    "Prove a bound on the error of a saved solution.",
    "hamsym certify orbit.hamsym",
    "hamsym certify orbit.hamsym --bound 1e-8",
)
@click.argument("file", type=click.Path())
@click.option("--rtol", default=0.02, show_default=True, help="Relative width of the bounds.")
@click.option("--bound", type=float, help="Prove only that each component's error is below.")
@_time_limit
@click.option("-o", "--output", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@rows_option
def certify(file: str, output: str | None, rows: int | None, **options: Any) -> Report:
    """Compute a rigorous error bound for a saved solution, and write the certificate.

    FILE is a solution saved by `hamsym solve -o FILE`. Exit 1 if nothing could be proven.
    """
    check_directory(output)
    solution = saved_solution(file)
    found = solution.certify(**options)
    path = write_certificate(found, file, output)
    return replace(report_of(found, rows), files=[path])


@command(
    "Repeat the proof of a certificate.",
    "hamsym verify orbit.hamsym",
    "hamsym verify orbit.hamsym --checker independent",
)
@click.argument("file", type=click.Path())
@click.option("--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@click.option(
    "--checker",
    type=click.Choice(["kernel", "independent"]),
    default="kernel",
    show_default=True,
    help="The program that proves, or a small one that shares no line with it.",
)
@_time_limit
def verify(file: str, certificate: str | None, time_limit: float | None, checker: str) -> Report:
    """Repeat the proof of a certificate from the saved solution or flow map.

    Exit 1 if a bound of the certificate is not proven. The independent checker covers solutions,
    flow maps of one leg and periodic orbits; it parses H itself and works in ball arithmetic, in
    two to fifty times the time of certify.
    """
    from hamsym.archive import read_certificate
    from hamsym.proof.prove import verify as run

    claims = read_certificate(Path(certificate or f"{file}{CERTIFICATE}"))
    run(claims, file, time_limit, checker=checker)
    facts, proven = claims.facts, "every bound of the certificate is proven"
    if checker == "independent":
        proven += " by the independent checker"
    text = f"{wrapped(facts.headline, 'verified: ')}\n{wrapped(proven)}"
    return Report(text, facts.values())
