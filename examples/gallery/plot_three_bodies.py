"""
Restricted three-body problem
=============================

A spacecraft in the field of the Earth and the Moon, in the frame that rotates with them: three
periodic orbits of Arenstorf, which pass close to the Moon, with their energies and errors.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

figure = Figure(figsize=(11, 4), layout="constrained")
for axis, start in zip(figure.subplots(1, 3), hamsym.systems.arenstorf().starts, strict=True):
    problem = hamsym.systems.arenstorf(start=start)
    H = problem.H
    solution = hamsym.solve(H, problem.z0, problem.span, tol=1e-9)
    t = np.linspace(*problem.span, 4001)
    z = solution(t)
    closing = np.abs(z[-1] - z[0]).max()
    print(f"{start}: {solution.message}")
    print(f"    period {problem.period:.6f}, misses its start by {closing:.1e}")
    axis.plot(z[:, 0], z[:, 1], color="#0072b2", linewidth=1)
    mu = 0.012277471
    axis.plot(-mu, 0, "o", color="#009e73", markersize=9, label="Earth")
    axis.plot(1 - mu, 0, "o", color="0.5", markersize=5, label="Moon")
    axis.set(title=start, xlabel="x", ylabel="y", aspect="equal")
axis.legend(loc="upper right")

# %%
# The state in 30 digits is in the catalogue, computed by another method. Near the Moon errors grow
# by many powers of ten, which the estimate includes.

error = np.abs(solution(problem.span[1]) - problem.reference.state)
print("error at the end     ", error)
print("estimate at the end  ", np.abs(solution.error_estimate(problem.span[1])))
