"""Point masses in a plane: names of their components, and integrals of forces between pairs."""

from __future__ import annotations


def planar_names(n: int) -> list[str]:
    """Return the names of the coordinates of n bodies, x1, x2, ..., y1, y2, ...

    Examples
    --------
    >>> planar_names(2)
    ['x1', 'x2', 'y1', 'y2']
    """
    return [f"{axis}{i}" for axis in ("x", "y") for i in range(1, n + 1)]


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
