"""Commands that derive: the equations and the generated code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from hamsym.cli.options import hamiltonian_options
from hamsym.cli.output import WIDTH, echo_wrapped
from hamsym.support.atomic import write_atomically

if TYPE_CHECKING:
    from hamsym.formula.printer import FormulaPrinter
    from hamsym.hamiltonian import Hamiltonian

__all__ = ["derive", "source"]


@click.command()
@hamiltonian_options
def derive(H: Hamiltonian) -> None:
    """Show H, its equations of motion, its Hessian and properties that follow from them."""
    from hamsym.formula.printer import FormulaPrinter

    write = FormulaPrinter()
    echo_wrapped("H = ", H.formula)
    echo_wrapped("z = ", f"({', '.join(H.names)})")
    if H.parameter_names:
        values = (
            f"{name} = {H.parameters[name]:g}" if name in H.parameters else name
            for name in H.parameter_names
        )
        echo_wrapped("parameters: ", ", ".join(values))
    click.echo("\nHamilton's equations")
    left = [f"d{name}/dt" for name in H.names]
    width = max(map(len, left))
    for name, rate in zip(left, H.vector_field, strict=True):
        echo_wrapped(f"  {name:<{width}} = ", write(rate))
    click.echo("\nHessian")
    _echo_hessian(H, write)
    click.echo("")
    if H.is_separable:
        click.echo("separable: yes")
        echo_wrapped("  T = ", write(H.kinetic))
        echo_wrapped("  V = ", write(H.potential))
    else:
        click.echo("separable: no, H has mixed second derivatives in q and p")
    cyclic = ", ".join(symbol.name for symbol in H.cyclic_coordinates)
    echo_wrapped("cyclic coordinates: ", cyclic or "none")
    smallest = H.sigma_min
    closed = "no short closed form (computed along solutions)"
    echo_wrapped("sigma_min: ", closed if smallest is None else write(smallest))


def _echo_hessian(H: Hamiltonian, write: FormulaPrinter) -> None:
    matrix = H.hessian
    cells = [[write(matrix[i, j]) for j in range(H.dim)] for i in range(H.dim)]
    widths = [max(len(row[j]) for row in cells) for j in range(H.dim)]
    if sum(widths) + 2 * H.dim + 4 <= WIDTH:
        for row in cells:
            padded = (cell.rjust(size) for cell, size in zip(row, widths, strict=True))
            click.echo(f"  [{'  '.join(padded)}]")
        return
    for i in range(H.dim):
        for j in range(i, H.dim):
            if matrix[i, j] != 0:
                echo_wrapped(f"  d2H/d{H.names[i]} d{H.names[j]} = ", cells[i][j])


@click.command()
@hamiltonian_options
@click.option("--backend", type=click.Choice(["torch", "numpy", "numba", "balls"]), default="torch")
@click.option("--part", metavar="NAME", help="One function, e.g. loss or vector_field.")
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write to a file.")
def source(H: Hamiltonian, backend: str, part: str | None, output: str | None) -> None:
    """Print the generated code, or write it to a file that runs without hamsym."""
    text = H.source(backend, part).rstrip("\n") + "\n"
    if output is None:
        click.echo(text, nl=False)
    else:
        write_atomically(Path(output), text.encode())
        click.echo(f"wrote {output}")
