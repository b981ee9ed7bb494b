"""
A thousand pendulums in one call
================================

``solve_many`` solves from arrays of starts and parameters, each member with its own error estimate
and verdict: the period of a pendulum against its energy, with the exact elliptic integral.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ellipk

import hamsym

H = hamsym.Hamiltonian("p**2/2 - cos(theta)")
energies = np.linspace(-0.99, 3, 1000)
many = hamsym.solve_many(H, H.state_at_energy(energies, {"theta": 0}), (0, 25))
print(many)
print(f"{many.success.sum()} of {many.size} within the tolerance")

# %%
# States of all members at all times are one array.

t = np.linspace(0, 25, 500)
states = many[::40](t)
print(states.shape)

# %%
# An index gives one solution, with its events.

some = range(0, len(many), 5)
periods = np.array([many[i].events("sin(theta/2) = 0, p > 0").t_events[0][0] for i in some])
m = (1 + energies[::5]) / 2
exact = np.where(m < 1, 4 * ellipk(np.minimum(m, 1)), 2 * ellipk(1 / np.maximum(m, 1)) / np.sqrt(m))
print(f"largest relative error of a period: {np.abs(periods / exact - 1).max():.1e}")

figure = Figure(figsize=(10, 4), layout="constrained")
plane, diagram = figure.subplots(1, 2)
for member in states:
    theta = (member[:, 0] + np.pi) % (2 * np.pi) - np.pi
    theta[np.abs(np.diff(theta, prepend=theta[0])) > np.pi] = np.nan  # the line ends at an edge
    plane.plot(theta, member[:, 1], color="#0072b2", linewidth=0.8)
plane.set(title="every fortieth motion", xlabel="theta", ylabel="p")
diagram.plot(energies[::5], exact, color="0.6", label="elliptic integral")
diagram.plot(energies[::5], periods, ".", color="#d55e00", markersize=4, label="solve_many")
diagram.set(title="period against energy", xlabel="energy", ylabel="period")
diagram.legend()
