"""Single equilibria from approximate points: proof, classification, repetitions.

Input:  approximate zeros of the gradient, or proven ones.
Output: :class:`~hamsym.dynamics.equilibrium.Equilibrium`.

Types are those of all Hamiltonians whose numbers round to those of H: what changes within round-off
is called degenerate.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from flint import arb

from hamsym.dynamics.equilibrium import Equilibrium
from hamsym.dynamics.linear_stability import LinearStability, linear_stability, undecided
from hamsym.dynamics.newton_starts import Candidates, continues
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import equilibrium_sizes
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import above, exact, working
from hamsym.proof.arithmetic.directed import TINY
from hamsym.proof.public_check import require_same
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import BITS, Root, enclosed_root

NEAR = 1e-3  # of the sizes: distance of approximations of one point with a singular Hessian
_SAME = 1e-7  # of the sizes: the same, for other points
_SAME_ENERGY = 1e-9
_PLAUSIBLE = 1e-9  # of the terms of its row: |g| at a numerical point
_COARSE = 40  # bits whose roundings include those of float64, in any order of operations
_BLUR = 1e-9  # of the sizes: uncertainty of a numerical point


class Finder:
    """Proof and classification of single points.

    - H: With a value for every parameter.
    - sizes: Sizes of the components, shape (dim,); by default they follow from each point.
    """

    def __init__(self, H: Hamiltonian, sizes: np.ndarray | None = None) -> None:
        self._sized = sizes is not None
        self.H, self.sizes = H, np.ones(H.dim) if sizes is None else sizes
        self.candidates = Candidates(H, self.sizes)
        self._balls: list[DerivativeBalls] | None = None
        # Where a function has no enclosure, nothing can be proven.
        with contextlib.suppress(CertificationError):
            self._balls = [DerivativeBalls(H), DerivativeBalls(H, rounded=True)]

    def point(self, z: np.ndarray, **known: Any) -> Equilibrium | None:
        """The equilibrium at an approximate zero, proven if possible; None if it is none."""
        if self._balls is not None:
            root = enclosed_root(self._balls[0], z.tolist(), self._around(z).tolist())
            if root is not None:
                return self.proven(root, **known)
            if "exact" not in known and not self._is_plausible(z):
                return None
        how = "symbolic" if "exact" in known else "numerical"
        if how == "numerical" and continues(self.candidates, z):
            known.setdefault("family", "one of its points is shown")
        linear = self._stability_at(z, exactly=how == "symbolic")
        return Equilibrium(self.H.names, z, self.energy(z), how, linear=linear, H=self.H, **known)

    def proven(self, root: Root, **known: Any) -> Equilibrium:
        """The equilibrium in an enclosure; without it if float64 does not tell it from others."""
        assert self._balls is not None
        with working(BITS):
            middle = [0.0 if entry.contains(0) else float(exact(entry)) for entry in root.enclosure]
            radius = [above(abs(e - arb(m))) for e, m in zip(root.enclosure, middle, strict=True)]
            energy = self._balls[0].energy(root.enclosure)
            stated = [arb(m, r) for m, r in zip(middle, radius, strict=True)]
            alone = all(u.contains(b) for u, b in zip(root.unique, stated, strict=True))
        z = np.array(middle) + 0.0
        self._require_same_function(z)
        return Equilibrium(
            self.H.names,
            z,
            float(energy.mid()),
            "symbolic" if "exact" in known else "proven" if alone else "numerical",
            Ball(z, np.array(radius)) if alone else None,
            linear=self._stability_of(z),
            H=self.H,
            **known,
        )

    def _require_same_function(self, z: np.ndarray) -> None:
        """Require that H evaluates the energy and gradient that were proven."""
        assert self._balls is not None
        with working(_COARSE):
            balls, state = self._balls[0], [arb(value) for value in z.tolist()]
            found = [balls.energy(state), *balls.gradient(state)]
            middle = [float(entry.mid()) for entry in found]
            radius = [above(entry.rad()) + TINY for entry in found]
        slopes = self.H.compile("numpy").at("gradient", z)
        require_same(
            "Hamiltonian",
            ("H", *(f"dH/d{name}" for name in self.H.names)),
            np.array([[self.energy(z), *slopes]]),
            np.array([[middle]]),
            np.array([[radius]]),
            lambda _: f"z = {z.tolist()}",
        )

    def _around(self, z: np.ndarray) -> np.ndarray:
        if self._sized:
            return np.maximum(self.sizes, np.abs(z))
        return equilibrium_sizes(self.candidates.derivatives(z)[1], z)

    def energy(self, z: np.ndarray) -> float:
        """H at a point."""
        return float(self.H.compile("numpy").at("energy", z))

    def _stability_of(self, z: np.ndarray) -> LinearStability:
        """Stability at a proven equilibrium, for all H that round to this one."""
        assert self._balls is not None
        root = enclosed_root(self._balls[1], z.tolist(), self._around(z).tolist())
        if root is None:
            return self._stability_at(z)
        with working(BITS):
            return linear_stability(self._balls[1].hessian(root.enclosure))

    def _stability_at(self, z: np.ndarray, exactly: bool = False) -> LinearStability:
        """Stability at a point that is known up to round-off, or less well."""
        radii = np.where(z != 0, np.spacing(np.abs(z)), 0.0) if exactly else _BLUR * self._around(z)
        with working(BITS):
            if self._balls is not None:
                around = [arb(x, r) for x, r in zip(z.tolist(), radii.tolist(), strict=True)]
                rows = self._balls[1].hessian(around)
                if all(entry.is_finite() for row in rows for entry in row):
                    return linear_stability(rows)
            matrix = self.candidates.derivatives(z)[1]
            diagonal = np.sqrt(np.abs(np.diag(matrix)))
            spread = _BLUR * (np.abs(matrix) + np.outer(diagonal, diagonal))
            present = self.H.real_equations.hessian
            found = linear_stability(
                [
                    [
                        arb(matrix[i, j], spread[i, j]) if (i, j) in present else arb(0)
                        for j in range(self.H.dim)
                    ]
                    for i in range(self.H.dim)
                ]
            )
        # Balls exist, but H is not smooth within the uncertainty: nothing holds there.
        return found if self._balls is None else undecided(found)

    def _is_plausible(self, z: np.ndarray) -> bool:
        """Whether the gradient is small in balls, which do not underflow."""
        assert self._balls is not None
        with working(BITS):
            at = [arb(value) for value in z.tolist()]
            slopes, rows = self._balls[0].gradient(at), self._balls[0].hessian(at)
            around = [arb(value) for value in self._around(z).tolist()]
            return all(
                slope.is_finite()
                and bool(
                    abs(slope)
                    <= _PLAUSIBLE
                    * sum((abs(e) * s for e, s in zip(row, around, strict=True)), arb(0))
                )
                for slope, row in zip(slopes, rows, strict=True)
            )


def add_points(
    found: list[Equilibrium], finder: Finder, points: np.ndarray, turns: Mapping[int, float]
) -> int:
    """Add the points that are new; return the number of those that are equilibria."""
    count = 0
    for z in spread_out(points, finder.sizes):
        for i, turn in turns.items():
            z[i] -= turn * math.ceil((z[i] - turn / 2) / turn - 1e-9)
        if _is_on_known_continuum(z, found, finder):
            count += 1
            continue
        each = finder.point(z)
        if each is None:
            continue
        count += 1
        if not is_known(each, found, finder, turns):
            found.append(each)
    return count


def _is_on_known_continuum(z: np.ndarray, found: Sequence[Equilibrium], finder: Finder) -> bool:
    """Whether a point has the energy of a continuum that was found, and a singular Hessian.

    The energy is the same along a continuum; two continua of one energy count as one.
    """
    energies = [each.energy for each in found if each.family]
    if not energies or not finder.candidates.null_vectors(z).shape[1]:
        return False
    energy = finder.energy(z)
    return any(abs(energy - e) <= _SAME_ENERGY * (1 + abs(e)) for e in energies)


def spread_out(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Points without approximate repetitions, closer than the proofs distinguish with ease."""
    kept: list[np.ndarray] = []
    for z in points:
        around = 1e-11 * np.maximum(sizes, np.abs(z))
        if not any((np.abs(z - other) <= around).all() for other in kept):
            kept.append(z.copy())
    return kept


