"""What of a system moves on the page: the body that the names of its coordinates suggest."""

from __future__ import annotations

import re
from typing import Any

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.workbench.animations.polar import RIGHT, direction_of_zero, polar_pairs
from hamsym.workbench.animations.scenes import rod_parameters, suggested_kind


def moving(H: Hamiltonian) -> dict[str, Any]:
    """Return the scene of a system for ``templates/player/``: a kind, and components by number.

    One degree of freedom that is no angle is a point on its potential; what has no picture of its
    own is a chain of its coordinates, and of two coordinates a point in their plane.

    Examples
    --------
    >>> moving(Hamiltonian("p**2/(2*l) - l*cos(theta)", parameters={"l": 2.0}))
    {'kind': 'pendulum', 'angles': [0], 'lengths': ['l']}
    >>> moving(Hamiltonian("(p_x**2 + p_y**2 + p_z**2)/2 + x*y*z"))
    {'kind': 'space', 'bodies': [[0, 1, 2]]}
    >>> moving(Hamiltonian("p**2/2 + x**4"))
    {'kind': 'potential'}
    """
    try:
        kind, chosen = suggested_kind(H, [])
    except InputError:
        kind, chosen = ("plane", [0, 1]) if H.dof == 2 else ("chain", list(range(H.dof)))
    if kind == "pendulum":
        names = rod_parameters(H, len(chosen))
        return {"kind": kind, "angles": chosen, "lengths": names or [1.0] * len(chosen)}
    if kind == "polar":
        pairs = polar_pairs(H)
        zero = direction_of_zero(H, pairs)
        return {
            "kind": kind,
            "pairs": [list(p) for p in pairs],
            "zero": zero,
            "rods": zero != RIGHT,
        }
    if kind == "plane":
        pairs = list(zip(chosen[::2], chosen[1::2], strict=True))
        heights = [re.sub("^x", "z", H.names[i]) for i, _ in pairs]
        if all(name in H.names[: H.dof] for name in heights) and 3 * len(pairs) == H.dof:
            places = map(H.names.index, heights)
            bodies = [[*pair, place] for pair, place in zip(pairs, places, strict=True)]
            return {"kind": "space", "bodies": bodies}
        return {"kind": kind, "bodies": [list(pair) for pair in pairs]}
    if kind == "chain":
        return {"kind": kind, "coordinates": chosen}
    return {"kind": "potential"}
