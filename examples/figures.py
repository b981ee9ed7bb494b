"""Pictures of pages: a trajectory, overview, panels, portrait, ensemble, section, flow map.

Run `python examples/figures.py`; `--out` sets the output folder, `--time` the span of the section.
"""

import argparse
from pathlib import Path

import numpy as np

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--time", type=float, default=3_000)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

problem = hamsym.systems.three_bodies()
eight = hamsym.solve(problem.H, problem.z0, problem.span)
pendulum = hamsym.solve("p**2/2 - cos(theta)", [2, 0], (0, 30))
swings = hamsym.solve_many(
    "p**2/2 - cos(theta)", {"theta": np.linspace(0.2, 3.1, 60), "p": 0.0}, (0, 12)
)
H = hamsym.systems.henon_heiles().H
trajectory = hamsym.solve(H, [0.3, -0.3, 0.3, 0.15], (0, 40))
starts = H.state_at_energy(1 / 8, {"x": 0, "y": np.linspace(-0.2, 0.28, 7), "p_y": 0})
section = hamsym.section(H, starts, (0, arguments.time), "x = 0, p_x > 0", dt=0.1)
box = {"x": (1.0, 1.6), "p": (0.7, 1.3)}
flow = hamsym.flow_map("p**2/2 + x**2/2 + x**4/4", box, (0, 4 * np.pi), tol=1e-8)

figures = {
    "trajectory": trajectory.plot(),
    "figure-overview": eight.plot(),
    "figure-portrait": pendulum.plot("theta", "p"),
    "figure-error": pendulum.plot("error"),
    "figure-ensemble": swings.plot("theta", "p"),
    "figure-section": section.plot(),
    "flow-map": flow.plot(),
}
arguments.out.mkdir(parents=True, exist_ok=True)
for name, figure in figures.items():
    path = arguments.out / f"{name}.png"
    figure.savefig(path, dpi=110)
    print(f"wrote {path}")
