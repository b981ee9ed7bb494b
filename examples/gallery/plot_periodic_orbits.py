"""
Periodic orbits
===============

Families of periodic orbits of Henon and Heiles's system and of the restricted three-body problem,
with bifurcations, and a proof that one of the orbits exists.
"""

import numpy as np
from matplotlib.figure import Figure

import hamsym

H = hamsym.systems.henon_heiles().H
guess = H.state_at_energy(0.13, {"x": 0, "y": 0, "p_x": 0})
orbit = hamsym.periodic_orbit(H, guess, energy=0.13)
print(orbit)
family = orbit.family(energy=0.165)
for found in family.bifurcations:
    print(f"{found.kind} at the energy {found.orbit.energy:.6f}")

# %%
figure = family.plot()

# %%
# Planar orbits around the libration point L1 of the Earth and the Moon, which a symmetry under
# reversal of time singles out, and a proof that one of them exists with exactly its energy.

H = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y"
    " - (1 - mu)/sqrt((x + mu)**2 + y**2) - mu/sqrt((x - 1 + mu)**2 + y**2)",
    parameters={"mu": 0.012150585609624},
)
guess = {"x": 0.8319, "y": 0, "p_x": 0, "p_y": 0.8738}
around = hamsym.periodic_orbit(H, (guess, 2.7), symmetry={"y": "-y", "p_x": "-p_x"})
certificate = around.certify()
print(f"period {certificate.period}, proven to be {certificate.stability}")

family_of_l1 = around.family(energy=-1.54)
picture = Figure(figsize=(6.5, 4.5), layout="constrained")
axis = picture.subplots()
for each in family_of_l1[:: max(1, len(family_of_l1) // 12)]:
    z = each(np.linspace(0, each.period, 501))
    axis.plot(z[:, 0], z[:, 1], color="#0072b2", linewidth=0.8)
axis.plot(1 - H.parameters["mu"], 0, "o", color="0.4")
axis.annotate("Moon", (1 - H.parameters["mu"], 0.012), ha="center")
axis.set(title="Lyapunov orbits around L1", xlabel="x", ylabel="y", aspect="equal")

# sphinx_gallery_thumbnail_number = 2
