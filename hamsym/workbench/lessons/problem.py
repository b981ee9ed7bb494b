"""A problem as ``templates/player/`` takes it: names, values, ranges, what moves, a reference."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy
from sympy.printing.conventions import split_super_sub
from sympy.printing.pretty.pretty_symbology import greek_unicode

from hamsym.codegen.generate import generate
from hamsym.errors import InputError
from hamsym.facts.wording import error_text
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.adaptive import dop853_coefficients
from hamsym.plotting.names import time_name
from hamsym.solution.solution import Solution
from hamsym.workbench.animations.polar import RIGHT, direction_of_zero, polar_pairs
from hamsym.workbench.animations.scenes import rod_parameters, suggested_kind

_MOST_NUMBERS = 6_000  # of a reference
_MOST_TIMES = 200
_RAISED = str.maketrans("0123456789-./", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻·ᐟ")
Ranges = Mapping[str, tuple[float, float]]


def problem(solution: Solution, ranges: Ranges) -> dict[str, Any]:
    """Return the problem of a solution, as values that JSON can store.

    - ranges: Of the parameters that have sliders.
    """
    H = solution.H
    scene = moving(H)
    keys = [key for key, _ in generate(H.real_equations, "javascript").names.parameters]
    own = dict(zip(H.parameter_names, keys, strict=True))
    if "lengths" in scene:
        scene["lengths"] = [own.get(length, length) for length in scene["lengths"]]
    labels = [label_of(H, name) for name in H.names]
    if scene["kind"] == "plane":
        scene["axes"] = [_shared([labels[b[k]] for b in scene["bodies"]]) for k in (0, 1)]
    if scene["kind"] == "chain":
        scene["axes"] = [{"base": "site"}, _shared(labels[: H.dof])]
    return {
        "names": list(H.names),
        "labels": labels,
        "dof": H.dof,
        "z0": solution.z0.tolist(),
        "span": list(map(float, solution.span)),
        "time_unit": unit_text(H.units.get(time_name(H), "1")),
        "parameters": [
            {
                "name": name,
                "key": own[name],
                "label": label_of(H, name),
                "value": float(H.parameters[name]),
                "range": list(map(float, ranges[name])) if name in ranges else None,
            }
            for name in H.parameter_names
        ],
        "starts": _start_ranges(solution),
        "scene": scene,
        "plane": [0, H.dof],
        "natural": is_natural(H),
        "conserved": H.conserves_energy,
        "timed": H.time is not None,
        "method": dop853_coefficients(),
        "reference": _reference(solution) if solution.success else None,
    }


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


def _shared(labels: list[dict[str, str]]) -> dict[str, str]:
    """One label for components of several bodies."""
    if len(labels) == 1:
        return labels[0]
    return {"base": labels[0]["base"], "unit": labels[0]["unit"]}


def label_of(H: Hamiltonian, name: str) -> dict[str, str]:
    """Return a name as a letter, its index and its unit.

    Examples
    --------
    >>> H = Hamiltonian("p_theta1**2/2 - cos(theta1)")
    >>> label_of(H, "p_theta1"), label_of(H, "theta1")
    ({'base': 'p', 'sub': 'θ1', 'unit': ''}, {'base': 'θ', 'sub': '1', 'unit': ''})
    """
    base, above, below = split_super_sub(name)
    inner = [_letter(part) for part in (*below, *above)]
    return {
        "base": _letter(base),
        "sub": ",".join(inner),
        "unit": unit_text(H.units.get(name, "1")),
    }


def _letter(part: str) -> str:
    letters, digits = re.fullmatch(r"(.*?)(\d*)", part).groups()  # type: ignore[union-attr]
    return greek_unicode.get(letters, letters) + digits


def unit_text(unit: str) -> str:
    """Return a unit with raised exponents; "" for numbers.

    Examples
    --------
    >>> unit_text("kg*m/s**2"), unit_text("1")
    ('kg·m/s²', '')
    """
    raised = re.sub(r"\*\*\(?(-?[\d./]+)\)?", lambda found: found[1].translate(_RAISED), unit)
    return "" if unit == "1" else raised.replace("*", "·")


def is_natural(H: Hamiltonian) -> bool:
    """Whether H = T + V with T quadratic in the momenta, so that both energies have a meaning.

    Examples
    --------
    >>> is_natural(Hamiltonian("p**2/(2*(1 + x**2)) + x**4")), is_natural(Hamiltonian("p*x + x**2"))
    (True, False)
    """
    momenta, d = set(H.p), H.dof
    second = H.real_equations.hessian
    symbols = dict(zip(H.real_equations.z, H.z, strict=True))
    if any(
        entry.xreplace(symbols).free_symbols & momenta
        for (i, j), entry in second.items()
        if min(i, j) >= d
    ):
        return False
    resting = dict.fromkeys(H.p, sympy.Integer(0))
    return all(slope.xreplace(resting) == 0 for slope in H.gradient[d:])


def _start_ranges(solution: Solution) -> list[list[float]]:
    """Ranges of the start: the motion and half as much again, on one side of zero if it is."""
    z = solution(np.linspace(*solution.span, 401)) if solution.success else solution.z0[None]
    found = []
    sizes = np.abs(z).reshape(len(z), 2, -1).max(axis=(0, 2)).repeat(solution.H.dof)
    for low, high, size in zip(z.min(axis=0), z.max(axis=0), sizes, strict=True):
        room = 0.5 * max(high - low, 0.5 * max(abs(low), abs(high)), 0.1 * size) or 1.0
        ends = float(low - room), float(high + room)
        if low > 0:
            ends = max(ends[0], float(low) / 20), ends[1]
        if high < 0:
            ends = ends[0], min(ends[1], float(high) / 20)
        found.append([float(f"{end:.3g}") for end in ends])
    return found


def _reference(solution: Solution) -> dict[str, Any]:
    """States at equal times, which the page compares with its own."""
    count = max(16, min(_MOST_TIMES, _MOST_NUMBERS // solution.H.dim))
    z = solution(np.linspace(*solution.span, count))
    scale = solution.scale.reshape(2, -1)
    floor = 1e-8 * scale.max(axis=1, keepdims=True)
    sizes = np.where(floor > 0, np.maximum(scale, floor), 1.0).ravel()
    return {
        "states": base64.b64encode(np.ascontiguousarray(z, "<f8").tobytes()).decode(),
        "sizes": sizes.tolist(),
        "error": error_text(solution.relative_error),
    }
