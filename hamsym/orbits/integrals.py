"""Integrals of H beside a periodic orbit: the symmetries that they generate, and their number.

An integral I is represented by the Hamiltonian I, whose flow commutes with that of H: it moves
periodic orbits to periodic orbits. So an orbit of three bodies can be shifted and rotated, and is
isolated only up to these motions. The equations of an orbit therefore have, for each independent
integral, a plane across its direction J grad I at the start, and leave out what the integral
implies (Munoz-Almaraz, Freire, Galan, Doedel & Vanderbauwhede 2003).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Arc, Problem, vector_field_at
from hamsym.orbits.symmetry import Closing, SignedPermutation, moved
from hamsym.random_features.flow import flow_of
from hamsym.symbolic import brackets
from hamsym.symbolic.invariants import find_invariants, suggested_basis

_DEGREE = 2  # of momenta, angular momenta and quadratic integrals
_SECONDS = 60.0  # for their search
_ROUND_OFF = 1e-7  # of a gradient, relative to what its terms may give
_CLOSING = 0.1  # change of a direction along an orbit, relative to it, that an inexact orbit causes


@functools.lru_cache(maxsize=64)
def integrals_of(H: Hamiltonian) -> tuple[Hamiltonian, ...]:
    """Return H, if it is conserved, and its further integrals without explicit time.

    Further integrals are those that :meth:`hamsym.Hamiltonian.invariants` finds, up to degree 2,
    for all values of the parameters. With forces there are none.
    """
    own = (H,) if H.conserves_energy else ()
    if H.forces:
        return own
    form = H.real_equations
    return (*own, *(_as_hamiltonian(H, expr) for expr in _found(form.expr, form.z, H.time)))


@functools.lru_cache(maxsize=64)
def shared_integrals(H: Hamiltonian, closing: Closing) -> tuple[Hamiltonian, ...]:
    """Return integrals that the maps of a closing condition keep, up to the sense of time.

    Symplectic maps keep their values and reversing maps their absolute values with the other sign,
    so that the maps keep the direction J grad I. The mean of any integral over all maps is one.
    """
    if closing.parts == 1:
        return integrals_of(H)
    maps = [closing.shift.power(k) for k in range(closing.order)]
    if closing.first is not None:
        maps += [each.after(closing.first) for each in maps]
    found = []
    for integral in integrals_of(H):
        if integral == H:
            if closing.first is None:
                found.append(H)
            continue
        parts = [one.time_direction * moved(integral, one) for one in maps]
        mean = sympy.expand(sympy.Add(*parts) / len(maps))
        if mean.free_symbols & {*H.real_equations.z}:
            found.append(_as_hamiltonian(H, mean))
    return tuple(found)


def directions(integrals: Sequence[Hamiltonian], state: np.ndarray) -> np.ndarray:
    """Return J grad I of each integral at a state, shape (n, dim)."""
    fields = [vector_field_at(each, state, 0.0) for each in integrals]
    return np.array(fields).reshape(len(integrals), len(state))


def gradients_from(fields: np.ndarray) -> np.ndarray:
    """Return grad I from J grad I, both along the last axis."""
    half = fields.shape[-1] // 2
    return np.concatenate([-fields[..., half:], fields[..., :half]], axis=-1)


def natural_sizes(
    integrals: Sequence[Hamiltonian], state: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Return what round-off of a state is relative to in the directions, shape (n,).

    A direction that vanishes at the state, as that of an oscillator at rest, is computed as
    round-off of the state times second derivatives.
    """
    found = []
    for each, field in zip(integrals, directions(integrals, state), strict=True):
        second = flow_of(each).jacobian(state[None], np.zeros(1))[0]
        sizes = np.abs(field) + np.abs(second) @ scale
        found.append(float((sizes / scale).max()))
    return np.array(found)


@dataclass(frozen=True)
class Slice:
    """Planes through the start of an arc, across the flow and the symmetries of integrals.

    - state: The start, shape (dim,).
    - normals: Of the planes, in units of the inverse of the components, shape (n, dim).
    - integrals: Those whose directions the planes cross, with independent gradients.
    """

    state: np.ndarray
    normals: np.ndarray
    integrals: tuple[Hamiltonian, ...]


