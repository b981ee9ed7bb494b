"""What a worker computes for the page; every function takes and returns plain data."""

from __future__ import annotations

import csv
import functools
import io
import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import hamsym
from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.parser import parse_number
from hamsym.hamiltonian import Hamiltonian
from hamsym.systems.catalogue import CATALOGUE
from hamsym.workbench.explore.messages import Derivation, JobResult, Motion, Setting, Verdict
from hamsym.workbench.lessons.lesson import system_code, usual_range
from hamsym.workbench.lessons.problem import problem
from hamsym.workbench.lessons.start import proposed_start
from hamsym.workbench.mathml import equations

_TIMES = 500  # of the energy error
_ROWS = 2_001  # of the table of states


# -- the formula ----------------------------------------------------------------------------------


@functools.lru_cache(maxsize=16)
def _hamiltonian(formula: str, q: str, p: str, forces: str) -> Hamiltonian:
    return Hamiltonian(
        formula, q=_listed(q), p=_listed(p), forces=_forces(forces) if forces.strip() else None
    )


def _listed(text: str) -> list[str] | None:
    return [part.strip() for part in text.split(",") if part.strip()] or None


def _forces(text: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for line in text.splitlines():
        if not line.strip():
            continue
        name, equals, formula = (piece.strip() for piece in line.partition("="))
        if not equals or not name or not formula:
            raise InputError(f"'{line.strip()}' is not a force; write for example p = -c*p")
        found[name] = formula
    return found


def _free(setting: Setting) -> Hamiltonian:
    """Return H without the values of parameters."""
    return _hamiltonian(setting.formula, setting.q, setting.p, setting.forces)


def _bound(setting: Setting) -> Hamiltonian:
    H = _free(setting)
    return H.with_parameters(**setting.parameters) if setting.parameters else H


def derive(setting: Setting) -> Derivation:
    """Derive equations and Hessian of a formula."""
    H = _free(setting)
    facts = H.facts
    cyclic = facts["cyclic"]
    said = facts.headline + (f"; {cyclic.label} {cyclic.text}" if cyclic.text else "")
    typeset = equations(H)
    more = typeset["more"]
    rest = f"<p>{more} more entries do not vanish.</p>" if more else ""
    return Derivation(
        names=H.names,
        parameter_names=H.parameter_names,
        equations=_lines(typeset["H"], *typeset["forces"], *typeset["rates"]),
        hessian=_lines(typeset["matrix"], *typeset["entries"]) + rest,
        facts=f"{said}.",
    )


def _lines(*formulas: str) -> str:
    return "".join(f'<div class="line">{formula}</div>' for formula in formulas if formula)


def code(setting: Setting, backend: str) -> str:
    """Return the generated code of a backend."""
    return _free(setting).source(backend).rstrip("\n") + "\n"


def number(text: str) -> float:
    """Return the value of a number or of a formula such as 4*pi."""
    value = parse_number(text)
    if not math.isfinite(value):
        raise InputError(f"'{text}' is not a finite number; write for example 1.3 or 4*pi")
    return value


def example(name: str) -> Setting:
    """Return a system of the catalogue as a setting."""
    problem = CATALOGUE[name]()
    H = problem.H
    return Setting(
        formula=H.formula,
        q=", ".join(symbol.name for symbol in H.q),
        p=", ".join(symbol.name for symbol in H.p),
        forces="\n".join(f"{momentum} = {text}" for momentum, text in H.force_texts.items()),
        z0=dict(zip(H.names, map(float, problem.z0), strict=True)),
        parameters=dict(H.parameters),
        span=problem.span,
    )


# -- motions --------------------------------------------------------------------------------------


def _solve(setting: Setting) -> hamsym.Solution:
    return hamsym.solve(_bound(setting), setting.z0, setting.span, tol=setting.tol, progress=False)


def start(setting: Setting, given: bool) -> dict[str, float]:
    """Return a start that is accepted; with ``given`` that of the setting, if it is."""
    own = list(setting.z0.values()) if given else None
    return proposed_start(_bound(setting), setting.span, own)


def verdict(setting: Setting) -> Verdict:
    """Solve, and say what is known of the solution."""
    return _verdict(*_timed(setting))


def motion(setting: Setting) -> Motion:
    """Solve, and return what the player of the page needs."""
    solution, seconds = _timed(setting)
    judged = _verdict(solution, seconds)
    try:
        code = system_code(solution.H)
    except CodeGenerationError as error:
        return Motion(judged, refusal=str(error))
    ranges = {name: usual_range(value) for name, value in setting.parameters.items()}
    return Motion(judged, code, json.dumps(problem(solution, ranges), allow_nan=False))


def _timed(setting: Setting) -> tuple[hamsym.Solution, float]:
    began = time.perf_counter()
    solution = _solve(setting)
    return solution, time.perf_counter() - began


def _verdict(solution: hamsym.Solution, seconds: float) -> Verdict:
    t = np.linspace(*solution.span, _TIMES)
    with np.errstate(all="ignore"):
        z, rates = solution.evaluate(t)
        pairs = z * np.roll(rates, solution.H.dof, axis=1)  # q_i dp_i/dt and p_i dq_i/dt
        terms = np.abs(pairs).sum(axis=1).max()
        drift = np.abs(solution.energy_drift(t)).max() / (terms if terms > 0 else 1.0)
    facts = solution.facts
    return Verdict(solution.success, solution.message, facts.headline, float(drift), seconds)


# -- buttons --------------------------------------------------------------------------------------


def certify(setting: Setting, seconds: float) -> JobResult:
    """Prove bounds on the error."""
    solution = _solve(setting)
    if not solution.success:
        return JobResult(f"Nothing to prove: {solution.message}.", success=False)
    found = hamsym.certify(solution, time_limit=seconds, progress=False)
    return replace(_job(found.facts), statement=found.statement)


def _job(facts: hamsym.Facts) -> JobResult:
    """The first sentences of a result, and its first table."""
    cells = facts.tables[0].cells(None)
    said = "; ".join(facts.opening)
    rows = tuple(map(tuple, cells.rows))
    return JobResult(f"{said}.", tuple(cells.header), rows, facts.success is not False)


def exponents(setting: Setting, spans: float) -> JobResult:
    """Compute all Lyapunov exponents over a multiple of the span."""
    H = _bound(setting)
    start, end = setting.span
    span = start, start + spans * (end - start)
    found = hamsym.lyapunov(H, setting.z0, span, count=H.dim, progress=False)
    return _job(found.facts)


def comparison(setting: Setting, methods: tuple[str, ...]) -> JobResult:
    """Compare the solution with integrators."""
    solution = _solve(setting)
    found = hamsym.compare(solution, list(methods) or "usual", max_steps=2_000_000)
    facts = found.facts
    needed = "; ".join(f"{name}: {match}" for name, match in found.matches.items())
    return replace(_job(facts), statement=f"{facts.headline}. To reach this error: {needed}.")


# -- files ----------------------------------------------------------------------------------------


def table(setting: Setting) -> bytes:
    """Return states, H and estimated errors as CSV."""
    solution = _solve(setting)
    t = np.linspace(*solution.span, _ROWS)
    z, errors, energy = solution(t), solution.error_estimate(t), solution.energy(t)
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n")
    names = list(solution.H.names)
    write.writerow(["t", *names, "H", *(f"error of {name}" for name in names)])
    for row in np.column_stack([t, z, energy, errors]):
        write.writerow([f"{value:.17g}" for value in row])
    return text.getvalue().encode()


def _written(ending: str, write: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"orbit{ending}"
        write(path)
        return path.read_bytes()


def solution_file(setting: Setting) -> bytes:
    """Return the file of the solution, for ``hamsym.load``."""
    return _written(".hamsym", _solve(setting).save)


def exported(setting: Setting, ending: str) -> bytes:
    """Return the solution as a file that needs no hamsym: .py, .json, .h, or a lesson."""
    return _written(ending, _solve(setting).export)


def report(setting: Setting, proven: bool) -> bytes:
    """Return the report of the solution, one HTML file, with its proof if the page has one."""
    solution = _solve(setting)
    return _written(".html", lambda path: hamsym.report(solution, path, certify=proven))
