"""
Order and chaos
===============

Henon and Heiles's system at the energy 1/8: a Poincare section shows regular islands in a chaotic
sea, and Lyapunov exponents measure the chaos.
"""

import numpy as np

import hamsym

H = hamsym.systems.henon_heiles().H
y = np.array([-0.25, -0.15, -0.016, 0.1, 0.3, 0.55])
starts = H.state_at_energy(1 / 8, {"x": 0, "y": y, "p_y": 0})
crossings = hamsym.section(H, starts, (0, 3000), "x = 0, p_x > 0")
figure = crossings.plot()

# %%
# On a regular trajectory the finite-time exponent falls like log(t)/t; on a chaotic one it
# converges. hamsym says which of the two it sees, and what it cannot exclude.

for name, start in zip(("y = -0.016", "y = 0.55"), starts[[2, 5]], strict=True):
    found = hamsym.lyapunov(H, start, (0, 20_000))
    print(f"{name}: {found.statement}\n")

# %%
# A plane of starts in one call.

y, p_y = np.linspace(-0.45, 0.7, 60), np.linspace(-0.52, 0.52, 60)
plane = {"x": 0, "y": y, "p_y": p_y[:, None]}
chaos = hamsym.lyapunov(H, H.state_at_energy(1 / 8, plane, missing="nan"), (0, 300))
map_of_chaos = chaos.plot()

# sphinx_gallery_thumbnail_number = 2
