"""
An ion in a Paul trap, in SI units
==================================

A calcium ion in a linear Paul trap, in kilograms, metres and seconds: momenta are of the order of
1e-24, positions of 1e-5, times of 1e-6. Tolerances are relative to the size of each component, so
that no scaling by hand is needed.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy import constants

import hamsym

H = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/(2*m) + e*(U - V*cos(w*t))*(x**2 - y**2)/(2*r0**2)",
    parameters={
        "m": 39.96259 * constants.atomic_mass,  # kg
        "e": constants.e,  # C
        "U": 1.0,  # V
        "V": 150.0,  # V
        "w": 2 * np.pi * 10e6,  # 1/s
        "r0": 0.5e-3,  # m
    },
)
m, e, V, w, r0 = (H.parameters[name] for name in ("m", "e", "V", "w", "r0"))
print(f"stability parameter q = {2 * e * V / (m * r0**2 * w**2):.3f}, below 0.908")

# %%
# Start 20 micrometres off the axis in both directions, at rest, and follow ten microseconds.

start = {"x": 20e-6, "y": 20e-6, "p_x": 0, "p_y": 0}
solution = hamsym.solve(H, start, (0, 10e-6), tol=1e-9)
print(solution.message)
print("sizes of the components  ", solution.scale)
t = np.linspace(0, 10e-6, 2001)
print("largest estimated errors ", np.abs(solution.error_estimate(t)).max(axis=0))

# %%
figure = solution.plot()

# %%
# Across the axis of the trap: the slow secular motion with the fast micromotion on it.

across = Figure(figsize=(8, 3.6), layout="constrained")
axis = across.subplots()
axis.plot(*(1e6 * solution(t)[:, :2].T), color="#0072b2", linewidth=0.8)
axis.set(xlabel="x in micrometres", ylabel="y in micrometres", aspect="equal")

# %%
# H depends on time, so that energy is exchanged with the field; the balance of power and energy
# still holds.

drift = np.abs(solution.energy_drift(t)).max() / np.abs(solution.energy(t)).max()
print(f"balance of energy, relative to the largest energy: {drift:.1e}")

# sphinx_gallery_thumbnail_number = 2
