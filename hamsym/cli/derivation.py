"""Commands that derive: the equations, the generated code, what is conserved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Choice, Report, command, completing, report_of
from hamsym.cli.options import formula_options, hamiltonian_options, rows_option
from hamsym.cli.texts import NAMES
from hamsym.codegen.backends import BACKENDS, FUNCTIONS
from hamsym.errors import InputError
from hamsym.support.atomic import write_atomically
from hamsym.support.text_tables import columns, wrapped

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.symbolic.lagrangian import Lagrangian


@command(
    "Show the equations of motion and the Hessian.",
    'hamsym derive "p**2/(2*m) + k*x**2/2" --param k=2',
    'hamsym derive --lagrangian "m*(rdot**2 + r**2*dphi**2)/2 + k/r"',
)
@formula_options
@click.option("--lagrangian", is_flag=True, help="The formula is a Lagrangian, e.g. in x and xdot.")
@click.option("--velocities", type=NAMES, help="Velocities of --q, for other names than xdot.")
@click.option("--latex", "typeset", is_flag=True, help="Print an align environment of LaTeX.")
def derive(
    expression: str,
    q: Sequence[str] | None,
    p: Sequence[str] | None,
    parameters: Mapping[str, float] | None,
    forces: Mapping[str, str] | None,
    lagrangian: bool,
    velocities: Sequence[str] | None,
    typeset: bool,
) -> Report:
    """Show H, its equations of motion, its Hessian and properties that follow from them."""
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.symbolic.lagrangian import read_lagrangian

    read = None
    if lagrangian:
        read = read_lagrangian(expression, q, velocities, p, parameters)
        H = Hamiltonian(
            read.hamiltonian, q=read.q, p=read.p, parameters=read.parameters, forces=forces
        )
    elif velocities is not None:
        raise InputError("--velocities names those of a Lagrangian; add --lagrangian")
    else:
        H = Hamiltonian(expression, q=q, p=p, parameters=parameters, forces=forces)
    values = _values_of(H, read)
    if typeset:
        from hamsym.cli.typesetting import aligned

        text = aligned(H, read)
        return Report(text, values | {"latex": text})
    return Report("\n".join(_lines(H, read)), values)


def _lines(H: Hamiltonian, read: Lagrangian | None) -> list[str]:
    """Return H, its equations and its properties as lines of text."""
    write = H.notation.text
    lines = [] if read is None else [wrapped(read.notation.text(read.expr), "L = ")]
    lines.append(wrapped(write(H.expr), "H = "))
    lines += [wrapped(write(force), f"force of {name} = ") for name, force in H.forces.items()]
    lines.append(wrapped(f"({', '.join(H.names)})", "z = "))
    if H.parameter_names:
        values = (
            f"{name} = {H.parameters[name]:g}" if name in H.parameters else name
            for name in H.parameter_names
        )
        lines.append(wrapped(", ".join(values), "parameters: "))
    if read is not None:
        lines.append("\nMomenta")
        width = max(len(symbol.name) for symbol in read.p)
        for symbol, momentum in zip(read.p, read.momenta, strict=True):
            text = read.notation.text(momentum)
            lines.append(wrapped(text, f"  {symbol.name:<{width}} = "))
    lines.append("\nHamilton's equations")
    left = [f"d{name}/dt" for name in H.names]
    width = max(map(len, left))
    for name, rate in zip(left, H.vector_field, strict=True):
        lines.append(wrapped(write(rate), f"  {name:<{width}} = "))
    lines += ["\nHessian", *_hessian(H), ""]
    if H.kinetic is not None:
        depends = "" if H.is_separable else ", but a force depends on momenta"
        lines.append(f"separable: yes{depends}")
        lines.append(wrapped(write(H.kinetic), "  T = "))
        lines.append(wrapped(write(H.potential), "  V = "))
    else:
        lines.append("separable: no, H has mixed second derivatives in q and p")
    cyclic = ", ".join(symbol.name for symbol in H.cyclic_coordinates)
    lines.append(wrapped(cyclic or "none", "cyclic coordinates: "))
    if H.forces:
        return [*lines, wrapped(write(H.power), "dH/dt = ")]
    smallest = H.sigma_min
    closed = "no short closed form (computed along solutions)"
    return [*lines, wrapped(closed if smallest is None else write(smallest), "sigma_min: ")]


def _values_of(H: Hamiltonian, read: Lagrangian | None) -> dict[str, Any]:
    """Return what is derived as values of JSON, formulas as texts."""
    write = H.notation.text
    values: dict[str, Any] = {
        "H": H.formula,
        "q": H.names[: H.dof],
        "p": H.names[H.dof :],
        "parameters": {name: H.parameters.get(name) for name in H.parameter_names},
        "forces": dict(H.force_texts),
        "equations": {n: write(rate) for n, rate in zip(H.names, H.vector_field, strict=True)},
        "hessian": [[write(H.hessian[i, j]) for j in range(H.dim)] for i in range(H.dim)],
        "separable": H.is_separable,
        "cyclic": [symbol.name for symbol in H.cyclic_coordinates],
        "sigma_min": None if H.forces or H.sigma_min is None else write(H.sigma_min),
    }
    if read is not None:
        momenta = zip(read.p, read.momenta, strict=True)
        write = read.notation.text
        values["L"] = write(read.expr)
        values["momenta"] = {symbol.name: write(momentum) for symbol, momentum in momenta}
    return values


def _hessian(H: Hamiltonian) -> list[str]:
    matrix = H.hessian
    cells = [[H.notation.text(matrix[i, j]) for j in range(H.dim)] for i in range(H.dim)]
    widths = [max(len(row[j]) for row in cells) for j in range(H.dim)]
    if sum(widths) + 2 * H.dim + 4 <= columns():
        return [
            f"  [{'  '.join(cell.rjust(size) for cell, size in zip(row, widths, strict=True))}]"
            for row in cells
        ]
    return [
        wrapped(cells[i][j], f"  d2H/d{H.names[i]} d{H.names[j]} = ")
        for i in range(H.dim)
        for j in range(i, H.dim)
        if matrix[i, j] != 0
    ]


@command(
    "Print the generated code.",
    'hamsym source "p**2/2 + x**2/2 + x**4/4" --backend numpy --part vector_field',
    'hamsym source "p**2/2 - k*cos(x)" --backend c -o pendulum.c',
)
@hamiltonian_options
@click.option("--backend", type=Choice(BACKENDS), default="torch", show_default=True)
@click.option(
    "--part",
    metavar="NAME",
    help="One function, e.g. loss or vector_field.",
    shell_complete=completing(lambda: FUNCTIONS),
)
@click.option("-o", "--output", type=click.Path(), metavar="FILE", help="Write to a file.")
def source(H: Hamiltonian, backend: str, part: str | None, output: str | None) -> Report:
    """Print the generated code, or write it to a file that runs without hamsym."""
    text = H.source(backend, part).rstrip("\n") + "\n"
    values = {"backend": backend, "part": part, "source": text}
    if output is None:
        return Report(text, values)
    write_atomically(Path(output), text.encode())
    return Report("", values, files=[output])


@command(
    "Find conserved functions.",
    'hamsym invariants "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)" --degree 3',
    'hamsym invariants "p_r**2/2 + p_phi**2/(2*r**2) - 1/r" --basis "cos(phi)"',
)
@hamiltonian_options
@click.option("--degree", type=int, default=2, show_default=True, help="Largest total degree.")
@click.option(
    "--basis",
    multiple=True,
    metavar="FORMULA",
    help="A further function, e.g. cos(phi); repeat it.",
)
@click.option("--time-limit", type=float, default=60.0, show_default=True, metavar="SECONDS")
@rows_option
def invariants(
    H: Hamiltonian, degree: int, basis: tuple[str, ...], time_limit: float, rows: int | None
) -> Report:
    """Find polynomials of the state, and of the functions in H, that are conserved beside H."""
    found = H.invariants(degree, basis=basis, time_limit=time_limit)
    return report_of(found, rows)
