"""
Molecules
=========

Vibration of a Morse molecule, whose exact motion is known, and a trimer of argon-like atoms with
Lennard-Jones forces in the plane: six degrees of freedom, with momentum and angular momentum
conserved.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

morse = hamsym.systems.morse_oscillator()
print(morse.H)
vibration = hamsym.solve(morse.H, morse.z0, (0, 4 * morse.period), tol=1e-10)
t = np.linspace(*vibration.span, 1001)
print(f"true error {np.abs(vibration(t) - morse.exact(t)).max():.1e}")
figure = vibration.plot()

# %%
# The trimer. The catalogue writes the Hamiltonian of any number of atoms.

trimer = hamsym.systems.lennard_jones()
print(trimer.H)
solution = hamsym.solve(trimer.H, trimer.z0, (0, 12), tol=1e-9)
print(solution.message)
t = np.linspace(0, 12, 2001)
z = solution(t)
n = trimer.H.dof // 2
x, y = z[:, :n], z[:, n : 2 * n]

paths = Figure(figsize=(10, 4), layout="constrained")
plane, distances = paths.subplots(1, 2)
for i, color in enumerate(("#0072b2", "#d55e00", "#009e73")):
    plane.plot(x[:, i], y[:, i], color=color, linewidth=1)
    plane.plot(x[0, i], y[0, i], "o", color=color, label=f"atom {i + 1}")
for i, j, color in ((0, 1, "#cc79a7"), (0, 2, "#e69f00"), (1, 2, "#56b4e9")):
    apart = np.hypot(x[:, i] - x[:, j], y[:, i] - y[:, j])
    distances.plot(t, apart, color=color, label=f"{i + 1} to {j + 1}")
plane.set(title="paths; dots are the starts", xlabel="x", ylabel="y", aspect="equal")
plane.legend()
distances.set(title="distances of the atoms", xlabel="t")
distances.legend()

# %%
# What is conserved, symbolically and along the solution.

for formula in trimer.conserved:
    value = trimer.H.observable(formula)(z)
    print(f"{trimer.H.is_conserved(formula)}, change {np.ptp(value):.1e}: {formula}")

# sphinx_gallery_thumbnail_number = 2
