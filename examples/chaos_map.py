"""Chaos map of the Henon-Heiles system: largest Lyapunov exponents over a plane of starts.

The plane is x = 0 at energy 1/8, where p_x > 0 follows from the energy. At the time 500 the
exponents of regular starts are about log(t)/t and still fall; those of chaotic starts are larger.

Run `python examples/chaos_map.py`; `--grid`, `--time` and `--out` set the number of starts along an
axis, the length and the output folder.
"""

import argparse
from pathlib import Path

import numpy as np

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--grid", type=int, default=200)
parser.add_argument("--time", type=float, default=500)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

H = hamsym.systems.henon_heiles().H
y, p_y = np.linspace(-0.45, 0.7, arguments.grid), np.linspace(-0.52, 0.52, arguments.grid)
plane = {"x": 0, "y": y, "p_y": p_y[:, None]}
starts = H.state_at_energy(1 / 8, plane, missing="nan")
chaos = hamsym.lyapunov(H, starts, (0, arguments.time))
print(f"{chaos.seconds:.1f} s: {chaos.statement}")

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "chaos-map.png"
chaos.plot().savefig(path, dpi=150)
print(f"wrote {path}")
