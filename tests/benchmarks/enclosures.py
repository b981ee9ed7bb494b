"""Enclosures of the true solution beside those of CAPD, and the time of proofs on windows.

Times are the least CPU times of up to five runs after a first one, which compiles; what takes more
than two seconds is repeated once. Widths are the largest of the components at the end of the span,
upper minus lower end as float64 numbers. CAPD (https://github.com/CAPDGroup/CAPD) takes part if the
environment variable HAMSYM_CAPD names the program of capd.cpp, which tries orders, tolerances and
representations of sets.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, takewhile
from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.equation import equation_of
from hamsym.proof.windows.proven_windows import WindowStepper
from hamsym.proof.windows.window_proof import WindowBounds, WindowProof

from . import markdown
from .measuring import cpu
from .problems import chain
from .results import Section

_TOL = 1e-9
_REPEATS, _ENOUGH = 5, 2.0  # runs, and seconds after which there are no more
_LIMIT = 120.0  # seconds of a proof
_ACCURACY, _TERMS = 2.0**-86, 48  # of the second attempt of hamsym.enclose
_WIDTHS = (1e-6, 1.0)  # whose last times are sought in chaos
_END, _END_OF_MARCH = 400.0, 1_000.0  # of spans in chaos


@dataclass(frozen=True)
class _Case:
    """An initial-value problem from t = 0, and its name in capd.cpp if it has one."""

    label: str
    H: hamsym.Hamiltonian
    z0: tuple[float, ...]
    end: float
    capd: str | None = None


def measure(quick: bool) -> Section:
    cases = [_oscillator()] if quick else list(_cases())
    sizes = (1, 2) if quick else (1, 2, 5, 10, 20, 30)
    return {
        "repeats": _REPEATS,
        "rows": [_row(case) for case in cases],
        "chains": [_chain(n, 2.0 if quick else 20.0) for n in sizes],
        "chaos": list(_chaos(*((20.0, 20.0) if quick else (_END, _END_OF_MARCH)))),
        "tol": _TOL,
    }


# -- problems -----------------------------------------------------------------------------------


def _oscillator() -> _Case:
    H = hamsym.Hamiltonian("p**2/2 + x**2/2")
    return _Case("oscillator, 4 pi", H, (1.0, 0.0), 4 * math.pi, "oscillator")


def _cases() -> Iterator[_Case]:
    yield _oscillator()
    pendulum = hamsym.Hamiltonian("p**2/2 - cos(x)")
    yield _Case("pendulum, t = 60", pendulum, (2.0, 0.0), 60.0, "pendulum")
    henon = systems.henon_heiles()
    for label, end, capd in (
        ("6 pi", 6 * math.pi, "henon_heiles_6pi"),
        ("t = 100", 100.0, "henon_heiles_100"),
        ("t = 300", 300.0, "henon_heiles_300"),
    ):
        yield _Case(f"Henon-Heiles, {label}", henon.H, tuple(henon.z0), end, capd)
    kepler = hamsym.Hamiltonian("(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)")
    yield _Case("Kepler e = 0.6, 2 periods", kepler, (0.4, 0.0, 0.0, 2.0), 4 * math.pi, "kepler")
    yield _pleiades()
    yield _trimer()


def _pleiades() -> _Case:
    """Seven bodies in the plane with masses 1, ..., 7 (Hairer, Norsett & Wanner 1993, II.10)."""
    masses = range(1, 8)
    potential = " - ".join(
        f"{i * j}/sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in combinations(masses, 2)
    )
    kinetic = " + ".join(f"(p_x{i}**2 + p_y{i}**2)/{2 * i}" for i in masses)
    x, y = (3, 3, -1, -3, 2, -2, 2), (3, -3, 2, 0, 0, -4, 4)
    vx, vy = (0, 0, 0, 0, 0, 1.75, -1.5), (0, 0, 0, -1.25, 1, 0, 0)
    momenta = [m * v for velocities in (vx, vy) for m, v in zip(masses, velocities, strict=True)]
    H = hamsym.Hamiltonian(f"{kinetic} - {potential}")
    return _Case("Pleiades, t = 3", H, tuple(map(float, (*x, *y, *momenta))), 3.0, "pleiades")


def _trimer() -> _Case:
    kinetic = " + ".join(f"(p_x{i}**2 + p_y{i}**2)/2" for i in (1, 2, 3))
    squares = [f"((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in combinations((1, 2, 3), 2)]
    bonds = " + ".join(f"4*(1/{square}**6 - 1/{square}**3)" for square in squares)
    H = hamsym.Hamiltonian(f"{kinetic} + {bonds}")
    z0 = (0.0, 1.12, 0.55, 0.0, 0.0, 0.97, 0.1, -0.1, 0.05, 0.1, -0.05, 0.02)
    return _Case("Lennard-Jones trimer, t = 20", H, z0, 20.0)


# -- runs ---------------------------------------------------------------------------------------


def _row(case: _Case) -> dict[str, Any]:
    span = (0.0, case.end)
    seconds, found = _best(lambda: hamsym.enclose(case.H, case.z0, span))
    row: dict[str, Any] = {
        "problem": case.label,
        "enclose": seconds,
        "width": found(case.end).width,
        "derivative": found.derivative(case.end).width,
        "windows": len(found.windows),
    }
    row["solve"], solution = _best(lambda: hamsym.solve(case.H, case.z0, span, tol=_TOL))
    sizes = np.abs(solution(np.linspace(*span, 4_001))).max(axis=0)
    row["certify"], certificate = _proof(solution)
    if certificate:
        uppers = [certificate.bound, *certificate.component_bounds]
        lowers = [certificate.lower, *certificate.component_lowers]
        if min(lowers) > 0:
            row["ratio"] = max(b / a for a, b in zip(lowers, uppers, strict=True))
    row["bounded"], _ = _proof(solution, bound=_TOL * np.maximum(1.0, sizes))
    if capd := _capd(case.capd):
        row["CAPD"] = {
            "fastest": _pair(capd["c0"]["fastest"], "width"),
            "narrowest": _pair(capd["c0"]["narrowest"], "width"),
            "derivative": _pair(capd["c1"].get("narrowest_derivative"), "derivative_width"),
        }
    return row


def _best(function: Callable[[], Any]) -> tuple[float, Any]:
    """Least CPU seconds of a call, and its last result."""
    found = function()
    times: list[float] = []
    while len(times) < _REPEATS and sum(times) < _ENOUGH:
        seconds, found = cpu(function)
        times.append(seconds)
    return min(times), found


def _proof(
    solution: hamsym.Solution, **options: Any
) -> tuple[float | None, hamsym.Certificate | None]:
    """Seconds of a proof and its certificate; none if it does not succeed."""
    try:
        return _best(lambda: solution.certify(time_limit=_LIMIT, **options))
    except hamsym.CertificationError as refusal:
        print(f"not proven: {refusal}")
        return None, None


def _capd(name: str | None) -> Any:
    """What the program of capd.cpp prints about a problem, if there is one."""
    program = os.environ.get("HAMSYM_CAPD")
    if not (program and name):
        return None
    run = subprocess.run([program, name], check=True, capture_output=True, text=True)
    return json.loads(run.stdout)


def _pair(run: Any, width: str) -> list[float] | None:
    """Seconds and width of one of CAPD's runs."""
    return run and [run["ms"] / 1e3, run[width]]


