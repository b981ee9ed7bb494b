"""The command that fits parameters and starts to data of a .csv file."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import Command, Report, report_of
from hamsym.cli.options import hamiltonian_options, output_options, rows_option
from hamsym.cli.texts import assignments, listed, number, ranges
from hamsym.errors import InputError
from hamsym.support.text_tables import ROWS

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


@click.command(
    cls=Command,
    short_help="Fit parameters and starts to data.",
    examples=[
        'hamsym fit "p**2/2 - g*cos(theta)" swing.csv --free g=1.4,theta=0.8,p=0 --sigma 0.02',
        'hamsym fit "p**2/2 - g*cos(theta)" swing.csv --free g=1 --z0 theta=0.9,p=0 --plot fit.png',
    ],
)
@hamiltonian_options
@click.argument("file", type=click.Path(), metavar="DATA")
@click.option("--free", required=True, metavar="GUESSES", help="For example g=1.4,theta=0.8.")
@click.option("--z0", "start", metavar="STATE", help="Components of the start that are not free.")
@click.option("--t-start", default="0", metavar="TIME", show_default=True)
@click.option("--t-end", metavar="TIME", help="[the last time of the data]")
@click.option("--sigma", metavar="NUMBERS", help="0.02, or x=0.02,p=0.1  [estimated]")
@click.option("--bounds", metavar="RANGES", help="For example g=0:10,p=:1.")
@click.option("--starts", default=1, show_default=True, help="Number of first guesses.")
@click.option("--seed", default=0, show_default=True, help="Seed of the further guesses.")
@click.option("--confidence", default=0.95, show_default=True, help="Of the intervals.")
@click.option("--tol", default=1e-9, show_default=True, help="Tolerance of the motion.")
@output_options("Data, model and residuals as .csv or .npz.")
@rows_option(ROWS)
def fit(
    H: Hamiltonian,
    file: str,
    free: str,
    start: str | None,
    t_start: str,
    t_end: str | None,
    sigma: str | None,
    bounds: str | None,
    rows: int | None,
    **options: Any,
) -> tuple[Any, Report, list[tuple[str, Any]], dict[str, Any]]:
    """Fit parameters and components of the start to noisy data; exit 1 without success.

    DATA is a .csv file with a header: the column t, and one for each observable, which is a
    component of the state or a formula, e.g. "r*cos(phi)". Empty cells are missing values. Made
    data: hamsym integrate "p**2/2 - g*cos(theta)" -P g=1.3 --z0 theta=0.9,p=0 --t-end 10 --tol 1e-9
    --saves 40 -o swing.csv
    """
    from hamsym.fitting.fit import fit as run

    columns = read_columns(file)
    if "t" not in columns:
        raise InputError(f"'{file}' has no column t; name the column of the times t")
    t = columns.pop("t")
    last = max(t, key=lambda time: abs(time - number(t_start)))
    found = run(
        H,
        t,
        columns,
        free=assignments(free, "--free"),
        span=(number(t_start), last if t_end is None else number(t_end)),
        sigma=None if sigma is None else _sigma(sigma),
        z0=None if start is None else assignments(start, "--z0"),
        bounds=None if bounds is None else _bounds(bounds),
        **options,
    )
    table: list[tuple[str, Any]] = [("t", found.t)]
    for label, data in found.data.items():
        residual = found.residuals[label]
        table += [
            (label, data),
            (f"model {label}", data - residual),
            (f"residual {label}", residual),
        ]
    arrays = {"covariance": found.covariance, **dict(table)}
    return found, report_of(found, rows), table, arrays


def read_columns(path: str) -> dict[str, list[float]]:
    """Return the columns of a .csv file with a header, nan for empty cells.

    Raise InputError if it is not such a file.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as lines:
            rows = [row for row in csv.reader(lines) if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"'{path}' is not a .csv file; give a table as text") from None
    if len(rows) < 2:
        raise InputError(f"'{path}' has no data; give a header and rows of numbers")
    header = [cell.strip() for cell in rows[0]]
    for k, name in enumerate(header):
        if not name or name in header[:k]:
            raise InputError(f"column {k + 1} of '{path}' has no name of its own; name each once")
    columns: dict[str, list[float]] = {name: [] for name in header}
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise InputError(f"row {line} of '{path}' has {len(row)} cells, not {len(header)}")
        for name, cell in zip(header, row, strict=True):
            try:
                columns[name].append(float(cell) if cell.strip() else math.nan)
            except ValueError:
                raise InputError(
                    f"'{cell[:40]}' in row {line} of '{path}' is not a number; leave a missing "
                    "value empty"
                ) from None
    return columns


def _sigma(text: str) -> float | dict[str, float]:
    return assignments(text, "--sigma") if "=" in text else number(text)


def _bounds(text: str) -> dict[str, tuple[float | None, float | None]]:
    """Return the bounds of NAME=LOW:HIGH parts between commas; either end may be empty."""
    return {
        name: (number(low) if low else None, number(high) if high else None)
        for name, (low, high) in ranges(listed(text), "--bounds").items()
    }
