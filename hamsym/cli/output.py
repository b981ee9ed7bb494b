"""Output of commands: text, tables and figures."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.errors import InputError
from hamsym.support.atomic import write_atomically

if TYPE_CHECKING:
    import numpy as np

    from hamsym.proof.certificate import Certificate

__all__ = [
    "CERTIFICATE",
    "WIDTH",
    "check_directory",
    "check_figure",
    "check_table",
    "echo_wrapped",
    "report",
    "save_figure",
    "write_certificate",
    "write_table",
]

WIDTH = 80  # columns of text
CERTIFICATE = ".certificate"  # ending of the file beside that of a solution


def echo_wrapped(start: str, text: str) -> None:
    """Print a text after a label, wrapped at 80 columns."""
    click.echo(
        textwrap.fill(
            text,
            WIDTH,
            initial_indent=start,
            subsequent_indent=" " * len(start),
            break_long_words=False,
            break_on_hyphens=False,
        )
    )


def report(solution: Any) -> None:
    """Print whether a solution converged, its errors and the time it took."""
    echo_wrapped("converged: " if solution.success else "", solution.message)
    sigma = solution.sigma_min
    bound = (
        f"{solution.error_bound:.2e} (heuristic)"
        if sigma > 0
        else "infinite: the Hessian is singular on the trajectory"
    )
    click.echo(f"ell_max {solution.ell_max:.2e}, sigma_min {sigma:.3g}")
    click.echo(f"bound ell_max/sigma_min: {bound}")
    record = solution.record
    from hamsym.solving import METHODS  # imports sympy

    if METHODS[solution.method].marches:
        width = max(map(len, solution.H.names))
        click.echo(f"{'':<{width}}  {'scale':>10}  {'estimated error':>16}")
        for name, scale, error in zip(
            solution.H.names, solution.scale, solution.largest_error, strict=True
        ):
            click.echo(f"{name:<{width}}  {scale:>10.4g}  {error:>16.1e}")
        click.echo(f"time {record.seconds:.3f} s for the last march")
    else:
        each = 1e3 * record.cpu_seconds / max(record.iterations, 1)
        unit = "epoch" if solution.method == "adam" else "iteration"
        click.echo(f"time {record.seconds:.1f} s, {each:.2f} ms of CPU per {unit}")


_FIGURE_ENDINGS = (".png", ".pdf", ".svg")


def check_figure(path: str | None) -> None:
    """Raise InputError if a figure could not be written, before hours of work."""
    if path is None:
        return
    if Path(path).suffix not in _FIGURE_ENDINGS:
        listed = ", ".join(_FIGURE_ENDINGS)
        raise InputError(f"'{path}' is not a figure file; give a name that ends in one of {listed}")
    check_directory(path)


def check_directory(path: str | None) -> None:
    """Raise InputError if the directory of a file does not exist."""
    if path is not None and not Path(path).absolute().parent.is_dir():
        raise InputError(f"directory of '{path}' does not exist; create it first")


def save_figure(figure: Any, path: str) -> None:
    """Write a figure in one step, in the format of the file's ending."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix[1:], dpi=130)
    write_atomically(Path(path), buffer.getvalue())
    click.echo(f"wrote {path}")


def check_table(path: str | None) -> None:
    """Raise InputError if a table could not be written."""
    if path is not None and Path(path).suffix not in (".csv", ".npz"):
        raise InputError(f"'{path}' is neither .csv nor .npz; give a name with such an ending")
    check_directory(path)


def write_table(
    path: str, columns: list[tuple[str, np.ndarray]], arrays: dict[str, np.ndarray]
) -> None:
    """Write columns as .csv or arrays as .npz; a repeated column name gets a trailing '_'."""
    import numpy as np

    buffer = io.BytesIO()
    if Path(path).suffix == ".npz":
        np.savez(buffer, allow_pickle=False, **arrays)
    else:
        table = np.column_stack([values for _, values in columns])
        names: list[str] = []
        for name, _ in columns:
            while name in names:
                name += "_"
            names.append(name)
        header = ",".join(names)
        np.savetxt(buffer, table, fmt="%.17g", delimiter=",", header=header, comments="")
    write_atomically(Path(path), buffer.getvalue())
    click.echo(f"wrote {path}")


def write_certificate(certificate: Certificate, file: str, path: str | None = None) -> str:
    """Write a certificate beside the file of its solution, or to a path; return the path."""
    path = path or f"{file}{CERTIFICATE}"
    write_atomically(Path(path), certificate.to_json().encode())
    return path
