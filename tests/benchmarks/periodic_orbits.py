"""Periodic orbits: CPU time to find each, and to prove that it exists.

Bounds are the largest distance of the true states from the computed ones, and the radius of a ball
without another orbit, relative to the largest size of each component. The time of a proof includes
its linear stability and the search for the largest such ball.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hamsym
from hamsym import systems

from . import markdown
from .measuring import cpu
from .results import Section

_ACROSS = {"x": "-x", "p_y": "-p_y"}
_EXAMPLE = Path(__file__).parents[2] / "examples" / "periodic_orbits.py"


def measure(quick: bool) -> Section:
    # compiles the arithmetic of proofs
    hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0]).certify()
    rows = []
    for name, find in _cases(quick):
        seconds, orbit = cpu(find)
        row: dict[str, Any] = {
            "orbit": name,
            "period": orbit.period,
            "find": seconds,
            "error": orbit.relative_error,
        }
        try:
            row["prove"], found = cpu(orbit.certify)
        except hamsym.CertificationError as refusal:
            row["refusal"] = str(refusal)
        else:
            row |= {
                "bound": found.bound,
                "unique": found.unique_within,
                "stability": found.stability,
                "pieces": found.pieces,
            }
        rows.append(row)
    return {"repeats": 1, "rows": rows}


def _cases(quick: bool) -> Iterator[tuple[str, Any]]:
    H = systems.henon_heiles().H
    starts = {"bent": (-0.15, 0.4), "loop": (0.25, 0.34)}
    energies = {"1/12": 1 / 12, "0.1": 0.1, "0.12": 0.12, "1/8": 1 / 8, "0.15": 0.15}
    for label, energy in energies.items():
        for shape, (y, p_x) in starts.items():
            start = [0.0, y, p_x, 0.0]
            yield f"Henon-Heiles {label}, {shape}", _found(H, start, energy, _ACROSS)
            if quick:
                return
    along = H.state_at_energy(0.12, {"x": 0, "y": 0, "p_x": 0})
    yield "Henon-Heiles 0.12, along y", _found(H, along, 0.12, None)
    example = _example()
    yield "Lyapunov orbit around L1", lambda: example.lyapunov_family()[0]
    yield "figure eight", example.figure_eight


def _found(H: Any, start: Any, energy: float, symmetry: Any) -> Any:
    return lambda: hamsym.periodic_orbit(H, start, energy=energy, symmetry=symmetry)


def _example() -> Any:
    spec = importlib.util.spec_from_file_location("periodic_orbits_example", _EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def table(section: Section) -> str:
    rows = []
    for row in section["rows"]:
        cells = [row["orbit"], f"{row['period']:.8g}", f"{row['find']:.2g} s"]
        if "refusal" in row:
            cells += [row["refusal"], "", "", ""]
        else:
            cells += [
                f"{row['prove']:.2g} s",
                f"{row['bound']:.1e}",
                f"{row['unique']:.0e}",
                row["stability"],
            ]
        rows.append(cells)
    header = ["orbit", "period", "to find", "to prove", "bound", "alone within", "stability"]
    return markdown.table(header, rows)
