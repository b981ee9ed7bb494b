"""
Friction and drive
==================

Forces that no Hamiltonian has: a damped, driven Duffing oscillator, its attractor by a
stroboscopic section, and its exponents.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

H = hamsym.Hamiltonian(
    "p**2/2 - x**2/2 + x**4/4",
    forces={"p": "-delta*p + a*cos(w*t)"},
    parameters={"delta": 0.3, "a": 0.5, "w": 1.2},
)
for name, rate in zip(H.names, H.vector_field, strict=True):
    print(f"d{name}/dt = {H.notation.text(rate)}")
print("rate of H along trajectories:", H.power)

# %%
# A solution, and its balance of energy.

solution = hamsym.solve(H, [1, 0], (0, 60), tol=1e-9)
t = np.linspace(0, 60, 1001)
print(solution.message)
print(f"H(t) - H(0) - work: {np.abs(solution.energy_drift(t)).max():.1e}")
figure = solution.plot()

# %%
# The state once in each period of the drive. A symplectic method does not apply; ``integrate``
# takes an implicit Gauss method, with a fixed number of steps in a period.

period = 2 * np.pi / 1.2
count = 3000
trajectory = hamsym.integrate(H, [1, 0], (0, count * period), "gauss6", steps=count * 40)
each = trajectory.z[::40][50:]
strobe = Figure(figsize=(6, 4.5), layout="constrained")
axis = strobe.subplots()
axis.plot(each[:, 0], each[:, 1], ".", color="#0072b2", markersize=2)
axis.set(title=f"strange attractor: {len(each)} periods", xlabel="x", ylabel="p")

# %%
# Exponents: one is positive, and their sum is the mean divergence of the equations, -0.3.

found = hamsym.lyapunov(H, [1, 0], (0, 2000), count=2)
print(found.exponents[-1], "sum", found.exponents[-1].sum())

# sphinx_gallery_thumbnail_number = 2
