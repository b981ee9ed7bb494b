"""The command that serves the page in the browser."""

from __future__ import annotations

import json

import click

from hamsym.cli.command import command


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
