"""Ideal flow in the plane: vortices."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require_whole
from hamsym.systems.catalogue import Problem, check_start, listed, numbered

_VORTICES = ("polygon", "shaken polygon")


@listed
def point_vortices(n: int = 4, start: str = "polygon") -> Problem:
    """Point vortices of equal strength 2 pi in the plane, H = -sum_i<j log(r_ij^2)/2.

    The coordinates are x1, x2, ... and the momenta y1, y2, ... On the regular polygon of radius 1
    they turn, exactly, with the angular velocity (n - 1)/2; that is stable up to n = 7. In the
    shaken polygon the first vortex is at (1.2, 0.3) instead of (1, 0); with four vortices or more
    that is not integrable.

    Raises
    ------
    InputError
        If n is not a whole number from 2 to 20, or there is no such start.

    Examples
    --------
    >>> point_vortices(n=3).conserved
    ('x1 + x2 + x3', 'y1 + y2 + y3', 'x1**2 + y1**2 + x2**2 + y2**2 + x3**2 + y3**2')
    """
    require_whole("n", n, 2, 20)
    check_start(start, _VORTICES)
    angles = 2 * math.pi * np.arange(n) / n
    x, y = (np.round(f(angles), 15) + 0.0 for f in (np.cos, np.sin))  # 0, not 6e-17
    rate = (n - 1) / 2

    def turning(t: np.ndarray) -> np.ndarray:
        phase = np.multiply.outer(rate * np.asarray(t), np.ones(n)) + angles
        return np.concatenate((np.cos(phase), np.sin(phase)), axis=-1)

    exact: Callable[[np.ndarray], np.ndarray] | None = turning
    if start != "polygon":
        x[0], y[0], exact = 1.2, 0.3, None
    xs, ys = numbered("x", n), numbered("y", n)
    pairs = [
        f"log(({xs[i]} - {xs[j]})**2 + ({ys[i]} - {ys[j]})**2)/2"
        for i, j in itertools.combinations(range(n), 2)
    ]
    return Problem(
        "point vortices",
        Hamiltonian(f"-({' + '.join(pairs)})", q=xs, p=ys),
        (*x.tolist(), *y.tolist()),
        (0.0, 10.0),
        "Kirchhoff 1876; Thomson 1883; Aref 1983",
        exact,
        2 * math.pi / rate if exact else None,
        (
            " + ".join(xs),
            " + ".join(ys),
            " + ".join(f"{a}**2 + {b}**2" for a, b in zip(xs, ys, strict=True)),
        ),
        start,
        _VORTICES,
    )
