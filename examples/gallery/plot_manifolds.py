"""
Manifolds and connections
=========================

Separatrices of a pendulum, and tubes through which comets change from an orbit outside Jupiter's to
one inside it.
"""

import numpy as np

import hamsym

saddle = hamsym.equilibria("p**2/2 - cos(x)")[1]
figure = saddle.manifolds().plot()

# %%
# Planar orbits about L1 and L2 of Sun and Jupiter with the energy of comet Oterma, the tubes of the
# inner one, and a connection from there to the outer one.

mu, C = 9.537e-4, 3.03
H = hamsym.systems.restricted_three_bodies(mu).H


def lyapunov(x: float, sign: int) -> hamsym.PeriodicOrbit:
    """The orbit that crosses the line of Sun and Jupiter at x, at a right angle."""
    potential = 2 * ((1 - mu) / abs(x + mu) + mu / abs(x - 1 + mu)) + mu * (1 - mu)
    start = [x, 0, 0, sign * np.sqrt(x**2 + potential - C) + x]
    mirror = {"y": "-y", "p_x": "-p_x"}
    return hamsym.periodic_orbit(H, (start, 3.1), energy=-(C - mu * (1 - mu)) / 2, symmetry=mirror)


inner, outer = lyapunov(0.9208034913, 1), lyapunov(1.0819294868, -1)
tubes, others = inner.manifolds(duration=2.4), outer.manifolds(duration=2.4)
tube_figure = tubes.unstable.plot("x", "y")

# %%
found = hamsym.connections(tubes.unstable, others.stable, "x = 1 - mu, y < 0", crossings=1)
print(found.message)
section_figure = found.plot()

# %%
connection_figure = found[0].plot()

# sphinx_gallery_thumbnail_number = 2
