"""Other solutions with the same data, by a change of signs."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from itertools import product

import numpy as np
import sympy

from hamsym.fitting.unknowns import Unknowns
from hamsym.hamiltonian import Hamiltonian

_MOST = 8  # quantities whose signs are tried together


def reflected(
    unknowns: Unknowns,
    changes: Sequence[np.ndarray],
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> list[str]:
    """Name the solutions that changes of signs make of one with its intervals, each shape (k,)."""
    texts: list[str] = []
    named = [np.ones(len(x))]
    for signs in changes:
        other, flipped = signs * x, signs < 0
        inside = ((other > unknowns.low) & (other < unknowns.high))[flipped].all()
        if not inside or any((signs == one).all() for one in named):
            continue
        named += [signs * one for one in named]
        names = [name for name, sign in zip(unknowns.names, signs, strict=True) if sign < 0]
        if ((low <= 0) & (high >= 0))[flipped].all():
            verb = "is" if len(names) == 1 else "are"
            interval = "its interval includes 0" if len(names) == 1 else "intervals include 0"
            texts.append(f"{_listed(names)} {verb} determined only up to sign, and {interval}")
        else:
            texts.append(
                f"another solution fits as well, by symmetry, {unknowns.text(other)}; give bounds "
                f"of {' or '.join(names)} that exclude it"
            )
    return texts


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def reflections(unknowns: Unknowns, observables: tuple[sympy.Expr, ...]) -> list[np.ndarray]:
    """Return signs of the free quantities, each of shape (k,), that change no observable."""
    H, names = unknowns.H, unknowns.names
    pairs = tuple(
        i
        for i in range(H.dof)
        if any(H.names[j] in names for j in (i, i + H.dof))
        and all(H.names[j] in names or unknowns.start[j] == 0 for j in (i, i + H.dof))
    )
    H = H.with_parameters(**dict.fromkeys(H.parameters, 1.0))
    found = _symmetries(H, observables, pairs, unknowns.free_parameters)
    return [np.array([-1.0 if name in flips else 1.0 for name in names]) for flips in found]


@functools.lru_cache(maxsize=64)
def _symmetries(
    H: Hamiltonian,
    observables: tuple[sympy.Expr, ...],
    pairs: tuple[int, ...],
    parameters: tuple[str, ...],
) -> tuple[frozenset[str], ...]:
    """Return the names that change sign in maps that leave H, forces and observables the same."""
    equations = H.real_equations
    parts = [frozenset((i, i + H.dof)) for i in pairs]
    items: list[dict[sympy.Expr, str]] = [
        {equations.z[j]: H.names[j] for j in sorted(part)} for part in parts
    ]
    items += [{equations.parameters[name][0]: name} for name in parameters]
    found = []
    for chosen in product((False, True), repeat=min(len(items), _MOST)):
        flipped = {
            s: n for item, one in zip(items, chosen, strict=False) if one for s, n in item.items()
        }
        change = {symbol: -symbol for symbol in flipped}
        if change and all(_same(e.xreplace(change), e) for e in (*observables, equations.expr)):
            signs = [-1 if equations.z[H.dof + i] in change else 1 for i in range(H.dof)]
            forces = zip(equations.forces, signs, strict=False)
            if all(_same(force.xreplace(change), sign * force) for force, sign in forces):
                found.append(frozenset(flipped.values()))
    return tuple(sorted(found, key=len))


def _same(one: sympy.Expr, other: sympy.Expr) -> bool:
    return bool(one == other or sympy.expand(one - other) == 0)
