"""Period-energy diagram of the pendulum: all energies in one call.

The pendulum H = p^2/2 - cos(theta) swings at energies below 1 and turns over at those above; at 1,
on the separatrix, the period is infinite. The exact period is a complete elliptic integral.

Run `python examples/pendulum_period.py`; `--count` and `--out` set the number of energies and the
output folder.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipk

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--count", type=int, default=200)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

H = hamsym.Hamiltonian("p**2/2 - cos(theta)")
energies = np.linspace(-0.99, 3, arguments.count)
many = hamsym.solve_many(H, H.state_at_energy(energies, {"theta": 0}), (0, 25))
returns = [member.events("sin(theta/2) = 0, p > 0").t_events[0] for member in many]
periods = np.array([times[0] for times in returns])

m = (1 + energies) / 2
exact = np.where(m < 1, 4 * ellipk(np.minimum(m, 1)), 2 * ellipk(1 / np.maximum(m, 1)) / np.sqrt(m))
largest = np.abs(periods / exact - 1).max()
print(f"{many.success.sum()} of {many.size} succeeded; largest error of a period {largest:.0e}")

figure, (plane, diagram) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
colours = plt.get_cmap("viridis")((energies + 1) / 4)
every = max(1, arguments.count // 25)
t = np.linspace(0, 25, 2_000)
for states, colour in zip(many[::every](t), colours[::every], strict=True):
    theta = (states[:, 0] + np.pi) % (2 * np.pi) - np.pi
    theta[np.abs(np.diff(theta, prepend=theta[0])) > np.pi] = np.nan  # the line ends at an edge
    plane.plot(theta, states[:, 1], color=colour, lw=0.8)
plane.set(xlabel="theta", ylabel="p", title="motions", xlim=(-np.pi, np.pi))
diagram.axvline(1, color="0.7", lw=0.8)
diagram.scatter(energies, periods, c=colours, s=8)
diagram.set(xlabel="energy", ylabel="period", title="swinging below 1, turning over above")

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "pendulum-period.png"
figure.savefig(path, dpi=150)
print(f"wrote {path}")
