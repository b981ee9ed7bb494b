"""Export of solutions, in the format of the file's ending."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hamsym
from hamsym.errors import InputError
from hamsym.exporting.about import About, checked_certificate
from hamsym.solution.solution import Solution
from hamsym.support.atomic import write_file
from hamsym.support.suggestions import checked_keywords


@dataclass(frozen=True)
class Format:
    """A format of exported files."""

    summary: str
    #: (About, stem of the file's name) -> its bytes.
    content: Callable[[About, str], bytes]
    #: Largest number of float64 numbers in a file.
    most: int


def _python(about: About, stem: str) -> bytes:
    from hamsym.exporting.python_module import python_module

    return python_module(about, _form(about, ".py"))


def _json(about: About, stem: str) -> bytes:
    from hamsym.exporting.json_document import json_document

    return json_document(about, _form(about, ".json"))


def _header(about: About, stem: str) -> bytes:
    from hamsym.exporting.c_header import c_header

    return c_header(about, _form(about, ".h"), stem)


#: Formats by the ending of the file's name.
FORMATS: dict[str, Format] = {
    ".py": Format("a module that needs only numpy", _python, 100_000_000),
    ".json": Format("numbers for JavaScript", _json, 5_000_000),
    ".h": Format("a header in C99", _header, 5_000_000),
}


def _form(about: About, ending: str) -> Any:
    from hamsym.exporting.closed_form import closed_form

    form = closed_form(about.solution)
    if form.numbers > FORMATS[ending].most:
        raise InputError(
            f"the solution has {form.numbers:,} numbers in {form.windows:,} windows, more than the "
            f"{FORMATS[ending].most:,} of a '{ending}' file; export a shorter span"
            + (", or a module with the ending .py" if ending in (".json", ".h") else "")
        )
    return form


@checked_keywords
def export(
    result: Solution,
    path: str | os.PathLike[str],
    *,
    certificate: hamsym.Certificate | None = None,
    allow_failed: bool = False,
) -> None:
    """Write a solution as a file that is evaluated without hamsym.

    The ending of the file's name is its format:

    ``.py``
        A module with ``state(t)``, ``derivative(t)`` and ``energy(t)`` that needs only numpy. It
        refuses times outside the span. Values are those of the solution, to the last bit for
        ``method="features"`` on the same machine.
    ``.json``
        The same numbers for JavaScript and others, in the arrangement that
        ``examples/guide/exporting.md`` gives.
    ``.h``
        A header in C99 with ``NAME_state(t, z)``, ``NAME_derivative(t, dz)`` and
        ``NAME_energy(t)``, where NAME is the name of the file.

    All of them say what they are: H and its parameters, the start, the span, the method, the
    tolerance that was asked and reached, the largest estimated error of each component, the
    certificate, and what makes the solution again. Numbers are exact.

    Parameters
    ----------
    result : Solution
    path : path-like
        The file, replaced in one step.
    certificate : Certificate, optional
        A proof of the solution's error, by default ``solution.certificate``. It is compared with
        the solution, and not proven again.
    allow_failed : bool
        Write a solution with ``success=False`` too; the file then says first that it failed.

    Raises
    ------
    InputError
        If the ending has no format, the result cannot be exported, failed, is too large for the
        format, or the certificate is that of another solution.
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> import hamsym, runpy, tempfile
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export(solution, folder + "/orbit.py")
    ...     orbit = runpy.run_path(folder + "/orbit.py")
    >>> bool((orbit["state"]([1.0, 2.0]) == solution([1.0, 2.0])).all())
    True
    """
    if not isinstance(result, Solution):
        members = isinstance(result, hamsym.Solutions)
        remedy = "export one of them, e.g. many[0]" if members else "give the result of solve"
        raise InputError(f"a {type(result).__name__} cannot be exported; {remedy}")
    target, chosen = _target(path)
    if not result.success and not allow_failed:
        raise InputError(
            f"the solution failed ({result.message}); solve it again, or give allow_failed=True to "
            "export it as it is"
        )
    about = About(result, checked_certificate(result, certificate))
    content = chosen.content(about, target.stem)
    write_file(target, content)


def check_target(path: str | os.PathLike[str]) -> None:
    """Raise InputError unless the ending of a file's name has a format."""
    _target(path)


def _target(path: str | os.PathLike[str]) -> tuple[Path, Format]:
    try:
        target = Path(os.fsdecode(path))
    except TypeError:
        raise InputError(f"path={path!r} is not the name of a file; give a str or a Path") from None
    chosen = FORMATS.get(target.suffix.lower())
    if chosen is None:
        known = ", ".join(f"{ending} ({row.summary})" for ending, row in FORMATS.items())
        raise InputError(f"'{path}' has no ending of a format; give one of {known}")
    return target, chosen
