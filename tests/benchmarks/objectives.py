"""Terms of the loss, side by side: true errors over seeds.

Every run has Adam, the same network, number of epochs and seeds. The error is the
largest of any component at 1,001 times, relative to the largest |z_i|. ``energy`` is energy_weight
1; ``symplectic`` is a Regularizer of weight 1, the mean square of the defect of a step of the
implicit midpoint rule between neighbouring points, per unit of time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

import hamsym
from hamsym import systems

from . import markdown
from .measuring import cpu, median
from .results import Section

_PROBLEMS: tuple[tuple[str, Callable[[], systems.Problem], float], ...] = (
    ("oscillator, t = pi", systems.nonlinear_oscillator, np.pi),
    ("Kepler e = 0.3, half a period", lambda: systems.kepler(eccentricity=0.3), np.pi),
)


def symplectic(H: hamsym.Hamiltonian) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """Return the squared defects of midpoint steps between neighbouring points."""
    field = H.compile("torch").vector_field

    def defects(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        order = t.argsort()
        h, z = t[order].diff().unsqueeze(-1), z[order]
        defect = z.diff(dim=0) - h * field((z[1:] + z[:-1]) / 2)
        return defect.square().sum(-1) / h.square().mean()

    return defects


def _variants(H: hamsym.Hamiltonian) -> list[tuple[str, dict[str, Any]]]:
    return [
        ("none", {}),
        ("energy", {"energy_weight": 1.0}),
        ("symplectic", {"regularizers": [hamsym.Regularizer(1.0, symplectic(H))]}),
    ]


def measure(quick: bool) -> Section:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    brief: dict[str, Any] = {"epochs": 40, "hidden": (8,), "points": 20} if quick else {}
    rows = []
    for label, make, end in _PROBLEMS[:1] if quick else _PROBLEMS:
        problem = make()
        t = np.linspace(0.0, end, 1_001)
        truth = hamsym.solve(problem.H, problem.z0, (0.0, end), tol=1e-12, seed=9)(t)
        for variant, options in _variants(problem.H):
            settings = {"epochs": 1_500, "points": 60} | options | brief
            for seed in range(1 if quick else 5):
                arguments = (problem.H, problem.z0, (0.0, end))
                chosen = hamsym.Adam(**settings)
                run = partial(hamsym.solve, *arguments, method=chosen, seed=seed, progress=False)
                seconds, solution = cpu(run)
                error = float(np.abs(solution(t) - truth).max() / np.abs(truth).max())
                row = {"problem": label, "term": variant, "seed": seed}
                rows.append(row | {"error": error, "seconds": seconds})
    torch.set_num_threads(threads)
    return {"rows": rows}


def table(section: Section) -> str:
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in section["rows"]:
        groups.setdefault((row["problem"], row["term"]), []).append(row)
    rows = []
    for (problem, term), runs in groups.items():
        errors = sorted(run["error"] for run in runs)
        rows.append(
            [
                problem,
                term,
                markdown.plain(median(errors)),
                f"{markdown.plain(errors[0])} to {markdown.plain(errors[-1])}",
                f"{median(run['seconds'] for run in runs):.1f}",
            ]
        )
    head = ["problem", "term of the loss", "median error", "range", "CPU s"]
    return markdown.table(head, rows, left=2)
