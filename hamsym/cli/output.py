"""Files that commands write: tables, figures and certificates."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hamsym.errors import InputError
from hamsym.support.atomic import write_atomically

if TYPE_CHECKING:
    import numpy as np

    from hamsym.proof.windows.certificate import Certificate

CERTIFICATE = ".certificate"  # ending of the file beside that of a solution


#: Endings of the files of figures and of tables.
FIGURES, TABLES = (".png", ".pdf", ".svg"), (".csv", ".npz")


def check_file(path: str | None, endings: Sequence[str]) -> None:
    """Raise InputError if a file with such an ending could not be written, before hours of work."""
    if path is not None and Path(path).suffix not in endings:
        raise InputError(f"'{path}' has another ending; give a name with {' or '.join(endings)}")
    check_directory(path)


def check_directory(path: str | None) -> None:
    """Raise InputError if the directory of a file does not exist."""
    if path is not None and not Path(path).absolute().parent.is_dir():
        raise InputError(f"directory of '{path}' does not exist; create it first")


def save_figure(figure: Any, path: str) -> None:
    """Write a figure in one step, in the format of the file's ending."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(path).suffix[1:])
    write_atomically(Path(path), buffer.getvalue())


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


def write_certificate(certificate: Certificate, file: str, path: str | None = None) -> str:
    """Write a certificate beside the file of its solution, or to a path; return the path."""
    path = path or f"{file}{CERTIFICATE}"
    write_atomically(Path(path), certificate.to_json().encode())
    return path
