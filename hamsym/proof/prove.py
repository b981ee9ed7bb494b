"""Certificates: proven bounds on the error of a neural trajectory.

Stage 1  H, J grad H and Hess become functions of balls (:mod:`hamsym.proof.enclosures`).
Stage 2  A validated integration encloses the exact solution, far more accurately than the neural
         trajectory (:mod:`hamsym.proof.taylor`).
Stage 3  The trajectory, as the real function that its weights define
         (:mod:`hamsym.proof.trials`), minus the exact solution is expanded
         (:mod:`hamsym.proof.expansions`) and bounded (:mod:`hamsym.proof.error_bounds`).
Stage 4  Upper bounds are rounded up and lower bounds down to the decimals of a
         :class:`Certificate`.

The docstrings of the modules of stages 2 and 3 contain the proof, with every inequality.

:func:`verify` repeats all of this from the solution, until the claims of the certificate are proven
or refuted. It assumes nothing in the certificate, and neither the claimed precision nor the size of
the certificate determines its run time.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np

from hamsym.archive import load_solution
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.balls import SMALLEST, at_least, at_most
from hamsym.proof.box_certificate import BoxCertificate
from hamsym.proof.box_proof import certify_box
from hamsym.proof.certificate import (
    FEWEST_BITS,
    FLOOR,
    LEAST_RTOL,
    MOST_BITS,
    MOST_RTOL,
    Certificate,
    check,
    rounded_down,
    rounded_up,
)
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.error_bounds import (
    ErrorBounds,
    Goal,
    Leaf,
    Quantity,
    Range,
    RefutedError,
    joints_of,
    quantities,
)
from hamsym.proof.limits import Deadline, PrecisionError
from hamsym.proof.presolve import Presolution, presolve
from hamsym.proof.taylor import SolutionEnclosure, enclose_solution
from hamsym.proof.trials import require_exact, segments
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require, require_number, require_positive, require_whole

__all__ = ["certify", "verify"]

_ACCURACY = 2.0**-62  # of the enclosure of the solution, in units of the components
_FLOOR_WITHOUT_SOLUTION = 2.0**-70  # floor of quantities that do not involve the exact solution
_PROGRESS = Fraction(1, 1_000)  # of the span: least gain of half as many bits again
_SPARE_BITS = 4
_TRIES = 2  # precisions, at least, before an undecided claim is rejected
# Default time limit of verify() in seconds: its own, per second of certify, and at most.
_PATIENCE, _PATIENCE_FACTOR, _MOST_PATIENCE = 60.0, 10.0, 600.0
_TICKS = 1_000  # of progress

_Found = TypeVar("_Found")


# -- proving ------------------------------------------------------------------------------------


@overload
def certify(
    solution: Solution,
    rtol: float = ...,
    time_limit: float | None = ...,
    bits: int | None = ...,
    progress: bool | None = ...,
) -> Certificate: ...


@overload
def certify(
    solution: FlowMap,
    *,
    box: Mapping[str, tuple[float, float]] | None = ...,
    time_limit: float | None = ...,
    max_parts: int = ...,
) -> BoxCertificate: ...


def certify(
    solution: Solution | FlowMap,
    rtol: float = 0.02,
    time_limit: float | None = None,
    bits: int | None = None,
    progress: bool | None = None,
    **options: Any,
) -> Certificate | BoxCertificate:
    """Compute rigorous bounds on the error of a solution, or of a flow map over a box.

    See :meth:`hamsym.Solution.certify` and :meth:`hamsym.FlowMap.certify` for the arguments.
    """
    if isinstance(solution, FlowMap):
        if (rtol, bits, progress) != (0.02, None, None):
            raise InputError(
                "rtol, bits and progress are not options for a flow map; give box, time_limit or "
                "max_parts"
            )
        return certify_box(solution, time_limit=time_limit, **options)
    if options:
        raise InputError(f"'{min(options)}' is not an option for a solution; leave it out")
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
        raise CertificationError(f"the solution has no digest for a certificate: {error}") from None
    goal = Goal(rtol)

    def attempt(bounds: ErrorBounds) -> tuple[list[Range], dict[str, tuple[float, ...]]]:
        found: list[Range] = []
        profile: dict[str, tuple[float, ...]] = {}
        leaves: list[Leaf] | None = None
        for quantity in quantities(proof.floors):
            found.append(bounds.refine(quantity, bounds.leaves(quantity, leaves), goal))
            leaves = found[-1].leaves
            profile = profile or proof.profile(bounds, quantity, leaves)
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
    """Accuracy that the enclosure of the solution needs, in units of the components."""
    return _ACCURACY * min(1.0, 50 * rtol)


def verify(
    certificate: Certificate | str,
    solution: Solution | str | os.PathLike[str],
    time_limit: float | None = None,
    progress: bool | None = None,
) -> None:
    """Repeat the proof from the solution and check every claim of a certificate.

    The precision is chosen as in :meth:`hamsym.Solution.certify`, independently of the certificate.
    While a claim is neither proven nor refuted, the precision grows by half, up to that of the
    certificate.

    Parameters
    ----------
    certificate : Certificate or str
        The text is that of :meth:`Certificate.to_json`.
    solution : Solution or path
        The path is that of a file written by :meth:`hamsym.Solution.save`.
    time_limit : float, optional
        Seconds. By default 60 s plus ten times the run time of certify, at most 600 s, because a
        forged certificate may claim any run time; give a limit for longer proofs.
    progress : bool, optional

    Raises
    ------
    CertificationError
        If a claim is not proven, naming the first one, or if the time limit is exceeded.
    FileError
        If the text is not a certificate, or the file cannot be read.
    InputError
        If an argument has another type.
    """
    if time_limit is not None:
        require_positive("time_limit", time_limit)
    if isinstance(certificate, str):
        certificate = Certificate.from_json(certificate)
    if not isinstance(certificate, Certificate):
        raise InputError(
            f"certificate must be a Certificate or its text, not {type(certificate).__name__}"
        )
    if isinstance(solution, (str, os.PathLike)):
        solution = load_solution(Path(solution))
    if not isinstance(solution, Solution):
        raise InputError(f"solution must be a Solution or a path, not {type(solution).__name__}")
    claims = certificate
    try:
        check(claims)
    except ValueError as error:
        raise CertificationError(f"not a valid certificate: {error}") from None
    _require_exact(solution)
    if digest(solution) != claims.digest:
        raise CertificationError(
            "the certificate does not belong to this solution (SHA-256 mismatch)"
        )
    if (claims.edges[0], claims.edges[-1]) != tuple(float(edge) for edge in solution.span):
        raise CertificationError("the certificate and the solution have different spans")
    if len(claims.component_bounds) != solution.H.dim:
        raise CertificationError("the certificate and the solution have different dimensions")
    proof = _Proof(solution, _deadline(time_limit, claims.seconds), progress)
    pairs = [
        (claims.bound, claims.lower),
        *zip(claims.component_bounds, claims.component_lowers, strict=True),
        (claims.energy_bound, claims.energy_lower),
        (claims.ell_max_bound, claims.ell_max_lower),
    ]

    tries = 0

    def attempt(bounds: ErrorBounds) -> None:
        nonlocal tries
        tries += 1
        last = tries >= _TRIES and bounds.bits >= claims.bits
        leaves: list[Leaf] | None = None
        found = quantities(proof.floors)
        for quantity, pair in zip(found, pairs, strict=True):
            leaves = bounds.leaves(quantity, leaves)
            leaves = _implied(bounds, quantity, leaves, pair, last).leaves
        norm = found[0]
        pieces = proof.cuts(bounds, norm, bounds.leaves(norm, leaves), claims.edges)
        for piece, claimed in zip(pieces, claims.piece_bounds, strict=True):
            _implied(bounds, norm, piece, (claimed, 0.0), last)

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
    bounds: ErrorBounds,
    quantity: Quantity,
    leaves: list[Leaf],
    pair: tuple[float, float],
    last: bool,
) -> Range:
    """Bounds at least as tight as a claimed pair (upper, lower).

    Raises
    ------
    PrecisionError
        If more bits may help, and this is not the last try.
    CertificationError
        If the claim is refuted, or not proven.
    """
    upper, lower = at_most(pair[0]), at_least(pair[1])
    try:
        found = bounds.refine(quantity, leaves, Goal(0.0, (upper, lower)))
        if found.upper <= upper and found.lower >= lower:  # False where H is singular along z^
            return found
    except RefutedError:
        pass
    except PrecisionError:
        if not last:
            raise
    raise CertificationError(
        f"the certificate does not hold: its claim about the {quantity.name} is not proven"
    )


def _within(
    ordered: list[Leaf], intervals: Iterable[tuple[Fraction, Fraction]]
) -> Iterator[list[Leaf]]:
    """For consecutive intervals, the leaves that overlap each of them."""
    first = 0
    for low, high in intervals:
        while first < len(ordered) and ordered[first].end <= low:
            first += 1
        last = first
        while last < len(ordered) and ordered[last].start < high:
            last += 1
        yield ordered[first:last]


def _require_exact(solution: Solution) -> None:
    """Require that z0, the span and all weights are finite numbers of exact types.

    Raises
    ------
    CertificationError
        Naming the first number that is not, and the remedy.
    """
    remedy = "solve again"
    z0, dim = solution.z0, solution.H.dim
    if not isinstance(z0, np.ndarray) or z0.dtype != np.float64 or z0.shape != (dim,):
        raise CertificationError(
            f"z0 of the solution is not an array of {dim} float64 numbers; {remedy}"
        )
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
    """The stages that certify and verify share."""

    def __init__(self, solution: Solution, deadline: Deadline, progress: bool | None) -> None:
        _require_exact(solution)
        self._deadline, self._progress = deadline, progress
        self._span = float(solution.span[0]), float(solution.span[1])
        self._enclosures = Enclosures(solution.H)
        self._parts = segments(solution.trial, self._span)
        self._z0 = solution.z0
        self._presolution: Presolution = presolve(solution.H, self._z0, self._span, solution.scale)
        start, end = map(Fraction, self._span)
        self._start, self._direction = start, 1 if end > start else -1
        self._total = abs(end - start)

    @property
    def floors(self) -> dict[str, np.ndarray]:
        """Differences of bounds that are always small enough, in the units of each quantity."""
        energy = FLOOR if self._enclosures.time_dependent else _FLOOR_WITHOUT_SOLUTION
        floors = {
            "error": FLOOR * np.array(self._presolution.scales),
            "energy": np.array(energy * self._presolution.energy_scale),
            "ell": np.array(_FLOOR_WITHOUT_SOLUTION * self._presolution.rate_scale),
        }
        # An infinite floor would accept any bound; SMALLEST is the smallest bound.
        return {
            name: np.where(np.isfinite(value), value, 0.0).clip(SMALLEST)
            for name, value in floors.items()
        }

    def profile(
        self, bounds: ErrorBounds, norm: Quantity, leaves: list[Leaf]
    ) -> dict[str, tuple[float, ...]]:
        """Edges of the pieces of the proof, and the upper bound on each piece."""
        start, end = self._span
        joints = [self.time(place) for place in joints_of(leaves)]
        edges = tuple(dict.fromkeys((start, *joints, end)))
        # Edges are rounded to floats, so that a piece may contain a narrow part of the next one.
        cuts = self.cuts(bounds, norm, leaves, edges)
        uppers = [max(leaf.upper for leaf in part) for part in cuts]
        return {"edges": edges, "piece_bounds": tuple(rounded_up(upper) for upper in uppers)}

    def cuts(
        self,
        bounds: ErrorBounds,
        norm: Quantity,
        leaves: list[Leaf],
        edges: Sequence[float],
    ) -> Iterator[list[Leaf]]:
        """Leaves that cover exactly each piece between two edges."""
        ordered = sorted(leaves, key=lambda leaf: leaf.centre)
        intervals = list(pairwise([self.elapsed(edge) for edge in edges]))
        for (low, high), part in zip(intervals, _within(ordered, intervals), strict=True):
            self._deadline.check("the pieces were bounded")
            yield bounds.cut(norm, part, low, high)

    def elapsed(self, t: float) -> Fraction:
        return self._direction * (Fraction(t) - self._start)

    def run(
        self, attempt: Callable[[ErrorBounds], _Found], bits: int | None, accuracy: float
    ) -> tuple[int, _Found]:
        """A sufficient precision, and the result of an attempt at it."""
        used = self._presolution.bits if bits is None else bits
        reached = Fraction(-1)
        while True:
            if used > MOST_BITS:
                raise self._separated(self._presolution.until(MOST_BITS))
            try:
                exact = self._solution(used)
                reached_accuracy = exact.accuracy(self._presolution.scales)
                if not reached_accuracy <= accuracy:
                    raise PrecisionError(missing=math.log2(reached_accuracy / accuracy))
                bounds = ErrorBounds(self._enclosures, self._z0, self._parts, exact, self._deadline)
                return used, attempt(bounds)
            except PrecisionError as error:
                if bits is not None:
                    raise CertificationError(
                        f"{bits} bits are not enough; give more, or omit bits"
                    ) from None
                if error.elapsed is not None:
                    # Near a singularity more bits bring no progress.
                    if error.elapsed - reached < _PROGRESS * self._total:
                        raise self._separated(float(error.elapsed)) from None
                    reached = error.elapsed
                missing = used / 2 if error.missing is None else error.missing + _SPARE_BITS
            used += 32 * math.ceil(missing / 32)

    def _separated(self, elapsed: float) -> CertificationError:
        t = self.time(Fraction(elapsed))
        return CertificationError(
            f"no bound beyond t = {t:.6g}: trajectories separate too fast (near-collision, escape "
            "or chaos); use an earlier end time"
        )

    def time(self, elapsed: Fraction) -> float:
        return float(self._start + self._direction * elapsed)

    def _solution(self, bits: int) -> SolutionEnclosure:
        with stepping_progress(_TICKS, self._progress) as advance:
            done = 0

            def report(part: float) -> None:
                nonlocal done
                now = int(part * _TICKS)
                advance(now - done)
                done = now

            return enclose_solution(
                self._enclosures,
                self._z0,
                self._span,
                self._presolution.units,
                bits,
                self._deadline,
                report,
            )
