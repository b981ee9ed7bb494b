"""Files of results: save and load.

A file is accepted only if it is exactly what is written: every type, shape, order and value is
checked when it is loaded and when it is saved (:mod:`hamsym.support.records`).
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import Any

import hamsym
from hamsym.errors import FileError, InputError
from hamsym.families.storage import is_store, open_store
from hamsym.problems.description import require_formula
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution
from hamsym.solving.methods import METHODS, option_names
from hamsym.support.atomic import write_file
from hamsym.support.record_fields import NotDataError, check_also
from hamsym.support.records import MALFORMED, packed, unpacked
from hamsym.support.sealed_text import SealedText, kind_of_text
from hamsym.support.shown import Saved
from hamsym.support.suggestions import checked_keywords
from hamsym.support.tensor_files import kind_of, one_line, read_tensors, write_tensors

#: Those of certificates, whose files are text.
CERTIFICATES = {
    "hamsym certificate": "Certificate",
    "hamsym flow map certificate": "BoxCertificate",
    "hamsym orbit certificate": "OrbitCertificate",
}
_LARGEST = 2**25  # bytes of a certificate


@checked_keywords
def save(result: Any, path: str | os.PathLike[str]) -> None:
    """Write a result to a file that :func:`load` reads.

    Parameters
    ----------
    result : Solution, Solutions, FlowMap, Trajectory, Section, PeriodicOrbit, OrbitFamily, Fit, \
Enclosure or a certificate
    path : path-like
        File in the safetensors format, or text of JSON for a certificate, replaced in one step.

    Raises
    ------
    FileError
        If the file cannot be written, or the result is invalid.
    InputError
        If it is no result that has files, or its network is a module of the caller's, whose code
        is not data.

    Examples
    --------
    >>> import hamsym, tempfile
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(solution, folder + "/circle.hamsym")
    ...     again = load(folder + "/circle.hamsym")
    >>> bool((again([1.0, 2.0]) == solution([1.0, 2.0])).all())
    True
    """
    if isinstance(result, SealedText):
        text = result.to_json()
        certificate_from(text)
        write_file(path, text.encode())
        return
    kind = kind_of_class(type(result))
    if class_of_kind(kind) is not type(result):
        raise InputError(
            f"there are no files of {type(result).__name__}; give a result that has a method save"
        )
    try:
        arrays, values = packed(result)
    except (FileError, NotDataError):
        raise
    except MALFORMED as error:
        verb = "are" if kind.endswith("s") else "is"
        raise FileError(
            f"'{path}' was not written, because the {kind} {verb} not valid: {one_line(error)}"
        ) from None
    require_formula(path, result.ensemble.H if hasattr(result, "ensemble") else result.H)
    write_tensors(path, kind, arrays, values)


@checked_keywords
def load(path: str | os.PathLike[str]) -> Any:
    """Read what :func:`save`, or ``save`` of a result, wrote.

    Parameters
    ----------
    path : path-like
        A file, or a store of :func:`hamsym.solve_many`.

    Returns
    -------
    Any
        The result. The windows of a store are read when they are needed. A certificate or an
        enclosure is not proven again; see :func:`hamsym.verify`.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, has another kind or version, or is not valid.
    """
    if is_store(path):
        return open_store(path)
    kind = kind_of(path)
    if kind is None and _is_text(path):
        return read_certificate(Path(path))
    return load_as(class_of_kind(kind or "") or Solution, path)


def load_as(result: type, path: str | os.PathLike[str]) -> Any:
    """Read a file of a class of results; see :func:`load`."""
    kind = kind_of_class(result)
    arrays, values = read_tensors(path, kind)
    try:
        return unpacked(result, arrays, values)
    except MALFORMED as error:
        noun = kind if kind.endswith("s") else f"a {kind}"
        raise FileError(f"'{path}' is not a valid file of {noun}: {one_line(error)}") from None


def kind_of_class(found: type) -> str:
    """Return the kind of the files of a class of results: its name in words.

    Examples
    --------
    >>> import hamsym
    >>> kind_of_class(hamsym.FlowMap)
    'flow map'
    """
    return re.sub("(?<=[a-z])(?=[A-Z])", " ", found.__name__).lower()


def class_of_kind(kind: str) -> Any:
    """Return the public class of results whose files have a kind, None if there is none."""
    name = kind.title().replace(" ", "")
    found = getattr(hamsym, name) if name in dir(hamsym) else None
    if not isinstance(found, type) or not issubclass(found, Saved) or kind_of_class(found) != kind:
        return None
    return None if issubclass(found, SealedText) else found


def load_solution(path: str | os.PathLike[str]) -> Solution:
    """Read a file of one solution; see :func:`load`."""
    found: Solution = load_as(Solution, path)
    return found


def certificate_from(text: str) -> Any:
    """Read the text of a certificate of a solution, a flow map or an orbit; nothing is proven.

    Raise FileError if the text is not a certificate.
    """
    name = CERTIFICATES.get(kind_of_text(text), "Certificate")
    return getattr(hamsym, name).from_json(text)


def read_certificate(path: Path) -> Any:
    """Read the file of a certificate; nothing is proven.

    Raise FileError if the file cannot be read, or has no certificate.
    """
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode) and status.st_size > _LARGEST:
            raise FileError(f"'{path}' is too large for a certificate")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FileError(f"'{path}' is not a certificate") from None
    return certificate_from(text)


def _is_text(path: str | os.PathLike[str]) -> bool:
    """Return whether a regular file begins as the text of a certificate does."""
    try:
        file = Path(path)
        if not file.is_file():  # to open a pipe may never end
            return False
        with file.open("rb") as opened:
            return opened.read(1) == b"{"
    except (OSError, ValueError, TypeError):  # it is no path
        return False


def _check_method(solution: Solution) -> None:
    """Raise ValueError unless the method of a solution can return it."""
    method = METHODS.get(solution.method)
    if method is None or method.marches != isinstance(solution.trial, FeatureTrial):
        raise ValueError(f"method '{solution.method}' does not return such a trial solution")
    solution.settings.require_method({*option_names(method)}, solution.H.dim, solution.span)


check_also(Solution, _check_method)
