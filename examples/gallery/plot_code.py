"""
From a Hamiltonian to code
==========================

What a course on mechanics does on the blackboard: write H, derive the equations, look at the code
that a computer runs, and see a trajectory. Here a bead slides on a rotating hoop.
"""

import numpy as np

import hamsym

# Radius and mass are 1; W is the speed of rotation of the hoop.
H = hamsym.Hamiltonian(
    "p**2/2 - W**2*sin(theta)**2/2 - g*cos(theta)", parameters={"g": 1, "W": 1.4}
)
print(H)
for name, rate in zip(H.names, H.vector_field, strict=True):
    print(f"d{name}/dt = {H.notation.text(rate)}")

# %%
# The second derivatives decide the stability of the points where the bead can rest.

print(H.hessian)
print(H.equilibria([[0, 0], [1, 0]]))

# %%
# The generated code is readable. It is what ``solve`` runs; with ``hamsym source`` it becomes a
# module that needs numpy only.

print(H.source("numpy", part="vector_field"))

# %%
# The same equations for other languages: numba, torch, jax, C, Julia and JavaScript.

print(H.source("c", part="vector_field"))

# %%
# A trajectory to nine digits. It is a function of time.

solution = hamsym.solve(H, {"theta": 0.1, "p": 0}, (0, 40), tol=1e-9)
print(solution.success, solution.message)
print(solution(12.5))

# %%
figure = solution.plot()

# %%
# The energy is no part of the method; that it is constant is a check.

t = np.linspace(0, 40, 1001)
print(f"largest change of H: {np.abs(solution.energy_drift(t)).max():.1e}")
