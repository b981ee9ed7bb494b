"""Commands that show and share: export, report, explore."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from hamsym.cli.command import Report, command
from hamsym.cli.output import CERTIFICATE, check_directory
from hamsym.cli.texts import intervals, joined, saved_solution
from hamsym.codegen.backends import BACKENDS
from hamsym.errors import InputError

_HIDDEN = "balls"  # code of proofs, which nobody runs by hand


@command(
    "Write a saved solution as code or as a page without hamsym.",
    "hamsym export orbit.hamsym -o orbit.py",
    "hamsym export orbit.hamsym -o lesson.html --title 'An oscillator'",
)
@click.argument("file", type=click.Path())
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(),
    metavar="FILE",
    help="Ends in .py, .json, .h or .html.",
)
@click.option(
    "--certificate", type=click.Path(), metavar="CERTIFICATE", help="[FILE.certificate, if there]"
)
@click.option("--allow-failed", is_flag=True, help="Export a solution that did not converge.")
@click.option(
    *("--slider", "parameters"),
    multiple=True,
    callback=joined(intervals),
    metavar="NAME=LOW:HIGH",
    help="A parameter with a slider on a page  [all]",
)
@click.option("--title", help="Heading of a page.")
@click.option("--text", default="", help="Text of a page; empty lines separate paragraphs.")
def export(file: str, output: str, certificate: str | None, **options: Any) -> Report:
    """Write a saved solution as Python, JSON or C code, or as a page, that needs no hamsym.

    FILE is a solution saved by `hamsym solve -o FILE`. Code says what it is, its error and its
    certificate, which is compared with the solution and not proven again. A page (.html) is a
    lesson: its motion is computed in the browser, with sliders for the start and parameters.
    """
    check_export(output)
    solution = saved_solution(file)
    path = Path(certificate or f"{file}{CERTIFICATE}")
    proof = None
    is_page = output.lower().endswith(".html")
    if certificate is not None or (path.exists() and not is_page):
        proof = _certificate(path, solution)
    solution.export(output, certificate=proof, **options)
    size = Path(output).stat().st_size
    return Report(f"wrote {output} ({_size(size)})", {"files": [output], "bytes": size})


def _certificate(path: Path, solution: Any) -> Any:
    """Return the certificate in a file, if it is that of a solution."""
    from hamsym.archive import read_certificate
    from hamsym.solution.digest import digest

    found = read_certificate(path)
    if found.digest != digest(solution):
        raise InputError(
            f"'{path}' is the certificate of another solution; remove it, or give the one of this "
            "solution with --certificate"
        )
    return found


def check_export(path: str | None) -> None:
    """Raise InputError if an export could not be written, before hours of work."""
    if path is not None:
        from hamsym.exporting.export import checked_target

        checked_target(path)
        check_directory(path)


def _size(count: int) -> str:
    """A number of bytes with a unit."""
    size, units = float(count), ["B", "kB", "MB", "GB"]
    while size >= 999.5 and len(units) > 1:
        size, units = size / 1_000, units[1:]
    return f"{size:.3g} {units[0]}"


@command(
    "Write a report about a saved solution.",
    "hamsym report orbit.hamsym -o report.html",
    "hamsym report orbit.hamsym --certify --no-compare",
)
@click.argument("file", type=click.Path())
@click.option("-o", "--output", type=click.Path(), metavar="HTML", help="[FILE with .html]")
@click.option("--title", help="Heading of the report.")
@click.option("--notes", metavar="TEXT", default="", help="Text of your own below the summary.")
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


@command(
    "Serve a page: type H, move sliders, see what follows.",
    "hamsym explore",
    'hamsym explore "p**2/2 - cos(x)" --port 8123 --no-browser',
)
@click.argument("formula", metavar="[H]", default="")
@click.option("--port", default=0, show_default="a free one", help="Port on 127.0.0.1.")
@click.option("--browser/--no-browser", default=True, help="Open the page in the browser.")
@click.pass_context
def explore(context: click.Context, formula: str, port: int, browser: bool) -> None:
    """Serve a page in the browser: type H, move sliders, see what follows.

    The page is for this machine alone: it needs the address that is printed, with its token. Ctrl-C
    ends it. It needs pip install "hamsym[explore]".
    """
    from hamsym.workbench.explore.server import explore as serve

    as_json = context.meta.get("hamsym.json", False)

    def announce(address: str) -> None:
        click.echo(json.dumps({"address": address}) if as_json else address)
        click.echo("Ctrl-C ends it.", err=True)

    serve(formula, port=port, browser=browser, announce=announce)