def is_known(
    each: Equilibrium, found: Sequence[Equilibrium], finder: Finder, turns: Mapping[int, float]
) -> bool:
    """Whether an equilibrium, or the continuum it is a part of, was found before."""
    around = np.maximum(finder.sizes, np.abs(each.z))
    for other in found:
        apart = np.abs(each.z - other.z)
        for i, turn in turns.items():
            apart[i] = abs(math.remainder(apart[i], turn))
        both = each.enclosure is not None and other.enclosure is not None
        if both:
            radii = each.enclosure.radius + other.enclosure.radius  # type: ignore[union-attr]
            if (apart <= radii + 4 * np.spacing(around) * bool(turns)).all():
                return True
            continue
        one = each.enclosure is not None or other.enclosure is not None
        if (apart <= (_SAME if one else NEAR) * around).all():
            return True
        alike = abs(each.energy - other.energy) <= _SAME_ENERGY * (1 + abs(each.energy))
        if each.family and other.family and alike and not (each.exact and other.exact):
            return True
    return False


def counted(found: Sequence[Equilibrium]) -> str:
    """The number of equilibria and of continua, in words."""
    families = sum(bool(each.family) for each in found)
    single = len(found) - families
    parts = []
    if single or not families:
        parts.append(f"{single:,} equilibri{'um' if single == 1 else 'a'}")
    if families == 1:
        parts.append("1 continuum of equilibria")
    elif families:
        parts.append(f"{families:,} continua of equilibria")
    return " and ".join(parts)


def ordered(found: Sequence[Equilibrium]) -> tuple[Equilibrium, ...]:
    """Equilibria in the order of their energies."""

    def place(each: Equilibrium) -> tuple[float, ...]:
        # Round-off must not decide about the order of equal energies.
        return tuple(float(f"{value:.9g}") for value in (each.energy, *each.z.tolist()))

    return tuple(sorted(found, key=place))
