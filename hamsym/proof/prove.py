"""Certificates: proven bounds on what a neural trajectory is off by.

Stage 1  H, J grad H and Hess become functions of balls (:mod:`hamsym.proof.enclosures`).
Stage 2  The equation is solved once more, with proof, to far more digits than the solution has
         (:mod:`hamsym.proof.taylor`).
Stage 3  The solution, as the real function that its weights define
         (:mod:`hamsym.proof.trials`), is compared with that
         (:mod:`hamsym.proof.error_bounds`).
Stage 4  Upper bounds are rounded up and lower bounds down to the decimals of a
         :class:`Certificate`.

The proof is in the docstrings of the modules of stages 2 and 3, with every inequality.

Checking a certificate (:func:`verify`) is doing all of this again from the solution itself, until
what the certificate claims is proven or refuted. Nothing in the certificate is taken as given, and
neither its precision nor its size decides how long that takes.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from hamsym.archive import load
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.proof.balls import SMALLEST, at_least, at_most
from hamsym.proof.certificate import (
    FEWEST_BITS,
    FLOOR,
    LEAST_RTOL,
    MOST_BITS,
    MOST_RTOL,
    Certificate,
    rounded_down,
    rounded_up,
)
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.error_bounds import (
    Comparison,
    Goal,
    Leaf,
    Quantity,
    Range,
    joints_of,
)
from hamsym.proof.presolve import Scout, scout
from hamsym.proof.taylor import Deadline, PrecisionError, Reference, validated_reference
from hamsym.proof.trials import require_exact, segments
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require, require_number, require_positive, require_whole

__all__ = ["certify", "verify"]

_ACCURACY = 2.0**-62  # of the reference, in units of the components: finer than float64
_FLOOR_WITHOUT_REFERENCE = 2.0**-70  # the same of what the reference does not take part in
_PROGRESS = Fraction(1, 1_000)  # of the span, that half as many bits again have to bring
_SPARE_BITS = 4
_TRIES = 2  # precisions, at least, at which a claim is tried that cannot be decided
# Seconds that verify() takes unless told otherwise: for itself, for each of certify's, and at most.
_PATIENCE, _PATIENCE_FACTOR, _MOST_PATIENCE = 60.0, 10.0, 600.0
_TICKS = 1_000  # of progress

_Found = TypeVar("_Found")


# -- proving ------------------------------------------------------------------------------------


def certify(
    solution: Solution,
    rtol: float = 0.02,
    time_limit: float | None = None,
    bits: int | None = None,
    progress: bool | None = None,
) -> Certificate:
    """Prove how large the error of a solution is; see :meth:`hamsym.Solution.certify`."""
    require_number("rtol", rtol, LEAST_RTOL)
    require(rtol <= MOST_RTOL, "rtol", rtol, "a number such as 0.02")
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    if bits is not None:
        require_whole("bits", bits, FEWEST_BITS, MOST_BITS)
    began = time.monotonic()
    proof = _Proof(solution, Deadline.after(time_limit), progress)
    try:
        known_by = digest(solution)
    except FileError as error:
        raise CertificationError(f"a certificate could not name the solution: {error}") from None
    goal = Goal(rtol)

    def attempt(comparison: Comparison) -> tuple[list[Range], dict[str, tuple[float, ...]]]:
        found: list[Range] = []
        profile: dict[str, tuple[float, ...]] = {}
        leaves: list[Leaf] | None = None
        for quantity in comparison.quantities(proof.floors):
            found.append(comparison.refine(quantity, comparison.leaves(quantity, leaves), goal))
            leaves = found[-1].leaves
            profile = profile or proof.profile(comparison, quantity, leaves)
        return found, profile

    used, (found, profile) = proof.run(attempt, bits, _accuracy(rtol))
    uppers = [rounded_up(entry.upper) for entry in found]
    lowers = [rounded_down(entry.lower) for entry in found]
    return Certificate(
        bound=uppers[0],
        lower=lowers[0],
        component_bounds=tuple(uppers[1:-2]),
        component_lowers=tuple(lowers[1:-2]),
        energy_bound=uppers[-2],
        energy_lower=lowers[-2],
        ell_max_bound=uppers[-1],
        ell_max_lower=lowers[-1],
        **profile,
        rtol=float(rtol),
        bits=used,
        digest=known_by,
        seconds=time.monotonic() - began,
    )


def _accuracy(rtol: float) -> float:
    """How accurate the reference has to be, in units of the components."""
    return _ACCURACY * min(1.0, 50 * rtol)


def verify(
    certificate: Certificate | str,
    solution: Solution | str | os.PathLike[str],
    time_limit: float | None = None,
    progress: bool | None = None,
) -> None:
    """Run the proof again, from the solution, and compare it with what a certificate claims.

    The precision is chosen as :meth:`hamsym.Solution.certify` chooses it, whatever the certificate
    says. Where a claim is neither implied nor refuted, half as many bits again are tried, until
    they are no fewer than the certificate's.

    Parameters
    ----------
    certificate : Certificate or str
        Or its text (:meth:`Certificate.to_json`).
    solution : Solution or path
        Or a file that :meth:`hamsym.Solution.save` wrote.
    time_limit : float, optional
        Seconds. By default a minute and ten times the seconds that certify took, but no more than
        600, because a forged certificate may claim any: give a limit for longer proofs.
    progress : bool, optional

    Raises
    ------
    CertificationError
        Naming the first claim that is not implied by what could be proven, or if the time limit
        is reached.
    FileError
        If the text is no certificate, or the file cannot be read.
    InputError
        If an argument is something else.
    """
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    if isinstance(certificate, str):
        certificate = Certificate.from_json(certificate)
    if not isinstance(certificate, Certificate):
        raise InputError(
            "certificate is neither a Certificate nor its text; give what certify made"
        )
    if isinstance(solution, (str, os.PathLike)):
        solution = load(Path(solution))
    if not isinstance(solution, Solution):
        raise InputError("solution is neither a Solution nor a path; give what certify was given")
    claims = certificate
    try:
        claims._check()
    except ValueError as error:
        raise CertificationError(f"this is no certificate: {error}") from None
    _require_exact(solution)
    if digest(solution) != claims.digest:
        raise CertificationError("the certificate is of another solution: the digests differ")
    if (claims.edges[0], claims.edges[-1]) != tuple(float(edge) for edge in solution.span):
        raise CertificationError("the certificate is of another span than the solution's")
    if len(claims.component_bounds) != solution.H.dim:
        raise CertificationError("the certificate is of a solution of another dimension")
    proof = _Proof(solution, _deadline(time_limit, claims.seconds), progress)
    pairs = [
        (claims.bound, claims.lower),
        *zip(claims.component_bounds, claims.component_lowers, strict=True),
        (claims.energy_bound, claims.energy_lower),
        (claims.ell_max_bound, claims.ell_max_lower),
    ]

    tries = 0

    def attempt(comparison: Comparison) -> None:
        nonlocal tries
        tries += 1
        last = tries >= _TRIES and comparison.reference.bits >= claims.bits
        leaves: list[Leaf] | None = None
        norm: Quantity | None = None
        for quantity, pair in zip(comparison.quantities(proof.floors), pairs, strict=True):
            norm = norm or quantity
            leaves = comparison.leaves(quantity, leaves)
            leaves = _implied(comparison, quantity, leaves, pair, last).leaves
        assert norm is not None
        assert leaves is not None
        for part, claimed in zip(
            proof.cuts(comparison, norm, comparison.leaves(norm, leaves), claims.edges),
            claims.piece_bounds,
            strict=True,
        ):
            _implied(comparison, norm, part, (claimed, 0.0), last)

    proof.run(attempt, None, _accuracy(claims.rtol))


def _deadline(time_limit: float | None, seconds: float) -> Deadline:
    if time_limit is not None:
        return Deadline.after(time_limit)
    limit = min(_PATIENCE + _PATIENCE_FACTOR * seconds, _MOST_PATIENCE)
    return Deadline.after(
        limit,
        f", by default {_PATIENCE:g} s and {_PATIENCE_FACTOR:g} times what certify took, "
        f"at most {_MOST_PATIENCE:g} s,",
    )


def _implied(
    comparison: Comparison,
    quantity: Quantity,
    leaves: list[Leaf],
    pair: tuple[float, float],
    last: bool,
) -> Range:
    """Bounds at least as good as those claimed.

    Raises
    ------
    PrecisionError
        If more bits may help, and this is not the last try.
    CertificationError
        If the claim is refuted, or not implied.
    """
    upper, lower = at_most(pair[0]), at_least(pair[1])
    try:
        found = comparison.refine(quantity, leaves, Goal(0.0, (upper, lower)))
        if not (found.upper <= upper and found.lower >= lower):  # as where H is singular along z^
            raise CertificationError("refuted")
        return found
    except (CertificationError, PrecisionError) as error:
        if isinstance(error, CertificationError) and str(error) != "refuted":
            raise
        if isinstance(error, PrecisionError) and not last:
            raise
        raise CertificationError(
            f"the certificate does not hold: what it says of the {quantity.name} is not implied by "
            "the proof"
        ) from None


def _within(
    ordered: list[Leaf], intervals: Iterable[tuple[Fraction, Fraction]]
) -> Iterator[list[Leaf]]:
    """For intervals that follow each other, the leaves that have more than an end in them."""
    first = 0
    for low, high in intervals:
        while first < len(ordered) and ordered[first].end <= low:
            first += 1
        last = first
        while last < len(ordered) and ordered[last].start < high:
            last += 1
        yield ordered[first:last]


def _require_exact(solution: Solution) -> None:
    """Refuse a solution whose numbers are not those that a proof can be about.

    Raises
    ------
    CertificationError
        Saying which, and what to do.
    """
    remedy = "nothing can be proven; solve again"
    z0, dim = solution.z0, solution.H.dim
    if not isinstance(z0, np.ndarray) or z0.dtype != np.float64 or z0.shape != (dim,):
        raise CertificationError(f"z0 of the solution is not {dim} numbers of float64; {remedy}")
    if not np.isfinite(z0).all():
        raise CertificationError(f"z0 of the solution is not finite; {remedy}")
    if not all(
        isinstance(edge, (int, float)) and abs(edge) <= sys.float_info.max for edge in solution.span
    ):
        raise CertificationError(f"the span of the solution is not two finite times; {remedy}")
    if float(solution.span[0]) == float(solution.span[1]):
        raise CertificationError(f"the span of the solution is empty; {remedy}")
    require_exact(solution.trial, dim)


class _Proof:
    """What certifying and verifying have in common."""

    def __init__(self, solution: Solution, deadline: Deadline, progress: bool | None) -> None:
        _require_exact(solution)
        self._deadline, self._progress = deadline, progress
        self._span = float(solution.span[0]), float(solution.span[1])
        self._enclosures = Enclosures(solution.H)
        self._parts = segments(solution.trial, self._span)
        self._z0 = solution.z0
        self._scout: Scout = scout(solution.H, self._z0, self._span, solution.scale)
        start, end = map(Fraction, self._span)
        self._start, self._direction = start, 1 if end > start else -1
        self._total = abs(end - start)

    @property
    def floors(self) -> dict[str, np.ndarray]:
        """Differences of bounds that do not matter, in the units of each quantity."""
        energy = FLOOR if self._enclosures.time_dependent else _FLOOR_WITHOUT_REFERENCE
        floors = {
            "error": FLOOR * np.array(self._scout.scales),
            "energy": np.array(energy * self._scout.energy_scale),
            "ell": np.array(_FLOOR_WITHOUT_REFERENCE * self._scout.rate_scale),
        }
        # An infinite floor would make any bound good enough; below the smallest there is no bound.
        return {
            name: np.where(np.isfinite(value), value, 0.0).clip(SMALLEST)
            for name, value in floors.items()
        }

    def profile(
        self, comparison: Comparison, norm: Quantity, leaves: list[Leaf]
    ) -> dict[str, tuple[float, ...]]:
        """Times that divide the span into the pieces of the proof, and upper bounds there."""
        start, end = self._span
        joints = [self.time(place) for place in joints_of(leaves)]
        edges = tuple(dict.fromkeys((start, *joints, end)))
        # Edges are rounded to floats: a sliver of the next piece may belong to this one.
        bounds = [
            max(leaf.upper for leaf in part) for part in self.cuts(comparison, norm, leaves, edges)
        ]
        return {"edges": edges, "piece_bounds": tuple(rounded_up(bound) for bound in bounds)}

    def cuts(
        self,
        comparison: Comparison,
        norm: Quantity,
        leaves: list[Leaf],
        edges: Sequence[float],
    ) -> Iterator[list[Leaf]]:
        """For each piece between two edges, leaves that cover it and no more."""
        ordered = sorted(leaves, key=lambda leaf: leaf.centre)
        intervals = list(pairwise([self.elapsed(edge) for edge in edges]))
        for (low, high), part in zip(intervals, _within(ordered, intervals), strict=True):
            self._deadline.check("the pieces were bounded")
            yield comparison.cut(norm, part, low, high)

    def elapsed(self, t: float) -> Fraction:
        return self._direction * (Fraction(t) - self._start)

    def run(
        self, attempt: Callable[[Comparison], _Found], bits: int | None, accuracy: float
    ) -> tuple[int, _Found]:
        """The result of an attempt at a precision that is high enough, and that precision."""
        used = self._scout.bits if bits is None else bits
        reached = Fraction(-1)
        while True:
            if used > MOST_BITS:
                raise self._too_wild(self._scout.until(MOST_BITS))
            try:
                reference = self._reference(used)
                reached_accuracy = reference.accuracy(self._scout.scales)
                if not reached_accuracy <= accuracy:
                    raise PrecisionError(missing=math.log2(reached_accuracy / accuracy))
                comparison = Comparison(
                    self._enclosures, self._z0, self._parts, reference, self._deadline
                )
                return used, attempt(comparison)
            except PrecisionError as error:
                if bits is not None:
                    raise CertificationError(
                        f"{bits} bits are not enough; leave out bits, or give more"
                    ) from None
                if error.elapsed is not None:
                    # As many bits again bring no progress: so near a singularity none will.
                    if error.elapsed - reached < _PROGRESS * self._total:
                        raise self._too_wild(float(error.elapsed)) from None
                    reached = error.elapsed
                missing = used / 2 if error.missing is None else error.missing + _SPARE_BITS
            used += 32 * math.ceil(missing / 32)

    def _too_wild(self, elapsed: float) -> CertificationError:
        t = self.time(Fraction(elapsed))
        return CertificationError(
            f"nothing can be proven beyond about t = {t:.6g}: nearby solutions part too fast "
            "there, as near a collision, in an escape to infinity or in long chaos; end the span "
            "before"
        )

    def time(self, elapsed: Fraction) -> float:
        return float(self._start + self._direction * elapsed)

    def _reference(self, bits: int) -> Reference:
        with stepping_progress(_TICKS, self._progress) as advance:
            done = 0

            def report(part: float) -> None:
                nonlocal done
                now = int(part * _TICKS)
                advance(now - done)
                done = now

            return validated_reference(
                self._enclosures,
                self._z0,
                self._span,
                self._scout.units,
                bits,
                self._deadline,
                report,
            )
