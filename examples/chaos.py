"""Lyapunov exponents and Poincare sections of the Henon-Heiles system.

Mattheakis et al., section III.B, call the orbit from their start chaotic, with a maximal Lyapunov
exponent of 0.069. This is not reproduced: over a million units of time the finite-time exponent
decreases like log(t)/t, as on a regular trajectory, and the section is a closed curve. For
comparison, the exponent of an orbit at energy 1/6 converges to about 0.13.

Run `python examples/chaos.py`; `--time` and `--out` set the length and the output folder.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--time", type=float, default=1e6)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

problem = hamsym.systems.henon_heiles()
H = problem.H
starts = {
    "the paper's start, E = 0.128": np.array(problem.z0),
    "(0, -0.15, 0.5555, 0), E = 1/6": H.state_at_energy(1 / 6, {"x": 0, "y": -0.15, "p_y": 0}),
}

figure = Figure(figsize=(11, 4.6), layout="constrained")
curve, plane = figure.subplots(1, 2)
for (label, start), color in zip(starts.items(), ("#0072b2", "#d55e00"), strict=True):
    found = hamsym.lyapunov(H, start, (0, arguments.time))
    print(f"{label}: {found.seconds:.1f} s, largest change of H {found.energy_error:.0e}")
    for t in (300, 2e4, 1e6):
        if t <= arguments.time:
            value = np.interp(t, found.t, found.exponents[:, 0])
            print(f"  exponent at t = {t:g}: {value:.2g}")
    print(f"  {found.statement}\n")
    curve.loglog(found.t, found.exponents[:, 0], color=color, label=label)
    crossed = hamsym.section(H, start, (0, arguments.time / 50), "x = 0, p_x > 0", dt=0.1)
    plane.plot(crossed.z[:, 1], crossed.z[:, 3], ".", color=color, markersize=1.5)

t = np.geomspace(100, max(arguments.time, 200), 50)
curve.loglog(t, 1.1 * np.log(t) / t, "--", color="0.5", linewidth=1, label="log(t)/t")
curve.axhline(0.069, color="0.5", linestyle=":", linewidth=1, label="0.069, as in the paper")
curve.set(title="Finite-time Lyapunov exponent", xlabel="t")
curve.legend(fontsize=8)
plane.set(title="Section x = 0, p_x > 0", xlabel="y", ylabel="p_y")
for axis in (curve, plane):
    axis.grid(alpha=0.25)

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "chaos.png"
figure.savefig(path, dpi=110)
print(f"wrote {path}")
