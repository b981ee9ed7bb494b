"""A report: one file of HTML with all that is known about a solution.

The file fetches nothing and runs nothing: equations are MathML, figures SVG, styles inline, and a
content security policy forbids everything else.
"""

from __future__ import annotations

import errno
import io
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from markupsafe import Markup
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import get_lexer_by_name

from hamsym.archive import load_solution, read_certificate
from hamsym.codegen.backends import BACKENDS
from hamsym.errors import CertificationError, FileError, HamsymError, InputError
from hamsym.facts.facts import Fact
from hamsym.facts.solutions import solution_facts
from hamsym.facts.wording import span_fact
from hamsym.proof.prove import certify as prove
from hamsym.proof.prove import verify
from hamsym.proof.windows.certificate import Certificate
from hamsym.solution.solution import Solution
from hamsym.solving.recipe import omissions, python_lines
from hamsym.support.atomic import write_file
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require_positive
from hamsym.workbench.mathml import equations
from hamsym.workbench.page_templates import page_template
from hamsym.workbench.reports import contents
from hamsym.workbench.reports.inline_svg import inline_svg

CERTIFICATE = ".certificate"  # ending of the file beside that of a solution
_COMPARE_SECONDS = 60.0
_MOST_LINES = 400  # of generated code


@checked_keywords
def report(
    solution: Solution | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    notes: str = "",
    certificate: Certificate | str | os.PathLike[str] | None = None,
    certify: bool = False,
    compare: bool = True,
    backend: str = "numpy",
    time_limit: float | None = None,
) -> contents.Proof:
    """Write a report about a solution: one file of HTML that fetches nothing.

    It has the equations, the settings, figures, all statements about the error, a certificate, a
    comparison with integrators, the generated code, and the lines that compute the solution again.

    Parameters
    ----------
    solution : Solution or path
        A path is that of a file written by :meth:`hamsym.Solution.save`.
    path : path-like
        File to write, replaced in one step.
    title : str, optional
        Heading of the report.
    notes : str
        Text of your own below the summary; an empty line begins a paragraph.
    certificate : Certificate or path, optional
        By default that of the solution, or of the file beside it with the ending ``.certificate``.
        It is verified by repeating its proof.
    certify : bool
        Prove a bound on the error now, if there is no certificate.
    compare : bool
        Compare with integrators, for at most a minute.
    backend : str
        Language of the generated code that is shown.
    time_limit : float, optional
        Seconds for a proof or its verification.

    Returns
    -------
    Proof
        With ``certificate``, which is None if nothing is proven, and ``sentence``, the outcome.

    Raises
    ------
    InputError
        If an argument cannot be used, or the report would replace one of its own files.
    FileError
        If a file cannot be read or written.
    CertificationError
        If a certificate belongs to another solution, or is not proven.

    Examples
    --------
    >>> import hamsym, tempfile
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     proof = report(solution, folder + "/circle.html", certify=True, compare=False)
    ...     text = Path(folder + "/circle.html").read_text("utf-8")
    >>> proof.sentence[:6], "<math" in text, "<script" in text
    ('Proven', True, False)
    """
    if backend not in BACKENDS:
        raise InputError(f"{backend!r} is not a backend; choose one of {', '.join(BACKENDS)}")
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    if not isinstance(notes, str):
        raise InputError(f"notes must be text, not {type(notes).__name__}")
    if certificate is not None and certify:
        raise InputError("certificate and certify exclude each other; give one of them")
    file = None if isinstance(solution, Solution) else _path("solution", solution)
    target = _target(path, file, certificate)
    found = load_solution(file) if file is not None else solution
    assert isinstance(found, Solution)
    proof = _proof(found, file, certificate, certify, time_limit)
    if compare:
        compared = contents.compared_within(found, _COMPARE_SECONDS)
    else:
        compared = contents.Compared(reason="it was not asked for")
    lines = found.H.source(backend).rstrip("\n").splitlines()
    code = "\n".join(lines[:_MOST_LINES]) + "\n"
    text = page_template("report").render(
        title=title or "Solution of Hamilton's equations",
        notes=[part.strip() for part in notes.split("\n\n") if part.strip()],
        citation=contents.citation(),
        file=None if file is None else file.name,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        proof=proof,
        compared=compared,
        comparison=Markup(compared.figure),
        code=_colored(code, _LANGUAGES[BACKENDS[backend].extension]),
        code_lines=len(lines),
        most_lines=_MOST_LINES,
        backend=backend,
        again=_again(found, target, proof),
        **_described(found, proof.certificate),
    )
    # A file name may have bytes that are no text, which Python has as lone surrogates.
    write_file(target, text.encode(errors="backslashreplace"))
    return proof


# -- files -----------------------------------------------------------------------------------------