def _chain(n: int, end: float) -> dict[str, Any]:
    H, z0 = hamsym.Hamiltonian(chain(n)), [*(math.sin(i) for i in range(1, n + 1)), *[0.0] * n]
    seconds, found = _best(lambda: hamsym.enclose(H, z0, (0.0, end)))
    return {
        "n": n,
        "windows": len(found.windows),
        "seconds": seconds,
        "width": found(end).width,
        "derivative": found.derivative(end).width,
    }


# -- chaos --------------------------------------------------------------------------------------


def _chaos(end: float, end_of_march: float) -> Iterator[dict[str, Any]]:
    """Times up to which widths, or bounds on errors, are below those of _WIDTHS."""
    H, z0 = systems.henon_heiles().H, np.array([0.0, -0.15, 0.5555, 0.0])
    if capd := _capd("henon_heiles_chaos" if end == _END else None):
        for width in ("1e-6", "1"):
            run = capd["c0"][f"longest_{width}"]
            yield {
                "method": f"CAPD, {run['set']}, order {run['order']}",
                "reached": [run["t_1e-6"], run["t_1"]],
                "end": None,
                "seconds": run["ms"] / 1e3,
            }
    _stepped(H, z0, end)  # compiles
    seconds, found = cpu(lambda: _stepped(H, z0, end))
    ends = [0.0, *(_at_most(window.end) for window in found.windows)]
    widths = [found(t).width for t in ends]
    reached = [_until(ends, widths, limit) for limit in _WIDTHS]
    yield {"method": "`enclose`", "reached": reached, "end": ends[-1], "seconds": seconds}
    last, bounds = _longest_proof(H, z0, end_of_march)
    seconds, _ = cpu(lambda: _on_windows(H, z0, last))
    ends = [0.0, *map(_at_most, bounds.edges[1:])]
    reached = [_until(ends, [0.0, *bounds.pieces], limit) for limit in _WIDTHS]
    yield {
        "method": "`certify()` on windows",
        "reached": reached,
        "end": last,
        "seconds": seconds,
    }


