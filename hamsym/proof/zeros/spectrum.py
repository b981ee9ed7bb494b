"""Proven kinds of eigenvalues of J Hess, from balls of the Hessian.

Eigenvalues of a Hamiltonian matrix come in pairs k, -k and complex conjugates. So an isolated
simple eigenvalue is imaginary if the mirror image -conj(k) of its ball meets no other ball, and
real if conj(k) meets no other one. Components that are not coupled are treated apart: two equal
frequencies of uncoupled oscillators are no resonance.

Two kinds of Hessian need no isolated eigenvalues. Where it is definite, they are imaginary and
semisimple. Where it has no mixed terms, Hess = diag(V, T), and T is definite, k^2 = -eig(T V):
T V is similar to a symmetric matrix, so that the numbers of positive and negative eigenvalues of V
decide (Sylvester); the same with T and V exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb_mat

from hamsym.numerics.scales import equilibrating
from hamsym.proof.arithmetic.balls import working
from hamsym.symbolic.derivatives import connected_blocks

_BITS = 128


@dataclass(frozen=True)
class BlockSpectrum:
    """Eigenvalues of J Hess for pairs (q, p) that are coupled with each other only."""

    #: Their places in z, those of q first.
    components: list[int]
    #: 1 or -1 if the Hessian is proven to be positive or negative definite, else 0.
    definite: int
    #: 1 if there are no mixed terms and those of p are proven to be definite, -1 if those of q are,
    #: else 0; and no eigenvalue is zero.
    natural: int
    #: Number of pairs of imaginary eigenvalues, if the Hessian is definite or natural.
    centres: int | None
    #: Rounded to nearest, with exact zeros for real and imaginary parts that are proven to vanish;
    #: None if they were not separated from each other.
    eigenvalues: np.ndarray | None
    #: Whether an eigenvalue is proven to have a positive real part.
    unstable: bool

    @property
    def decided(self) -> bool:
        """Whether each eigenvalue is proven to be imaginary, real, or one of four."""
        return self.definite != 0 or self.natural != 0 or self.eigenvalues is not None


def block_spectra(hessian: Sequence[Sequence[Any]]) -> list[BlockSpectrum]:
    """Classify the eigenvalues of J Hess.

    - hessian: Rows of a symmetric matrix; entries that are exactly zero do not couple.

    Examples
    --------
    >>> from flint import arb
    >>> rows = [[arb(a) for a in row] for row in ([-1, 0], [0, 4])]
    >>> [found] = block_spectra(rows)
    >>> found.natural, found.unstable
    (1, True)
    """
    dim, half = len(hessian), len(hessian) // 2
    pairs = [
        (i % half, j % half) for i in range(dim) for j in range(dim) if not hessian[i][j].is_zero()
    ]
    with working(_BITS):
        return [
            _spectrum(hessian, [*block, *(half + i for i in block)])
            for block in connected_blocks(pairs, half)
        ]


def _spectrum(hessian: Sequence[Sequence[Any]], components: list[int]) -> BlockSpectrum:
    rows = [[hessian[i][j] for j in components] for i in components]
    half, size = len(rows) // 2, len(rows)
    definite = {(size, 0): 1, (0, size): -1}.get(_inertia(rows), 0)
    if definite:
        return BlockSpectrum(components, definite, 0, half, None, False)
    unstable = False
    if all(entry.is_zero() for row in rows[:half] for entry in row[half:]):
        parts = [row[:half] for row in rows[:half]], [row[half:] for row in rows[half:]]
        counts = _inertia(parts[0]), _inertia(parts[1])
        for natural, own, other in ((1, 1, 0), (-1, 0, 1)):
            if counts[own] not in ((half, 0), (0, half)):
                continue
            sign = 1 if counts[own][0] else -1
            unstable = unstable or _has_sign(parts[other], -sign)
            if sum(counts[other]) == half:
                centres = counts[other][0 if sign > 0 else 1]
                unstable = unstable or centres < half
                return BlockSpectrum(components, 0, natural, centres, None, unstable)
    matrix = acb_mat([*rows[half:], *([-entry for entry in row] for row in rows[:half])])
    found = _two_pairs(matrix) if half == 2 else _isolated(matrix)
    if found is None:
        return BlockSpectrum(components, 0, 0, None, None, unstable)
    unstable = any(value.real > 0 for value in found)
    return BlockSpectrum(components, 0, 0, None, np.array(found), unstable)


def _two_pairs(matrix: acb_mat) -> list[complex] | None:
    """Eigenvalues of two degrees of freedom, from s^2 + a s + b = 0 for s = k^2.

    Closer to a collision than balls of the eigenvalues themselves.
    """
    a = -(matrix * matrix).trace().real / 2
    b = matrix.det().real
    discriminant = a * a - 4 * b
    if discriminant < 0:
        root = (acb(-a, (-discriminant).sqrt()) / 2).sqrt()
        re, im = float(root.real.mid()), float(root.imag.mid())
        if not (re and im):  # below the smallest float
            return None
        return [complex(x, y) for x in (re, -re) for y in (im, -im)]
    if not discriminant > 0 or b.contains(0) or (b > 0 and a.contains(0)):
        return None
    # The root of larger magnitude first, without cancellation; the other one is b divided by it.
    sign = -1 if a > 0 else 1
    first = (sign * discriminant.sqrt() - a) / 2
    values: list[complex] = []
    for s in (first, b / first):
        if not (s > 0 or s < 0):
            return None
        k = float(abs(s).sqrt().mid())
        if not k:  # below the smallest float
            return None
        values += [complex(k), complex(-k)] if s > 0 else [complex(0, k), complex(0, -k)]
    return values


def _isolated(matrix: acb_mat) -> list[complex] | None:
    """Eigenvalues, if all are isolated from each other and from mirror images of others."""
    try:
        found = matrix.eig()
    except (ValueError, ZeroDivisionError):  # some of them coincide
        return None
    if not all(value.is_finite() for value in found):
        return None
    values = []
    for k, value in enumerate(found):
        mirrored, conjugate = (
            [i for i, other in enumerate(found) if other.overlaps(image)]
            for image in (-value.conjugate(), value.conjugate())
        )
        if len(mirrored) != 1 or len(conjugate) != 1:
            return None
        re, im = float(value.real.mid()), float(value.imag.mid())
        imaginary, real = mirrored == [k], conjugate == [k]
        if not ((re or imaginary) and (im or real)):  # below the smallest float
            return None
        values.append(complex(0.0 if imaginary else re, 0.0 if real else im))
    return values


def _inertia(rows: list[list[Any]]) -> tuple[int, int]:
    """Numbers of eigenvalues proven positive and negative; (0, 0) if one may be zero.

    A congruence with approximate eigenvectors makes the matrix nearly diagonal. The signs of the
    pivots of Gaussian elimination are then those of the eigenvalues (Sylvester): no pivot is zero,
    so that the congruence is regular.
    """
    size = len(rows)
    middle = np.array([[float(entry.mid()) for entry in row] for row in rows])
    scale = equilibrating(middle)
    if not np.isfinite(middle).all() or not np.isfinite(scale).all():
        return 0, 0
    vectors = scale[:, None] * np.linalg.eigh(middle * scale[:, None] * scale)[1]
    V = arb_mat(size, size, vectors.ravel().tolist())
    product = V.transpose() * arb_mat(rows) * V
    rest = [[product[i, j] for j in range(size)] for i in range(size)]
    signs = []
    while rest:
        row = rest[0]
        pivot = row[0]
        if not (pivot > 0 or pivot < 0):
            return 0, 0
        signs.append(bool(pivot > 0))
        rest = [
            [rest[i][j] - row[i] * row[j] / pivot for j in range(1, len(row))]
            for i in range(1, len(row))
        ]
    return sum(signs), size - sum(signs)


def _has_sign(rows: list[list[Any]], sign: int) -> bool:
    """Whether a symmetric matrix is proven to have an eigenvalue of this sign."""
    middle = np.array([[float(entry.mid()) for entry in row] for row in rows])
    scale = equilibrating(middle)
    values, vectors = np.linalg.eigh(middle * scale[:, None] * scale)
    v = arb_mat(len(rows), 1, (scale * vectors[:, np.argmax(sign * values)]).tolist())
    return bool(sign * (v.transpose() * arb_mat(rows) * v)[0, 0] > 0)
