"""Systems with known exponents. The files share them, because compiling a loop takes seconds."""

from __future__ import annotations

from hamsym import Hamiltonian


def linear(k: float) -> Hamiltonian:
    return Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": k})


def saddle(a: float, b: float) -> Hamiltonian:
    """A system with the exponents a, b, -b, -a."""
    values = {"a": a, "b": b}
    return Hamiltonian("(p_x**2 - a**2*x**2 + p_y**2 - b**2*y**2)/2", parameters=values)
