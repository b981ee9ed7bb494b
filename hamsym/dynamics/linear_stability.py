"""Linear stability of an equilibrium: eigenvalues of J Hess, normal modes, Krein signatures.

Input:  balls of the Hessian (:mod:`hamsym.proof.zeros.spectrum`).
Output: :class:`LinearStability`.

*Modes.* For an eigenvalue i w with w > 0 the complex vector v, with J Hess v = i w v, is scaled so
that |v* J v| = 1, where v* is the conjugate transpose. The motion along it is Re(c v exp(i w t)).

*Krein signature.* The sign of -i v* J v, which is that of v* Hess v = w (-i v* J v): +1 for a mode
with positive energy, -1 for one with negative energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from flint import acb_mat, arb

from hamsym.numerics.symplectic import generators, poisson_product
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.zeros.spectrum import BlockSpectrum, block_spectra

DEGENERATE = "degenerate"
_NOISE = 1e-14  # of the largest eigenvalue
_FEW = 3  # parts of a type that are spelled out
_ACCURATE = 1e-10  # of a frequency: residual of a mode in float64
_APART = 1e-6  # of the largest eigenvalue: distance of eigenvalues that float64 separates
_SOFT = 1e-5  # of the largest eigenvalue: the least one of which float64 has ten digits
_BITS = 512  # where float64 is not enough


@dataclass(frozen=True, eq=False)
class LinearStability:
    """Linear stability of an equilibrium.

    What is stated holds for every Hessian in the balls; where these include several types, the
    type is ``"degenerate"``.

    Attributes
    ----------
    type : str
        Parts joined by hyphens: ``"saddle"`` for each pair of real eigenvalues, ``"focus-focus"``
        for four complex ones, ``"centre"`` for each pair of imaginary ones, for example
        ``"saddle-centre"``; or ``"degenerate"``.
    eigenvalues : numpy.ndarray
        Of J Hess, shape (dim,), complex, in units of 1/time.
    frequencies : numpy.ndarray
        Angular frequencies of the centres, positive and ascending, shape (k,).
    signatures : numpy.ndarray
        Krein signatures of these modes, 1 or -1, shape (k,).
    modes : numpy.ndarray
        Their vectors, the columns, normalised to \\|v* J v\\| = 1, shape (dim, k), complex.
    stable : bool or None
        Linear stability: False if an eigenvalue has a positive real part, True if all are imaginary
        and semisimple, None if this is not decided.
    definite : int
        1 or -1 if the Hessian is positive or negative definite, else 0. Where it is definite, H is
        a Lyapunov function: the equilibrium is stable, not only linearly (Dirichlet).
    """

    type: str
    eigenvalues: np.ndarray
    frequencies: np.ndarray
    signatures: np.ndarray
    modes: np.ndarray
    stable: bool | None
    definite: int


def linear_stability(hessian: Sequence[Sequence[Any]]) -> LinearStability:
    """Compute eigenvalues and modes, and classify them as far as the balls allow.

    - hessian: Rows; entries that are exactly zero do not couple.

    Examples
    --------
    >>> from flint import arb
    >>> found = linear_stability([[arb(-1), arb(0)], [arb(0), arb(-4)]])
    >>> found.type, found.frequencies, found.signatures, found.definite
    ('centre', array([2.]), array([-1]), -1)
    """
    spectra = block_spectra(hessian)
    parts = [_modes_of(hessian, spectrum) for spectrum in spectra]
    modes = np.concatenate([part.modes for part in parts], axis=1)
    frequencies = np.concatenate([part.frequencies for part in parts])
    signatures = np.concatenate([part.signatures for part in parts])
    order = np.argsort(frequencies, kind="stable")
    eigenvalues = np.concatenate([part.eigenvalues for part in parts])
    decided = all(part.decided for part in parts)
    unstable = any(spectrum.unstable for spectrum in spectra)
    signs = {spectrum.definite for spectrum in spectra}
    return LinearStability(
        type=_type_of(eigenvalues, len(frequencies)) if decided else DEGENERATE,
        eigenvalues=eigenvalues[np.lexsort((eigenvalues.imag, np.abs(eigenvalues.imag),
                                            -eigenvalues.real))],
        frequencies=frequencies[order],
        signatures=signatures[order],
        modes=modes[:, order],
        stable=False if unstable else True if decided else None,
        definite=signs.pop() if len(signs) == 1 else 0,
    )  # fmt: skip


def _without_noise(values: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of round-off set to zero."""
    least = _NOISE * np.abs(values).max(initial=0.0)
    return (
        np.where(np.abs(values.real) <= least, 0.0, values.real)
        + np.where(np.abs(values.imag) <= least, 0.0, values.imag) * 1j
    )


