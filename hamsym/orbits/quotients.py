"""The derivative of a periodic orbit over one shift, without its trivial directions, in balls.

Each integral has a gradient, which is a left eigenvector of the derivative, and a direction J grad
I, which is a right one. The derivative therefore acts on the directions v across all gradients,
modulo those J grad I that are among them. Its matrix there has the multipliers that integrals do
not imply. It is the product of one matrix for each piece of the orbit, in bases that follow the
motion: in others a product of many balls becomes wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from flint import arb, arb_mat

from hamsym.numerics.symplectic import poisson_matrix
from hamsym.orbits.arc import Problem
from hamsym.orbits.integrals import are_permuted, independent_integrals, neutral
from hamsym.orbits.square_system import gradients
from hamsym.orbits.symmetry import Closing, SignedPermutation
from hamsym.proof.arithmetic.functions import BALLS
from hamsym.proof.arithmetic.generated import GeneratedFunctions

_PARALLEL = 1e6  # condition of a basis
_RANK = 1e-10  # singular values relative to the largest that count as zero

#: Slopes and fields: balls, shapes (r, dim) and (dim, d).
_Across = tuple[arb_mat, arb_mat]


@dataclass(frozen=True)
class ShiftDerivative:
    """The derivative over one shift, and back by it, of an orbit, in units."""

    closing: Closing
    #: Derivatives of the pieces of the arc, in units of the components.
    maps: Sequence[arb_mat]
    #: These.
    units: Sequence[arb]

    def whole(self) -> arb_mat:
        """The derivative of all directions, whose inverse is that of a symplectic matrix."""
        closing, dim = self.closing, self.maps[0].nrows()
        nothing = arb_mat(0, dim), arb_mat(dim, 0)
        places = [nothing] * (len(self.maps) + 1)
        end, through = self._through(places, _Quotient(*nothing, np.eye(dim)))
        through = end.within * through
        if closing.first is None or closing.last is None:
            return self._signed(closing.shift).inv() * through
        J, units = poisson_matrix(dim // 2).tolist(), self.units
        rows = list(zip(J, units, strict=True))
        covariant = [[v * a * b for v, a in zip(row, units, strict=True)] for row, b in rows]
        contravariant = [[v / a / b for v, a in zip(row, units, strict=True)] for row, b in rows]
        inverse = -arb_mat(contravariant) * through.transpose() * arb_mat(covariant)
        return self._signed(closing.first) * inverse * self._signed(closing.last) * through

    def across(self, places: Sequence[_Across]) -> arb_mat:
        """The derivative of the directions across slopes modulo fields, in a basis of its own.

        Raise ZeroDivisionError if these may be dependent.

        - places: Slopes and fields at the starts of the pieces and at the end of the last one.
        """
        start = _Quotient(*places[0])
        middle = _middles(self._closed(places, start))
        if not np.isfinite(middle).all():
            raise ZeroDivisionError
        # again, in a basis of eigenvectors
        values, vectors = np.linalg.eig(middle)
        basis = np.where(values.imag >= 0, vectors.real, vectors.imag)
        if len(basis) and not np.linalg.cond(basis) < _PARALLEL:
            basis = np.eye(len(basis))
        return self._closed(places, _Quotient(*places[0], start.across @ basis))

    def _closed(self, places: Sequence[_Across], start: _Quotient) -> arb_mat:
        """The derivative of the directions of a quotient."""
        end, through = self._through(places, start)
        closing = self.closing
        if closing.first is None or closing.last is None:
            return start.coordinates(self._signed(closing.shift).inv() * end.within) * through
        first = start.coordinates(self._signed(closing.first) * start.within)
        last = end.coordinates(self._signed(closing.last) * end.within)
        return first * through.solve(last * through)

    def _through(self, places: Sequence[_Across], start: _Quotient) -> tuple[_Quotient, arb_mat]:
        """The quotient at the end of the arc, and the derivative from that at its start."""
        here, through = start, start.coordinates(start.within)
        for k, matrix in enumerate(self.maps):
            there = here.followed(matrix, *places[k + 1])
            through = there.coordinates(matrix * here.within) * through
            here = there
        return here, through

    def _signed(self, symmetry: SignedPermutation) -> arb_mat:
        """The matrix of a symmetry, in units."""
        return scaled(symmetry.matrix.tolist(), self.units)


class Directions:
    """The gradients and directions of the integrals of an orbit.

    ZeroDivisionError is raised if it is not proven that its symmetries map these to themselves.

    - state, scale: The start, and sizes of the components.
    """

    def __init__(self, problem: Problem, state: np.ndarray, scale: np.ndarray) -> None:
        closing, integrals = problem.closing, independent_integrals(problem.H, state, scale)
        maps = [each for each in (closing.shift, closing.first, closing.last) if each is not None]
        if not all(are_permuted(integrals, each) for each in maps):
            raise ZeroDivisionError
        if problem.conservative and problem.H not in integrals:
            raise ZeroDivisionError
        self._integrals = [GeneratedFunctions(each, BALLS) for each in integrals]
        self._flows, self._free = self._integrals, neutral(integrals, problem.H)
        if not integrals and problem.autonomous:  # with forces
            self._flows, self._free = [GeneratedFunctions(problem.H, BALLS)], [True]

    def at(self, places: Sequence[list[arb]], units: list[arb]) -> list[_Across]:
        """Slopes and fields at balls of states, in units of the components."""
        inverses, found = [1 / unit for unit in units], []
        for state in places:
            slopes = gradients(self._integrals, state).tolist()
            flows = [list(each("vector_field", state, arb(0))) for each in self._flows]
            fields = _neutral_fields(slopes, flows, self._free)
            found.append((_in_units(slopes, units), _in_units(fields, inverses).transpose()))
        return found


class _Quotient:
    """The directions v with slopes v = 0 modulo the fields, which are among them, with a basis.

    ZeroDivisionError is raised if the slopes or the fields may be dependent.

    - slopes, fields: Balls, shapes (r, dim) and (dim, d).
    - across: Approximate directions, shape (dim, dim - r - d); by default orthonormal ones.
    """

    def __init__(self, slopes: arb_mat, fields: arb_mat, across: np.ndarray | None = None) -> None:
        dim, self._fields = slopes.ncols(), fields.ncols()
        middles = [_middles(slopes), _middles(fields).T]
        if not all(np.isfinite(part).all() for part in middles):
            raise ZeroDivisionError
        self._normal = scipy.linalg.null_space(np.concatenate(middles), rcond=_RANK)
        if self._normal.shape[1] != dim - slopes.nrows() - self._fields:
            raise ZeroDivisionError
        self.across = self._normal if across is None else self._normal @ (self._normal.T @ across)
        self.within = arb_mat(self.across.tolist())
        if slopes.nrows():
            inverse = arb_mat(np.linalg.pinv(middles[0]).tolist())
            self.within -= inverse * (slopes * inverse).solve(slopes * self.within)
        pairs = zip(fields.tolist(), self.within.tolist(), strict=True)
        basis = arb_mat([[*a, *b] for a, b in pairs])
        self._left = arb_mat(np.linalg.pinv(_middles(basis)).tolist())
        self._basis = self._left * basis

    def coordinates(self, vectors: arb_mat) -> arb_mat:
        """Coordinates of directions, modulo the fields."""
        found = self._basis.solve(self._left * vectors).tolist()
        return arb_mat(found[self._fields :])

    def followed(self, matrix: arb_mat, slopes: arb_mat, fields: arb_mat) -> _Quotient:
        """The quotient at the end of a map, with the images of this one's basis, of length one.

        So the map is nearly diagonal, and products of many do not lose digits; but where images
        become parallel the basis is orthonormal.
        """
        normal = _Quotient(slopes, fields)._normal
        moved = normal.T @ (_middles(matrix) @ self.across)
        moved /= np.linalg.norm(moved, axis=0)
        if moved.size and not np.linalg.cond(moved) < _PARALLEL:
            moved = np.linalg.qr(moved)[0]
        return _Quotient(slopes, fields, normal @ moved)


def _neutral_fields(
    slopes: list[list[Any]], fields: list[list[Any]], free: list[bool]
) -> list[list[Any]]:
    """A basis of the fields of integrals that keep the values of all of them.

    Raise ZeroDivisionError if their number is not proven.

    - slopes, fields: grad I and J grad I of independent integrals.
    - free: Whether all brackets of an integral vanish. Of two others the bracket must be proven not
      to vanish; of three one combination has a field.
    """
    found = [field for field, is_free in zip(fields, free, strict=True) if is_free]
    others = [k for k, is_free in enumerate(free) if not is_free]
    if not others:
        return found

    def bracket(i: int, k: int) -> Any:
        return sum((s * f for s, f in zip(slopes[i], fields[k], strict=True)), arb(0))

    if len(others) == 2:
        weights, brackets = [], [bracket(*others)]
    elif len(others) == 3:
        i, j, k = others
        weights = brackets = [bracket(j, k), bracket(k, i), bracket(i, j)]
    else:
        raise ZeroDivisionError
    if not any(entry != 0 for entry in brackets):
        raise ZeroDivisionError
    if weights:
        columns = zip(*(fields[k] for k in others), strict=True)
        found.append(
            [sum((w * f for w, f in zip(weights, c, strict=True)), arb(0)) for c in columns]
        )
    return found


def _in_units(rows: list[list[Any]], units: list[arb]) -> arb_mat:
    """Rows times units, each divided by about its size: that of H is an energy, that of another
    integral is not, and ranks compare them.
    """
    entries = []
    for row in rows:
        found = [entry * unit for entry, unit in zip(row, units, strict=True)]
        size = max(abs(float(entry.mid())) for entry in found)
        exponent = math.frexp(size)[1] if math.isfinite(size) else 0
        entries += [entry / arb(2) ** exponent for entry in found]
    return arb_mat(len(rows), len(units), entries)


def _middles(matrix: Any) -> np.ndarray:
    """Mid-points of a matrix of balls."""
    entries = [float(entry.mid()) for entry in matrix.entries()]
    return np.array(entries).reshape(matrix.nrows(), matrix.ncols())


def scaled(matrix: Sequence[Sequence[Any]], units: Sequence[arb]) -> arb_mat:
    """Return a matrix of derivatives of states by states in units of the components."""
    return arb_mat(
        [
            [value * own / unit for value, own in zip(row, units, strict=True)]
            for row, unit in zip(matrix, units, strict=True)
        ]
    )
