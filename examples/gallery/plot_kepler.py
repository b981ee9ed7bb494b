"""
Kepler ellipses
===============

The Kepler problem has an exact solution, so that errors can be measured: here those of solutions
to three tolerances, on an ellipse of eccentricity 0.8 over five periods.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

problem = hamsym.systems.kepler(eccentricity=0.8)
H = problem.H
print(H)
span = (0, 5 * problem.period)
t = np.linspace(*span, 2001)
exact = problem.exact(t)

figure = Figure(figsize=(10, 4), layout="constrained")
orbit, errors = figure.subplots(1, 2)
for tol, color in ((1e-6, "#d55e00"), (1e-9, "#009e73"), (1e-11, "#0072b2")):
    solution = hamsym.solve(H, problem.z0, span, tol=tol)
    error = np.linalg.norm(solution(t) - exact, axis=1)
    print(f"tol {tol:.0e}: success {solution.success}, largest true error {error.max():.1e}")
    errors.semilogy(
        t / problem.period, np.maximum(error, 1e-17), color=color, label=f"tol {tol:.0e}"
    )
orbit.plot(exact[:, 0], exact[:, 1], color="0.6")
orbit.plot(0, 0, "o", color="#e69f00", markersize=10)
# The march takes short windows where the planet is fast.
edges = solution.record.edges
orbit.plot(*solution(span[0] + np.asarray(edges)[:-1])[:, :2].T, ".", color="#0072b2")
orbit.set(title="orbit, with the starts of windows", xlabel="x", ylabel="y", aspect="equal")
errors.set(title="true error", xlabel="periods", ylabel="distance in phase space")
errors.legend()

# %%
# Angular momentum and the Runge-Lenz vector are conserved. This is proven symbolically, and
# measured along the last solution.

x, y, p_x, p_y = solution(t).T
for formula in problem.conserved:
    print(f"conserved: {H.is_conserved(formula)}   {formula}")
print(f"largest change of the angular momentum: {np.ptp(x * p_y - y * p_x):.1e}")