def slice_of(problem: Problem, arc: Arc) -> Slice:
    """Return the planes across all directions along which a periodic orbit can be moved.

    These lead to other orbits that close. On an orbit that does not close yet there may be more
    integrals: the angular momentum of the centre of mass is one only while this moves, and it does
    not along a periodic orbit.
    """
    state, scale, closing = arc.ends[0], problem.scale_of(arc), problem.closing
    integrals = shared_integrals(problem.H, closing)
    start, end = directions(integrals, state), directions(integrals, arc.ends[-1])
    gaps = end - closing.shift(start) if closing.last is None else (end - closing.last(end)) / 2
    kept = tuple(_independent(problem.H, integrals, state, scale, gaps))
    rows = directions(kept, state)
    if problem.autonomous and not problem.conservative:
        rows = vector_field_at(problem.H, state, problem.start)[None]
    rows = rows / scale
    if not np.isfinite(rows).all():
        return Slice(state, rows, kept)
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    normals = np.linalg.qr((rows / np.where(lengths > 0, lengths, 1.0)).T)[0].T
    return Slice(state, normals / scale, kept)


def independent_integrals(
    H: Hamiltonian, state: np.ndarray, scale: np.ndarray
) -> list[Hamiltonian]:
    """Return integrals of H whose gradients at a state are independent."""
    found = integrals_of(H)
    return _independent(H, found, state, scale, np.zeros((len(found), len(state))))


def _independent(
    H: Hamiltonian,
    integrals: Sequence[Hamiltonian],
    state: np.ndarray,
    scale: np.ndarray,
    gaps: np.ndarray,
) -> list[Hamiltonian]:
    """The first integrals with independent directions, of which gaps are a small part."""
    sizes = natural_sizes(integrals, state, scale)
    units = scale * np.where(sizes > 0, sizes, 1.0)[:, None]
    left, gaps = directions(integrals, state) / units, gaps / units
    chosen = []
    for k, integral in enumerate(integrals):
        length = np.linalg.norm(left[k])
        closes = np.linalg.norm(gaps[k]) <= _CLOSING * length
        # H moves along every orbit; a start near an equilibrium has a small gradient.
        least, closes = (0.0, True) if integral == H else (_ROUND_OFF, closes)
        if not (length > least and closes):
            continue
        chosen.append(integral)
        unit, gap = left[k] / length, gaps[k] / length
        shares = left @ unit
        left, gaps = left - np.outer(shares, unit), gaps - np.outer(shares, gap)
    return chosen


def neutral(integrals: Sequence[Hamiltonian], H: Hamiltonian) -> list[bool]:
    """Return whether brackets of each integral with all others are proven to vanish.

    They vanish along periodic orbits, not everywhere: the bracket of a momentum and an angular
    momentum is a momentum, which is zero where the centre of mass comes back.
    """
    z, exprs = H.real_equations.z, [each.real_equations.expr for each in integrals]
    further = [expr for expr, each in zip(exprs, integrals, strict=True) if each != H]
    return [
        each == H
        or all(
            _vanishes_along_orbits(sympy.expand(brackets.poisson_bracket(one, other, z)), H)
            for other in further
        )
        for each, one in zip(integrals, exprs, strict=True)
    ]


def _vanishes_along_orbits(bracket: sympy.Expr, H: Hamiltonian) -> bool:
    """Whether an integral is 0, or the rate of a linear function of the coordinates, which is
    periodic: then it is its mean over the period, 0.
    """
    form = H.real_equations
    rest = bracket
    for momentum in form.z[len(form.z) // 2 :]:
        share = sympy.diff(bracket, momentum)
        if share == 0:
            continue
        mass = sympy.simplify(sympy.diff(form.expr, momentum) / momentum)
        if share.free_symbols & {*form.z} or mass.free_symbols & {*form.z, H.time}:
            return False
        rest -= share * momentum
    return bool(sympy.expand(rest) == 0)


def are_permuted(integrals: Sequence[Hamiltonian], symmetry: SignedPermutation) -> bool:
    """Return whether a symmetry maps each integral to one of them, or to its negative."""
    exprs = [sympy.expand(each.real_equations.expr) for each in integrals]
    images = [sympy.expand(moved(each, symmetry)) for each in integrals]
    return all(image in exprs or sympy.expand(-image) in exprs for image in images)


def _as_hamiltonian(H: Hamiltonian, expr: sympy.Expr) -> Hamiltonian:
    names = {symbol.name for symbol in expr.free_symbols}
    values = {name: value for name, value in H.parameters.items() if name in names}
    return Hamiltonian(expr, q=H.q, p=H.p, parameters=values)


@functools.lru_cache(maxsize=64)
def _found(
    H: sympy.Expr, z: tuple[sympy.Symbol, ...], time: sympy.Symbol | None
) -> tuple[sympy.Expr, ...]:
    """Further integrals that do not contain the time."""
    try:
        found = find_invariants(H, z, time, {}, _DEGREE, suggested_basis(H, z), _SECONDS)
    except InputError:  # too many candidates, or a function without exact rules
        return ()
    return tuple(integral.expr for integral in found if time not in integral.expr.free_symbols)
