"""CPU time of a training epoch: hamsym against the same network written in the usual way.

The usual way: torch.nn.Linear layers, one backward pass through the network for the time
derivative of each component, default Adam. Both train the paper's 2 x 50 sine network on its
oscillator with 200 noisy points, in the same process and precision; only the ratio means anything.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time

import torch

import hamsym


def usual(epochs: int, dtype: torch.dtype) -> float:
    """CPU seconds per epoch."""

    class Net(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.first = torch.nn.Linear(1, 50, dtype=dtype)
            self.second = torch.nn.Linear(50, 50, dtype=dtype)
            self.last = torch.nn.Linear(50, 2, dtype=dtype)

        def forward(self, t: torch.Tensor) -> torch.Tensor:
            return self.last(torch.sin(self.second(torch.sin(self.first(t)))))

    net = Net()
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


def ours(epochs: int, dtype: torch.dtype) -> float:
    """CPU seconds per epoch."""
    problem = hamsym.systems.nonlinear_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, problem.span, method="adam", epochs=epochs, dtype=dtype
    )
    return solution.training.cpu_seconds / epochs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--epochs", type=int, default=1_000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    threads = torch.get_num_threads()
    print("CPU time per epoch, usual way and hamsym, median over interleaved repeats")
    for dtype in (torch.float64, torch.float32):
        for count in sorted({1, threads}):
            torch.set_num_threads(count)
            ratios, times = [], []
            for _ in range(arguments.repeats):
                theirs, own = usual(arguments.epochs, dtype), ours(arguments.epochs, dtype)
                ratios.append(own / theirs)
                times.append((theirs, own))
            theirs, own = (statistics.median(column) for column in zip(*times, strict=True))
            print(
                f"{str(dtype).removeprefix('torch.')}, {count} thread(s): "
                f"{1e3 * theirs:.2f} ms, {1e3 * own:.2f} ms, "
                f"ratio {statistics.median(ratios):.2f} "
                f"(from {min(ratios):.2f} to {max(ratios):.2f})"
            )
    torch.set_num_threads(threads)


if __name__ == "__main__":
    main()
