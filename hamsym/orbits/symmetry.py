"""Symmetries of a Hamiltonian that permute components of the state and change their signs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.symplectic import poisson_matrix
from hamsym.support.suggestions import did_you_mean
from hamsym.symbolic import derivatives


@dataclass(frozen=True)
class SignedPermutation:
    """The linear map (S z)_i = signs_i z_(places_i)."""

    places: tuple[int, ...]
    signs: tuple[int, ...]

    def check(self) -> None:
        """Raise ValueError unless each component occurs once, with a sign."""
        if sorted(self.places) != list(range(len(self.signs))) or not {*self.signs} <= {1, -1}:
            raise ValueError("its symmetry does not use each component once, with a sign")
        if self.time_direction == 0:
            raise ValueError("its symmetry is neither symplectic nor reversing")

    @classmethod
    def identity(cls, dim: int) -> SignedPermutation:
        return cls(tuple(range(dim)), (1,) * dim)

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Apply the map to states, shape (..., dim)."""
        return np.asarray(z[..., list(self.places)] * np.array(self.signs, dtype=float))

    @cached_property
    def matrix(self) -> np.ndarray:
        """Matrix of the map, shape (dim, dim)."""
        found = np.zeros((len(self.places), len(self.places)))
        found[np.arange(len(self.places)), list(self.places)] = self.signs
        return found

    def after(self, other: SignedPermutation) -> SignedPermutation:
        """Return the map that applies ``other`` first."""
        places = tuple(other.places[i] for i in self.places)
        signs = tuple(
            sign * other.signs[i] for i, sign in zip(self.places, self.signs, strict=True)
        )
        return SignedPermutation(places, signs)

    def power(self, exponent: int) -> SignedPermutation:
        """Return the map applied ``exponent`` times."""
        found = SignedPermutation.identity(len(self.places))
        for _ in range(exponent):
            found = self.after(found)
        return found

    @cached_property
    def order(self) -> int:
        """Smallest k > 0 for which the k-th power is the identity."""
        identity, found, k = SignedPermutation.identity(len(self.places)), self, 1
        while found != identity:
            found, k = self.after(found), k + 1
        return k

    @cached_property
    def time_direction(self) -> int:
        """1 if the map is symplectic, -1 if it is antisymplectic, else 0."""
        J = poisson_matrix(len(self.places) // 2)
        moved = self.matrix.T @ J @ self.matrix
        return 1 if (moved == J).all() else -1 if (moved == -J).all() else 0

    @cached_property
    def conditions(self) -> np.ndarray:
        """Independent rows c with c z = 0 for all z = S z, of an involution."""
        return self._rows(-1)

    @cached_property
    def fixed_basis(self) -> np.ndarray:
        """Columns that span all z = S z, with entries 0, 1 and -1, of an involution."""
        return self._rows(1).T

    def _rows(self, side: int) -> np.ndarray:
        """A basis of all z = side * S z, of an involution, one in a row."""
        unit, rows = np.eye(len(self.places)), []
        for i, (place, sign) in enumerate(zip(self.places, self.signs, strict=True)):
            if place == i and sign == side:
                rows.append(unit[i])
            elif place > i:
                rows.append(unit[i] + side * sign * unit[place])
        return np.array(rows).reshape(-1, len(self.places))


@dataclass(frozen=True)
class Closing:
    """The condition that closes an orbit after a part of its period, its arc.

    With reversing symmetries the arc leads from the fixed set of ``first`` to that of ``last``, and
    ``shift`` is last o first; otherwise z(arc) = shift z(0).
    """

    shift: SignedPermutation
    first: SignedPermutation | None = None
    last: SignedPermutation | None = None

    def check(self) -> None:
        """Raise ValueError unless it closes an orbit."""
        maps = [each for each in (self.first, self.last) if each is not None]
        if any(each.time_direction != -1 or each.order != 2 for each in maps) or len(maps) == 1:
            raise ValueError("its symmetries are not a pair that reverses time")
        shift = self.shift if self.last is None else self.last.after(maps[0])
        if shift != self.shift or shift.time_direction != 1:
            raise ValueError("its symmetries do not close an orbit")

    @property
    def reversing(self) -> bool:
        return self.first is not None

    @property
    def order(self) -> int:
        """Number of shifts in a period."""
        return self.shift.order

    @property
    def parts(self) -> int:
        """Number of arcs in a period."""
        return self.order * (2 if self.reversing else 1)

    def unfolded(self, part: int, z: np.ndarray) -> np.ndarray:
        """Move states of an arc, in its own direction, to arc number ``part`` of the period."""
        if self.last is None:
            return self.shift.power(part % self.order)(z)
        moved = self.last(z) if part % 2 else z
        return self.shift.power((part // 2) % self.order)(moved)


def closing_of(H: Hamiltonian, symmetry: Any) -> Closing:
    """Convert the argument ``symmetry`` of :func:`hamsym.periodic_orbit`.

    Raise InputError if it is not a symmetry of H, or does not close an orbit.
    """
    if symmetry is None:
        return Closing(SignedPermutation.identity(H.dim))
    if H.time is not None:
        raise InputError("symmetry= needs an H without explicit time; leave it out")
    if H.forces:
        raise InputError(
            "symmetry= needs an H without forces, which may not share it; leave it out"
        )
    if isinstance(symmetry, Mapping):
        maps = [_symmetry(H, symmetry)]
    elif isinstance(symmetry, (tuple, list)) and len(symmetry) == 2:
        maps = [_symmetry(H, part) for part in symmetry]
    else:
        raise InputError(
            "symmetry must be a mapping of components to components with signs, such as "
            '{"y": "-y", "p_x": "-p_x"}, or a pair of reversing symmetries'
        )
    if len(maps) == 1 and maps[0].time_direction == 1:
        return Closing(maps[0])
    for found in maps:
        if found.time_direction != -1:
            raise InputError("of a pair of symmetries both must reverse time; give one of them")
        if found.order != 2:
            raise InputError("a reversing symmetry must be its own inverse; give another one")
    first, last = maps[0], maps[-1]
    return Closing(last.after(first), first, last)


def _symmetry(H: Hamiltonian, given: Any) -> SignedPermutation:
    if not isinstance(given, Mapping):
        raise InputError(
            'a symmetry must be a mapping of components, such as {"y": "-y", "p_x": "-p_x"}, not '
            f"{type(given).__name__}"
        )
    places, signs = list(range(H.dim)), [1] * H.dim
    for name, value in given.items():
        text = str(value).replace(" ", "")
        sign, target = (-1, text[1:]) if text.startswith("-") else (1, text.removeprefix("+"))
        for part in (str(name), target):
            if part not in H.names:
                raise InputError(
                    f"'{part}' in a symmetry is not a component of the state"
                    f"{did_you_mean(part, H.names)}; these are "
                    f"{', '.join(H.names)}, with or without a minus sign"
                )
        i = H.names.index(str(name))
        places[i], signs[i] = H.names.index(target), sign
    if sorted(places) != list(range(H.dim)):
        twice = H.names[max(places, key=places.count)]
        raise InputError(f"a symmetry must use each component once; it uses '{twice}' twice")
    found = SignedPermutation(tuple(places), tuple(signs))
    if found.time_direction == 0:
        raise InputError(
            "the symmetry is neither symplectic nor reversing: coordinates and momenta must be "
            "permuted alike, with the same signs, or with opposite signs throughout"
        )
    if not is_unchanged(H, found):
        raise InputError("H changes under the symmetry, or that it does not could not be shown")
    return found


def moved(H: Hamiltonian, symmetry: SignedPermutation) -> sympy.Expr:
    """Return the formula of H after a map of the states, in real symbols."""
    form = H.real_equations
    pairs = zip(form.z, symmetry.places, symmetry.signs, strict=True)
    return form.expr.xreplace({symbol: sign * form.z[i] for symbol, i, sign in pairs})


def is_unchanged(H: Hamiltonian, symmetry: SignedPermutation) -> bool:
    """Whether H is shown to be the same after a map of its states."""
    return derivatives.vanishes(moved(H, symmetry) - H.real_equations.expr)
