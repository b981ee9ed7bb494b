"""
Parameters from noisy data
==========================

Angles of a pendulum on the Moon, with errors of 0.02: gravity and the initial state from the data,
with confidence intervals, and a verdict on the model.
"""

import numpy as np

import hamsym

H = hamsym.Hamiltonian("p**2/(2*m*l**2) - m*g*l*cos(theta)", parameters={"m": 1, "l": 1})
moon = hamsym.solve(H.with_parameters(g=1.62), {"theta": 0.9, "p": 0.1}, (0, 20))
t = np.linspace(0, 20, 200)
data = moon(t)[:, 0] + np.random.default_rng(5).normal(0, 0.02, len(t))

free = {"g": 1.4, "theta": 0.8, "p": 0}  # first guesses
found = hamsym.fit(H, t, {"theta": data}, free=free, sigma=0.02, span=(0, 20))
print(found.success, found.message)
for name, (low, high) in found.confidence_intervals.items():
    print(f"{name}: between {low:.4f} and {high:.4f}")

# %%
figure = found.plot()

# %%
# What data do not determine is named instead of reported with huge errors: with a free length,
# only the ratio g/l has an effect.

free = {"g": 1.6, "l": 1.1, "theta": 0.9, "p": 0}
loose = hamsym.fit(H, t, {"theta": data}, free=free, sigma=0.02, span=(0, 20))
print(loose.success, loose.message)
