"""All equilibria in a box, from the zeros of the gradient in each block of coupled components.

Input:  a Hamiltonian with a value for every parameter, a box.
Output: :class:`~hamsym.dynamics.equilibrium.Equilibria`, complete if nothing is undecided.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import sympy
from flint import arb

from hamsym.dynamics.equilibrium import Equilibria, Equilibrium, Region
from hamsym.dynamics.equilibrium_points import NEAR, Finder, counted, is_known, ordered, spread_out
from hamsym.dynamics.newton_starts import continues, converged_points
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.limits import Deadline
from hamsym.proof.zeros.box_search import SINGULAR, Undecided, search_box, singular_term
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import BITS, Root, polynomial_roots
from hamsym.symbolic.stationary_points import blocks, exact_gradient

_PROBES = 6  # 2**6 starts in the box
_FINEST = 2.0**-32  # width of the smallest boxes, as a share of the box
_COARSE = 2.0**-7  # the same, where a continuum is known
_APART = 1e-6  # of the box: undecided boxes closer than that are one region
_MOST = 10_000  # equilibria
_MOST_MERGED = 2_000  # undecided boxes whose neighbours are looked for


def all_in_box(
    H: Hamiltonian, low: np.ndarray, high: np.ndarray, most: int, deadline: Deadline
) -> Equilibria:
    """Find all equilibria between the corners low and high, in at most so many boxes."""
    form = H.real_equations
    finder = Finder(H, high - low)
    balls = DerivativeBalls(H)  # raises where nothing can be proven
    from scipy.stats import qmc  # slow to import

    probes = qmc.scale(qmc.Sobol(H.dim, rng=0).random_base2(_PROBES), low, high)
    points = converged_points(finder.candidates, probes)
    inside = points[((points >= low) & (points <= high)).all(axis=1)]
    singular = [z for z in inside if finder.candidates.null_vectors(z).shape[1]]
    gradient = exact_gradient(form)
    cyclic = [i for i, entry in enumerate(gradient) if _is_zero(entry, form.z)]
    is_curved = any(continues(finder.candidates, z) for z in singular[:8]) and not cyclic
    finest = _COARSE if is_curved else _FINEST
    parts: list[tuple[list[int], list[Root]]] = []
    undecided: list[Undecided] = []
    used = 0
    for block in blocks(form):
        if len(block) == 1 and block[0] in cyclic:
            continue
        a, b = low[block].tolist(), high[block].tolist()
        slope, symbol = gradient[block[0]], form.z[block[0]]
        if len(block) == 1 and _is_rational_polynomial(slope, symbol):
            roots, left = polynomial_roots(slope, symbol, a[0], b[0]), []
        else:
            rest = max(most - used, 0)
            search = search_box(balls, block, a, b, most=rest, deadline=deadline, finest=finest)
            used += search.boxes
            roots, left = search.roots, search.undecided
        if not roots and not left:  # then there are none at all
            return Equilibria(H, (), True, _box_message([], [], used), (), used)
        parts.append((block, roots))
        undecided += [_whole(part, block, low, high) for part in left]
    found, outside = _combined(finder, balls, parts, cyclic, low, high)
    undecided += outside
    regions = _merged(H, undecided, _APART * (high - low))
    if regions:
        centres = np.array([(np.array(r.low) + np.array(r.high)) / 2 for r in regions])
        more = converged_points(finder.candidates, centres[:64])
        _add_undecided(found, finder, np.concatenate((inside, more)), regions)
    message = _box_message(found, regions, used)
    return Equilibria(H, ordered(found), not regions, message, tuple(regions), used)


def _is_zero(slope: sympy.Expr, z: Sequence[sympy.Symbol]) -> bool:
    """Whether a component of the gradient vanishes identically, if it is a polynomial."""
    return slope == 0 or bool(slope.is_polynomial(*z) and sympy.Poly(slope, *z).is_zero)


def _is_rational_polynomial(slope: sympy.Expr, symbol: sympy.Symbol) -> bool:
    """Whether an expression is a polynomial in one symbol with rational coefficients."""
    if not slope.is_polynomial(symbol) or not slope.free_symbols <= {symbol}:
        return False
    domain = sympy.Poly(slope, symbol).domain
    return bool(domain.is_QQ or domain.is_ZZ)


def _whole(part: Undecided, block: list[int], low: np.ndarray, high: np.ndarray) -> Undecided:
    """An undecided box of some components, with the whole intervals of the others."""
    first, last = low.copy(), high.copy()
    first[block], last[block] = part.low, part.high
    return Undecided(tuple(first.tolist()), tuple(last.tolist()), part.reason)


def _combined(
    finder: Finder,
    balls: DerivativeBalls,
    parts: list[tuple[list[int], list[Root]]],
    cyclic: list[int],
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[list[Equilibrium], list[Undecided]]:
    """Equilibria from the zeros in each block, and those at which H itself is not smooth."""
    count = math.prod(len(roots) for _, roots in parts)
    if count > _MOST:
        raise InputError(f"the box contains {count:,} equilibria; give a smaller one")
    found, undecided = [], []
    family = f"any {', '.join(finder.H.names[i] for i in cyclic)}" if cyclic else ""
    for roots in itertools.product(*(roots for _, roots in parts)):
        state: list[Any] = [arb(0)] * len(low)
        unique: list[Any] = [arb(0)] * len(low)
        for i in cyclic:
            state[i] = arb(0.0 if low[i] <= 0 <= high[i] else float((low[i] + high[i]) / 2))
        for (block, _), root in zip(parts, roots, strict=True):
            for i, entry, around in zip(block, root.enclosure, root.unique, strict=True):
                state[i], unique[i] = entry, around
        with working(BITS):
            smooth = balls.energy(state).is_finite()
            edge = any(
                not bool(entry > a and entry < b)
                for i, (entry, a, b) in enumerate(zip(state, low, high, strict=True))
                if i not in cyclic
            )
        if not smooth:
            ends = [float(entry.mid()) for entry in state]
            undecided.append(Undecided(tuple(ends), tuple(ends), SINGULAR))
            continue
        each = finder.proven(Root(state, unique), family=family, on_edge=edge)
        found.append(dataclasses.replace(each, enclosure=None) if cyclic else each)
    return found, undecided


def _add_undecided(
    found: list[Equilibrium], finder: Finder, points: np.ndarray, regions: Sequence[Region]
) -> None:
    """Add points of undecided regions at which the gradient vanishes to round-off."""
    for z in spread_out(points, finder.sizes):
        slack = NEAR * finder.sizes
        if not any(
            (z >= np.array(region.low) - slack).all() and (z <= np.array(region.high) + slack).all()
            for region in regions
        ):
            continue
        each = finder.point(z)
        if each is not None and each.enclosure is None and not is_known(each, found, finder, {}):
            found.append(each)


def _merged(H: Hamiltonian, parts: Sequence[Undecided], gap: np.ndarray) -> list[Region]:
    """Regions of undecided boxes with no more than a gap between them."""
    if not parts:
        return []
    low, high = np.array([part.low for part in parts]), np.array([part.high for part in parts])
    labels = np.arange(len(parts))
    if len(parts) > _MOST_MERGED:
        labels[:] = 0
    else:
        for k in range(len(parts)):
            touching = ((low <= high[k] + gap) & (high >= low[k] - gap)).all(axis=1)
            labels[np.isin(labels, labels[touching])] = labels[k]
    regions = []
    for label in np.unique(labels):
        own = np.flatnonzero(labels == label)
        a, b = low[own].min(axis=0), high[own].max(axis=0)
        boxes = [parts[k] for k in own.tolist()]
        reason = boxes[0].reason
        for box in boxes:
            if box.reason == SINGULAR:
                term = singular_term(H, box.low, box.high)
                reason = f"{term} is not smooth there" if term else SINGULAR
                break
        regions.append(Region(H.names, tuple(a.tolist()), tuple(b.tolist()), len(own), reason))
    return sorted(regions, key=lambda region: region.low)


def _box_message(found: Sequence[Equilibrium], regions: Sequence[Region], boxes: int) -> str:
    if not regions:
        which = {0: "no equilibria", 1: f"the only {counted(found).removeprefix('1 ')}"}
        where = "in the box" + " or on its edge" * any(each.on_edge for each in found)
        return f"{which.get(len(found), f'all {counted(found)}')} {where}, proven"
    left = sum(region.boxes for region in regions)
    count = counted(found) if found else "no equilibria"
    text = f"{count} found; not proven to be all of them in the box: "
    if left == 1:
        text += f"1 of {boxes:,} boxes is undecided"
    else:
        text += f"{left:,} of {boxes:,} boxes, in {len(regions):,} region"
        text += "s, are undecided" if len(regions) > 1 else ", are undecided"
    if any(each.family for each in found):
        text += "; a continuum of equilibria cannot be isolated"
    return text
