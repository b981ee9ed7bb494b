"""Catalogue of Hamiltonian systems: usual starts and spans, exact solutions, reference states.

Each function returns a :class:`Problem`; :data:`CATALOGUE` lists them all, and a new system is
one more function with the decorator :func:`~hamsym.systems.catalogue.listed` in the module of its
kind.
"""

from typing import NoReturn

from hamsym.support.suggestions import attribute_message
from hamsym.systems.catalogue import CATALOGUE, Problem, Reference
from hamsym.systems.celestial import (
    arenstorf,
    halo_orbits,
    kepler,
    pleiades,
    restricted_three_bodies,
    three_bodies,
)
from hamsym.systems.chains import (
    calogero_moser,
    coupled_oscillators,
    fermi_pasta_ulam_tsingou,
    toda_chain,
)
from hamsym.systems.charges import charged_particle, paul_trap, penning_trap, stormer
from hamsym.systems.fluids import point_vortices
from hamsym.systems.molecules import argon_crystal, lennard_jones
from hamsym.systems.oscillators import (
    driven_duffing,
    driven_oscillator,
    harmonic_oscillator,
    henon_heiles,
    morse_oscillator,
    nonlinear_oscillator,
)
from hamsym.systems.pendulums import double_pendulum, pendulum, spring_pendulum, swinging_atwood
from hamsym.systems.tops import kovalevskaya_top, lagrange_top

__all__ = [
    "CATALOGUE",
    "Problem",
    "Reference",
    "arenstorf",
    "argon_crystal",
    "calogero_moser",
    "charged_particle",
    "coupled_oscillators",
    "double_pendulum",
    "driven_duffing",
    "driven_oscillator",
    "fermi_pasta_ulam_tsingou",
    "halo_orbits",
    "harmonic_oscillator",
    "henon_heiles",
    "kepler",
    "kovalevskaya_top",
    "lagrange_top",
    "lennard_jones",
    "morse_oscillator",
    "nonlinear_oscillator",
    "paul_trap",
    "pendulum",
    "penning_trap",
    "pleiades",
    "point_vortices",
    "restricted_three_bodies",
    "spring_pendulum",
    "stormer",
    "swinging_atwood",
    "three_bodies",
    "toda_chain",
]


def __getattr__(name: str) -> NoReturn:
    message = attribute_message(f"module '{__name__}'", name, CATALOGUE)
    raise AttributeError(message, name=name)
