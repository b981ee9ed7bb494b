"""Export of solutions and of systems, in the format of the file's ending."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sympy

import hamsym
from hamsym.errors import InputError
from hamsym.exporting.about import About, checked_certificate
from hamsym.exporting.closed_form import ClosedForm, closed_form
from hamsym.exporting.formats import c_header, json_document, python_module
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.solution.solution import Solution
from hamsym.support.atomic import write_file
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import checked_mapping


@dataclass(frozen=True)
class Format:
    """A format of exported files."""

    summary: str
    #: (About, the numbers, stem of the file's name) -> its bytes.
    content: Callable[[About, ClosedForm, str], bytes]
    #: Largest number of float64 numbers in a file.
    most: int


#: Formats by the ending of the file's name.
FORMATS: dict[str, Format] = {
    ".py": Format("a module that needs only numpy", python_module, 100_000_000),
    ".json": Format("numbers for JavaScript", json_document, 5_000_000),
    ".h": Format("a header in C99", c_header, 5_000_000),
}


#: Ending of lessons, which are pages of a system rather than numbers of a solution.
LESSON = ".html"
_SPAN = (0.0, 20.0)


def _form(about: About, ending: str) -> ClosedForm:
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
    result: Solution | HamiltonianLike,
    path: str | os.PathLike[str],
    *,
    certificate: hamsym.Certificate | None = None,
    allow_failed: bool = False,
    z0: Sequence[float] | Mapping[str, float] | None = None,
    span: tuple[float, float] | None = None,
    parameters: Mapping[str, tuple[float, float]] | None = None,
    title: str | None = None,
    text: str = "",
) -> None:
    """Write a solution as a file that is evaluated without hamsym, or a system as a lesson.

    The ending of the file's name is its format:

    ``.py``
        A module with ``state(t)``, ``derivative(t)`` and ``energy(t)`` that needs only numpy. It
        refuses times outside the span. Values are those of the solution, but for
        round-off.
    ``.json``
        The same numbers for JavaScript and others, in the arrangement that
        ``examples/guide/exporting.md`` gives.
    ``.h``
        A header in C99 with ``NAME_state(t, z)``, ``NAME_derivative(t, dz)`` and
        ``NAME_energy(t)``, where NAME is the name of the file.
    ``.html``
        A lesson: a page with equations, sliders for the start and the parameters, the moving
        system, phase plane, energies, and a section for two degrees of freedom. The motion is
        computed in the reader's browser by generated JavaScript; the page needs no network, and
        prints how far it is from ``solve``.

    The others say what they are: H and its parameters, the start, the span, the method, the
    tolerance that was asked and reached, the largest estimated error of each component, the
    certificate, and what makes the solution again. Numbers are exact.

    Parameters
    ----------
    result : Solution, Hamiltonian or str
        A Hamiltonian becomes a lesson.
    path : path-like
        The file, replaced in one step.
    certificate : Certificate, optional
        A proof of the solution's error, by default ``solution.certificate``. It is compared with
        the solution, and not proven again. Lessons have none.
    allow_failed : bool
        Write a solution with ``success=False`` too; the file then says first that it failed. Not
        for lessons.
    z0, span : optional
        Start and span of a Hamiltonian's lesson, as :func:`hamsym.solve` takes them; by default a
        start that is accepted, and (0, 20).
    parameters : mapping of str to (float, float), optional
        Parameters with a slider, each from and to, by default all. One without a value in H begins
        in the middle.
    title, text : str, optional
        Heading of a lesson, and text below it, whose paragraphs are separated by empty lines.

    Raises
    ------
    InputError
        If the ending has no format, the result cannot be exported, failed, is too large for the
        format, an option is not one of the format, or the certificate is that of another solution.
    CodeGenerationError
        If JavaScript lacks a function of a lesson's H.
    FileError
        If the file cannot be written.

    Examples
    --------
    >>> import hamsym, runpy, tempfile
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export(solution, folder + "/orbit.py")
    ...     orbit = runpy.run_path(folder + "/orbit.py")
    >>> bool(abs(orbit["state"]([1.0, 2.0]) - solution([1.0, 2.0])).max() < 1e-14)
    True
    >>> H = "p**2/2 + k*x**2/2"
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export(H, folder + "/spring.html", z0=[1, 0], parameters={"k": (0.5, 2.0)})
    ...     "<canvas" in Path(folder + "/spring.html").read_text("utf-8")
    True
    """
    target, ending = checked_target(path)
    if ending == LESSON:
        if certificate is not None:
            raise InputError("a lesson computes its own motion and has no certificate; give none")
        _export_lesson(result, target, z0, span, parameters, title, text)
        return
    options = {
        "z0": z0,
        "span": span,
        "parameters": parameters,
        "title": title,
        "text": text or None,
    }
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} is an option of lessons; give a name that ends in {LESSON}")
    if not isinstance(result, Solution):
        members = isinstance(result, hamsym.Solutions)
        remedy = "export one of them, e.g. many[0]" if members else "give the result of solve"
        raise InputError(f"a {type(result).__name__} cannot be exported; {remedy}")
    if not result.success and not allow_failed:
        raise InputError(
            f"the solution failed ({result.message}); solve it again, or give allow_failed=True to "
            "export it as it is"
        )
    about = About(result, checked_certificate(result, certificate))
    write_file(target, FORMATS[ending].content(about, _form(about, ending), target.stem))


def _export_lesson(
    result: Any,
    target: Path,
    z0: Any,
    span: tuple[float, float] | None,
    parameters: Mapping[str, Any] | None,
    title: str | None,
    text: str,
) -> None:
    from hamsym.workbench.lessons.lesson import lesson, with_values
    from hamsym.workbench.lessons.start import proposed_start

    checked_mapping("parameters", parameters, '{"k": (0.5, 2)}')
    if isinstance(result, Solution):
        if z0 is not None or span is not None:
            raise InputError("z0 and span are those of the solution; leave them out, or give its H")
        solution = result
    elif isinstance(result, Hamiltonian | str | sympy.Expr):
        H = with_values(Hamiltonian.of(result, bound=False), parameters)
        span = _SPAN if span is None else span
        solution = hamsym.solve(H, proposed_start(H, span) if z0 is None else z0, span)
    else:
        raise InputError(
            f"a {type(result).__name__} cannot become a lesson; give a Hamiltonian or a solution"
        )
    if not solution.success:
        raise InputError(
            f"the solution failed ({solution.message}), and the lesson would begin with it; give "
            "another start or a shorter span"
        )
    write_file(target, lesson(solution, parameters, title, text))


def checked_target(path: str | os.PathLike[str]) -> tuple[Path, str]:
    """Return the file and its ending; raise InputError unless this has a format."""
    try:
        target = Path(os.fsdecode(path))
    except TypeError:
        raise InputError(f"path={path!r} is not the name of a file; give a str or a Path") from None
    ending = target.suffix.lower()
    if ending not in (*FORMATS, LESSON):
        known = ", ".join(f"{ending} ({row.summary})" for ending, row in FORMATS.items())
        raise InputError(
            f"'{path}' has no ending of a format; give one of {known}, {LESSON} (a lesson)"
        )
    return target, ending
