"""How the time to derive, generate and load grows with the degrees of freedom.

The Fermi-Pasta-Ulam-Tsingou chain of n masses, each bond with a quadratic, a cubic and a quartic
term (Fermi, Pasta, Ulam & Tsingou 1955), from text; the torch module is loaded and called once.
"""

from __future__ import annotations

import itertools
import time

import numpy as np
import torch

from hamsym import Hamiltonian


def chain(n: int, alpha: float = 0.25, beta: float = 0.3) -> str:
    q = ["0", *(f"q{i}" for i in range(1, n + 1)), "0"]
    kinetic = " + ".join(f"p{i}**2/2" for i in range(1, n + 1))
    bonds = (
        f"({b} - {a})**2/2 + {alpha}*({b} - {a})**3/3 + {beta}*({b} - {a})**4/4"
        for a, b in itertools.pairwise(q)
    )
    return f"{kinetic} + {' + '.join(bonds)}"


def main() -> None:
    sizes = (8, 16, 32, 64)
    totals = []
    Hamiltonian("p**2/2 + x**2/2").compile("torch")  # imports
    print(f"{'masses':>6} {'parse':>8} {'derive':>8} {'generate':>9} {'load':>8} {'total s':>8}")
    for n in sizes:
        text = chain(n)
        marks = [time.perf_counter()]
        H = Hamiltonian(text)
        marks.append(time.perf_counter())
        _ = H.gradient, H.hessian
        marks.append(time.perf_counter())
        H.source("torch")
        marks.append(time.perf_counter())
        system = H.compile("torch")
        z = torch.zeros(4, 2 * n, dtype=torch.float64)
        system.loss(z, z, 0.0, 1.0)
        system.hessian(z)
        marks.append(time.perf_counter())
        parse, derive, generate, load = np.diff(marks)
        totals.append(marks[-1] - marks[0])
        print(
            f"{n:>6} {parse:>8.3f} {derive:>8.3f} {generate:>9.3f} {load:>8.3f} {totals[-1]:>8.3f}"
        )
    power = np.polyfit(np.log(sizes), np.log(totals), 1)[0]
    print(f"the total grows as n**{power:.2f} from {sizes[0]} to {sizes[-1]}")


if __name__ == "__main__":
    main()
