"""Commands that prove: certify and verify."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Command, Report, picked
from hamsym.cli.options import rows_option
from hamsym.cli.output import CERTIFICATE, check_directory, write_certificate
from hamsym.cli.texts import saved_solution
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.proof.box_certificate import BoxCertificate
    from hamsym.proof.certificate import Certificate

_time_limit = click.option(
    "--time-limit", type=float, metavar="SECONDS", help="Refuse after this time."
)


@click.command(
    cls=Command,
    short_help="Prove a bound on the error of a saved solution.",
    examples=["hamsym certify orbit.hamsym", "hamsym certify orbit.hamsym --bound 1e-8"],
)
@click.argument("file", type=click.Path())
@click.option("--rtol", default=0.02, show_default=True, help="Relative width of the bounds.")
@click.option("--bound", type=float, help="Prove only that each component's error is below.")
@_time_limit
@click.option("-o", "--output", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@rows_option(ROWS)
def certify(file: str, output: str | None, rows: int | None, **options: Any) -> Report:
    """Compute a rigorous error bound for a saved solution, and write the certificate.

    FILE is a solution saved by `hamsym solve -o FILE`. Exit 1 if nothing could be proven.
    """
    check_directory(output)
    solution = saved_solution(file)
    found = solution.certify(**options)
    path = write_certificate(found, file, output)
    return Report(found.summary(rows), _values_of(found), True, [path])


def _values_of(found: Certificate) -> dict[str, Any]:
    """Return a certificate as values of JSON; the file has the numbers as they are proven."""
    names = found.components
    return {
        **picked(found, "statement bound lower"),
        "component_bounds": dict(zip(names, found.component_bounds, strict=True)),
        "component_lowers": dict(zip(names, found.component_lowers, strict=True)),
        "asked": None if found.asked is None else dict(zip(names, found.asked, strict=True)),
        **picked(found, "energy_bound energy_lower ell_max_bound ell_max_lower digest seconds"),
    }


@click.command(
    cls=Command,
    short_help="Repeat the proof of a certificate.",
    examples=["hamsym verify orbit.hamsym", "hamsym verify orbit.hamsym --time-limit 60"],
)
@click.argument("file", type=click.Path())
@click.option("--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate]")
@_time_limit
def verify(file: str, certificate: str | None, time_limit: float | None) -> Report:
    """Repeat the proof of a certificate from the saved solution or flow map.

    Exit 1 if a bound of the certificate is not proven.
    """
    from hamsym.archive import read_certificate
    from hamsym.proof.balls import decimal
    from hamsym.proof.box_certificate import BoxCertificate
    from hamsym.proof.prove import verify as run

    claims = read_certificate(Path(certificate or f"{file}{CERTIFICATE}"))
    run(claims, file, time_limit)
    last = "every bound of the certificate is proven"
    if isinstance(claims, BoxCertificate):
        return Report(f"verified: {claims.bounds}\n{last}", _values_of_box(claims))
    first = f"verified: the error is at most {decimal(claims.bound)} (2-norm)"
    return Report(f"{first}\n{last}", _values_of(claims))


def _values_of_box(found: BoxCertificate) -> dict[str, Any]:
    """Return a certificate of a flow map as values of JSON."""
    return {
        "statement": found.statement,
        "component_bounds": dict(zip(found.components, found.bound, strict=True)),
        "box": {name: list(ends) for name, ends in found.box.items()},
        "span": list(found.span),
        **picked(found, "parts digest seconds"),
    }
