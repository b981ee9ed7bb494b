"""Point masses in a plane: their Hamiltonians, and integrals of forces between pairs."""

from __future__ import annotations

from hamsym.hamiltonian import Hamiltonian


def planar_hamiltonian(n: int, formula: str, **parameters: float) -> Hamiltonian:
    """Return the Hamiltonian of n bodies, with coordinates x1, x2, ..., y1, y2, ...

    Examples
    --------
    >>> planar_hamiltonian(1, "(px1**2 + py1**2)/2").names
    ('x1', 'y1', 'px1', 'py1')
    """
    names = [f"{axis}{i}" for axis in ("x", "y") for i in range(1, n + 1)]
    return Hamiltonian(formula, q=names, p=["p" + name for name in names], parameters=parameters)


def planar_integrals(n: int) -> tuple[str, ...]:
    """Return the total momentum and angular momentum of n bodies.

    Examples
    --------
    >>> planar_integrals(1)
    ('px1', 'py1', 'x1*py1 - y1*px1')
    """
    every = range(1, n + 1)
    return (
        " + ".join(f"px{i}" for i in every),
        " + ".join(f"py{i}" for i in every),
        " + ".join(f"x{i}*py{i} - y{i}*px{i}" for i in every),
    )
