"""CPU time of a training epoch: hamsym over the same network written in the usual way.

The usual way: torch.nn.Linear layers, one backward pass through the network for the time
derivative of each component, default Adam. Both train the paper's 2 x 50 sine network on its
oscillator with 200 noisy points, in the same process and precision; only the ratio has a meaning.
On one torch thread: the CPU time of several includes that of threads that wait.
"""

from __future__ import annotations

import math
import time

import torch

import hamsym

from . import markdown
from .measuring import median
from .results import Section


class Network(torch.nn.Module):
    """Two layers of 50 sines, two outputs."""

    def __init__(self, dtype: torch.dtype) -> None:
        super().__init__()
        self.first = torch.nn.Linear(1, 50, dtype=dtype)
        self.second = torch.nn.Linear(50, 50, dtype=dtype)
        self.last = torch.nn.Linear(50, 2, dtype=dtype)

    def forward(self, t: torch.Tensor) -> torch.Tensor:
        return self.last(torch.sin(self.second(torch.sin(self.first(t)))))  # type: ignore[no-any-return]


def usual(epochs: int, dtype: torch.dtype) -> float:
    """CPU seconds of an epoch, written in the usual way."""
    net = Network(dtype)
    optimizer = torch.optim.Adam(net.parameters(), lr=8e-3)
    grid = torch.linspace(0, 4 * math.pi, 200, dtype=dtype).unsqueeze(1)
    began = time.process_time()
    for _ in range(epochs):
        t = (grid + 0.06 * math.pi * torch.randn_like(grid)).requires_grad_()
        n, f = net(t), 1 - torch.exp(-t)
        x, p = 1.3 + f * n[:, :1], 1.0 + f * n[:, 1:]
        ones = torch.ones_like(t)
        (dx,) = torch.autograd.grad(x, t, ones, create_graph=True)
        (dp,) = torch.autograd.grad(p, t, ones, create_graph=True)
        loss = ((dx - p) ** 2 + (dp + x + x**3) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        loss.item()
    return (time.process_time() - began) / epochs


def own(epochs: int, dtype: torch.dtype) -> float:
    """CPU seconds of an epoch of hamsym."""
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, problem.span, method=hamsym.Adam(epochs=epochs, dtype=dtype)
    )
    return float(solution.record.cpu_seconds / epochs)


def measure(quick: bool) -> Section:
    epochs, turns = (50, 1) if quick else (300, 7)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = []
    for dtype in (torch.float64,) if quick else (torch.float64, torch.float32):
        times = [(usual(epochs, dtype), own(epochs, dtype)) for _ in range(turns)]
        ratios = [ours / theirs for theirs, ours in times]
        theirs, ours = map(median, zip(*times, strict=True))
        rows.append(
            {
                "precision": str(dtype).removeprefix("torch."),
                "usual": theirs,
                "hamsym": ours,
                "ratio": median(ratios),
                "range": [min(ratios), max(ratios)],
            }
        )
    torch.set_num_threads(threads)
    return {"repeats": turns, "epochs": epochs, "rows": rows}


def table(section: Section) -> str:
    rows = [
        [
            row["precision"],
            f"{1e3 * row['usual']:.2f}",
            f"{1e3 * row['hamsym']:.2f}",
            f"{row['ratio']:.2f}",
            "{:.2f} to {:.2f}".format(*row["range"]),
        ]
        for row in section["rows"]
    ]
    return markdown.table(["precision", "usual way, ms", "hamsym, ms", "ratio", "range"], rows)
