"""The command that fits parameters and starts to data of a .csv file."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hamsym.cli.command import command, report_of
from hamsym.cli.options import Output, hamiltonian_options, output_options, rows_option
from hamsym.cli.texts import TIME, VALUES, Parsed, number, ranges, state
from hamsym.errors import InputError

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian


def _sigma(text: str) -> Any:
    return state(text) if "=" in text else number(text)


@command(
    "Fit parameters and starts to data.",
    'hamsym fit "p**2/2 - g*cos(theta)" swing.csv --free g=1.4,theta=0.8,p=0 --sigma 0.02',
    'hamsym fit "p**2/2 - g*cos(theta)" swing.csv --free g=1 --z0 theta=0.9,p=0 --plot fit.png',
)
@hamiltonian_options
@click.argument("file", type=click.Path(), metavar="DATA")
@click.option("--free", type=VALUES, required=True, metavar="GUESSES", help="E.g. g=1.4,theta=0.8.")
@click.option("--z0", type=VALUES, help="Components of the start that are not free.")
@click.option("--t-start", type=TIME, default="0", show_default=True)
@click.option("--t-end", type=TIME, help="[the last time of the data]")
@click.option("--sigma", type=Parsed("numbers", _sigma), help="0.02, or x=0.02,p=0.1  [estimated]")
@click.option("--bounds", type=Parsed("ranges", ranges), help="For example g=0:10,p=:1.")
@click.option("--starts", default=1, show_default=True, help="Number of first guesses.")
@click.option("--seed", default=0, show_default=True, help="Seed of the further guesses.")
@click.option("--confidence", default=0.95, show_default=True, help="Of the intervals.")
@click.option("--tol", default=1e-9, show_default=True, help="Tolerance of the motion.")
@output_options("Data, model and residuals as .csv or .npz.")
@rows_option
def fit(
    H: Hamiltonian,
    file: str,
    t_start: float,
    t_end: float | None,
    rows: int | None,
    **options: Any,
) -> Output:
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
    last = max(t, key=lambda time: abs(time - t_start))
    found = run(H, t, columns, span=(t_start, last if t_end is None else t_end), **options)
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