def _type_of(eigenvalues: np.ndarray, centres: int) -> str:
    saddles = int(((eigenvalues.real > 0) & (eigenvalues.imag == 0)).sum())
    foci = int(((eigenvalues.real > 0) & (eigenvalues.imag > 0)).sum())
    counts = {"saddle": saddles, "focus-focus": foci, "centre": centres}
    if sum(counts.values()) <= _FEW:
        return "-".join("-".join([name] * count) for name, count in counts.items() if count)
    return ", ".join(f"{count} x {name}" for name, count in counts.items() if count)


def undecided(found: LinearStability) -> LinearStability:
    """The eigenvalues alone, as approximations from which nothing is concluded."""
    return replace(
        found,
        type=DEGENERATE,
        frequencies=found.frequencies[:0],
        signatures=found.signatures[:0],
        modes=found.modes[:, :0],
        stable=None,
        definite=0,
    )


class _Part(NamedTuple):
    """Eigenvalues of a block of components, and its centres."""

    eigenvalues: np.ndarray
    frequencies: np.ndarray
    signatures: np.ndarray
    modes: np.ndarray
    decided: bool = True


def _modes_of(hessian: Sequence[Sequence[Any]], spectrum: BlockSpectrum) -> _Part:
    """Eigenvalues of a block; frequencies, signatures and modes of its centres.

    In float64, and where its round-off may matter, as for a stiff and a soft spring, in more
    digits.
    """
    places = spectrum.components
    rows = [[hessian[i][j].mid() for j in places] for i in places]
    part = np.array([[float(entry) for entry in row] for row in rows])
    found = None
    if spectrum.decided:
        found = _float_modes(part, spectrum) or _precise_modes(rows, spectrum)
    if found is None:  # no part of it is certain
        eigenvalues = _without_noise(np.linalg.eigvals(generators(part)).astype(complex))
        none = np.empty((len(places), 0), complex)
        found = _Part(eigenvalues, np.empty(0), np.empty(0, int), none, decided=False)
    whole = np.zeros((len(hessian), len(found.frequencies)), complex)
    whole[places] = found.modes
    return found._replace(modes=whole)


def _float_modes(part: np.ndarray, spectrum: BlockSpectrum) -> _Part | None:
    """Eigenvalues and modes; None if round-off may matter."""
    try:
        if spectrum.definite:
            frequencies, vectors = _definite_modes(part, spectrum.definite)
            eigenvalues = np.concatenate((1j * frequencies, -1j * frequencies))
        elif spectrum.natural:
            eigenvalues, frequencies, vectors = _natural_modes(part, spectrum.natural)
        else:
            assert spectrum.eigenvalues is not None
            eigenvalues = spectrum.eigenvalues
            gaps = np.abs(eigenvalues[:, None] - eigenvalues)[~np.eye(len(part), dtype=bool)]
            if not gaps.min() > _APART * np.abs(eigenvalues).max():
                return None
            frequencies, vectors = _simple_modes(part, eigenvalues)
    except np.linalg.LinAlgError:
        return None
    if spectrum.centres not in (None, len(frequencies)):
        return None
    with np.errstate(all="ignore"):
        slopes = part @ vectors
        residuals = np.abs(poisson_product(slopes) - 1j * frequencies * vectors).max(axis=0)
        energies = (vectors.conj() * slopes).sum(axis=0).real
        small = residuals <= _ACCURATE * frequencies * np.abs(vectors).max(axis=0)
        alike = np.abs(np.abs(energies) - frequencies) <= _ACCURATE * frequencies
        sizes = np.abs(eigenvalues)
        stiff = not sizes.min() > _SOFT * sizes.max()
    if stiff or not (small & alike).all():
        return None
    return _Part(eigenvalues, frequencies, np.sign(energies).astype(int), vectors)


