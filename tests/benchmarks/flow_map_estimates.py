"""Estimated and true errors of flow maps of different systems, boxes and tolerances.

The true error is the largest found from 100,000 starts at 10 times each, a third of them near the
worst ones found, against solve_many with other features. The allowed error of a component is the
tolerance times its largest value over the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.errors import InputError

from . import markdown
from .flow_map_errors import OSCILLATOR, MapCase, search
from .results import Section

__all__ = ["measure", "measured", "table"]

_PI = float(np.pi)
_QUICK = ("oscillator, backward", "oscillator, k alone")


def _around(centre: Sequence[float], width: float) -> list[tuple[float, float]]:
    return [(value - width, value + width) for value in centre]


def cases() -> list[MapCase]:
    """All maps."""
    names = (
        *("double_pendulum", "henon_heiles", "kepler", "toda_chain"),
        *("driven_oscillator", "charged_particle", "calogero_moser", "morse_oscillator"),
    )
    H = {name: systems.CATALOGUE[name]().H for name in names}
    pendulum, double_well = systems.pendulum().H, "p**2/2 - x**2/2 + x**4/4"
    duffing = f"{double_well} - 0.3*x*cos(1.2*t)"
    coupled = (
        "(p1**2 + p2**2 + p3**2)/2 + (q1**2 + q2**2 + q3**2)/2"
        " + (q2 - q1)**4/4 + (q3 - q2)**4/4 + (q2 - q1)**2/4 + (q3 - q2)**2/4"
    )
    polar = "p_r**2/2 + p_phi**2/(2*r**2) - 1/r"
    metres = "(p_x**2 + p_y**2)/(2*m) - G*M*m/sqrt(x**2 + y**2)"
    earth = {"m": 5.972e24, "G": 6.6743e-11, "M": 1.989e30}
    two = {"x": (0.5, 1.0), "p": (0.0, 0.5)}
    about_pi = {"theta": (2.9, 3.3), "p": 0}
    across = {"theta": (2.9, 3.3), "p": (-0.2, 0.2)}
    outward = {"r": (0.9, 1.1), "phi": 0, "p_r": (0.1, 0.3), "p_phi": (0.9, 1.1)}
    circular = {**outward, "p_r": (-0.1, 0.1)}
    orbits = {"x": "1 - e", "y": 0, "p_x": 0, "p_y": "sqrt((1 + e)/(1 - e))"}
    around_sun = {"x": (1.4e11, 1.6e11), "y": 0, "p_x": 0, "p_y": (1.67e29, 1.85e29)}
    hit = [0.0, 2.0, 4.0, (1.0, 2.0), (-0.3, 0.3), 0.0]
    released = [-1.5, 0.0, 1.5, (0.5, 1.5), (-0.5, 0.5), 0.0]
    morse, driven = H["morse_oscillator"], H["driven_oscillator"]
    rest, start = {"x": 1.0, "p": 0.0}, {"x": 1.3, "p": 1.0}
    turn = 2 * _PI
    return [
        MapCase("pendulum", pendulum, {"theta": (0.5, 1.5), "p": (-0.5, 0.5)}, (0, 10), 1e-6),
        MapCase("pendulum, theta about pi", pendulum, about_pi, (0, 10), 1e-6),
        MapCase("pendulum, across the separatrix", pendulum, across, (0, 6), 1e-3),
        MapCase("Morse", morse, {"x": (0.5, 1.2), "p": (-0.2, 0.2)}, (0, 15), 1e-8),
        MapCase(
            "Morse, D and a alone", morse, rest, (0, 10), 1e-6, {"D": (0.8, 1.2), "a": (0.8, 1.2)}
        ),
        MapCase("driven Duffing", duffing, two, (0, turn), 1e-6),
        MapCase("driven Duffing, backward from t = 5", duffing, two, (5, 0), 1e-7),
        MapCase(
            "driven, frequency varies",
            driven,
            {"x": (0.5, 1), "p": 0},
            (0, 20),
            1e-9,
            {"Omega": (0.7, 1.3)},
        ),
        MapCase("double well, across the separatrix", double_well, two, (0, 8), 1e-4),
        MapCase(
            "double pendulum, +-0.02",
            H["double_pendulum"],
            _around((1.0, 0.5, 0.0, 0.0), 0.02),
            (0, 5),
            1e-5,
        ),
        MapCase("Kepler, polar", polar, outward, (0, turn), 1e-8),
        MapCase("Kepler, polar, about a circle", polar, circular, (0, turn), 1e-8),
        MapCase("Earth's orbit, SI units", metres, around_sun, (0, 3.156e7), 1e-6, earth),
        MapCase("Kepler, e from 0 to 0.6", H["kepler"], orbits, (0, turn), 1e-9, {"e": (0.0, 0.6)}),
        MapCase("Kepler, e from 0 to 0.95", H["kepler"], orbits, (0, turn), 1e-4, {"e": (0, 0.95)}),
        MapCase("Toda, 3 particles", H["toda_chain"], hit, (0, 5), 1e-9),
        MapCase(
            "coupled oscillators, +-0.05",
            coupled,
            _around((0.5, 0.0, -0.3, 0.0, 0.3, 0.0), 0.05),
            (0, 5),
            1e-5,
        ),
        MapCase(
            "Henon-Heiles, +-0.02",
            H["henon_heiles"],
            _around((0.3, -0.3, 0.3, 0.15), 0.02),
            (0, 3 * turn),
            1e-4,
        ),
        MapCase(
            "charged particle, B varies",
            H["charged_particle"],
            _around((1.0, 0.0, 0.0, 1.0), 0.2),
            (0, turn),
            1e-6,
            {"B": (0.8, 1.2)},
        ),
        MapCase("Calogero-Moser, p alone", H["calogero_moser"], released, (0, 5), 1e-7),
        MapCase("oscillator, backward", OSCILLATOR.H, OSCILLATOR.z0, (0, -turn), 1e-5),
        MapCase(
            "oscillator, k alone",
            "p**2/2 + k*x**2/2 + x**4/4",
            start,
            (0, 2 * turn),
            1e-10,
            {"k": (0.5, 2.0)},
        ),
        MapCase("oscillator, from rest to far", OSCILLATOR.H, [(-2, 2), (-2, 2)], (0, 5), 1e-3),
    ]


def measure(quick: bool) -> Section:
    chosen = [case for case in cases() if not quick or case.label in _QUICK]
    return measured(chosen, 500 if quick else 100_000, 10)


def measured(chosen: Sequence[MapCase], starts: int, times: int) -> Section:
    """Build maps and search their errors."""
    rows = []
    for case in chosen:
        row: dict[str, Any] = {"map": case.label, "tol": case.tol}
        try:
            flow = case.build()
            row |= _judged(flow, starts, times)
        except InputError as error:
            row["refused"] = str(error)
        rows.append(row)
    return {"starts": starts, "times": times, "rows": rows}


def _judged(flow: hamsym.FlowMap, starts: int, times: int) -> dict[str, Any]:
    found = search(flow, starts, times)
    # A component that is zero everywhere has no unit; its error is zero too.
    unit = np.where(found.scale > 0, flow.tol * found.scale, 1.0)
    estimate, true = flow.error_estimate / unit, found.largest / unit
    return {
        "inputs": len(flow.inputs),
        "solutions": flow.solutions,
        "success": flow.success,
        "message": flow.message,
        "estimate": _finite(estimate.max()),
        "true": _finite(true.max()),
        "starts": found.starts,
        "failed": found.failed,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def table(section: Section) -> str:
    rows, false, beyond = [], [], []
    for row in section["rows"]:
        name = [row["map"], str(row.get("inputs", "-")), markdown.plain(row["tol"])]
        if "refused" in row:
            rows.append([*name, "refused", "-", "-", "-"])
            continue
        estimate, true = row["estimate"], row["true"]
        ratio = estimate / true if estimate and true else None
        rows.append(
            [
                *(*name, "yes" if row["success"] else "no"),
                *(markdown.number(value, 2) for value in (estimate, true, ratio)),
            ]
        )
        if row["success"] and not (true is not None and true <= 1):
            false.append(row["map"])
        if not (ratio is not None and 1 <= ratio <= 10):
            beyond.append(row["map"])
    head = ["map", "inputs", "tol", "success", "estimate / allowed", "true / allowed"]
    text = markdown.table([*head, "estimate / true"], rows)
    text += (
        f"\n\nTrue errors from {section['starts']:,} starts at {section['times']} times each. "
        f"Success with a true error above the allowed one: {', '.join(false) or 'none'}. Estimate "
        f"below the true error, or more than ten times above it: {', '.join(beyond) or 'none'}."
    )
    return text