def _path(name: str, given: Any) -> Path:
    try:
        path = Path(os.fspath(given))
    except TypeError:
        kind = "a Solution or a path" if name == "solution" else "a path"
        raise InputError(f"{name} must be {kind}, not {type(given).__name__}") from None
    if "\0" in os.fspath(path):
        raise InputError(f"{name} has a null character, which no file name has")
    return path


def _target(path: Any, *inputs: Any) -> Path:
    """Return the file to write, which is none of the inputs."""
    target = _path("path", path)
    try:
        target.stat()
    except OSError as error:
        if error.errno not in (errno.ENOENT, errno.ENOTDIR):  # e.g. too long a name
            raise FileError(f"'{target}' cannot be written: {error.strerror or error}") from None
    if target.is_dir():
        raise InputError(f"'{target}' is a directory; give the name of a file, e.g. report.html")
    if not target.absolute().parent.is_dir():
        raise InputError(f"directory of '{target}' does not exist; create it first")
    if not os.access(target.absolute().parent, os.W_OK):
        raise FileError(f"'{target}' cannot be written: its directory is read-only")
    own = [file for file in inputs if isinstance(file, str | os.PathLike)]
    own += [f"{file}{CERTIFICATE}" for file in inputs[:1] if file is not None]
    for file in own:
        if os.path.realpath(file) == os.path.realpath(target) or (
            target.exists() and os.path.exists(file) and os.path.samefile(target, file)
        ):
            raise InputError(f"the report would replace '{file}'; give another name for it")
    return target


# -- proofs ----------------------------------------------------------------------------------------


def _proof(
    solution: Solution, file: Path | None, given: Any, certify: bool, time_limit: float | None
) -> contents.Proof:
    """Return a verified certificate: the given one, that of the solution, or a new one."""
    beside = None if file is None else Path(f"{file}{CERTIFICATE}")
    if given is None:
        given = solution.certificate
    if given is None and beside is not None and beside.exists():
        given = beside
    if given is not None:
        how = "its proof was repeated for this report"
        if not isinstance(given, Certificate):
            name = _path("certificate", given)
            given = read_certificate(name)
            how = f"read from {name.name}; {how}"
        verify(given, solution, time_limit, progress=False)
        return contents.proof(solution, given, how)
    if not certify:
        return contents.proof(solution, None, "there is no certificate")
    try:
        new = prove(solution, time_limit=time_limit)
    except CertificationError as error:
        return contents.proof(solution, None, str(error))
    return contents.proof(solution, new, "proven for this report")


# -- parts -----------------------------------------------------------------------------------------


def _figure(solution: Solution) -> tuple[Markup, str]:
    """The figure of a solution, or the reason why there is none."""
    names = ", ".join(solution.H.names[:12]) + (" ..." if solution.H.dim > 12 else "")
    label = f"Figure of the solution over time and in phase space; components {names}"
    try:
        return Markup(inline_svg(solution.plot(), "solution", label)), ""
    except (ArithmeticError, ValueError, HamsymError) as error:
        return Markup(""), f"The figure could not be drawn: {error}"


def _colored(text: str, language: str) -> Markup:
    """Return code with classes for its parts, escaped."""
    lexer = get_lexer_by_name(language, stripnl=False)
    out = io.StringIO()
    highlight(text, lexer, HtmlFormatter(nowrap=True), out)
    return Markup(out.getvalue())


_LANGUAGES = {"py": "python", "c": "c", "jl": "julia", "js": "javascript"}


def _again(solution: Solution, target: Path, proof: contents.Proof) -> Markup:
    """The lines of Python that make the solution and the report again."""
    proven = "" if proof.certificate is None else ", certify=True"
    report_line = f"hamsym.report(solution, {target.name!r}{proven})"
    return _colored(f"{python_lines(solution)}\n{report_line}\n", "python")


def _described(solution: Solution, certificate: Certificate | None) -> dict[str, Any]:
    """What the solution contains, as the template names it."""
    figure, no_figure = _figure(solution)
    facts = solution_facts(solution, certificate)
    shown = [fact for fact in (*facts.given, *facts.found) if isinstance(fact, Fact) and fact.text]
    return {
        "formula": solution.H.formulas,
        "facts": facts,
        "asked": span_fact(solution.settings.span, solution.H.units.get("t", "")).text,
        "settings": [(fact.label.rstrip(":"), fact.text) for fact in shown],
        "tables": [table.cells(None, brief=False) for table in facts.tables],
        "equations": equations(solution.H),
        "structure": solution.H.facts,
        "figure": figure,
        "no_figure": no_figure,
        "check": contents.check(solution),
        "windows": contents.windows(solution),
        "bounds": None if certificate is None else certificate.facts.tables[0].cells(None),
        "digest": contents.solution_digest(solution),
        "omissions": omissions(solution),
        "versions": contents.versions(solution),
    }