def _precise_modes(rows: list[list[Any]], spectrum: BlockSpectrum) -> _Part | None:
    """The same in many digits; None if it contradicts what is proven."""
    half, size = len(rows) // 2, len(rows)
    with working(_BITS):
        matrix = acb_mat([*rows[half:], *([-entry for entry in row] for row in rows[:half])])
        values, right = matrix.eig(right=True, algorithm="approx")
        if not all(value.is_finite() for value in [*values, *right.entries()]):
            return None
        if spectrum.eigenvalues is None:
            centres = [k for k, v in enumerate(values) if v.imag > abs(v.real)]
            eigenvalues = np.array(
                [
                    complex(0.0, float(v.imag)) if abs(v.imag) > abs(v.real)
                    else complex(float(v.real))
                    for v in values
                ]
            )  # fmt: skip
            if len(centres) != spectrum.centres:
                return None
        else:
            eigenvalues = spectrum.eigenvalues
            count = int(((eigenvalues.real == 0) & (eigenvalues.imag > 0)).sum())
            upper = [k for k, value in enumerate(values) if value.imag > 0]
            upper.sort(key=lambda k: float(abs(values[k].real / values[k].imag)))
            centres = upper[:count]
        centres.sort(key=lambda k: float(values[k].imag))
        frequencies = np.array([float(values[k].imag) for k in centres])
        signatures, modes = [], np.empty((size, len(centres)), complex)
        for column, k in enumerate(centres):
            vector = [right[i, k] for i in range(size)]
            pairs = zip(vector[half:], vector[:half], strict=True)
            area = 2 * sum(((p * q.conjugate()).imag for p, q in pairs), arb(0))
            if not abs(area) > 0:
                return None
            signatures.append(1 if area > 0 else -1)
            largest = max(vector, key=lambda entry: float(abs(entry)))
            factor = abs(largest) / largest / abs(area).sqrt()
            modes[:, column] = [complex(entry * factor) for entry in vector]
    return _Part(eigenvalues, frequencies, np.array(signatures, int), modes)


def _definite_modes(hessian: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Modes of sign * L L^T by Williamson's theorem: from the Hermitian matrix -i L^T J L."""
    half = len(hessian) // 2
    L = np.linalg.cholesky(sign * hessian)
    found, vectors = np.linalg.eigh(-1j * (L.T @ poisson_product(L)))
    modes = np.linalg.solve(L.T, vectors[:, half:])
    return found[half:], _normalised(modes if sign > 0 else modes.conj())


def _natural_modes(hessian: np.ndarray, definite: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues, frequencies and modes of diag(V, T) with T = +-L L^T, or V instead of T.

    With q = L w exp(k t), L^T V L w = -+k^2 w and p = k T^-1 q. If V is definite, the canonical
    change to (p, -q) exchanges the two.
    """
    half = len(hessian) // 2
    V, T = hessian[:half, :half], hessian[half:, half:]
    if definite < 0:
        V, T = T, V
    sign = 1 if T[0, 0] > 0 else -1
    L = np.linalg.cholesky(sign * T)
    squares, w = np.linalg.eigh(sign * (L.T @ V @ L))
    roots = np.sqrt(np.abs(squares))
    eigenvalues = np.where(squares > 0, 1j * roots, roots)
    centres = squares > 0
    frequencies = roots[centres]
    q = (L @ w[:, centres]).astype(complex)
    p = 1j * frequencies * np.linalg.solve(T, q)
    modes = np.concatenate((q, p) if definite > 0 else (-p, q))
    return np.concatenate((eigenvalues, -eigenvalues)), frequencies, _normalised(modes)


def _simple_modes(hessian: np.ndarray, eigenvalues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Modes of isolated imaginary eigenvalues."""
    frequencies = np.sort(eigenvalues.imag[(eigenvalues.real == 0) & (eigenvalues.imag > 0)])
    values, vectors = np.linalg.eig(generators(hessian))
    nearest = [int(np.argmin(np.abs(values - 1j * w))) for w in frequencies]
    return frequencies, _normalised(vectors[:, nearest].astype(complex))


def _normalised(modes: np.ndarray) -> np.ndarray:
    """Scale columns to |v* J v| = 1, with a real positive largest component."""
    areas = np.abs((modes.conj() * poisson_product(modes)).sum(axis=0))
    if not modes.shape[1]:
        return modes
    largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=0, keepdims=True), axis=0)
    phases = np.abs(largest) / largest
    return modes * phases / np.sqrt(areas)
