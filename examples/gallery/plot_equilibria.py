"""
Equilibria and their stability
==============================

The five Lagrange points of the Earth and the Moon, each proven to exist, with frequencies and Krein
signatures, and the curves that bound the motion at their energies.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

H = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y"
    " - (1 - mu)/sqrt((x + mu)**2 + y**2) - mu/sqrt((x - 1 + mu)**2 + y**2)",
    parameters={"mu": 0.012150585609624},
)
found = H.equilibria()
print(found)

# %%
# Zero-velocity curves: H of a state at rest in the rotating frame, p_x = -y and p_y = x.

x, y = np.meshgrid(np.linspace(-1.5, 1.5, 401), np.linspace(-1.4, 1.4, 381))
potential = H.compile("numpy").energy(np.stack((x, y, -y, x), axis=-1))
top = found.energies.max()
figure = Figure(figsize=(6.5, 5.5), layout="constrained")
axis = figure.subplots()
axis.contourf(x, y, potential, np.linspace(top - 0.6, top, 25), cmap="Blues_r", extend="min")
unstable = [each for each in found if not each.stable]
for each, color in zip(unstable, ("#d55e00", "#009e73", "#cc79a7"), strict=True):
    axis.contour(x, y, potential, [each.energy], colors=color, linewidths=1, linestyles="solid")
for each in found:
    axis.plot(*each.z[:2], "^" if each.stable else "x", color="black")
axis.set(title="crosses unstable, triangles stable", xlabel="x", ylabel="y", aspect="equal")

# %%
# All equilibria in a box, proven to be all.

box = {"x": (0.3, 0.7), "y": (-1, 1), "p_x": (-1, 1), "p_y": (-1, 1)}
print(H.equilibria(box=box).message)
