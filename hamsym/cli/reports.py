"""The command report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hamsym.cli.command import Command, Report
from hamsym.codegen.backends import BACKENDS

_HIDDEN = "balls"  # code of proofs, which nobody runs by hand


@click.command(
    cls=Command,
    short_help="Write a report about a saved solution.",
    examples=[
        "hamsym report orbit.hamsym -o report.html",
        "hamsym report orbit.hamsym --certify --no-compare",
    ],
)
@click.argument("file", type=click.Path())
@click.option("-o", "--output", type=click.Path(), metavar="HTML", help="[FILE with .html]")
@click.option("--title", help="Heading of the report.")
@click.option(
    "--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate, if any]"
)
@click.option("--certify", is_flag=True, help="Prove a bound on the error now.")
@click.option("--compare/--no-compare", default=True, help="Compare with integrators  [yes]")
@click.option(
    "--backend",
    type=click.Choice([name for name in BACKENDS if name != _HIDDEN]),
    default="numpy",
    show_default=True,
    help="Language of the code that is shown.",
)
@click.option("--time-limit", type=float, metavar="SECONDS", help="For a proof.")
def report(file: str, output: str | None, **options: Any) -> Report:
    """Write all that is known about a saved solution to one file of HTML.

    FILE is a solution saved by `hamsym solve -o FILE`. A certificate is verified by repeating its
    proof. Exit 1 if --certify proved nothing.
    """
    from hamsym.workbench.reports.report import report as run

    path = str(Path(file).with_suffix(".html")) if output is None else output
    proof = run(file, path, **options)
    proven = proof.certificate
    values = {"proof": proof.sentence, "digest": None if proven is None else proven.digest}
    return Report(proof.sentence, values, proven is not None or not options["certify"], [path])
