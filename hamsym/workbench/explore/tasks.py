"""What a worker computes for the page; every function takes and returns plain data."""

from __future__ import annotations

import csv
import functools
import io
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.formula.parser import parse_number
from hamsym.hamiltonian import Hamiltonian
from hamsym.systems.catalogue import CATALOGUE
from hamsym.workbench.equations import equations
from hamsym.workbench.explore.results import Derivation, JobResult, Picture, SectionPicture
from hamsym.workbench.explore.setting import Setting

POINTS = 500  # of a curve
_MOST_POINTS = 3_000
_POINTS_OF_WINDOW = 20
_GRID = 64, 48  # of the level sets
_LEVELS = 12
_SPANS_OF_SECTION = 30
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


def _bound(setting: Setting) -> Hamiltonian:
    H = _hamiltonian(setting.formula, setting.q, setting.p, setting.forces)
    return H.with_parameters(**setting.parameters) if setting.parameters else H


def derive(formula: str, q: str, p: str, forces: str) -> Derivation:
    """Derive equations and Hessian of a formula."""
    H = _hamiltonian(formula, q, p, forces)
    facts = H.facts
    cyclic = facts["cyclic"]
    said = facts.headline + (f"; {cyclic.label} {cyclic.text}" if cyclic.text else "")
    # A surface through the origin that the second pair crosses.
    surface = f"{H.names[1]} = 0, {H.names[H.dof + 1]} > 0" if H.dof > 1 else ""
    typeset = equations(H)
    more = typeset["more"]
    rest = f"<p>{more} more entries do not vanish.</p>" if more else ""
    return Derivation(
        names=H.names,
        parameter_names=H.parameter_names,
        equations=_lines(typeset["H"], *typeset["forces"], *typeset["rates"]),
        hessian=_lines(typeset["matrix"], *typeset["entries"]) + rest,
        facts=f"{said}.",
        has_energy=H.conserves_energy,
        surface=surface,
    )


def _lines(*formulas: str) -> str:
    return "".join(f'<div class="line">{formula}</div>' for formula in formulas if formula)


def code(formula: str, q: str, p: str, forces: str, backend: str) -> str:
    """Return the generated code of a backend."""
    return _hamiltonian(formula, q, p, forces).source(backend).rstrip("\n") + "\n"


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


# -- pictures -------------------------------------------------------------------------------------


def _solve(setting: Setting) -> hamsym.Solution:
    return hamsym.solve(_bound(setting), setting.z0, setting.span, tol=setting.tol, progress=False)


def picture(setting: Setting) -> Picture:
    """Solve, and sample what the page draws."""
    began = time.perf_counter()
    solution = _solve(setting)
    needed = _POINTS_OF_WINDOW * (len(solution.history.edges) - 1)
    t = np.linspace(*solution.span, min(max(needed, POINTS), _MOST_POINTS) + 1)
    z, rates = solution.evaluate(t)
    # The sizes to which the tolerance is relative.
    scale = solution.scale if solution.error is None else solution.error.scale
    with np.errstate(all="ignore"):
        pairs = z * np.roll(rates, solution.H.dof, axis=1)  # q_i dp_i/dt and p_i dq_i/dt
        terms = np.abs(pairs).sum(axis=1).max()
        energy_error = np.abs(solution.energy_drift(t)) / (terms if terms > 0 else 1.0)
        error = np.abs(solution.error_estimate(t)) / np.where(scale > 0, scale, 1)
    levels, box = _level_sets(solution, z) if solution.H.dof == 1 else ([], None)
    return Picture(
        success=solution.success,
        message=solution.message,
        headline=solution.facts.headline,
        t=t,
        z=z,
        energy_error=energy_error,
        error=error.max(axis=1),
        levels=levels,
        box=box,
        seconds=time.perf_counter() - began,
        coarse=needed > _MOST_POINTS,
    )


def _level_sets(
    solution: hamsym.Solution, z: np.ndarray
) -> tuple[list[np.ndarray], tuple[float, float, float, float] | None]:
    """Return level sets of H at the start of the span, and the box that they fill."""
    import contourpy

    low, high = z.min(axis=0), z.max(axis=0)
    width = np.where(high > low, high - low, np.maximum(np.abs(high), 1e-300))
    low, high = low - 0.35 * width, high + 0.35 * width
    if not np.all(np.isfinite(width)) or not np.all(high > low):
        return [], None
    q, p = (np.linspace(low[k], high[k], _GRID[k]) for k in (0, 1))
    grid = np.stack(np.meshgrid(q, p), axis=-1)
    H = solution.H
    with np.errstate(all="ignore"):
        system = H.compile("numpy")
        energy = np.asarray(system.energy(*system.arguments(grid, solution.span[0])), dtype=float)
    energy = np.broadcast_to(energy, grid.shape[:-1])
    known = energy[np.isfinite(energy)]
    if not known.size:
        return [], None
    # Equal shares of the plane between levels: near a pole most equidistant ones would be empty.
    values = np.unique(np.quantile(known, np.linspace(0.02, 0.98, _LEVELS)))
    lines = contourpy.contour_generator(q, p, np.ma.masked_invalid(energy))
    found: list[Any] = [line for value in values for line in lines.lines(float(value))]
    return found, (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def section(setting: Setting, surface: str) -> SectionPicture:
    """Compute the section of the trajectory on a longer span.

    For a new H its loops are compiled, for seconds.
    """
    start, end = setting.span
    span = start, start + _SPANS_OF_SECTION * (end - start)
    H = _bound(setting)
    found = hamsym.section(H, setting.z0, span, surface, progress=False)
    index = [found.names.index(name) for name in found.axes]
    return SectionPicture(found.z[:, index], found.axes, bool(found.success), found.message)


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
    """Return the solution as a module or data that need no hamsym: .py, .json or .h."""
    return _written(ending, _solve(setting).export)


def report(setting: Setting, proven: bool) -> bytes:
    """Return the report of the solution, one HTML file, with its proof if the page has one."""
    solution = _solve(setting)
    return _written(".html", lambda path: hamsym.report(solution, path, certify=proven))
