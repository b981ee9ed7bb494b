"""Lagrange points of the restricted three-body problem: zero-velocity curves and stability.

On the left the effective potential of the Earth and the Moon in the rotating frame, with the
curves that bound the motion at the energies of L1, L2 and L3. On the right the eigenvalues at L4
for all mass ratios: two frequencies, of modes with energies of different sign, collide at Routh's
critical value, beyond which L4 is unstable.

Run `python examples/lagrange_points.py`; `--count` and `--out` set the number of mass ratios and
the output folder.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import hamsym

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--count", type=int, default=241)
parser.add_argument("--out", type=Path, default=Path("output"))
arguments = parser.parse_args()

H = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y"
    " - (1 - mu)/sqrt((x + mu)**2 + y**2) - mu/sqrt((x - 1 + mu)**2 + y**2)",
    parameters={"mu": 0.012150585609624},  # Earth and Moon
)
found = H.equilibria()
print(found)

figure = Figure(figsize=(11, 5), layout="constrained")
plane, curves = figure.subplots(1, 2)

# H of a state at rest in the rotating frame, p_x = -y and p_y = x.
x, y = np.meshgrid(np.linspace(-1.5, 1.5, 601), np.linspace(-1.4, 1.4, 561))
potential = H.compile("numpy").energy(np.stack((x, y, -y, x), axis=-1))
highest = found.energies.max()
levels = np.linspace(highest - 0.6, highest, 25)
plane.contourf(x, y, potential, levels, cmap="Blues_r", extend="min")
collinear = sorted(found[:3], key=lambda each: each.energy)
for each, color in zip(collinear, ("#d55e00", "#009e73", "#cc79a7"), strict=True):
    plane.contour(x, y, potential, [each.energy], colors=color, linewidths=1, linestyles="solid")
mu = H.parameters["mu"]
plane.plot([-mu, 1 - mu], [0, 0], "o", color="black", markersize=4)
names = ["L1", "L2", "L3", "L5", "L4"]  # in the order of energies, then of y
for name, each in zip(names, found, strict=True):
    marker = "^" if each.stable else "x"
    plane.plot(*each.z[:2], marker, color="#d55e00" if marker == "x" else "#0072b2")
    plane.annotate(name, each.z[:2], (0, 7), textcoords="offset points", ha="center")
plane.set(title="Earth and Moon: crosses unstable, triangles stable", xlabel="x", ylabel="y")
plane.set_aspect("equal")

ratios = np.linspace(1e-4, 0.06, arguments.count)
points = [
    H.with_parameters(mu=ratio).equilibria([0.5 - ratio, 0.87, -0.87, 0.5 - ratio])[0]
    for ratio in ratios
]
eigenvalues = np.array([each.eigenvalues for each in points])
curves.plot(ratios, eigenvalues.real.max(axis=1), color="#d55e00", label="exponent")
for sign, label, color in ((1, "positive", "#0072b2"), (-1, "negative", "#009e73")):
    pairs = [
        (ratio, frequency)
        for ratio, each in zip(ratios, points, strict=True)
        for frequency in each.frequencies[each.signatures == sign]
    ]
    curves.plot(*np.transpose(pairs), color=color, label=f"frequency, {label} energy")
unstable = eigenvalues.real.max(axis=1) > 0
frequencies = eigenvalues.imag.max(axis=1)
curves.plot(ratios[unstable], frequencies[unstable], color="0.5", label="frequency of the spiral")
curves.axvline((1 - np.sqrt(69) / 9) / 2, color="0.5", linestyle=":", linewidth=1)
curves.set(title="Eigenvalues at L4 (dotted: Routh's value)", xlabel="mass ratio mu", ylim=(0, 1))
curves.legend(fontsize=8)
curves.grid(alpha=0.25)

arguments.out.mkdir(parents=True, exist_ok=True)
path = arguments.out / "lagrange-points.png"
figure.savefig(path, dpi=110)
print(f"wrote {path}")