def _stepped(H: hamsym.Hamiltonian, z0: np.ndarray, end: float) -> hamsym.Enclosure:
    """The enclosure up to where it ends."""
    stepper = WindowStepper(
        equation_of(H),
        Fraction(0),
        1,
        Fraction(end),
        z0,
        np.zeros(len(z0)),
        _ACCURACY,
        Deadline.after(_LIMIT),
        _TERMS,
    )
    windows = []
    try:
        while stepper.elapsed < stepper.total:
            windows.append(stepper.step(stepper.total))
    except hamsym.CertificationError as refusal:
        print(refusal)
    start = hamsym.Ball(z0, np.zeros(len(z0)))
    return hamsym.Enclosure(H, start, (0.0, _at_most(windows[-1].end)), {}, tuple(windows), 0.0)


def _at_most(time: Fraction) -> float:
    """The last float64 time up to this one."""
    nearest = float(time)
    return nearest if nearest <= time else math.nextafter(nearest, -math.inf)


def _until(times: list[float], values: list[float], limit: float) -> float:
    """The last of the times before a value reaches the limit."""
    below = takewhile(lambda pair: pair[1] < limit, zip(times, values, strict=True))
    return max(t for t, _ in below)


def _longest_proof(H: hamsym.Hamiltonian, z0: np.ndarray, end: float) -> tuple[float, WindowBounds]:
    """The last end of a span, to within a unit, for which windows prove close bounds."""
    known = _on_windows(H, z0, end)
    if known:
        return end, known
    low, high = 1.0, end
    while high - low > 1:
        middle = float((low + high) // 2)
        found = _on_windows(H, z0, middle)
        if found:
            low, known = middle, found
        else:
            high = middle
    if not known:
        raise RuntimeError("windows proved nothing about the chaotic march")
    return low, known


def _on_windows(H: hamsym.Hamiltonian, z0: np.ndarray, end: float) -> WindowBounds | None:
    """What ``certify()`` finds."""
    solution = hamsym.solve(H, z0, (0.0, end), tol=_TOL)
    try:
        return WindowProof(solution, Deadline.after(_LIMIT)).bounds(0.02, None)
    except hamsym.CertificationError:
        return None


# -- tables -------------------------------------------------------------------------------------


def table(section: Section) -> str:
    rows = section["rows"]
    parts = [_enclosures(rows), _proofs(rows, section["tol"])]
    parts += [_chains(section["chains"]), _reaches(section["chaos"])]
    return "\n\n".join(parts)


def _enclosures(rows: list[dict[str, Any]]) -> str:
    head = ["ms, width", "CAPD, fastest", "CAPD, narrowest", "CAPD, dz/dz0"]
    head += ["`enclose`", "dz/dz0", "windows"]
    lines = [
        [
            row["problem"],
            *(_cell(row, kind) for kind in ("fastest", "narrowest", "derivative")),
            _ms_and_width(row["enclose"], row["width"]),
            markdown.plain(row["derivative"]),
            str(row["windows"]),
        ]
        for row in rows
    ]
    return markdown.table(head, lines)


def _cell(row: dict[str, Any], kind: str) -> str:
    if "CAPD" not in row:
        return "-"
    return _ms_and_width(*row["CAPD"][kind]) if row["CAPD"][kind] else "none"


def _ms_and_width(seconds: float, width: float) -> str:
    return f"{markdown.number(1e3 * seconds)}, {markdown.plain(width)}"


def _proofs(rows: list[dict[str, Any]], tol: float) -> str:
    head = ["ms", "`solve`", "`certify()`", "largest upper / lower"]
    head += [f"`certify(bound={tol:.0e})`", "over `solve`"]
    lines = [
        [
            row["problem"],
            markdown.number(1e3 * row["solve"]),
            _proof_cell(row["certify"]),
            f"{row['ratio']:.4f}" if row.get("ratio") else "-",
            _proof_cell(row["bounded"]),
            markdown.number(row["bounded"] and row["bounded"] / row["solve"], 2),
        ]
        for row in rows
    ]
    return markdown.table(head, lines)


def _proof_cell(seconds: float | None) -> str:
    return "not proven" if seconds is None else markdown.number(1e3 * seconds)


def _chains(rows: list[dict[str, Any]]) -> str:
    head = ["chain", "dimension", "windows", "ms", "ms per window", "width", "width of dz/dz0"]
    lines = [
        [
            f"{row['n']} masses" if row["n"] > 1 else "1 mass",
            str(2 * row["n"]),
            str(row["windows"]),
            markdown.number(1e3 * row["seconds"]),
            markdown.number(1e3 * row["seconds"] / row["windows"]),
            markdown.plain(row["width"]),
            markdown.plain(row["derivative"]),
        ]
        for row in rows
    ]
    return markdown.table(head, lines)


def _reaches(rows: list[dict[str, Any]]) -> str:
    head = ["chaotic Henon-Heiles", "below 1e-6 until", "below 1 until", "ends at", "ms"]
    lines = [
        [
            row["method"],
            *(f"{t:.1f}" for t in row["reached"]),
            "-" if row["end"] is None else f"{row['end']:.1f}",
            markdown.number(1e3 * row["seconds"]),
        ]
        for row in rows
    ]
    return markdown.table(head, lines)
