"""Growth of the time to derive, generate and load with the degrees of freedom.

The Fermi-Pasta-Ulam-Tsingou chain of n masses, each bond with a quadratic, a cubic and a quartic
term (Fermi, Pasta, Ulam & Tsingou 1955), from text; the torch module is loaded and called once.
"""

from __future__ import annotations

import time

import numpy as np
import torch

from hamsym import Hamiltonian

from . import markdown
from .measuring import exponent, median
from .problems import chain
from .results import Section

_STAGES = ("parse", "derive", "generate", "load")


def measure(quick: bool) -> Section:
    sizes, repeats = ((4, 8), 1) if quick else ((8, 16, 32, 64), 3)
    Hamiltonian("p**2/2 + x**2/2").compile("torch")  # imports
    times: dict[int, list[list[float]]] = {n: [] for n in sizes}
    for repeat in range(repeats):
        for n in sizes:
            # Another coefficient each time, so that nothing is found in a cache.
            times[n].append(_stages(n, chain(n, alpha=0.25 + repeat / 1_000)))
    rows = [
        {"masses": n, **dict(zip(_STAGES, map(median, zip(*runs, strict=True)), strict=True))}
        for n, runs in times.items()
    ]
    totals = [sum(row[stage] for stage in _STAGES) for row in rows]
    return {"repeats": repeats, "rows": rows, "exponent": exponent(sizes, totals)}


def _stages(n: int, text: str) -> list[float]:
    """CPU seconds of each stage."""
    marks = [time.process_time()]
    H = Hamiltonian(text)
    marks.append(time.process_time())
    _ = H.gradient, H.hessian
    marks.append(time.process_time())
    H.source("torch")
    marks.append(time.process_time())
    system = H.compile("torch")
    z = torch.zeros(4, 2 * n, dtype=torch.float64)
    system.loss(z, z, 0.0, 1.0)
    system.hessian(z)
    marks.append(time.process_time())
    return [float(seconds) for seconds in np.diff(marks)]


def table(section: Section) -> str:
    rows = [
        [
            str(row["masses"]),
            *(f"{row[stage]:.3f}" for stage in _STAGES),
            f"{sum(row[stage] for stage in _STAGES):.3f}",
        ]
        for row in section["rows"]
    ]
    sizes = [row["masses"] for row in section["rows"]]
    return (
        markdown.table(["masses", *_STAGES, "total s"], rows)
        + f"\n\nThe total grows as n^{section['exponent']:.2f} from {sizes[0]} to {sizes[-1]}."
    )
